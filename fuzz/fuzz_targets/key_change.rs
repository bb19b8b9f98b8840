//! While a key is changed, never are both ends deaf.
//! Properties: K1.
//!
//! Compares both ends of a link whose key is changed, through losses, restarts and failed stores, with what
//! they must hear.
#![no_main]

use mavseal_fuzz::memory::Change;

libfuzzer_sys::fuzz_target!(|input: Change| mavseal_fuzz::key_change(input));
