//! W3: the decoder, one step and whole streams.

use mavlink_signing::field::MAX_FRAME_SIZE;
use mavlink_signing::{DecodeError, MessageId, Packet, ParseError};

/// W3, one step: whatever stands at the front of the decoder's buffer is a packet that lies in it,
/// a fault, or too short; it is never too short when the buffer is full, so the decoder always goes
/// on. Returns what it is, and the packet's length.
///
/// # Errors
///
/// What [`Packet::parse`] says.
///
/// # Panics
///
/// If the property does not hold.
pub fn front(
    buffer: &[u8],
    crc_extra: impl FnOnce(MessageId) -> Option<u8>,
) -> Result<usize, DecodeError> {
    let parsed = Packet::parse(buffer, crc_extra);
    match parsed {
        Ok(packet) => {
            let length = packet.as_bytes().len();
            assert!((8..=MAX_FRAME_SIZE).contains(&length));
            assert!(length <= buffer.len());
            assert_eq!(packet.as_bytes().as_ptr(), buffer.as_ptr());
            match packet {
                Packet::Mavlink2(frame) => assert_eq!(frame.as_bytes()[0], 0xFD),
                Packet::Mavlink1(packet) => {
                    assert_eq!(packet.as_bytes()[0], 0xFE);
                    assert_eq!(length, 8 + packet.as_bytes()[1] as usize);
                }
            }
            Ok(length)
        }
        Err(error) => {
            let truncated = error == DecodeError::Parse(ParseError::Truncated);
            assert!(!truncated || buffer.len() < MAX_FRAME_SIZE);
            Err(error)
        }
    }
}

#[cfg(test)]
mod twins {
    use super::*;
    use mavlink_signing::dialect::crc_extra;
    use mavlink_signing::{Decoder, Frame, Resync};
    use proptest::prelude::*;

    /// Streams of frames, damaged ones, magic bytes and noise.
    fn stream() -> impl Strategy<Value = Vec<u8>> {
        let bytes = proptest::collection::vec(any::<u8>(), 0..40);
        let frame = (
            proptest::collection::vec(any::<u8>(), 0..=255),
            any::<bool>(),
        )
            .prop_map(|(payload, damaged)| {
                let frame = Frame::new(crate::HEARTBEAT, &payload).expect("a frame");
                let mut bytes = frame.as_bytes().to_vec();
                bytes[4] ^= u8::from(damaged);
                bytes
            });
        let magic = Just(vec![0xFD, 0xFE]);
        proptest::collection::vec(prop_oneof![bytes, frame, magic], 0..12)
            .prop_map(|parts| parts.concat())
    }

    /// What is found in `stream`, given to the decoder in pieces whose lengths repeat `cuts`; at
    /// the end the line is silent.
    fn decode(stream: &[u8], cuts: &[usize]) -> (Vec<Vec<u8>>, usize) {
        let mut decoder = Decoder::new(Resync::NextByte, crc_extra);
        let mut cuts = cuts.iter().copied().cycle();
        let mut rest = stream;
        let mut packets = Vec::new();
        let mut faults = 0;
        loop {
            while let Some(decoded) = decoder.read() {
                match decoded {
                    Ok(packet) => packets.push(packet.as_bytes().to_vec()),
                    Err(_) => faults += 1,
                }
            }
            if rest.is_empty() {
                break;
            }
            assert!(decoder.room() > 0, "the decoder is stuck");
            let piece = &rest[..rest.len().min(cuts.next().expect("a cycle"))];
            rest = &rest[decoder.write(piece)..];
        }
        decoder.idle();
        while let Some(decoded) = decoder.read() {
            match decoded {
                Ok(packet) => packets.push(packet.as_bytes().to_vec()),
                Err(_) => faults += 1,
            }
        }
        let in_packets: usize = packets.iter().map(Vec::len).sum();
        assert_eq!(in_packets + decoder.dropped() as usize, stream.len());
        (packets, faults)
    }

    proptest! {
        #[test]
        fn w3_cut_does_not_matter(
            stream in stream(),
            cuts in proptest::collection::vec(1..400_usize, 1..6),
        ) {
            prop_assert_eq!(decode(&stream, &cuts), decode(&stream, &[usize::MAX]));
        }

        #[test]
        fn w3_front(bytes in stream(), length in 0..=MAX_FRAME_SIZE) {
            let bytes = &bytes[..length.min(bytes.len())];
            for at in 0..=bytes.len() {
                let _ = front(&bytes[at..], crc_extra);
            }
        }
    }
}

#[cfg(kani)]
mod harness {
    use super::*;
    use crate::model::{any_prefix, set_checksum};

    #[kani::proof]
    #[kani::unwind(9)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn w3_front() {
        set_checksum(kani::any());
        let buffer: [u8; MAX_FRAME_SIZE] = kani::any();
        let buffer = any_prefix(&buffer);
        let extra: Option<u8> = kani::any();
        let found = front(buffer, |_| extra);
        kani::cover!(found == Ok(MAX_FRAME_SIZE), "the longest frame");
        kani::cover!(
            found == Ok(263),
            "the longest packet of MAVLink 1, or a frame"
        );
        kani::cover!(found == Ok(8), "the shortest packet");
        kani::cover!(
            found == Err(DecodeError::Parse(ParseError::Truncated)),
            "more is needed"
        );
        kani::cover!(
            matches!(found, Err(DecodeError::BadChecksum(_))),
            "a bad checksum"
        );
        kani::cover!(
            matches!(found, Err(DecodeError::UnknownMessage(_))),
            "an unknown message"
        );
    }
}
