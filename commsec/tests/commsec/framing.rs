//! Framing: conformance strings, and what is dropped.

use mavlink_commsec::hx::{DecodeError, Decoder, Frame, FrameError, FrameKind, MAX_ENCODED_SIZE};

use crate::common::{hex, seal};
use crate::vectors::{FRAMES, STATUS, STATUS_FRAME};

/// A frame's tag and payload, or why it was dropped.
type Outcome = Result<(u8, Vec<u8>), DecodeError>;

/// Everything that comes out of `bytes`.
fn decode(bytes: &[u8]) -> Vec<Outcome> {
    let mut decoder = Decoder::new();
    let mut outcomes = Vec::new();
    for byte in bytes {
        if let Some(outcome) = decoder.push(*byte) {
            outcomes.push(outcome.map(|frame| (frame.kind().to_wire(), frame.payload().to_vec())));
        }
    }
    outcomes
}

fn encode(tag: FrameKind, payload: &[u8]) -> Vec<u8> {
    let frame = Frame::new(tag, payload).expect("a frame");
    frame.encode().collect()
}

#[test]
fn conformance_strings() {
    let air = |payload: &str| Ok((0, hex(payload)));
    let cases: [(&str, &[Outcome]); 7] = [
        ("aabb7c7d7e0001027e7e0003047e", &[air("0102"), air("0304")]),
        ("7e0001027e0003047e", &[air("0102"), air("0304")]),
        (
            "7e0001027c7e0003047e",
            &[Err(DecodeError::TruncatedEscape), air("0304")],
        ),
        ("7e007c5e7c5c7c007c7c7e", &[air("7e7c205c")]),
        (
            "7e0701027e0003047e",
            &[Err(DecodeError::UnknownKind(7)), air("0304")],
        ),
        ("7e007e7e0003047e", &[Err(DecodeError::Empty), air("0304")]),
        ("7e000102", &[]),
    ];
    for (bytes, outcomes) in cases {
        assert_eq!(decode(&hex(bytes)), outcomes, "{bytes}");
    }
    let payload = hex("0102ff7b7c7d7e09");
    let encoded = hex("7e000102ff7b7c5c7d7c5e097e");
    assert_eq!(encode(FrameKind::AirData, &payload), encoded);
}

#[test]
fn reference_frames() {
    for (vector, frame) in FRAMES {
        let package = seal(vector).expect("a counter is left");
        let encoded: Vec<u8> = Frame::from(&package).encode().collect();
        assert_eq!(encoded, hex(frame), "{}", vector.name);
        assert_eq!(decode(&encoded), [Ok((0, hex(vector.package)))]);
    }
    for (text, frame) in [
        (&b"B\r"[..], "7e01420d7e"),
        (b"D\r", "7e01440d7e"),
        (b"ATI5\r", "7e01415449350d7e"),
        (&hex(STATUS), STATUS_FRAME),
    ] {
        assert_eq!(encode(FrameKind::Radio, text), hex(frame));
        assert_eq!(decode(&hex(frame)), [Ok((1, text.to_vec()))]);
    }
}

#[test]
fn no_empty_and_no_endless_frames() {
    for tag in [FrameKind::AirData, FrameKind::Radio] {
        assert_eq!(Frame::new(tag, &[]), Err(FrameError::Empty));
        assert_eq!(Frame::new(tag, &[0; 101]), Err(FrameError::TooLong(101)));
        assert_eq!(encode(tag, &[1]).len(), 4);
        assert_eq!(encode(tag, &[0x7C; 100]).len(), MAX_ENCODED_SIZE);
    }
}

/// A frame too long is dropped once, up to its end; the next one is found.
#[test]
fn too_long() {
    for length in [101, 102, 150, 10_000] {
        let mut bytes = vec![0x7E, 0];
        bytes.extend(vec![0x55; length]);
        bytes.extend(hex("7e0003047e"));
        let expected = [Err(DecodeError::TooLong), Ok((0, vec![3, 4]))];
        assert_eq!(decode(&bytes), expected, "{length}");
    }
    let longest = encode(FrameKind::Radio, &[0x7E; 100]);
    assert_eq!(decode(&longest), [Ok((1, vec![0x7E; 100]))]);
    // What is escaped counts once.
    let mut escaped = longest;
    escaped.splice(2..2, [0x7C, 0x00]);
    assert_eq!(decode(&escaped), [Err(DecodeError::TooLong)]);
}

#[test]
fn unknown_tags_are_passed_over() {
    for tag in (2..=255).filter(|tag| *tag != 0x7E) {
        let bytes = [&[0x7E, tag, 1, 2, 3][..], &hex("7e0003047e")].concat();
        let expected = [Err(DecodeError::UnknownKind(tag)), Ok((0, vec![3, 4]))];
        assert_eq!(decode(&bytes), expected);
    }
}

/// Boundaries shared, doubled, or many in a row, and a last frame that has none.
#[test]
fn boundaries() {
    let frames = |between: &[u8]| [&[0x7E, 0, 1][..], between, &[1, 2], between].concat();
    for between in [&[0x7E][..], &[0x7E; 2], &[0x7E; 50]] {
        let outcomes = decode(&frames(between));
        assert_eq!(outcomes, [Ok((0, vec![1])), Ok((1, vec![2]))]);
    }
    assert_eq!(decode(&hex("7e0001027e0103")), [Ok((0, vec![1, 2]))]);
}

/// Every payload byte round, after any first byte on the line.
#[test]
fn every_byte_round_trips() {
    let all: Vec<u8> = (0..=255).collect();
    for payload in all.chunks(100) {
        for noise in 0..=255 {
            let bytes = [&[noise][..], &encode(FrameKind::AirData, payload)].concat();
            assert_eq!(decode(&bytes), [Ok((0, payload.to_vec()))]);
        }
    }
}
