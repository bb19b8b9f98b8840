//! The standard's signature is the one of the crate `mavlink`.
//! Properties: S3.
//!
//! Compares the standard's tag, and what is accepted with it, with the crate mavlink-core; the tag with the
//! crate hmac-sha256.
#![no_main]

use mavseal_fuzz::standard::Foreign;

libfuzzer_sys::fuzz_target!(|input: Foreign<'_>| mavseal_fuzz::diff_standard(input));
