//! An end of a sealed link uses no counter and opens no package twice, wherever its power fails.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::ends::Ends<'_>| mavseal_fuzz::sealed_end(&input));
