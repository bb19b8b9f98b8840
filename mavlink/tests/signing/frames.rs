//! Frames of every length, every damage, every edge of time.

use std::error::Error;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::common::*;
use mavlink_signing::field::{HEADER_SIZE, MAX_FRAME_SIZE, SIGNATURE_SIZE, TAG_SIZE};
use mavlink_signing::{
    Frame, FrameRef, Hmac, KEY_SIZE, KeyChange, KeyChangeError, KeyError, MessageId, Packet,
    ParseError, ReplayGuard, RolloverState, SignError, SigningKey, Stamp, Stamper, Timestamp,
    VerifyError, Window, accept_unsigned, authenticate, dialect, redact_for_log, sign_frame,
};

/// The checksum by a library that shares no code with this one.
fn checksum(covered: &[u8], crc_extra: u8) -> [u8; 2] {
    let crc = crc::Crc::<u16>::new(&crc::CRC_16_MCRF4XX);
    let mut digest = crc.digest();
    digest.update(covered);
    digest.update(&[crc_extra]);
    digest.finalize().to_le_bytes()
}

/// Payload bytes that are not all alike.
fn payload(length: usize) -> Vec<u8> {
    (0..length).map(|i| (i * 7 + length) as u8).collect()
}

#[test]
fn every_payload_length() {
    for length in 0..=255 {
        let payload = payload(length);
        let frame = signed(&payload, NOW);
        let bytes = frame.as_bytes();
        assert_eq!(bytes.len(), HEADER_SIZE + length + 2 + SIGNATURE_SIZE);

        // Every byte, from the guide's description and two independent libraries.
        let mut expected = vec![0xFD, length as u8, 1, 0, 17, 1, 190, 0, 0, 0];
        expected.extend(&payload);
        expected.extend(checksum(&expected[1..], 50));
        expected.push(LINK_ID);
        expected.extend(&NOW.to_le_bytes()[..6]);
        let tag = hmac_sha256::HMAC::mac(&expected, KEY);
        expected.extend(&tag[..TAG_SIZE]);
        assert_eq!(bytes, expected);

        let state = fresh();
        let verified = receive(bytes, NOW, &state).expect("verified");
        assert_eq!(verified.payload(), payload);
        assert_eq!(verified.to_frame(), frame);
        assert_eq!(verified.to_unsigned(), unsigned(0, &payload));
    }
    assert_eq!(signed(&payload(255), NOW).as_bytes().len(), MAX_FRAME_SIZE);
}

#[test]
fn every_message_of_the_dialect() {
    assert!(dialect::messages().len() > 0);
    for (id, crc_extra) in dialect::messages() {
        let frame = unsigned(id.get(), &[1, 2]);
        let bytes = frame.as_bytes();
        assert_eq!(bytes[12..], checksum(&bytes[1..12], crc_extra));
        let received = FrameRef::parse(bytes).expect("a frame");
        assert_eq!(received.header(), header(id.get()));

        // Signed and verified, whatever bytes the id has.
        let mut signed = Frame::try_from(received).expect("its checksum is right");
        let stamp = Stamp {
            link_id: LINK_ID,
            timestamp: at(NOW),
        };
        sign_frame(&mut signed, &key(), stamp).expect("signed");
        let (covered, tag) = signed.as_bytes().split_at(19 + 2);
        assert_eq!(tag, &hmac_sha256::HMAC::mac(covered, KEY)[..TAG_SIZE]);
        let state = fresh();
        let verified = receive(signed.as_bytes(), NOW, &state).expect("verified");
        assert_eq!(verified.header(), header(id.get()));
    }
}

/// The verdict on a signed HEARTBEAT in which bit `bit` is wrong.
fn verdict_on_flip(bit: usize, length: usize) -> Vec<VerifyError> {
    let (byte, mask) = (bit / 8, 1_u8 << (bit % 8));
    match byte {
        0 => vec![VerifyError::Parse(ParseError::BadMagic(0xFD ^ mask))],
        // Shorter than announced, or the checksum is looked for elsewhere.
        1 if length as u8 & mask == 0 => vec![VerifyError::Parse(ParseError::Truncated)],
        1 => vec![VerifyError::BadChecksum],
        2 if mask == 1 => vec![VerifyError::NotSigned],
        2 => vec![VerifyError::Parse(ParseError::UnknownIncompatFlags(
            1 | mask,
        ))],
        7..10 => {
            let id = MessageId::new(1 << (bit - 7 * 8)).expect("24 bits");
            vec![VerifyError::UnknownMessage(id), VerifyError::BadChecksum]
        }
        _ if byte < 10 + length + 2 => vec![VerifyError::BadChecksum],
        _ => vec![VerifyError::BadTag],
    }
}

