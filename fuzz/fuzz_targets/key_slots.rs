//! While keys in flash are changed, and its power fails, never are both ends deaf.
//! Properties: K1.
//!
//! Compares what both ends hear, with keys in flash and power that fails inside its writes, with what they
//! must; which keys and regions are
//! taken with what is specified.
#![no_main]

use mavseal_fuzz::flash::Slots;

libfuzzer_sys::fuzz_target!(|input: Slots| mavseal_fuzz::key_slots(input));
