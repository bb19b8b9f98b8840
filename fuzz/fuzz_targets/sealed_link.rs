//! A vehicle and two stations hear each package once, whatever the link does.
#![no_main]

libfuzzer_sys::fuzz_target!(
    |input: mavseal_fuzz::sealed::History| mavseal_fuzz::sealed_link(&input)
);
