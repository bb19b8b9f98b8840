//! W3: the decoder, one step and whole streams.

use core::cell::Cell;

use mavlink_signing::field::{MAGIC_V1, MAX_FRAME_SIZE};
use mavlink_signing::{DecodeError, Decoder, MessageId, Packet, ParseError, Resync, dialect};

use crate::wire::checksum_is_right;

/// W3, one step: whatever stands at the front of the decoder's buffer is a packet that lies in it, a
/// fault, or too short. It is never too short when the buffer is full, so the decoder always goes on. A
/// packet is known, and both bytes of its checksum are right; a fault says what is wrong. Returns what
/// it is, and the packet's length.
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
    let asked = Cell::new(None);
    let parsed = Packet::parse(buffer, |id| {
        let extra = crc_extra(id);
        asked.set(Some((id, extra)));
        extra
    });
    let right = match asked.get() {
        Some((id, Some(extra))) => {
            assert_eq!(id, id_of(buffer));
            Some(checksum_is_right(buffer, extra))
        }
        _ => None,
    };
    match parsed {
        Ok(packet) => {
            assert_eq!(right, Some(true));
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
            match error {
                DecodeError::UnknownMessage(id) => assert_eq!(asked.get(), Some((id, None))),
                DecodeError::BadChecksum(id) => {
                    assert_eq!(right, Some(false));
                    assert_eq!(id, id_of(buffer));
                }
                _ => assert_eq!(asked.get(), None),
            }
            Err(error)
        }
    }
}

/// Which message the packet at the front of `bytes` carries, of either version.
fn id_of(bytes: &[u8]) -> MessageId {
    if bytes[0] == MAGIC_V1 {
        bytes[5].into()
    } else {
        MessageId::from_le_bytes([bytes[7], bytes[8], bytes[9]])
    }
}

/// W3, in: whatever the decoder holds, it takes a byte if it said that it has room. A deaf one drops and counts it.
///
/// # Panics
///
/// If the property does not hold.
pub fn takes(decoder: &mut Decoder, byte: u8) {
    let (room, dropped, deaf) = (decoder.room(), decoder.dropped(), decoder.is_deaf());
    let (held, _) = decoder.begun();
    let taken = decoder.write(&[byte]);
    assert_eq!(taken, usize::from(room > 0));
    assert_eq!(decoder.is_deaf(), deaf);
    let (kept, lost) = if deaf { (0, taken) } else { (taken, 0) };
    assert_eq!(decoder.begun().0, held + kept);
    assert_eq!(decoder.room(), room - kept);
    assert_eq!(decoder.dropped() as usize, dropped as usize + lost);
}

/// W3, out: whatever the decoder holds, what it completes parses. Every byte is then kept, in the
/// packet, or counted as dropped. When nothing comes out there is room for the next byte. Returns what
/// came out, and its length.
///
/// # Errors
///
/// What [`Decoder::read`] says.
///
/// # Panics
///
/// If the property does not hold.
pub fn gives(
    decoder: &mut Decoder,
    crc_extra: impl FnOnce(MessageId) -> Option<u8>,
) -> Option<Result<usize, DecodeError>> {
    let ((held, _), dropped) = (decoder.begun(), decoder.dropped());
    let found = decoder.read().map(|found| {
        found.map(|packet| {
            let bytes = packet.as_bytes();
            assert_eq!(front(bytes, crc_extra), Ok(bytes.len()));
            bytes.len()
        })
    });
    let passed = if let Some(Ok(length)) = found {
        length
    } else {
        0
    };
    let dropped = (decoder.dropped() - dropped) as usize;
    assert_eq!(decoder.begun().0 + passed + dropped, held);
    assert!(found.is_some() || decoder.room() > 0);
    found
}

/// W3, a whole stream: however it is cut, the same packets and faults come out. Every byte is in a
/// packet, counted as dropped, or of a packet whose end has not come. `cuts` are the lengths of the pieces, repeated; the line is silent at
/// the end.
///
/// # Panics
///
/// If the property does not hold.
pub fn cut_does_not_matter(resync: Resync, stream: &[u8], cuts: &[usize]) {
    assert_eq!(decode(resync, stream, cuts), decode(resync, stream, &[]));
}

/// What is found in `stream`: packets as bytes, and faults.
fn decode(resync: Resync, stream: &[u8], cuts: &[usize]) -> Vec<Result<Vec<u8>, DecodeError>> {
    let mut decoder = Decoder::new(resync, dialect::crc_extra);
    let mut found = Vec::new();
    let mut rest = stream;
    let mut cuts = cuts.iter().cycle();
    while !rest.is_empty() {
        assert!(decoder.room() > 0, "the decoder is stuck");
        let piece = cuts
            .next()
            .map_or(rest.len(), |cut| rest.len().min(*cut).max(1));
        rest = &rest[decoder.write(&rest[..piece])..];
        read_all(&mut decoder, &mut found);
    }
    decoder.idle();
    read_all(&mut decoder, &mut found);
    let in_packets: usize = found.iter().flatten().map(Vec::len).sum();
    // With `Silence`, the end of a packet that has begun is still waited for.
    let (held, _) = decoder.begun();
    assert_eq!(in_packets + decoder.dropped() as usize + held, stream.len());
    found
}

