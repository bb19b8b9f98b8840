//! What a receiver of several senders accepts, against a naive model.
//! Properties: R2.
//!
//! Compares what a receiver accepts of several senders (any order, repetition, reflection, forgery, clocks
//! that jump), and what it remembers, with a naive model.
#![no_main]

use mavseal_fuzz::senders::Arrivals;

libfuzzer_sys::fuzz_target!(|input: Arrivals| mavseal_fuzz::streams_model(input));
