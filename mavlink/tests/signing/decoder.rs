//! The decoder: whatever comes over the line, in whatever pieces.

use std::{
    error::Error,
    process,
    sync::{
        atomic::{AtomicUsize, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use crate::common::*;
use mavlink_signing::field::MAX_FRAME_SIZE;
use mavlink_signing::{
    DecodeError, Decoder, MessageId, Packet, ParseError, Resync, SetupSigning, Timestamp,
    dialect::crc_extra,
};

/// A MAVLink 1 HEARTBEAT.
const MAVLINK1: [u8; 17] = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];

#[derive(Debug, PartialEq)]
enum Found {
    Mavlink2(Vec<u8>),
    Mavlink1(Vec<u8>),
    Fault(DecodeError),
}

fn read_all(decoder: &mut Decoder) -> Vec<Found> {
    let mut found = Vec::new();
    while let Some(decoded) = decoder.read() {
        found.push(match decoded {
            Ok(Packet::Mavlink2(frame)) => Found::Mavlink2(frame.as_bytes().into()),
            Ok(Packet::Mavlink1(packet)) => Found::Mavlink1(packet.as_bytes().into()),
            Err(fault) => Found::Fault(fault),
        });
        assert!(found.len() <= MAX_FRAME_SIZE, "each takes a byte at least");
    }
    found
}

/// Everything that is found when `stream` comes in pieces of `size`.
fn decode(stream: &[u8], size: usize) -> Vec<Found> {
    let mut decoder = Decoder::new(Resync::NextByte, crc_extra);
    let mut found = Vec::new();
    for mut piece in stream.chunks(size) {
        while !piece.is_empty() {
            let taken = decoder.write(piece);
            assert!(taken > 0, "there is room after read has returned None");
            piece = &piece[taken..];
            found.extend(read_all(&mut decoder));
        }
    }
    found
}

/// A stream with some of everything.
fn stream() -> Vec<u8> {
    let mut stream = b"noise\xFD\xFEnoise".to_vec();
    stream.extend(signed(&[1, 2, 3], NOW).as_bytes());
    stream.extend(MAVLINK1);
    stream.extend(unsigned(0, &[0xFD; 255]).as_bytes());
    stream.extend([0xFD, 0xFF]);
    stream.extend(signed(&[0xFE; 255], NOW).as_bytes());
    let mut damaged = unsigned(0, &[9; 9]).as_bytes().to_vec();
    damaged[12] ^= 4;
    stream.extend(damaged);
    // Enough of nothing that every packet that noise begins is over.
    stream.extend([0; 300]);
    stream
}

#[test]
fn packets_come_out_as_what_they_are() {
    let found = decode(&stream(), 1);
    let packets: Vec<&Found> = found
        .iter()
        .filter(|found| !matches!(found, Found::Fault(_)))
        .collect();
    assert_eq!(
        packets,
        [
            &Found::Mavlink2(signed(&[1, 2, 3], NOW).as_bytes().into()),
            &Found::Mavlink1(MAVLINK1.into()),
            &Found::Mavlink2(unsigned(0, &[0xFD; 255]).as_bytes().into()),
            &Found::Mavlink2(signed(&[0xFE; 255], NOW).as_bytes().into()),
        ]
    );
    let damaged = Found::Fault(DecodeError::BadChecksum(MessageId::from(0)));
    assert!(found.contains(&damaged));
}

#[test]
fn the_cut_of_the_stream_does_not_matter() {
    let stream = stream();
    let expected = decode(&stream, 1);
    for size in 2..=stream.len() {
        assert_eq!(decode(&stream, size), expected, "pieces of {size}");
    }
}

#[test]
fn every_byte_is_dropped_or_in_a_packet() {
    let stream = stream();
    let mut decoder = Decoder::new(Resync::NextByte, crc_extra);
    let mut rest = &stream[..];
    let mut in_packets = 0;
    while !rest.is_empty() {
        let room = decoder.room();
        let taken = decoder.write(rest);
        assert_eq!(taken, room.min(rest.len()));
        assert!(taken > 0, "there is room after read has returned None");
        rest = &rest[taken..];
        for found in read_all(&mut decoder) {
            if let Found::Mavlink2(bytes) | Found::Mavlink1(bytes) = found {
                in_packets += bytes.len();
            }
        }
    }
    assert_eq!(in_packets + decoder.dropped() as usize, stream.len());
}

/// A decoder that searches for ever would hold up whatever else the machine does.
#[test]
fn the_decoder_always_returns() {
    let (returned, wait) = mpsc::channel();
    thread::spawn(move || {
        for resync in [Resync::NextByte, Resync::Silence] {
            let mut decoder = Decoder::new(resync, crc_extra);
            for byte in stream() {
                decoder.write(&[byte]);
                decoder.idle();
                read_all(&mut decoder);
            }
        }
        returned.send(())
    });
    if wait.recv_timeout(Duration::from_secs(20)) == Err(mpsc::RecvTimeoutError::Timeout) {
        // A thread cannot be stopped: the tests that wait for the decoder would never end.
        eprintln!("the decoder does not return");
        process::exit(1);
    }
}

#[test]
fn unknown_messages_and_flags_are_told() {
    let mut unknown = unsigned(0, &[1]).as_bytes().to_vec();
    let id = header(UNKNOWN).message_id;
    unknown[7..10].copy_from_slice(&id.to_le_bytes());
    let mut decoder = Decoder::new(Resync::NextByte, crc_extra);
    decoder.write(&unknown);
    let first = decoder.read().expect("a fault");
    assert_eq!(first.expect_err("unknown"), DecodeError::UnknownMessage(id));

    let mut flags = unsigned(0, &[1]).as_bytes().to_vec();
    flags[2] = 0x82;
    let mut decoder = Decoder::new(Resync::NextByte, crc_extra);
    decoder.write(&flags);
    let first = decoder.read().expect("a fault");
    assert_eq!(
        first.expect_err("unknown"),
        DecodeError::Parse(ParseError::UnknownIncompatFlags(0x82))
    );
}

#[test]
fn noise_that_announces_255_bytes_holds_nothing_back() {
    let frame = signed(&[1, 2, 3], NOW);
    let mut decoder = Decoder::new(Resync::NextByte, crc_extra);
    decoder.write(&[0xFD, 255, 0, 0]);
    decoder.write(frame.as_bytes());
    assert!(decoder.read().is_none(), "it may still be a packet of 267");

    decoder.idle();
    let found = read_all(&mut decoder);
    assert_eq!(found, [Found::Mavlink2(frame.as_bytes().into())]);
    assert_eq!(decoder.dropped(), 4);

    // Silence lasts until the next byte.
    let (first, second) = frame.as_bytes().split_at(5);
    decoder.idle();
    decoder.write(first);
    assert!(decoder.read().is_none());
    decoder.write(second);
    assert_eq!(read_all(&mut decoder).len(), 1);
}

#[test]
fn a_partial_packet_is_given_up_when_the_line_is_idle() {
    let frame = signed(&[1, 2, 3], NOW);
    let mut decoder = Decoder::new(Resync::NextByte, crc_extra);
    decoder.write(&frame.as_bytes()[..20]);
    decoder.idle();
    assert!(decoder.read().is_none());
    assert_eq!(decoder.dropped(), 20);
    assert_eq!(decoder.room(), 280);
}

/// An unknown or damaged packet whose payload is a whole frame, and a frame behind it.
fn packet_in_packet(outer: impl Fn(&mut Vec<u8>)) -> Vec<u8> {
    let inner = unsigned(0, &[1, 2, 3]);
    let mut stream = unsigned(0, inner.as_bytes()).as_bytes().to_vec();
    outer(&mut stream);
    stream.extend(unsigned(0, &[4, 5, 6]).as_bytes());
    stream
}

#[test]
fn a_payload_is_taken_for_packets_only_where_that_is_asked_for() {
    let unknown = packet_in_packet(|packet| packet[7..10].copy_from_slice(&[0xF0; 3]));
    let damaged = packet_in_packet(|packet| packet[4] ^= 1);
    let flags = packet_in_packet(|packet| packet[2] = 4);
    let magic = packet_in_packet(|packet| packet[0] = 0x55);
    let lost = packet_in_packet(|packet| {
        packet.remove(4);
    });
    let inner = Found::Mavlink2(unsigned(0, &[1, 2, 3]).as_bytes().into());
    let behind = Found::Mavlink2(unsigned(0, &[4, 5, 6]).as_bytes().into());
    for stream in [unknown, damaged, flags, magic, lost] {
        for size in 1..=stream.len() {
            let [searched, trusted] = [Resync::NextByte, Resync::Silence].map(|resync| {
                let mut decoder = Decoder::new(resync, crc_extra);
                let mut found = Vec::new();
                for piece in stream.chunks(size) {
                    assert_eq!(decoder.write(piece), piece.len());
                    found.extend(read_all(&mut decoder));
                }
                decoder.idle();
                found.extend(read_all(&mut decoder));
                decoder.write(unsigned(0, &[4, 5, 6]).as_bytes());
                found.extend(read_all(&mut decoder));
                assert_eq!(found.last(), Some(&behind));
                found
            });
            assert!(searched.contains(&inner), "the next byte");
            // What follows is not heard before the line was silent.
            let packets = trusted.iter().filter(|it| !matches!(it, Found::Fault(_)));
            assert_eq!(packets.collect::<Vec<_>>(), [&behind]);
        }
    }
}

#[test]
fn a_packet_that_has_begun_waits_for_its_bytes_however_long_the_pauses_are() {
    let whole = packet_in_packet(|_| ());
    for cut in 1..whole.len() {
        let mut decoder = Decoder::new(Resync::Silence, crc_extra);
        decoder.write(&whole[..cut]);
        let mut found = read_all(&mut decoder);
        decoder.idle();
        found.extend(read_all(&mut decoder));
        decoder.write(&whole[cut..]);
        found.extend(read_all(&mut decoder));
        assert_eq!(found.len(), 2, "cut at {cut}");
        assert_eq!(decoder.dropped(), 0);
    }
}

#[test]
fn a_fault_of_the_line_gives_up_what_has_begun_and_nothing_before() {
    let frame = unsigned(0, &[1, 2, 3]);
    for resync in [Resync::NextByte, Resync::Silence] {
        let mut decoder = Decoder::new(resync, crc_extra);
        decoder.write(frame.as_bytes());
        decoder.write(&frame.as_bytes()[..7]);
        decoder.fault();
        assert_eq!(read_all(&mut decoder).len(), 1, "it came before");
        let deaf = resync == Resync::Silence;
        assert_eq!(decoder.is_deaf(), deaf);
        assert_eq!(decoder.write(frame.as_bytes()), frame.as_bytes().len());
        assert_eq!(read_all(&mut decoder).len(), usize::from(!deaf));
        decoder.idle();
        assert!(decoder.read().is_none());
        decoder.write(frame.as_bytes());
        assert_eq!(read_all(&mut decoder).len(), 1);
    }
}

/// What magic bytes alone cost: checksums over so many bytes for each byte that came.
#[test]
fn a_flood_of_magic_bytes_costs_little() {
    static CHECKED: AtomicUsize = AtomicUsize::new(0);
    fn counted(id: MessageId) -> Option<u8> {
        CHECKED.fetch_add(1, Ordering::Relaxed);
        crc_extra(id)
    }
    let mut decoder = Decoder::new(Resync::NextByte, counted);
    let flood = vec![0xFE; 100_000];
    for piece in flood.chunks(64) {
        let mut rest = piece;
        while !rest.is_empty() {
            rest = &rest[decoder.write(rest)..];
            while decoder.read().is_some() {}
        }
    }
    let checksums = CHECKED.load(Ordering::Relaxed);
    // Of 262 bytes each: 8 for a byte.
    assert!(checksums * 262 <= 8 * (flood.len() + 280), "{checksums}");
    let frame = signed(&[1, 2, 3], NOW);
    let mut found = Vec::new();
    for byte in frame.as_bytes() {
        assert_eq!(decoder.write(&[*byte]), 1);
        found.extend(read_all(&mut decoder));
    }
    decoder.idle();
    found.extend(read_all(&mut decoder));
    assert!(matches!(found[..], [.., Found::Mavlink2(_)]), "{found:?}");
}

/// A key that was in it is in no log, and no longer in its memory.
#[test]
fn what_went_through_a_decoder_is_not_shown() {
    let key = *b"a key that nobody else must read";
    let setup = SetupSigning {
        target_system: 1,
        target_component: 25,
        secret_key: key,
        initial_timestamp: Timestamp::ZERO,
    };
    let frame = setup.to_frame(header(0)).expect("in the dialect");
    let mut decoder = Decoder::new(Resync::Silence, crc_extra);
    decoder.write(frame.as_bytes());
    assert!(matches!(decoder.read(), Some(Ok(_))));
    let shown = format!("{decoder:?}");
    assert!(!shown.contains("97, 32, 107"), "{shown}");
    assert!(shown.starts_with("Decoder { held: "), "{shown}");
}

#[test]
fn what_is_wrong_with_bytes_is_said() {
    let id = MessageId::from(7);
    let flags = ParseError::UnknownIncompatFlags(3);
    let said = [
        DecodeError::Parse(flags).to_string(),
        DecodeError::UnknownMessage(id).to_string(),
        DecodeError::BadChecksum(id).to_string(),
    ];
    assert_eq!(
        said,
        [
            "unknown incompatibility flags 0x03",
            "message 7 is not in the dialect",
            "bad checksum for message 7",
        ]
    );
    let parse = DecodeError::Parse(flags);
    let source = parse.source().and_then(|source| source.downcast_ref());
    assert_eq!(source, Some(&flags));
    assert!(DecodeError::BadChecksum(id).source().is_none());
}
