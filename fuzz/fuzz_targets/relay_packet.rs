//! The relay passes on a packet as it should.
#![no_main]

libfuzzer_sys::fuzz_target!(
    |input: mavseal_fuzz::frames::Packaged<'_>| mavseal_fuzz::relay_packet(&input)
);
