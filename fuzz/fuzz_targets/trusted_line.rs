//! What lies inside a payload never becomes a packet, on a line that is trusted.
//! Properties: D1.
//!
//! Compares what comes out of a line, damaged in one place, with the packets that were sent.
#![no_main]

use mavseal_fuzz::streams::Trusted;

libfuzzer_sys::fuzz_target!(|input: Trusted<'_>| mavseal_fuzz::trusted_line(input));
