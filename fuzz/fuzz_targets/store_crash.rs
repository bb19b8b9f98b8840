//! The mark in flash is above everything that was used, wherever the power failed.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::memory::Runs| mavseal_fuzz::store_crash(&input));
