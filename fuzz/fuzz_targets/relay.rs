//! The relay between two pipes, against its parts in sequence.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::streams::Piped<'_>| mavseal_fuzz::relay(&input));
