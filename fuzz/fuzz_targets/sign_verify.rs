//! What is signed has the right bytes, and verifies.
//! Properties: W2, S1, S2, V3.
//!
//! Compares what is emitted, signed and verified with the bytes that the guide asks for.
#![no_main]

use mavseal_fuzz::frames::ToSign;

libfuzzer_sys::fuzz_target!(|input: ToSign<'_>| mavseal_fuzz::sign_verify(input));
