//! A vehicle and two stations hear each package once, whatever the link does.
//! Properties: O1, N1, F1.
//!
//! Compares whole histories of a vehicle and two stations (loss, repetition, reordering, damage, noise,
//! restarts), in both formats, with a naive model.
#![no_main]

use mavseal_fuzz::sealed::History;

libfuzzer_sys::fuzz_target!(|input: History| mavseal_fuzz::sealed_link(input));
