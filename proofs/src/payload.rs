//! D1: on a line that is trusted, what lies inside a payload never becomes a packet.

use mavlink_signing::field::{MAGIC, MAGIC_V1, MAX_FRAME_SIZE};
use mavlink_signing::{DecodeError, Decoder, ParseError, Resync, dialect};

/// What happens to a line once.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub struct Damage {
    /// Where, counted round the bytes of the stream.
    pub at: u16,
    /// How many bytes are lost there.
    pub lost: u8,
    /// What comes in their place.
    pub inserted: Vec<u8>,
    /// Whether the line tells.
    pub reported: bool,
}

/// How a stream comes in.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub struct Arrival {
    /// Behind which packets the line is silent: bit `n` for packet `n`, modulo 32.
    pub silences: u32,
    /// The sender pauses before each byte of this number, but not while the decoder is deaf; never, if it is zero.
    pub pauses: u8,
    /// What comes out is not looked at before there is no more room. Nobody knows then whether the decoder would be deaf,
    /// so the sender does not pause.
    pub late: bool,
}

/// D1, whole streams of packets whose boundaries are known, all of MAVLink 2, or 1, and right: with [`Resync::Silence`],
/// whatever comes out is one of them, each at most once and in order. That holds when bytes of the line are lost, come
/// in or are changed in one place, and it tells: then nothing that lies inside a payload comes out. If it does not tell,
/// the checksum finds it, or a byte that is no magic byte where a packet should begin. What they do not find is what
/// somebody made fit, or one in 2^16: a packet that has the place in it, or begins there. A pause within a packet
/// changes nothing.
///
/// The line is silent between packets alone, as long as the decoder is deaf. Returns how many packets came out.
///
/// # Panics
///
/// If the property does not hold.
#[must_use]
pub fn never_a_packet(packets: &[Vec<u8>], arrival: &Arrival, damage: Option<&Damage>) -> usize {
    let (line, place) = Line::new(packets, arrival.silences, damage);
    let found = line.decode(arrival);
    let without = Arrival {
        pauses: 0,
        ..*arrival
    };
    assert_eq!(found, line.decode(&without), "a pause changed something");
    let mut sent = packets.iter();
    let mut misread = false;
    for (number, packet) in found.iter().enumerate() {
        // It fits what was damaged, even if one like it was sent. Where packets begin behind it is not known any more.
        misread |= place.is_some_and(|[from, to]| {
            let windows = line.bytes.windows(packet.len()).enumerate();
            let mut same = windows.filter(|(_, window)| window == packet);
            same.any(|(at, _)| at < to.max(from + 1) && from < at + packet.len())
        });
        if sent.any(|sent| sent == packet) {
            continue;
        }
        assert!(misread, "no packet was sent like {packet:02x?}");
        assert!(damage.is_some_and(|damage| !damage.reported));
        return number;
    }
    if damage.is_none() && !arrival.late {
        assert_eq!(found.len(), packets.len(), "nothing was wrong");
    }
    found.len()
}

/// The bytes of a line, and what it tells between them.
struct Line {
    bytes: Vec<u8>,
    /// Before how many bytes the line is silent, longer than within a packet.
    silences: Vec<usize>,
    /// Before how many bytes it tells a fault: behind a silence before it.
    fault: Option<usize>,
    /// Whether it is silent right behind the fault.
    silent_again: bool,
}

impl Line {
    /// The line, and which bytes of it are not as they were sent.
    fn new(
        packets: &[Vec<u8>],
        silences: u32,
        damage: Option<&Damage>,
    ) -> (Self, Option<[usize; 2]>) {
        let mut bytes = packets.concat();
        let ends = packets.iter().scan(0, |end, packet| {
            *end += packet.len();
            Some(*end)
        });
        let silent = ends
            .enumerate()
            .filter(|(n, _)| silences >> (n % 32) & 1 == 1);
        let mut silences: Vec<_> = silent.map(|(_, end)| end).collect();
        let Some(damage) = damage else {
            let line = Self {
                bytes,
                silences,
                fault: None,
                silent_again: false,
            };
            return (line, None);
        };
        let at = usize::from(damage.at) % (bytes.len() + 1);
        let to = (at + usize::from(damage.lost)).min(bytes.len());
        bytes.splice(at..to, damage.inserted.iter().copied());
        let behind = at + damage.inserted.len();
        // While bytes are lost, the line is not silent.
        silences.retain(|silence| *silence <= at || *silence >= to);
        let mut silent_again = false;
        for silence in silences.iter_mut().filter(|silence| **silence > at) {
            *silence = *silence - to + behind;
            silent_again |= *silence == at;
        }
        let line = Self {
            bytes,
            silences,
            fault: damage.reported.then_some(at),
            silent_again,
        };
        (line, Some([at, behind]))
    }

