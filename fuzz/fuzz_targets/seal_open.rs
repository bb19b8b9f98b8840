//! No nonce comes twice, and what is sealed opens.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::sealed::Sealing| mavseal_fuzz::seal_open(&input));