#[test]
fn every_flipped_bit_is_rejected() {
    for length in 0..=255 {
        let frame = signed(&payload(length), NOW);
        for bit in 0..frame.as_bytes().len() * 8 {
            let mut bytes = frame.as_bytes().to_vec();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let state = fresh();
            let error = receive(&bytes, NOW, &state).expect_err("rejected");
            let expected = verdict_on_flip(bit, length);
            assert!(
                expected.contains(&error),
                "length {length}, bit {bit}: {error:?}"
            );
            assert_eq!(state.last(), None);
        }
    }
}

/// A wrong bit in a frame without signature: nothing lets it through, copies it to be signed, or logs it.
#[test]
fn every_flipped_bit_without_signature_is_rejected() {
    for length in [0, 1, 9, 255] {
        let frame = unsigned(0, &payload(length));
        for bit in 3 * 8..frame.as_bytes().len() * 8 {
            let mut bytes = frame.as_bytes().to_vec();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let received = FrameRef::parse(&bytes).expect("a frame");
            let accepted = accept_unsigned(received, LINK_ID, &|_| true);
            assert!(accepted.is_err(), "length {length}, bit {bit}");
            assert!(Frame::try_from(received).is_err());
            assert!(redact_for_log(received).is_err());
            assert!(Packet::parse(&bytes, dialect::crc_extra).is_err());
            assert!(!received.checksum_matches(50));
        }
    }
}

#[test]
fn a_flip_under_a_repaired_checksum_is_a_bad_tag() {
    let frame = signed(&payload(9), NOW);
    let checksum_at = HEADER_SIZE + 9;
    for bit in 3 * 8..checksum_at * 8 {
        let mut bytes = frame.as_bytes().to_vec();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let id = MessageId::from_le_bytes([bytes[7], bytes[8], bytes[9]]);
        let Some(crc_extra) = dialect::crc_extra(id) else {
            assert_rejected(&bytes, NOW, &fresh(), VerifyError::UnknownMessage(id));
            continue;
        };
        let repaired = checksum(&bytes[1..checksum_at], crc_extra);
        bytes[checksum_at..checksum_at + 2].copy_from_slice(&repaired);
        assert_rejected(&bytes, NOW, &fresh(), VerifyError::BadTag);
    }
}

#[test]
fn the_window_includes_its_edges() {
    for (age, expected) in [
        (0, Ok(())),
        (1, Ok(())),
        (999_999, Ok(())),
        (1_000_000, Ok(())),
        (1_000_001, Err(VerifyError::TooOld)),
    ] {
        let frame = signed(&[1], NOW - age);
        let state = fresh();
        let verdict = receive(frame.as_bytes(), NOW, &state).map(drop);
        assert_eq!(verdict, expected, "{age} ticks old");
    }
    let window = Window { past: 5, ahead: 7 };
    for (stamp, expected) in [
        (NOW - 6, Err(VerifyError::TooOld)),
        (NOW - 5, Ok(())),
        (NOW + 7, Ok(())),
        (NOW + 8, Err(VerifyError::FromFuture)),
    ] {
        assert_eq!(window.check(at(stamp), at(NOW)), expected);
    }
    // A clock that has run for less than the window, and one at its end.
    assert_eq!(Window::STRICT.check(Timestamp::ZERO, at(3)), Ok(()));
    let open = Window {
        past: 0,
        ahead: u64::MAX,
    };
    assert_eq!(open.check(Timestamp::MAX, Timestamp::ZERO), Ok(()));
}

