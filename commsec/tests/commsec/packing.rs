//! Packing whole packets, and getting them out again.

use core::time::Duration;

use mavlink_commsec::{LEGACY_SIZE, PackError, Packer, Plaintext, UnpackError, packets};
use mavlink_signing::ParseError;

use crate::common::{hex, message};
use crate::vectors::{A, B, C};

const MAX_DELAY: Duration = Duration::from_millis(50);
const START: Duration = Duration::from_secs(7);

/// A MAVLink 1 packet of `size` bytes with message `id`; its checksum is of no concern here.
fn packet(id: u8, size: usize) -> Vec<u8> {
    let mut packet = vec![id | 0x80; size];
    packet[..6].copy_from_slice(&[0xFE, (size - 8) as u8, 0, 1, 1, id]);
    packet
}

/// A MAVLink 2 packet of `size` bytes with message `id`, unsigned.
fn packet2(id: u8, size: usize) -> Vec<u8> {
    let mut packet = vec![id | 0x80; size];
    packet[..10].copy_from_slice(&[0xFD, (size - 12) as u8, 0, 0, 0, 1, 1, id, 0, 0]);
    packet
}

/// What a message holds.
fn unpack(message: &Plaintext) -> Vec<Vec<u8>> {
    let packets = packets(message).map(|packet| packet.expect("a packet").to_vec());
    packets.collect()
}

/// The messages of the reference, from their packets.
#[test]
fn reference_messages() {
    for (vector, count) in [(&A, 2), (&B, 2), (&C, 2)] {
        let message = message(vector.plain);
        let found = unpack(&message);
        assert_eq!(found.len(), count, "{}", vector.name);
        let mut packer = Packer::new(MAX_DELAY);
        for packet in &found {
            assert_eq!(packer.push(packet, START), Ok(None));
        }
        assert_eq!(packer.flush(), Some(message), "{}", vector.name);
    }
}

#[test]
fn heartbeat_does_not_wait() {
    for heartbeat in [packet(0, 17), packet2(0, 21)] {
        let mut packer = Packer::new(MAX_DELAY);
        assert_eq!(packer.push(&packet(30, 36), START), Ok(None));
        assert_eq!(packer.poll(START), None);
        assert_eq!(packer.push(&heartbeat, START), Ok(None));
        let message = packer.poll(START).expect("a message");
        assert_eq!(unpack(&message), [packet(30, 36), heartbeat]);
        assert_eq!(packer.poll(START), None);
        // What comes next waits again.
        assert_eq!(packer.push(&packet(30, 36), START), Ok(None));
        assert_eq!(packer.poll(START), None);
    }
}

/// A heartbeat that does not fit sends what is before it, and then itself.
#[test]
fn heartbeat_behind_a_full_message() {
    let mut packer = Packer::new(MAX_DELAY);
    assert_eq!(packer.push(&packet(30, 70), START), Ok(None));
    let full = packer.push(&packet(0, 17), START).expect("a packet");
    assert_eq!(unpack(&full.expect("a message")), [packet(30, 70)]);
    let message = packer.poll(START).expect("a heartbeat does not wait");
    assert_eq!(unpack(&message), [packet(0, 17)]);
}

#[test]
fn nothing_waits_longer_than_patience() {
    let mut packer = Packer::new(MAX_DELAY);
    let short = Duration::from_millis(49);
    assert_eq!(packer.push(&packet(30, 10), START), Ok(None));
    assert_eq!(packer.push(&packet(31, 10), START + short), Ok(None));
    assert_eq!(packer.poll(START + short), None);
    let message = packer
        .poll(START + MAX_DELAY)
        .expect("the first has waited");
    assert_eq!(unpack(&message), [packet(30, 10), packet(31, 10)]);
    // The clock starts with the first packet of a message, also where another one made room.
    assert_eq!(packer.poll(START + 9 * MAX_DELAY), None);
    let later = START + 10 * MAX_DELAY;
    assert_eq!(packer.push(&packet(30, 60), later), Ok(None));
    assert!(matches!(
        packer.push(&packet(31, 60), later + short),
        Ok(Some(_))
    ));
    assert_eq!(packer.poll(later + MAX_DELAY), None);
    assert!(packer.poll(later + short + MAX_DELAY).is_some());
}

