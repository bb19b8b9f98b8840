//! Any text is read as a key file without a panic, and kept as it was read.
//! Properties: none.
//!
//! Compares any text, as TOML and as Keys.mk, with what is written of it again; errors with what they may
//! show.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mavseal_fuzz::key_file(bytes));
