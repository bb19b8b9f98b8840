//! What the bytes of a frame say, read by hand: properties do not ask the code under test.

use mavlink_signing::crc::checksum;
use mavlink_signing::dialect::crc_extra;
use mavlink_signing::field::{CHECKSUM_SIZE, HEADER_SIZE};
use mavlink_signing::{MessageId, SignError};

/// Whether both bytes of the checksum are right, in a whole frame. C1 says what the checksum is.
pub(crate) fn checksum_is_right(frame: &[u8], crc_extra: u8) -> bool {
    let at = HEADER_SIZE + usize::from(frame[1]);
    let expected = checksum(&frame[1..at], crc_extra);
    let written = [frame[at], frame[at + CHECKSUM_SIZE - 1]];
    u16::from(written[0]) | u16::from(written[1]) << 8 == expected
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