    fn decode(&self, arrival: &Arrival) -> Vec<Vec<u8>> {
        let mut decoder = Decoder::new(Resync::Silence, dialect::crc_extra);
        let mut found = Vec::new();
        for at in 0..=self.bytes.len() {
            if self.silences.contains(&at) {
                decoder.idle();
                assert!(!decoder.is_deaf());
            }
            if self.fault == Some(at) {
                decoder.fault();
                assert!(decoder.is_deaf());
                if self.silent_again {
                    decoder.idle();
                }
            }
            let pauses = usize::from(arrival.pauses);
            let may_pause = !arrival.late && !decoder.is_deaf();
            if pauses > 0 && at % pauses == 0 && may_pause {
                decoder.idle();
            }
            let Some(byte) = self.bytes.get(at) else {
                break;
            };
            if decoder.room() == 0 {
                read(&mut decoder, &mut found);
            }
            assert_eq!(decoder.write(&[*byte]), 1);
            if !arrival.late {
                read(&mut decoder, &mut found);
            }
        }
        read(&mut decoder, &mut found);
        found
    }
}

fn read(decoder: &mut Decoder, found: &mut Vec<Vec<u8>>) {
    while let Some(decoded) = decoder.read() {
        found.extend(decoded.ok().map(|packet| packet.as_bytes().to_vec()));
    }
}

/// D1, one look, at a decoder with [`Resync::Silence`] that knows where a packet begins: at the front of what it holds.
/// Only what is there comes out. If it is no magic byte, not whole and right, or unknown, all is dropped, and the decoder
/// is deaf. If more is needed, nothing is dropped.
///
/// `next` comes behind it. Returns what came out, and its length.
///
/// # Errors
///
/// What [`Decoder::read`] says.
///
/// # Panics
///
/// If the property does not hold.
pub fn one_look(decoder: &mut Decoder, first: u8, next: u8) -> Option<Result<usize, DecodeError>> {
    let ((held, _), dropped) = (decoder.begun(), decoder.dropped());
    assert!(!decoder.is_deaf());
    let found = decoder
        .read()
        .map(|found| found.map(|packet| packet.as_bytes().len()));
    let left = decoder.begun();
    let lost = (decoder.dropped() - dropped) as usize;
    match found {
        Some(Ok(length)) => {
            assert!(!decoder.is_deaf());
            assert_eq!((left.0, lost), (held - length, 0));
        }
        None if held == 0 || matches!(first, MAGIC | MAGIC_V1) => {
            assert!(!decoder.is_deaf());
            assert_eq!((left.0, lost), (held, 0));
        }
        lost_place => {
            let told = matches!(lost_place, Some(Err(error)) if !is_noise(error));
            assert!(told || lost_place.is_none());
            assert_eq!((left.0, lost), (0, held));
            deaf_until_silence(decoder, next);
            decoder.idle();
            assert!(!decoder.is_deaf());
            assert_eq!(decoder.room(), MAX_FRAME_SIZE);
        }
    }
    found
}

/// Whether it says that there is no magic byte, or that more is needed: a decoder does not tell that.
const fn is_noise(error: DecodeError) -> bool {
    matches!(
        error,
        DecodeError::Parse(ParseError::BadMagic(_) | ParseError::Truncated)
    )
}

/// D1: a pause within a packet changes nothing, at a decoder that waits for the end of one.
///
/// # Panics
///
/// If the property does not hold.
pub fn a_pause_changes_nothing(decoder: &mut Decoder) {
    let before = (decoder.begun(), decoder.dropped(), decoder.room());
    assert!(!decoder.is_deaf());
    decoder.idle();
    assert!(decoder.read().is_none());
    assert!(!decoder.is_deaf());
    let after = (decoder.begun(), decoder.dropped(), decoder.room());
    assert_eq!(after, before);
}

