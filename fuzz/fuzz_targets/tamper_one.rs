//! Any change of a signed frame is rejected.
//! Properties: V1, S2.
//!
//! Compares a changed frame with the signed one: rejected, also with its checksum repaired.
#![no_main]

use mavseal_fuzz::frames::Tampered;

libfuzzer_sys::fuzz_target!(|input: Tampered<'_>| mavseal_fuzz::tamper_one(input));
