//! Stamps and accepted timestamps strictly increase.
//! Properties: T1, R1, R3.
//!
//! Compares two stamps of a sender, and one step of a receiver, with what they must be; also with a memory
//! that may fail, and after a restart.
#![no_main]

use mavseal_fuzz::values::Clocks;

libfuzzer_sys::fuzz_target!(|input: Clocks| mavseal_fuzz::stamps(input));