/// D1: what comes in at a deaf decoder is dropped, and what it holds stays what it was.
///
/// # Panics
///
/// If the property does not hold.
pub fn deaf_until_silence(decoder: &mut Decoder, next: u8) {
    let (held, dropped) = (decoder.begun(), decoder.dropped());
    assert!(decoder.is_deaf());
    assert_eq!(decoder.room(), MAX_FRAME_SIZE);
    assert_eq!(decoder.write(&[next]), 1);
    assert!(decoder.is_deaf());
    assert_eq!((decoder.begun(), decoder.dropped()), (held, dropped + 1));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use mavlink_signing::{Frame, Header};
    use proptest::prelude::*;

    /// Of other systems than those inside of payloads.
    fn packet(system_id: u8, payload: &[u8]) -> Vec<u8> {
        let header = Header {
            system_id,
            ..HEARTBEAT
        };
        let frame = Frame::new(header, payload).expect("short enough");
        frame.as_bytes().to_vec()
    }

    /// Packets inside of a payload, and bytes around them.
    fn payload() -> impl Strategy<Value = Vec<u8>> {
        let inner = (200..=255_u8, proptest::collection::vec(any::<u8>(), 0..5))
            .prop_map(|(system_id, payload)| packet(system_id, &payload));
        let noise = proptest::collection::vec(any::<u8>(), 0..6);
        let magic = Just(vec![0xFD, 0xFE]);
        let parts = prop_oneof![3 => inner, 1 => noise, 1 => magic];
        proptest::collection::vec(parts, 0..9).prop_map(|parts| {
            let mut payload = parts.concat();
            payload.truncate(255);
            payload
        })
    }

    fn packets() -> impl Strategy<Value = Vec<Vec<u8>>> {
        let packet = (0..100_u8, payload()).prop_map(|(id, payload)| packet(id, &payload));
        proptest::collection::vec(packet, 1..6)
    }

    fn damage() -> impl Strategy<Value = Damage> {
        let lost = prop_oneof![3 => 0..3_u8, 1 => 0..=255_u8];
        let inserted = prop_oneof![
            2 => Just(Vec::new()),
            2 => proptest::collection::vec(any::<u8>(), 1..4),
            1 => Just(vec![0xFD, 255, 0]),
        ];
        (any::<u16>(), lost, inserted, any::<bool>()).prop_map(|(at, lost, inserted, reported)| {
            Damage {
                at,
                lost,
                inserted,
                reported,
            }
        })
    }

    fn arrival() -> impl Strategy<Value = Arrival> {
        (any::<u32>(), any::<u8>(), any::<bool>()).prop_map(|(silences, pauses, late)| Arrival {
            silences,
            pauses,
            late,
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]

        #[test]
        fn d1_random(
            packets in packets(),
            arrival in arrival(),
            damage in proptest::option::weighted(0.9, damage()),
        ) {
            let _ = never_a_packet(&packets, &arrival, damage.as_ref());
        }
    }

    /// Each bit of a stream, each byte lost, and a byte before each: whatever is heard was sent. Told of it, nothing is
    /// lost but the packet itself.
    #[test]
    fn d1_each_place() {
        let inner = packet(200, &[7]);
        let packets: Vec<_> = (1..=3)
            .map(|system_id| packet(system_id, &inner.repeat(4)))
            .collect();
        let stream = packets.concat();
        let arrival = Arrival {
            silences: u32::MAX,
            pauses: 3,
            late: false,
        };
        for (at, byte) in stream.iter().enumerate() {
            let bits = (0..8).map(|bit| (1, vec![byte ^ 1 << bit]));
            let changes = bits.chain([(1, vec![]), (0, vec![0]), (0, vec![0xFD])]);
            for (lost, inserted) in changes {
                for reported in [true, false] {
                    let damage = Damage {
                        at: at as u16,
                        lost,
                        inserted: inserted.clone(),
                        reported,
                    };
                    let found = never_a_packet(&packets, &arrival, Some(&damage));
                    assert!(if reported { found == 2 } else { found < 3 }, "{damage:?}");
                }
            }
        }
    }

    #[test]
    fn d1_one_look() {
        let right = packet(1, &[1, 2, 3]);
        let look = |bytes: &[u8]| {
            let mut decoder = Decoder::new(Resync::Silence, dialect::crc_extra);
            assert_eq!(decoder.write(bytes), bytes.len());
            let first = bytes.first().copied().unwrap_or_default();
            let found = one_look(&mut decoder, first, right[0]);
            if found.is_none_or(|it| it.is_err()) {
                assert!(decoder.read().is_none());
                a_pause_changes_nothing(&mut decoder);
            }
            found
        };
        assert_eq!(look(&[]), None);
        assert_eq!(look(&right), Some(Ok(right.len())));
        assert_eq!(look(&[&[7], &right[..]].concat()), None);
        for at in 1..right.len() {
            assert_eq!(look(&right[..at]), None);
            let mut damaged = right.clone();
            damaged[at] ^= 0x80;
            let longer = at == 1;
            assert_eq!(look(&damaged).is_none(), longer);
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use core::mem;
    use core::sync::atomic::{AtomicU16, Ordering::Relaxed};
    use mavlink_signing::MessageId;

    static EXTRA: AtomicU16 = AtomicU16::new(0);

    /// A table that knows every message, or none.
    fn any_extra(_id: MessageId) -> Option<u8> {
        u8::try_from(EXTRA.load(Relaxed)).ok()
    }

    #[kani::proof]
    #[kani::unwind(3)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn d1_one_look() {
        let (bytes, length): ([u8; MAX_FRAME_SIZE], usize) = kani::any();
        kani::assume(length <= MAX_FRAME_SIZE);
        EXTRA.store(kani::any(), Relaxed);
        let decoder = Decoder::new(Resync::Silence, any_extra);
        let mut decoder = decoder.holding(bytes, length, [0, 0]);
        let found = one_look(&mut decoder, bytes[0], kani::any());
        // Not wiped, which is a loop over 280 bytes.
        mem::forget(decoder);
        kani::cover!(found == Some(Ok(MAX_FRAME_SIZE)), "the longest frame");
        kani::cover!(
            matches!(found, Some(Err(DecodeError::BadChecksum(_)))),
            "damaged"
        );
        kani::cover!(
            matches!(found, Some(Err(DecodeError::UnknownMessage(_)))),
            "unknown"
        );
        kani::cover!(
            matches!(found, Some(Err(DecodeError::Parse(_)))),
            "unknown flags"
        );
        kani::cover!(found.is_none() && bytes[0] == MAGIC, "more is needed");
        kani::cover!(
            found.is_none() && bytes[0] == 0 && length > 0,
            "no magic byte"
        );
    }

    #[kani::proof]
    #[kani::unwind(3)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn d1_pause() {
        let (bytes, length): ([u8; MAX_FRAME_SIZE], usize) = kani::any();
        kani::assume(length <= MAX_FRAME_SIZE && matches!(bytes[0], MAGIC | MAGIC_V1));
        EXTRA.store(kani::any(), Relaxed);
        let decoder = Decoder::new(Resync::Silence, any_extra);
        let mut decoder = decoder.holding(bytes, length, [0, 0]);
        kani::assume(decoder.read().is_none() && !decoder.is_deaf());
        a_pause_changes_nothing(&mut decoder);
        mem::forget(decoder);
        kani::cover!(length == 0, "between packets");
        kani::cover!(length == MAX_FRAME_SIZE - 1, "before the last byte");
    }

    #[kani::proof]
    #[kani::unwind(4)]
    fn d1_fault() {
        let decoder = Decoder::new(Resync::Silence, any_extra);
        let mut decoder = decoder.holding(kani::any(), kani::any(), kani::any());
        kani::assume(decoder.is_valid());
        let (held, _) = decoder.begun();
        decoder.fault();
        deaf_until_silence(&mut decoder, kani::any());
        mem::forget(decoder);
        kani::cover!(held == 0, "between packets");
        kani::cover!(held == MAX_FRAME_SIZE - 1, "within one");
    }
}
