//! Any change of a signed frame is rejected.
#![no_main]

libfuzzer_sys::fuzz_target!(
    |input: mavseal_fuzz::frames::Tampered<'_>| mavseal_fuzz::tamper_one(&input)
);
