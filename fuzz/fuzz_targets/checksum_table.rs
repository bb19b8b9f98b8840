//! The checksum is the one of its definition; the table is searched without a gap.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::values::Checked<'_>| {
    mavseal_fuzz::checksum_table(&input)
});
