//! AES-128-GCM with tags of 8 bytes is that of another implementation.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::sealed::Gcm<'_>| mavseal_fuzz::diff_gcm(&input));
