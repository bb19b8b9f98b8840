//! What a link accepts, against a naive model.
//! Properties: R1, T1.
//!
//! Compares a link's whole history (loss, repetition, reordering, damage, clocks that jump) with a naive
//! model.
#![no_main]

use mavseal_fuzz::streams::History;

libfuzzer_sys::fuzz_target!(|input: History| mavseal_fuzz::replay_model(input));
