//! W1: parsing takes any bytes.

use mavlink_signing::field::{CHECKSUM_SIZE, HEADER_SIZE, MAGIC, SIGNATURE_SIZE, SIGNED_FLAG};
use mavlink_signing::{FrameRef, ParseError};

use crate::wire::checksum_is_right;

/// W1: `bytes` are parsed or rejected without a panic. A frame is the front of `bytes`, exactly as long
/// as its header says. Every accessor agrees with the bytes, the one about the checksum with both of its
/// bytes. An error is the first thing that is wrong. Returns the frame's length.
///
/// # Errors
///
/// What [`FrameRef::parse`] says.
///
/// # Panics
///
/// If the property does not hold.
pub fn parse_any(bytes: &[u8], crc_extra: u8) -> Result<usize, ParseError> {
    let frame = match FrameRef::parse(bytes) {
        Ok(frame) => frame,
        Err(error) => {
            assert_eq!(error, first_fault(bytes));
            return Err(error);
        }
    };
    let length = frame.as_bytes().len();
    assert!(length <= bytes.len());
    assert_eq!(frame.as_bytes().as_ptr(), bytes.as_ptr());

    let signed = bytes[2] == SIGNED_FLAG;
    let trailer = if signed { SIGNATURE_SIZE } else { 0 };
    assert_eq!(
        length,
        HEADER_SIZE + bytes[1] as usize + CHECKSUM_SIZE + trailer
    );

    let header = frame.header();
    assert_eq!(header.compat_flags, bytes[3]);
    assert_eq!(header.sequence, bytes[4]);
    assert_eq!(header.system_id, bytes[5]);
    assert_eq!(header.component_id, bytes[6]);
    assert_eq!(
        header.message_id.to_le_bytes(),
        [bytes[7], bytes[8], bytes[9]]
    );

    assert_eq!(frame.is_signed(), signed);
    match frame.signature() {
        None => assert!(!signed),
        Some(signature) => {
            assert!(signed);
            let at = length - SIGNATURE_SIZE;
            assert_eq!(signature.stamp.link_id, bytes[at]);
            let ticks = signature.stamp.timestamp.ticks().to_le_bytes();
            for (i, byte) in ticks.into_iter().enumerate() {
                assert_eq!(byte, if i < 6 { bytes[at + 1 + i] } else { 0 });
            }
            for (i, byte) in signature.tag.into_iter().enumerate() {
                assert_eq!(byte, bytes[at + 7 + i]);
            }
        }
    }
    assert_eq!(
        frame.checksum_matches(crc_extra),
        checksum_is_right(bytes, crc_extra)
    );
    Ok(length)
}

/// Why bytes that are no frame are none.
fn first_fault(bytes: &[u8]) -> ParseError {
    if bytes.first().is_some_and(|magic| *magic != MAGIC) {
        ParseError::BadMagic(bytes[0])
    } else if bytes.len() >= HEADER_SIZE && bytes[2] & !SIGNED_FLAG != 0 {
        ParseError::UnknownIncompatFlags(bytes[2])
    } else {
        ParseError::Truncated
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use mavlink_signing::Frame;
    use proptest::prelude::*;

    /// Bytes that often begin like a frame.
    fn bytes() -> impl Strategy<Value = Vec<u8>> {
        let head = (
            prop_oneof![9 => Just(MAGIC), 1 => any::<u8>()],
            any::<u8>(),
            prop_oneof![4 => Just(0), 4 => Just(1), 1 => any::<u8>()],
        );
        (head, proptest::collection::vec(any::<u8>(), 0..300)).prop_map(|((a, b, c), rest)| {
            let mut bytes = vec![a, b, c];
            bytes.extend(rest);
            bytes
        })
    }

    proptest! {
        #[test]
        fn w1_random(bytes in bytes(), crc_extra: u8) {
            let _ = parse_any(&bytes, crc_extra);
        }
    }

    /// Each bit behind the length: what an accessor says of the checksum follows both of its bytes.
    #[test]
    fn w1_each_bit() {
        let frame = Frame::new(HEARTBEAT, &[1, 2, 3]).expect("a frame");
        assert_eq!(parse_any(frame.as_bytes(), 50), Ok(15));
        for place in 2..frame.as_bytes().len() {
            for bit in 0..8 {
                let mut bytes = frame.as_bytes().to_vec();
                bytes[place] ^= 1 << bit;
                let _ = parse_any(&bytes, 50);
            }
        }
    }

    #[test]
    fn w1_every_length_of_every_cut() {
        for payload_length in 0..=255 {
            for flags in 0..=2 {
                let mut bytes = [0x55; 283];
                bytes[..3].copy_from_slice(&[MAGIC, payload_length, flags]);
                for cut in 0..=bytes.len() {
                    let _ = parse_any(&bytes[..cut], 50);
                }
            }
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::any_prefix;

    /// Longer than the longest frame, 280 bytes: every frame, and bytes behind it.
    const LENGTH: usize = 300;

    #[kani::proof]
    #[kani::unwind(8)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn w1_parse_any() {
        let bytes: [u8; LENGTH] = kani::any();
        let bytes = any_prefix(&bytes);
        let crc_extra = kani::any();
        let parsed = parse_any(bytes, crc_extra);
        let right = |length| parsed == Ok(length) && checksum_is_right(bytes, crc_extra);
        kani::cover!(right(280), "undamaged");
        kani::cover!(parsed == Ok(280) && !right(280), "damaged");
        kani::cover!(parsed == Ok(280), "the longest frame");
        kani::cover!(parsed == Ok(12), "the shortest frame");
        kani::cover!(parsed == Err(ParseError::Truncated), "truncated");
        kani::cover!(matches!(parsed, Err(ParseError::BadMagic(_))), "bad magic");
        kani::cover!(
            matches!(parsed, Err(ParseError::UnknownIncompatFlags(_))),
            "flags"
        );
    }
}
