//! Nothing foreign is signed, obeyed or handed on, nothing twice, and honest frames get through in time.
//! Properties: D1, D2, D3.
//!
//! Plays a history of link, payloads, power, flash and old keys against three devices as the firmware builds them.
#![no_main]

use mavseal_fuzz::devices::Devices;

libfuzzer_sys::fuzz_target!(|input: Devices| mavseal_fuzz::adversary(input));
