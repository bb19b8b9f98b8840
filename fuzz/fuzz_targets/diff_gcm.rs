//! AES-128-GCM with tags of 8 bytes is that of another implementation.
//! Properties: N1, O2.
//!
//! Compares what is sealed, and its tag, with the crate ring; which keys are none.
#![no_main]

use mavseal_fuzz::sealed::Gcm;

libfuzzer_sys::fuzz_target!(|input: Gcm<'_>| mavseal_fuzz::diff_gcm(input));