#[test]
fn a_clock_of_48_bits() {
    let max = (1 << 48) - 1;
    assert_eq!(Timestamp::MAX.ticks(), max);
    assert_eq!(Timestamp::from_ticks(max + 1), None);
    assert_eq!(Timestamp::from_ticks(u64::MAX), None);
    assert_eq!(Timestamp::MAX.to_wire(), [0xFF; 6]);
    assert_eq!(
        Timestamp::from_wire([1, 2, 3, 4, 5, 6]).ticks(),
        0x0605_0403_0201
    );
    assert_eq!(Timestamp::MAX.saturating_add(1), Timestamp::MAX);
    assert_eq!(at(max - 1).saturating_add(1), Timestamp::MAX);
    assert_eq!(Timestamp::ZERO.saturating_add(u64::MAX), Timestamp::MAX);

    // date -u -d 2015-01-01T00:00:00Z +%s
    let epoch = 1_420_070_400_000_000;
    assert_eq!(Timestamp::from_unix_micros(epoch), Some(Timestamp::ZERO));
    assert_eq!(Timestamp::from_unix_micros(epoch - 1), None);
    assert_eq!(Timestamp::from_unix_micros(epoch + 19), Some(at(1)));
    assert_eq!(Timestamp::from_unix_micros(u64::MAX), None);
    assert_eq!(at(1).unix_micros(), epoch + 10);

    // The last frame of all is accepted, once.
    let state = fresh();
    let last = signed(&[1], max);
    receive(last.as_bytes(), max, &state).expect("the last");
    assert_rejected(last.as_bytes(), max, &state, VerifyError::Replayed);
    assert_eq!(state.last(), Some(Timestamp::MAX));
}

#[test]
fn stamps_increase_and_end() {
    let mut stamper = Stamper::new(LINK_ID);
    let stamps: Vec<u64> = [5, 5, 3, 9, 9]
        .map(|now| stamper.stamp(at(now)).expect("a stamp").timestamp.ticks())
        .into();
    assert_eq!(stamps, [5, 6, 7, 9, 10]);

    // A minute of silence does not leave the stamps behind.
    let later = stamper.stamp(at(6_000_009)).expect("a stamp");
    assert_eq!(later.timestamp, at(6_000_009));

    let mut stamper = Stamper::resume(LINK_ID, Timestamp::MAX);
    assert_eq!(stamper.link_id(), LINK_ID);
    let last = stamper.stamp(Timestamp::ZERO).expect("the last stamp");
    assert_eq!(last.timestamp, Timestamp::MAX);
    for now in [Timestamp::ZERO, Timestamp::MAX] {
        assert_eq!(stamper.stamp(now), Err(SignError::TimestampsExhausted));
    }
}

#[test]
fn a_receiver_resumes_at_its_mark() {
    let mut replay = ReplayGuard::resume(LINK_ID, Window::STRICT, at(NOW));
    assert_eq!(
        (replay.link_id(), replay.window()),
        (LINK_ID, Window::STRICT)
    );
    assert_eq!(replay.last(), Some(at(NOW - 1)));
    for (ticks, accepted) in [(NOW - 1, false), (NOW, true), (NOW, false), (NOW + 1, true)] {
        let frame = signed(&[1], ticks);
        let received = FrameRef::parse(frame.as_bytes()).expect("a frame");
        let authentic = authenticate(received, &key()).expect("authentic");
        assert_eq!(replay.admit(authentic, at(NOW + 1)).is_ok(), accepted);
    }
}

#[test]
fn a_frame_is_signed_once() {
    let mut frame = signed(&[1], NOW);
    let before = frame.clone();
    let stamp = Stamp {
        link_id: LINK_ID,
        timestamp: at(NOW + 1),
    };
    assert_eq!(
        sign_frame(&mut frame, &key(), stamp),
        Err(SignError::AlreadySigned)
    );
    assert_eq!(frame, before);
}

#[test]
fn frames_that_cannot_be_made() {
    let long = Frame::new(header(0), &[1; 256]);
    assert_eq!(long, Err(SignError::PayloadTooLong(256)));

    let mut bytes = unsigned(0, &[1, 2, 3]).as_bytes().to_vec();
    bytes[11] ^= 1;
    let damaged = FrameRef::parse(&bytes).expect("a frame");
    assert_eq!(Frame::try_from(damaged), Err(SignError::BadChecksum));
    bytes[7..10].copy_from_slice(&header(UNKNOWN).message_id.to_le_bytes());
    let unknown = FrameRef::parse(&bytes).expect("a frame");
    let error = SignError::UnknownMessage(header(UNKNOWN).message_id);
    assert_eq!(Frame::try_from(unknown), Err(error));
}

