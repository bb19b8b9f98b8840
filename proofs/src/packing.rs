//! P1: packing splits nothing, and loses nothing that fits.

use core::time::Duration;

use mavlink_commsec::field::PLAINTEXT_SIZE;
use mavlink_commsec::{PackError, Packer, Plaintext, UnpackError, packets};

/// What a packer is told when it is made.
#[derive(Clone, Copy, Debug)]
pub struct Kind {
    /// Whether it packs for old vehicles: 72 bytes, and MAVLink 1 alone.
    pub old: bool,
    /// How long a packet may wait.
    pub max_delay: Duration,
}

impl Kind {
    /// Bytes of a message that packets may lie in.
    #[must_use]
    pub const fn size(self) -> usize {
        if self.old { 72 } else { 80 }
    }

    /// The packer.
    #[must_use]
    pub const fn packer(self) -> Packer {
        if self.old {
            Packer::legacy(self.max_delay)
        } else {
            Packer::new(self.max_delay)
        }
    }

    /// Why `packet` is rejected, in the order in which that is looked for. The length of a first packet
    /// in it says where another one begins.
    fn rejects(self, packet: &[u8]) -> Option<Fault> {
        let Some(length) = announced(packet).filter(|length| *length <= packet.len()) else {
            return Some(Fault::Parse);
        };
        match length {
            _ if self.old && packet[0] != 0xFE => Some(Fault::LegacyVehicle),
            length if length < packet.len() => Some(Fault::Trailing(packet.len() - length)),
            length if length > self.size() => Some(Fault::TooLong(length)),
            _ => None,
        }
    }
}

/// Why a packet is rejected.
#[derive(Debug, PartialEq, Eq)]
enum Fault {
    Parse,
    LegacyVehicle,
    Trailing(usize),
    TooLong(usize),
}

impl From<PackError> for Fault {
    fn from(error: PackError) -> Self {
        match error {
            PackError::Parse(_) => Self::Parse,
            PackError::LegacyVehicle => Self::LegacyVehicle,
            PackError::Trailing(length) => Self::Trailing(length),
            PackError::TooLong(length) => Self::TooLong(length),
            other => unreachable!("{other:?}"),
        }
    }
}

/// P1: of the packets given to a packer, those that are whole and fit into a message come out again,
/// whole, unchanged and in order. Every other one is rejected with the reason and counted. Behind the
/// last packet of a message there are zeros alone. A message makes room if and only if the next packet
/// does not fit into it. When it is asked for, one comes if and only if it holds a HEARTBEAT or its
/// first packet has waited long enough. `polls` says whether the packer is asked after each packet.
/// Returns how many messages there were.
///
/// The times go up.
///
/// # Panics
///
/// If the property does not hold.
#[must_use]
pub fn packed(kind: Kind, given: &[(&[u8], Duration)], polls: bool) -> usize {
    let mut packer = kind.packer();
    let mut messages = Vec::new();
    let mut fitting = Vec::new();
    let mut rejected = 0;
    // Of what is pending: bytes, since when, and whether a HEARTBEAT is among it.
    let (mut bytes, mut since, mut due) = (0, Duration::ZERO, false);
    for (packet, now) in given {
        let pushed = packer.push(packet, *now);
        let fault = pushed.as_ref().err().map(|error| Fault::from(*error));
        assert_eq!(fault, kind.rejects(packet));
        if let Ok(message) = pushed {
            let full = bytes + packet.len() > kind.size();
            assert_eq!(message.is_some(), full);
            if full {
                (bytes, due) = (0, false);
            }
            if bytes == 0 {
                since = *now;
            }
            bytes += packet.len();
            due |= is_heartbeat(packet);
            messages.extend(message);
            fitting.push(*packet);
        } else {
            rejected += 1;
        }
        if polls {
            let message = packer.poll(*now);
            let leaves = bytes > 0 && (due || *now - since >= kind.max_delay);
            assert_eq!(message.is_some(), leaves);
            if leaves {
                (bytes, due) = (0, false);
            }
            messages.extend(message);
        }
    }
    messages.extend(packer.flush());
    assert_eq!(packer.flush(), None);
    assert_eq!(packer.rejected(), rejected);
    let mut expected = fitting.into_iter();
    for message in &messages {
        let mut end = 0;
        for packet in packets(message) {
            let packet = packet.expect("a packet");
            assert_eq!(Some(packet), expected.next());
            assert_eq!(packet, &message[end..end + packet.len()]);
            end += packet.len();
        }
        assert!(end > 0 && end <= kind.size());
        assert!(message[end..].iter().all(|byte| *byte == 0));
    }
    assert_eq!(expected.next(), None);
    messages.len()
}

