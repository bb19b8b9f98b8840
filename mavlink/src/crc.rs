//! The X.25 checksum of a MAVLink packet: CRC-16/MCRF4XX.

/// The checksum's value before the first byte.
pub const INITIAL: u16 = 0xFFFF;

/// The checksum after one more byte.
///
/// Polynomial x^16 + x^12 + x^5 + 1, reflected, without table (MAVLink guide, "Packet
/// Serialization", checksum).
#[must_use]
pub const fn step(crc: u16, byte: u8) -> u16 {
    let [low, high] = crc.to_le_bytes();
    let mixed = byte ^ low;
    let mixed = mixed ^ (mixed << 4);
    let wide = mixed as u16;
    high as u16 ^ (wide << 8) ^ (wide << 3) ^ (wide >> 4)
}

/// The checksum of a packet.
///
/// `covered` is everything between the magic byte and the checksum. `crc_extra` is the byte that the
/// message's definition adds. So two ends with different definitions do not understand each other by
/// accident (MAVLink guide, "Packet Serialization", CRC_EXTRA).
#[must_use]
pub fn checksum(covered: &[u8], crc_extra: u8) -> u16 {
    #[cfg(feature = "fast-checksum")]
    let crc = by_tables(covered);
    #[cfg(not(feature = "fast-checksum"))]
    let crc = fold(covered);
    step(crc, crc_extra)
}

/// The checksum of `covered` alone, byte by byte: no table.
#[must_use]
pub fn fold(covered: &[u8]) -> u16 {
    covered.iter().fold(INITIAL, |crc, &byte| step(crc, byte))
}

/// The same, 16 bytes at a time: 8 KB of tables.
#[cfg(feature = "fast-checksum")]
fn by_tables(covered: &[u8]) -> u16 {
    use crcxx::crc16::{Crc, LookupTable256xN, catalog::CRC_16_MCRF4XX};
    static TABLES: Crc<LookupTable256xN<16>> = Crc::<LookupTable256xN<16>>::new(&CRC_16_MCRF4XX);
    TABLES.compute(covered)
}