#[test]
fn every_incompatibility_flag_but_one_is_unknown() {
    for flags in 0..=255_u8 {
        let mut bytes = signed(&[1], NOW).as_bytes().to_vec();
        bytes[2] = flags;
        match FrameRef::parse(&bytes) {
            Ok(frame) => assert_eq!(frame.is_signed(), flags == 1),
            Err(error) => {
                assert!(flags > 1);
                assert_eq!(error, ParseError::UnknownIncompatFlags(flags));
            }
        }
    }
}

#[test]
fn what_follows_a_frame_is_left_alone() {
    let frame = signed(&[1, 2, 3], NOW);
    let mut bytes = frame.as_bytes().to_vec();
    bytes.extend([0xAA; 300]);
    let received = FrameRef::parse(&bytes).expect("a frame");
    assert_eq!(received.as_bytes(), frame.as_bytes());
}

#[test]
fn keys_of_zeros_are_none() {
    let error = SigningKey::<Hmac>::new(&[0; 32]).expect_err("zeros");
    assert_eq!(error, KeyError::AllZero);
    for set in 0..32 {
        let mut bytes = [0; 32];
        bytes[set] = 1;
        SigningKey::<Hmac>::new(&bytes).expect("one byte is set");
    }
}

#[test]
fn nothing_shows_a_key() {
    assert_eq!(format!("{:?}", key()), "SigningKey(redacted)");
}

/// Logs say what a frame is, and nothing of a payload that nobody has vouched for, nor the tag.
#[test]
fn a_frame_is_shown_without_its_payload() {
    for frame in [unsigned(0, &[0xA5; 3]), signed(&[0xA5; 3], NOW)] {
        let received = FrameRef::parse(frame.as_bytes()).expect("a frame");
        let header = received.header();
        let stamp = received.signature().map(|signature| signature.stamp);
        let shown = format!("{received:?}");
        assert_eq!(
            shown,
            format!("FrameRef {{ header: {header:?}, payload_length: 3, stamp: {stamp:?} }}")
        );
        assert_eq!(format!("{frame:?}"), shown);
    }
}

/// RFC 4231, section 4, cases 1 to 5, cut to 48 bits. A key shorter than 32 bytes is the same key
/// with zeros after it (RFC 2104, section 2); the longer keys of cases 6 and 7 are none here.
#[test]
fn hmac_sha256_rfc4231() {
    use mavlink_signing::Profile;

    let count_up: Vec<u8> = (1..=25).collect();
    let cases: [(&[u8], &[u8], [u8; 6]); 5] = [
        (
            &[0x0B; 20],
            b"Hi There",
            [0xB0, 0x34, 0x4C, 0x61, 0xD8, 0xDB],
        ),
        (
            b"Jefe",
            b"what do ya want for nothing?",
            [0x5B, 0xDC, 0xC1, 0x46, 0xBF, 0x60],
        ),
        (
            &[0xAA; 20],
            &[0xDD; 50],
            [0x77, 0x3E, 0xA9, 0x1E, 0x36, 0x80],
        ),
        (&count_up, &[0xCD; 50], [0x82, 0x55, 0x8A, 0x38, 0x9A, 0x44]),
        (
            &[0x0C; 20],
            b"Test With Truncation",
            [0xA3, 0xB6, 0x16, 0x74, 0x73, 0x10],
        ),
    ];
    for (key, message, expected) in cases {
        let mut padded = [0; 32];
        padded[..key.len()].copy_from_slice(key);
        assert_eq!(<Hmac>::new(&padded).tag(message), expected);
    }
}

