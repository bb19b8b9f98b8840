//! The 17 tests of the code that mavseal grew from, by what they check.

use crate::common::*;
use mavlink_signing::{
    Frame, FrameRef, Hmac, KeyError, ParseError, SignError, SigningKey, Stamp, VerifyError,
    sign_frame, verify_frame,
};

const PAYLOAD: &[u8] = &[1, 2, 3];

#[test]
fn valid_round_trip() {
    let frame = signed(PAYLOAD, NOW);
    let state = fresh();
    let verified = receive(frame.as_bytes(), NOW, &state).expect("verified");
    assert_eq!(verified.payload(), PAYLOAD);
    assert_eq!(verified.header(), header(0));
    assert_eq!(state.last(), Some(at(NOW)));
}

#[test]
fn key_too_short() {
    let error = SigningKey::<Hmac>::new(&[1; 31]).expect_err("31 bytes");
    assert_eq!(error, KeyError::WrongLength(31));
}

#[test]
fn key_too_long() {
    let error = SigningKey::<Hmac>::new(&[1; 33]).expect_err("33 bytes");
    assert_eq!(error, KeyError::WrongLength(33));
}

#[test]
fn sign_unknown_message() {
    let id = header(UNKNOWN).message_id;
    assert_eq!(
        Frame::new(header(UNKNOWN), PAYLOAD).expect_err("unknown"),
        SignError::UnknownMessage(id)
    );
}

#[test]
fn verify_unknown_message() {
    let mut bytes = signed(PAYLOAD, NOW).as_bytes().to_vec();
    let id = header(UNKNOWN).message_id;
    bytes[7..10].copy_from_slice(&id.to_le_bytes());
    assert_rejected(&bytes, NOW, &fresh(), VerifyError::UnknownMessage(id));
}

#[test]
fn wrong_key() {
    let frame = signed(PAYLOAD, NOW);
    let other = SigningKey::<Hmac>::new(&[0x5A; 32]).expect("a key");
    let received = FrameRef::parse(frame.as_bytes()).expect("a frame");
    let error = verify_frame(received, &other, at(NOW), &fresh()).expect_err("another key");
    assert_eq!(error, VerifyError::BadTag);
}

#[test]
fn tampered_payload() {
    let mut bytes = signed(PAYLOAD, NOW).as_bytes().to_vec();
    bytes[10] ^= 0x80;
    assert_rejected(&bytes, NOW, &fresh(), VerifyError::BadChecksum);
}

#[test]
fn tampered_signature() {
    let mut bytes = signed(PAYLOAD, NOW).as_bytes().to_vec();
    *bytes.last_mut().expect("a tag") ^= 1;
    assert_rejected(&bytes, NOW, &fresh(), VerifyError::BadTag);
}

#[test]
fn unsigned_frame() {
    let frame = unsigned(0, PAYLOAD);
    assert_rejected(frame.as_bytes(), NOW, &fresh(), VerifyError::NotSigned);
}

#[test]
fn wrong_link() {
    let mut frame = unsigned(0, PAYLOAD);
    let stamp = Stamp {
        link_id: LINK_ID + 1,
        timestamp: at(NOW),
    };
    sign_frame(&mut frame, &key(), stamp).expect("signed");
    let error = VerifyError::WrongLink(LINK_ID + 1);
    assert_rejected(frame.as_bytes(), NOW, &fresh(), error);
}

#[test]
fn stamped_in_the_future() {
    let frame = signed(PAYLOAD, NOW + 1);
    assert_rejected(frame.as_bytes(), NOW, &fresh(), VerifyError::FromFuture);
}

#[test]
fn stamped_too_long_ago() {
    let frame = signed(PAYLOAD, NOW - 1_000_001);
    assert_rejected(frame.as_bytes(), NOW, &fresh(), VerifyError::TooOld);
}

#[test]
fn replayed() {
    let frame = signed(PAYLOAD, NOW);
    let state = fresh();
    receive(frame.as_bytes(), NOW, &state).expect("the first time");
    assert_rejected(frame.as_bytes(), NOW, &state, VerifyError::Replayed);
}

#[test]
fn not_increasing() {
    let state = fresh();
    receive(signed(PAYLOAD, NOW).as_bytes(), NOW, &state).expect("newer");
    let earlier = signed(PAYLOAD, NOW - 1);
    assert_rejected(earlier.as_bytes(), NOW, &state, VerifyError::Replayed);
    receive(signed(PAYLOAD, NOW + 1).as_bytes(), NOW + 1, &state).expect("newer still");
}

#[test]
fn bytes_round_trip() {
    let frame = signed(PAYLOAD, NOW);
    let received = FrameRef::parse(frame.as_bytes()).expect("a frame");
    assert_eq!(received.as_bytes(), frame.as_bytes());
    assert_eq!(Frame::try_from(received).expect("a copy"), frame);
}

#[test]
fn wrong_magic() {
    let mut bytes = signed(PAYLOAD, NOW).as_bytes().to_vec();
    bytes[0] = 0xFE;
    let error = VerifyError::Parse(ParseError::BadMagic(0xFE));
    assert_rejected(&bytes, NOW, &fresh(), error);
}

#[test]
fn too_short() {
    let frame = signed(PAYLOAD, NOW);
    let bytes = frame.as_bytes();
    for end in 0..bytes.len() {
        let error = VerifyError::Parse(ParseError::Truncated);
        assert_rejected(&bytes[..end], NOW, &fresh(), error);
    }
}
