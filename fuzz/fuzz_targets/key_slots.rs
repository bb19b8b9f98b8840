//! While keys in flash are changed, and its power fails, never are both ends deaf.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::flash::Slots| mavseal_fuzz::key_slots(&input));
