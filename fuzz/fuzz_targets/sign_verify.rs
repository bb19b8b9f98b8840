//! What is signed has the right bytes, and verifies.
#![no_main]

libfuzzer_sys::fuzz_target!(
    |input: mavseal_fuzz::frames::ToSign<'_>| mavseal_fuzz::sign_verify(&input)
);
