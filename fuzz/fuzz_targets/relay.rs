//! The relay between two pipes, against its parts in sequence.
//! Properties: L1.
//!
//! Compares the relay between two pipes, both ways, with its parts in sequence.
#![no_main]

use mavseal_fuzz::streams::Piped;

libfuzzer_sys::fuzz_target!(|input: Piped<'_>| mavseal_fuzz::relay(input));