fn read_all(decoder: &mut Decoder, found: &mut Vec<Result<Vec<u8>, DecodeError>>) {
    while let Some(decoded) = decoder.read() {
        found.push(decoded.map(|packet| {
            let bytes = packet.as_bytes();
            assert_eq!(front(bytes, dialect::crc_extra), Ok(bytes.len()));
            bytes.to_vec()
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_signing::dialect::crc_extra;
    use mavlink_signing::{Frame, Hmac, SigningKey, Stamp, Timestamp, sign_frame};
    use proptest::prelude::*;

    /// A HEARTBEAT of MAVLink 1.
    const MAVLINK1: [u8; 17] = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];

    /// Noise is passed over as far as the next packet, of either version, and no farther.
    #[test]
    fn w3_behind_noise() {
        let frame = Frame::new(crate::model::HEARTBEAT, &[1, 2, 3]).expect("a frame");
        let noise = b"noise".to_vec();
        for packet in [frame.as_bytes(), &MAVLINK1] {
            let stream = [&noise, packet].concat();
            let found = decode(Resync::NextByte, &stream, &[]);
            assert_eq!(found, [Ok(packet.to_vec())]);
            assert_eq!(
                decode(Resync::Silence, &stream, &[]),
                [],
                "it may be a payload"
            );
            for resync in [Resync::NextByte, Resync::Silence] {
                cut_does_not_matter(resync, &stream, &[1]);
            }
        }
    }

    /// Each bit of a packet of either version, but of what says how long it is: none parses.
    #[test]
    fn w3_each_bit() {
        let frame = Frame::new(crate::model::HEARTBEAT, &[1, 2, 3]).expect("a frame");
        let mut signed = frame.clone();
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let stamp = Stamp {
            link_id: 1,
            timestamp: Timestamp::ZERO,
        };
        sign_frame(&mut signed, &key, stamp).expect("not signed yet");
        // A checksum says nothing about the signature behind it.
        let checked = &signed.as_bytes()[..signed.as_bytes().len() - 13];
        for (packet, behind) in [(frame.as_bytes(), 0), (checked, 13), (&MAVLINK1, 0)] {
            for place in 3..packet.len() {
                for bit in 0..8 {
                    let mut bytes = [packet, &vec![0; behind]].concat();
                    bytes[place] ^= 1 << bit;
                    assert!(front(&bytes, crc_extra).is_err());
                }
            }
        }
    }

    /// Streams of packets of both versions, damaged ones, magic bytes and noise.
    fn stream() -> impl Strategy<Value = Vec<u8>> {
        let bytes = proptest::collection::vec(any::<u8>(), 0..40);
        let frame = (
            proptest::collection::vec(any::<u8>(), 0..=255),
            any::<bool>(),
        )
            .prop_map(|(payload, damaged)| {
                let frame = Frame::new(crate::model::HEARTBEAT, &payload).expect("a frame");
                let mut bytes = frame.as_bytes().to_vec();
                bytes[4] ^= u8::from(damaged);
                bytes
            });
        let magic = Just(vec![0xFD, 0xFE]);
        let mavlink1 = Just(MAVLINK1.to_vec());
        proptest::collection::vec(prop_oneof![bytes, frame, magic, mavlink1], 0..12)
            .prop_map(|parts| parts.concat())
    }

    proptest! {
        #[test]
        fn w3_cut_does_not_matter(
            stream in stream(),
            cuts in proptest::collection::vec(1..400_usize, 1..6),
        ) {
            for resync in [Resync::NextByte, Resync::Silence] {
                cut_does_not_matter(resync, &stream, &cuts);
            }
        }

        #[test]
        fn w3_byte_by_byte(stream in stream(), next_byte: bool, silences: u8) {
            let resync = if next_byte { Resync::NextByte } else { Resync::Silence };
            let mut decoder = Decoder::new(resync, crc_extra);
            for (at, byte) in stream.into_iter().enumerate() {
                if at % (usize::from(silences) + 1) == 0 {
                    decoder.idle();
                }
                // Either something comes out, or there is room.
                while decoder.room() == 0 {
                    let _ = gives(&mut decoder, crc_extra);
                }
                takes(&mut decoder, byte);
                let _ = gives(&mut decoder, crc_extra);
            }
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
mod verification {
    use super::*;
    use crate::model::any_prefix;
    use core::mem;
    use core::sync::atomic::{AtomicU16, Ordering::Relaxed};
    use mavlink_signing::field::MAGIC;

    #[kani::proof]
    #[kani::unwind(9)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn w3_front() {
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

    static EXTRA: AtomicU16 = AtomicU16::new(0);

    /// A table that knows every message, or none.
    fn any_extra(_id: MessageId) -> Option<u8> {
        u8::try_from(EXTRA.load(Relaxed)).ok()
    }

    /// Stands for the decoder's search for the next magic byte: any place that its own harness,
    /// [`w3_noise`], allows.
    #[expect(dead_code, reason = "named in an attribute alone")]
    fn any_noise(pending: &[u8]) -> usize {
        let skipped = kani::any();
        kani::assume(skipped <= pending.len());
        kani::assume(skipped > 0 || pending.is_empty() || is_magic(pending[0]));
        kani::assume(skipped == pending.len() || is_magic(pending[skipped]));
        skipped
    }

    const fn is_magic(byte: u8) -> bool {
        matches!(byte, MAGIC | MAGIC_V1)
    }

    #[kani::proof]
    #[kani::unwind(42)]
    fn w3_noise() {
        const LENGTH: usize = 40;
        let pending: [u8; LENGTH] = kani::any();
        let pending = any_prefix(&pending);
        let skipped = Decoder::noise(pending);
        let index: usize = kani::any();
        if index < skipped {
            assert!(!is_magic(pending[index]));
        }
        assert!(skipped <= pending.len());
        assert!(skipped == pending.len() || is_magic(pending[skipped]));
        kani::cover!(skipped == LENGTH, "nothing but noise");
        kani::cover!(skipped == LENGTH - 1, "the last byte");
    }

    #[kani::proof]
    #[kani::unwind(4)]
    fn w3_takes() {
        let decoder = Decoder::new(Resync::NextByte, any_extra);
        let mut decoder = decoder.holding(kani::any(), kani::any(), kani::any());
        kani::assume(decoder.is_valid());
        let room = decoder.room();
        takes(&mut decoder, kani::any());
        assert!(decoder.is_valid());
        // Not wiped, which is a loop over 280 bytes.
        mem::forget(decoder);
        kani::cover!(room == 0, "full");
        kani::cover!(room == MAX_FRAME_SIZE, "empty");
    }

    /// Room is made of bytes that are done with or were lent out: the others stay, and the new one is behind
    /// them. How many there are is known to the solver.
    #[kani::proof]
    #[kani::unwind(4)]
    fn w3_keeps() {
        const HELD: usize = 40;
        let bytes: [u8; MAX_FRAME_SIZE] = kani::any();
        let decoder = Decoder::new(Resync::NextByte, any_extra);
        let mut decoder = decoder.holding(bytes, HELD, [3, 8]);
        let (index, byte): (usize, u8) = kani::any();
        takes(&mut decoder, byte);
        assert_eq!(decoder.pending().len(), HELD - 11 + 1);
        if index < HELD - 11 {
            assert_eq!(decoder.pending()[index], bytes[11 + index]);
        }
        assert_eq!(decoder.pending()[HELD - 11], byte);
        mem::forget(decoder);
        kani::cover!(index == HELD - 12, "the last that was there");
    }

    /// What comes out of a decoder that holds the first `length` of `bytes`, done with none of them,
    /// whose line is silent if `idle`.
    fn gives_of(
        resync: Resync,
        idle: bool,
        bytes: [u8; MAX_FRAME_SIZE],
        length: usize,
    ) -> Option<Result<usize, DecodeError>> {
        EXTRA.store(kani::any(), Relaxed);
        let mut decoder = Decoder::new(resync, any_extra).holding(bytes, length, [0, 0]);
        if idle {
            decoder.idle();
        }
        let found = gives(&mut decoder, any_extra);
        assert!(decoder.is_valid());
        mem::forget(decoder);
        found
    }

    /// Any bytes where something begins like a packet.
    #[kani::proof]
    #[kani::unwind(3)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    #[kani::stub(mavlink_signing::decoder::noise, any_noise)]
    fn w3_gives_packets() {
        let (bytes, length): ([u8; MAX_FRAME_SIZE], usize) = kani::any();
        kani::assume(length <= MAX_FRAME_SIZE && is_magic(bytes[0]));
        let found = gives_of(Resync::NextByte, false, bytes, length);
        kani::cover!(found == Some(Ok(MAX_FRAME_SIZE)), "the longest frame");
        kani::cover!(found.is_none(), "more is needed");
    }

    /// Up to 40 bytes, noise before packets too, and silence.
    #[kani::proof]
    #[kani::unwind(4)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    #[kani::stub(mavlink_signing::decoder::noise, any_noise)]
    fn w3_gives_behind_noise() {
        let (bytes, length): ([u8; MAX_FRAME_SIZE], usize) = kani::any();
        kani::assume(length <= 40);
        let silence = kani::any();
        let resync = if silence {
            Resync::Silence
        } else {
            Resync::NextByte
        };
        // After a silence with `NextByte` the decoder may try every byte.
        let idle = silence && kani::any();
        let found = gives_of(resync, idle, bytes, length);
        kani::cover!(found == Some(Ok(8)) && length == 40, "the shortest packet");
        kani::cover!(found.is_none() && idle, "nothing in a silence");
    }
}
