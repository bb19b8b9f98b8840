//! Any packet, its checksum and tag made right or not, is accepted as specified.
//! Properties: V1, S2.
//!
//! Compares a packet, made right as far as its input says and then damaged: the verdict with what is
//! specified.
#![no_main]

use mavseal_fuzz::frames::Packaged;

libfuzzer_sys::fuzz_target!(|input: Packaged<'_>| mavseal_fuzz::verify_repaired(input));
