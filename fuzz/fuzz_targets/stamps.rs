//! Stamps and accepted timestamps strictly increase.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::values::Clocks| mavseal_fuzz::stamps(&input));
