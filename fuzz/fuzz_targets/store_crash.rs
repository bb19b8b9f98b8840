//! The mark in flash is above everything that was used, wherever the power failed.
//! Properties: T2.
//!
//! Compares the mark in flash, over runs that end wherever the power fails and with words that cannot be read, with
//! what was used.
#![no_main]

use mavseal_fuzz::memory::Runs;

libfuzzer_sys::fuzz_target!(|input: Runs| mavseal_fuzz::store_crash(input));
