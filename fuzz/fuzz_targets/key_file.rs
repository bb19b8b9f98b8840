//! Any text is read as a key file without a panic, and kept as it was read.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mavseal_fuzz::key_file(bytes));