/// Whether a whole packet is a HEARTBEAT: message 0.
fn is_heartbeat(packet: &[u8]) -> bool {
    match packet[0] {
        0xFE => packet[5] == 0,
        _ => packet[7..10] == [0, 0, 0],
    }
}

/// The length that a packet of MAVLink 1 or 2 announces; none if its header is cut or it is neither.
fn announced(packet: &[u8]) -> Option<usize> {
    match packet {
        [0xFE, length, _, _, _, _, ..] => Some(8 + usize::from(*length)),
        [0xFD, length, 0, _, _, _, _, _, _, _, ..] => Some(12 + usize::from(*length)),
        [0xFD, length, 1, _, _, _, _, _, _, _, ..] => Some(25 + usize::from(*length)),
        _ => None,
    }
}

/// P1, two packets that fit into a message each: the second makes room if and only if there is none for
/// both. What comes out holds them whole and in order, and zeros behind them.
///
/// `at` is an index below 80 at which the messages are looked at. Returns whether they share one.
///
/// # Panics
///
/// If the property does not hold.
#[must_use]
pub fn two_packets(one: &[u8], two: &[u8], at: usize) -> bool {
    let is_alone = |message: Option<Plaintext>, packet: &[u8]| {
        let message = message.expect("a message");
        assert_eq!(message[at], packet.get(at).copied().unwrap_or(0));
    };
    let mut packer = Packer::new(Duration::MAX);
    let pushed = packer.push(one, Duration::ZERO);
    assert_eq!(pushed, Ok(None));
    let room = packer
        .push(two, Duration::ZERO)
        .expect("it fits into a message");
    let shared = one.len() + two.len() <= PLAINTEXT_SIZE;
    assert_eq!(room.is_none(), shared);
    if shared {
        let message = packer.flush().expect("both");
        let expected = one.get(at).or_else(|| two.get(at - one.len()));
        assert_eq!(message[at], expected.copied().unwrap_or(0));
    } else {
        is_alone(room, one);
        is_alone(packer.flush(), two);
    }
    assert_eq!(packer.flush(), None);
    shared
}

/// P1, asking for a message: one comes if and only if the packet is a HEARTBEAT, or was packed as long
/// ago as a packet may wait. It holds the packet whole, and zeros behind it.
///
/// # Panics
///
/// If the property does not hold.
pub fn asked_later(packet: &[u8], max_delay: Duration, later: Duration, at: usize) {
    let mut packer = Packer::new(max_delay);
    let pushed = packer.push(packet, Duration::ZERO);
    assert_eq!(pushed, Ok(None));
    let message = packer.poll(later);
    assert_eq!(
        message.is_some(),
        is_heartbeat(packet) || later >= max_delay
    );
    if let Some(message) = message {
        assert_eq!(message[at], packet.get(at).copied().unwrap_or(0));
    }
}

/// Whether the length of a packet of MAVLink 1 or 2 is the one that it announces.
fn is_whole(packet: &[u8]) -> bool {
    announced(packet) == Some(packet.len())
}

