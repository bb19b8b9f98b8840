//! Any packet, its checksum and tag made right or not, is accepted as specified.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::frames::Packaged<'_>| {
    mavseal_fuzz::verify_repaired(&input)
});
