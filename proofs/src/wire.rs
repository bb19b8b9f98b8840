//! What the bytes of a frame say, read by hand: properties do not ask the code under test.

use mavlink_signing::crc::checksum;
use mavlink_signing::dialect::crc_extra;
use mavlink_signing::field::{HEADER_SIZE, HEADER_SIZE_V1, MAGIC_V1};
use mavlink_signing::{MessageId, SignError};

/// Whether both bytes of the checksum are right, of the whole packet at the front of `bytes`, of either
/// version. C1 says what the checksum is.
pub(crate) fn checksum_is_right(bytes: &[u8], crc_extra: u8) -> bool {
    let header = if bytes[0] == MAGIC_V1 {
        HEADER_SIZE_V1
    } else {
        HEADER_SIZE
    };
    let at = header + usize::from(bytes[1]);
    let expected = checksum(&bytes[1..at], crc_extra);
    u16::from(bytes[at]) | u16::from(bytes[at + 1]) << 8 == expected
}

/// Why a whole frame is not known and undamaged, unless it is: then the CRC_EXTRA of its message.
pub(crate) fn known_and_undamaged(frame: &[u8]) -> Result<u8, SignError> {
    let id = MessageId::from_le_bytes([frame[7], frame[8], frame[9]]);
    let extra = crc_extra(id).ok_or(SignError::UnknownMessage(id))?;
    if checksum_is_right(frame, extra) {
        Ok(extra)
    } else {
        Err(SignError::BadChecksum)
    }
}
