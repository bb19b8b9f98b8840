//! The checksum is the one of its definition; the table is searched without a gap.
//! Properties: C1, C2.
//!
//! Compares the checksum with its definition and the crate crc; the search of the table with a walk through
//! it.
#![no_main]

use mavseal_fuzz::values::Checked;

libfuzzer_sys::fuzz_target!(|input: Checked<'_>| mavseal_fuzz::checksum_table(input));
