//! The tag is the one of another HMAC-SHA256.
//! Properties: S3.
//!
//! Compares the tag with the crate hmac-sha256; which keys are none.
#![no_main]

use mavseal_fuzz::values::Keyed;

libfuzzer_sys::fuzz_target!(|input: Keyed<'_>| mavseal_fuzz::diff_hmac(input));