/// Four threads receive the same frames; none is accepted by two of them.
#[test]
fn two_frames_with_one_stamp_cannot_both_pass() {
    let state = fresh();
    let frames: Vec<Frame> = (0..200).map(|i| signed(&[1], NOW + i)).collect();
    let accepted: Vec<AtomicUsize> = frames.iter().map(|_| AtomicUsize::new(0)).collect();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                for (frame, accepted) in frames.iter().zip(&accepted) {
                    let verdict = receive(frame.as_bytes(), NOW + 200, &state);
                    accepted.fetch_add(verdict.is_ok().into(), Ordering::Relaxed);
                }
            });
        }
    });
    let accepted: Vec<usize> = accepted.into_iter().map(AtomicUsize::into_inner).collect();
    assert!(accepted.iter().all(|times| *times <= 1), "{accepted:?}");
    assert_eq!(accepted.last(), Some(&1), "nothing is newer than the last");
}

#[test]
fn errors_say_what_is_wrong() {
    let id = MessageId::from(7);
    let said = [
        KeyError::WrongLength(31).to_string(),
        KeyError::AllZero.to_string(),
        SignError::PayloadTooLong(256).to_string(),
        SignError::UnknownMessage(id).to_string(),
        SignError::BadChecksum.to_string(),
        SignError::AlreadySigned.to_string(),
        SignError::TimestampsExhausted.to_string(),
        VerifyError::Parse(ParseError::Truncated).to_string(),
        VerifyError::Parse(ParseError::BadMagic(0xFE)).to_string(),
        VerifyError::Parse(ParseError::UnknownIncompatFlags(3)).to_string(),
        VerifyError::NotSigned.to_string(),
        VerifyError::UnknownMessage(id).to_string(),
        VerifyError::BadChecksum.to_string(),
        VerifyError::BadTag.to_string(),
        VerifyError::WrongLink(9).to_string(),
        VerifyError::FromFuture.to_string(),
        VerifyError::TooOld.to_string(),
        VerifyError::Replayed.to_string(),
        VerifyError::Reflected.to_string(),
        VerifyError::Signed.to_string(),
        KeyChangeError::Key(KeyError::AllZero).to_string(),
        KeyChangeError::UnderWay.to_string(),
        KeyChangeError::NotOffered.to_string(),
        KeyChangeError::NotConfirmed.to_string(),
        KeyChangeError::NotStored.to_string(),
    ];
    assert_eq!(
        said.join("\n"),
        "a key has 32 bytes, this one has 31\n\
         a key of zeros only is no key\n\
         a payload has at most 255 bytes, this one has 256\n\
         message 7 is not in the dialect\n\
         the frame to sign is damaged: bad checksum\n\
         the frame is already signed\n\
         all timestamps of 6 bytes are used up\n\
         the frame is cut short\n\
         a MAVLink 2 frame begins with 0xFD, not 0xFE\n\
         unknown incompatibility flags 0x03\n\
         the frame is not signed\n\
         message 7 is not in the dialect\n\
         bad checksum\n\
         bad tag: another key or a forgery\n\
         made for link 9\n\
         stamped in the future\n\
         stamped too long ago\n\
         not newer than the last accepted frame\n\
         of a system that this end signs for: sent back\n\
         the frame is signed\n\
         a key of zeros only is no key\n\
         another change of key is under way\n\
         no key is offered that could be withdrawn\n\
         the other end has not been heard with the new key\n\
         the keys cannot be stored"
    );
    let parse = VerifyError::Parse(ParseError::Truncated);
    let source = parse.source().and_then(|source| source.downcast_ref());
    assert_eq!(source, Some(&ParseError::Truncated));
    assert!(VerifyError::BadTag.source().is_none());
    let change = KeyChangeError::Key(KeyError::AllZero);
    let source = change.source().and_then(|source| source.downcast_ref());
    assert_eq!(source, Some(&KeyError::AllZero));
    assert!(KeyChangeError::UnderWay.source().is_none());
}

#[test]
fn what_is_stored_of_a_key_does_not_show_it() {
    let changes = [
        KeyChange::Begin(&[0xAB; KEY_SIZE], RolloverState::Offered),
        KeyChange::Confirm,
        KeyChange::Retire,
        KeyChange::Withdraw,
    ];
    assert_eq!(
        format!("{changes:?}"),
        "[Begin(redacted), Confirm, Retire, Withdraw]"
    );
}
