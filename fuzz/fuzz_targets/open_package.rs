//! A package is accepted as specified, and its message comes out as it was.
#![no_main]

libfuzzer_sys::fuzz_target!(
    |input: mavseal_fuzz::sealed::Arrival<'_>| mavseal_fuzz::open_package(&input)
);
