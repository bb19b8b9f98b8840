//! The relay passes on a packet as it should.
//! Properties: L1, V1, V2.
//!
//! Compares what the relay's two directions make of a packet with the verdict on it.
#![no_main]

use mavseal_fuzz::frames::Packaged;

libfuzzer_sys::fuzz_target!(|input: Packaged<'_>| mavseal_fuzz::relay_packet(input));
