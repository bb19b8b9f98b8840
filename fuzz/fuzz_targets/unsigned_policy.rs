//! Unsigned frames are let through as a policy says, which is asked about nothing else.
//! Properties: U1.
//!
//! Compares what a policy is asked, and what it lets through, with what is specified, also in the relay.
#![no_main]

use mavseal_fuzz::unsigned::Asked;

libfuzzer_sys::fuzz_target!(|input: Asked<'_>| mavseal_fuzz::unsigned_policy(input));
