//! Any bytes are parsed, and accepted as specified.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mavseal_fuzz::verify_frame(bytes));
