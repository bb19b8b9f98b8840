//! Packets go into messages and come out again whole.
#![no_main]

libfuzzer_sys::fuzz_target!(
    |input: mavseal_fuzz::sealed::Packets| mavseal_fuzz::pack_packets(&input)
);
