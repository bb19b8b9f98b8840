//! A package is accepted as specified, and its message comes out as it was.
//! Properties: O1, O2.
//!
//! Compares a package of any bytes, or made right in parts: the verdict with what is specified, the message
//! with what was sealed.
#![no_main]

use mavseal_fuzz::sealed::Arrival;

libfuzzer_sys::fuzz_target!(|input: Arrival<'_>| mavseal_fuzz::open_package(input));
