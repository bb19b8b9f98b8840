//! A key goes over a cable, and not to a log.
//! Properties: M1.
//!
//! Compares the message that carries a key with its definition; what is logged of it and of any frame with
//! what may be.
#![no_main]

use mavseal_fuzz::unsigned::Shared;

libfuzzer_sys::fuzz_target!(|input: Shared<'_>| mavseal_fuzz::setup_signing(input));
