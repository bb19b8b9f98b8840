//! The tag is the one of another HMAC-SHA256.
#![no_main]

libfuzzer_sys::fuzz_target!(
    |input: mavseal_fuzz::values::Keyed<'_>| mavseal_fuzz::diff_hmac(&input)
);
