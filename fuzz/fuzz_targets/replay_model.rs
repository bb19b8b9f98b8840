//! What a link accepts, against a naive model.
#![no_main]

libfuzzer_sys::fuzz_target!(
    |input: mavseal_fuzz::streams::History| mavseal_fuzz::replay_model(&input)
);
