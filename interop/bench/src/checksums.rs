//! Published implementations of CRC-16/MCRF4XX: those with the fastest algorithm of each crate.

use crcxx::crc16::{self as slices, catalog};

/// A way to compute the checksum.
pub trait Checksum {
    /// Its crate, and which of its algorithms.
    const NAME: &'static str;

    /// The checksum of `bytes`.
    fn of(bytes: &[u8]) -> u16;
}

/// Of the crate `crc`, with 16 tables.
pub struct Crc16Tables;
/// Of the crate `crcxx`, with 8 tables.
pub struct Crcxx8Tables;
/// Of the crate `crcxx`, with 16 tables.
pub struct Crcxx16Tables;
/// Of the crate `crc-fast`, with the processor's wide instructions.
pub struct CrcFast;
/// Of the crate `crc-any`, with one table: what the peers use.
pub struct CrcAny;
/// Of the crate `crc16`, with one table.
pub struct Crc16;

static CRC: crc::Crc<u16, crc::Table<16>> =
    crc::Crc::<u16, crc::Table<16>>::new(&crc::CRC_16_MCRF4XX);
static CRCXX_8: slices::Crc<slices::LookupTable256xN<8>> =
    slices::Crc::<slices::LookupTable256xN<8>>::new(&catalog::CRC_16_MCRF4XX);
static CRCXX_16: slices::Crc<slices::LookupTable256xN<16>> =
    slices::Crc::<slices::LookupTable256xN<16>>::new(&catalog::CRC_16_MCRF4XX);

impl Checksum for Crc16Tables {
    const NAME: &'static str = "crc, 16 tables";

    fn of(bytes: &[u8]) -> u16 {
        CRC.checksum(bytes)
    }
}

impl Checksum for Crcxx8Tables {
    const NAME: &'static str = "crcxx, 8 tables";

    fn of(bytes: &[u8]) -> u16 {
        CRCXX_8.compute(bytes)
    }
}

impl Checksum for Crcxx16Tables {
    const NAME: &'static str = "crcxx, 16 tables";

    fn of(bytes: &[u8]) -> u16 {
        CRCXX_16.compute(bytes)
    }
}

impl Checksum for CrcFast {
    const NAME: &'static str = "crc-fast";

    fn of(bytes: &[u8]) -> u16 {
        crc_fast::checksum(crc_fast::CrcAlgorithm::Crc16Mcrf4xx, bytes) as u16
    }
}

impl Checksum for CrcAny {
    const NAME: &'static str = "crc-any";

    fn of(bytes: &[u8]) -> u16 {
        // Its name of the algorithm has a slip of the pen.
        let mut crc = crc_any::CRCu16::crc16mcrf4cc();
        crc.digest(bytes);
        crc.get_crc()
    }
}

impl Checksum for Crc16 {
    const NAME: &'static str = "crc16";

    fn of(bytes: &[u8]) -> u16 {
        crc16::State::<crc16::MCRF4XX>::calculate(bytes)
    }
}
