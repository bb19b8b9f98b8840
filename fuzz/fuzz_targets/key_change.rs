//! While a key is changed, never are both ends deaf.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::memory::Change| mavseal_fuzz::key_change(&input));