/// P1's other side: any message is unpacked without a panic. The packets in it do not overlap. With what
/// is zero between them they are all of it, or there is an error, which is the last. How many packets
/// there are.
///
/// # Errors
///
/// What is wrong behind them.
///
/// # Panics
///
/// If the property does not hold.
pub fn unpacked(message: &Plaintext) -> Result<usize, UnpackError> {
    let mut found = packets(message);
    let (mut end, mut count) = (0, 0);
    let zeros_to = |end: usize, offset: usize| {
        assert!(end <= offset && offset <= message.len());
        assert!(message[end..offset].iter().all(|byte| *byte == 0));
    };
    loop {
        match found.next() {
            None => {
                zeros_to(end, message.len());
                return Ok(count);
            }
            Some(Ok(packet)) => {
                let offset = packet.as_ptr() as usize - message.as_ptr() as usize;
                zeros_to(end, offset);
                assert!(is_whole(packet));
                end = offset + packet.len();
                count += 1;
            }
            Some(Err(error)) => {
                zeros_to(end, error.offset);
                assert!(message[error.offset] != 0);
                assert_eq!(found.next(), None);
                return Err(error);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const KIND: Kind = Kind {
        old: false,
        max_delay: Duration::from_secs(1),
    };

    /// A packet, whole or not; ids are small, so that there are heartbeats.
    fn packet() -> impl Strategy<Value = Vec<u8>> {
        let content = proptest::collection::vec(any::<u8>(), 0..=255);
        let length = prop_oneof![9 => 0..75_usize, 1 => 0..256_usize];
        (0..20_u8, 0..3_u8, length, content).prop_map(|(kind, id, length, mut content)| {
            content.resize(length, 0x5A);
            let length = length as u8;
            let mut packet = match kind {
                0..10 => [&[0xFE, length, 7, 1, 1, id][..], &content, &[1, 2]].concat(),
                10..17 => [
                    &[0xFD, length, 0, 0, 7, 1, 1, id, 0, 0][..],
                    &content,
                    &[1, 2],
                ]
                .concat(),
                _ => [
                    &[0xFD, length, 1, 0, 7, 1, 1, id, 0, 0][..],
                    &content,
                    &[9; 15],
                ]
                .concat(),
            };
            match kind {
                8 => packet.truncate(packet.len() - 1),
                9 => packet.push(0),
                _ => {}
            }
            packet
        })
    }

    proptest! {
        #[test]
        fn p1_random(
            given in proptest::collection::vec((packet(), 0..100_u64), 0..30),
            old: bool,
            polls: bool,
        ) {
            let mut now = Duration::ZERO;
            let max_delay = Duration::from_millis(120);
            let given: Vec<(&[u8], Duration)> = given
                .iter()
                .map(|(packet, wait)| {
                    now += Duration::from_millis(*wait);
                    (&packet[..], now)
                })
                .collect();
            let _ = packed(Kind { old, max_delay }, &given, polls);
        }

        #[test]
        fn p1_any_message(
            bytes in proptest::collection::vec(
                prop_oneof![8 => Just(0), 2 => Just(0xFE), 2 => Just(0xFD), 6 => 0..20_u8, 1 => any::<u8>()],
                80,
            ),
        ) {
            let _ = unpacked(&bytes.try_into().expect("80 bytes"));
        }
    }

    /// A packet of MAVLink 1 that is no HEARTBEAT.
    fn whole(length: usize) -> Vec<u8> {
        let mut packet = vec![0xFE, length as u8, 1, 1, 1, 30];
        packet.resize(length + 8, 0xEE);
        packet
    }

    /// What the proofs look at, for all pairs of lengths.
    #[test]
    fn p1_two_of_every_length() {
        for (a, b) in (8..=80).flat_map(|a| (8..=80).map(move |b| (a, b))) {
            let (one, two) = (whole(a - 8), whole(b - 8));
            for (later, at) in [(4, 0), (5, a - 1), (6, (a + b - 1) % 80)] {
                assert_eq!(two_packets(&one, &two, at), a + b <= 80);
                asked_later(&one, Duration::from_secs(5), Duration::from_secs(later), at);
            }
        }
    }

    /// Every length of a packet behind every other.
    #[test]
    fn p1_every_length() {
        for first in 0..=80 {
            for second in 0..=80 {
                let [one, two] = [first, second].map(whole);
                let given = [(&one[..], Duration::ZERO), (&two[..], Duration::ZERO)];
                let messages = packed(KIND, &given, false);
                let fit = [one.len(), two.len()].map(|length| length <= 80);
                let expected = match fit {
                    [false, false] => 0,
                    [true, true] if one.len() + two.len() > 80 => 2,
                    _ => 1,
                };
                assert_eq!(messages, expected);
            }
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;

    /// A MAVLink 1 packet of `N` bytes with any content.
    fn any_packet<const N: usize>() -> [u8; N] {
        let mut packet: [u8; N] = kani::any();
        packet[0] = 0xFE;
        packet[1] = (N - 8) as u8;
        packet
    }

    fn any_index() -> usize {
        let at = kani::any();
        kani::assume(at < PLAINTEXT_SIZE);
        at
    }

    /// Two that fill a message.
    #[kani::proof]
    #[kani::unwind(82)]
    fn p1_two_fit() {
        let shared = two_packets(&any_packet::<40>(), &any_packet::<40>(), any_index());
        assert!(shared);
        kani::cover!(true, "in one message");
    }

    /// Two that do not fit into one.
    #[kani::proof]
    #[kani::unwind(82)]
    fn p1_two_do_not_fit() {
        let shared = two_packets(&any_packet::<40>(), &any_packet::<41>(), any_index());
        assert!(!shared);
        kani::cover!(true, "in two");
    }

    #[kani::proof]
    #[kani::unwind(82)]
    fn p1_asked_later() {
        let times: [u32; 2] = kani::any();
        let [max_delay, later] = times.map(|seconds| Duration::from_secs(seconds.into()));
        let packet = any_packet::<40>();
        asked_later(&packet, max_delay, later, any_index());
        kani::cover!(later < max_delay && packet[5] == 0, "a heartbeat");
        kani::cover!(later < max_delay && packet[5] != 0, "in time");
        kani::cover!(later >= max_delay, "waited");
    }
}
