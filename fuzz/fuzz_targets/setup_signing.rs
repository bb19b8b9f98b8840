//! A key goes over a cable, and not to a log.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::unsigned::Shared<'_>| {
    mavseal_fuzz::setup_signing(&input)
});
