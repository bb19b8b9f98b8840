//! Any bytes are parsed, and accepted as specified.
//! Properties: W1, V1, V2.
//!
//! Compares any bytes: parsing, and the verdict, with what is specified; shared state with local state.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mavseal_fuzz::verify_frame(bytes));
