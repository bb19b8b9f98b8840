//! What a receiver of several senders accepts, against a naive model.
#![no_main]

libfuzzer_sys::fuzz_target!(
    |input: mavseal_fuzz::senders::Arrivals| mavseal_fuzz::streams_model(&input)
);
