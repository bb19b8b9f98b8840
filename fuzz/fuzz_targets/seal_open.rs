//! No nonce comes twice, and what is sealed opens.
//! Properties: N1.
//!
//! Compares two packages with what they must be sealed under, in both formats; what is opened with what was
//! sealed.
#![no_main]

use mavseal_fuzz::sealed::Sealing;

libfuzzer_sys::fuzz_target!(|input: Sealing| mavseal_fuzz::seal_open(input));