#[test]
fn eighty_bytes_fit_and_not_one_more() {
    let mut packer = Packer::new(MAX_DELAY);
    for fits in [packet(1, 80), packet2(1, 80)] {
        assert_eq!(packer.push(&fits, START), Ok(None));
        let message = packer.flush().expect("a message");
        assert_eq!(message[..], fits);
        assert_eq!(unpack(&message), [fits]);
    }
    assert_eq!(packer.push(&packet(1, 40), START), Ok(None));
    for (rejected, long) in (1..).zip([packet(1, 81), packet2(1, 81), packet2(1, 267)]) {
        let error = PackError::TooLong(long.len());
        assert_eq!(packer.push(&long, START), Err(error));
        assert_eq!(packer.rejected(), rejected);
    }
    // What was pending is still there, and fills up to the last byte.
    assert_eq!(packer.push(&packet(2, 40), START), Ok(None));
    let message = packer.flush().expect("a message");
    assert_eq!(unpack(&message), [packet(1, 40), packet(2, 40)]);
}

/// Old vehicles lose what lies behind byte 71.
#[test]
fn old_vehicles() {
    let mut packer = Packer::legacy(MAX_DELAY);
    assert_eq!(
        packer.push(&packet(1, 73), START),
        Err(PackError::TooLong(73))
    );
    assert_eq!(packer.push(&packet(1, 36), START), Ok(None));
    assert_eq!(packer.push(&packet(2, 36), START), Ok(None));
    // Nor do they know MAVLink 2, of whatever length.
    for size in [12, 36, 72, 80] {
        let rejected = packer.push(&packet2(1, size), START);
        assert_eq!(rejected, Err(PackError::LegacyVehicle));
    }
    assert_eq!(packer.rejected(), 5);
    let full = packer.push(&packet(3, 8), START).expect("a packet");
    let full = full.expect("a message");
    assert_eq!(full[LEGACY_SIZE..], [0; 8]);
    assert_eq!(unpack(&full), [packet(1, 36), packet(2, 36)]);
}

#[test]
fn only_whole_packets_are_packed() {
    let mut packer = Packer::new(MAX_DELAY);
    let cut = packet(1, 40)[..39].to_vec();
    let two = [packet(1, 20), packet(2, 20)].concat();
    let mut flags = packet2(1, 30);
    flags[2] = 2;
    let cases = [
        (Vec::new(), PackError::Parse(ParseError::Truncated)),
        (vec![0xFE], PackError::Parse(ParseError::Truncated)),
        (cut, PackError::Parse(ParseError::Truncated)),
        (vec![0; 80], PackError::Parse(ParseError::BadMagic(0))),
        (two, PackError::Trailing(20)),
        (flags, PackError::Parse(ParseError::UnknownIncompatFlags(2))),
    ];
    for (rejected, (bytes, error)) in (1..).zip(cases) {
        assert_eq!(packer.push(&bytes, START), Err(error));
        assert_eq!(packer.rejected(), rejected);
        assert_eq!(packer.flush(), None);
    }
}

/// Zeros in front, between and behind are nothing; whatever else is no packet is an error, and the end.
#[test]
fn messages_of_other_senders() {
    let mut message = [0; 80];
    message[3..13].copy_from_slice(&packet(1, 10));
    message[20..32].copy_from_slice(&packet2(2, 12));
    assert_eq!(packets(&[0; 80]).next(), None);
    let found: Vec<_> = packets(&message).collect();
    assert_eq!(found, [Ok(&packet(1, 10)[..]), Ok(&message[20..32])]);

    let truncated = |offset| UnpackError {
        offset,
        fault: ParseError::Truncated,
    };
    for (at, byte, fault) in [
        (15, 0x55, ParseError::BadMagic(0x55)),
        (79, 0xFE, ParseError::Truncated),
        (78, 0xFD, ParseError::Truncated),
        (40, 1, ParseError::BadMagic(1)),
    ] {
        let mut message = [0; 80];
        message[..10].copy_from_slice(&packet(1, 10));
        message[at] = byte;
        let found: Vec<_> = packets(&message).collect();
        let error = UnpackError { offset: at, fault };
        assert_eq!(found, [Ok(&packet(1, 10)[..]), Err(error)]);
    }
    // A packet that announces more than the message holds does not swallow what is behind it.
    let mut message = [0; 80];
    message[..2].copy_from_slice(&hex("fe49"));
    assert_eq!(packets(&message).collect::<Vec<_>>(), [Err(truncated(0))]);
}
