//! The standard's signature, streams, unsigned frames and keys in transit, with frames of others.

use mavlink_signing::*;

const PASSPHRASE: &str = "correct horse battery staple";

/// pymavlink 2.4.50: `signing.secret_key = sha256(PASSPHRASE)`, link id 3, HEARTBEAT of system 7.
const PYMAVLINK_HEARTBEAT: [u8; 34] = [
    0xFD, 0x09, 0x01, 0x00, 0x00, 0x07, 0x01, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x02, 0x03,
    0x51, 0x04, 0x03, 0xED, 0x5E, 0x03, 0x05, 0x04, 0x03, 0x02, 0x01, 0x00, 0xD7, 0x8E, 0x58, 0xC1,
    0xA6, 0xF1,
];
const TICKS: u64 = 0x01_0203_0405;

fn key() -> SigningKey<Standard> {
    SigningKey::from_passphrase(PASSPHRASE).expect("a key")
}

fn at(ticks: u64) -> Timestamp {
    Timestamp::from_ticks(ticks).expect("48 bits")
}

#[test]
fn a_frame_of_pymavlink_is_authentic_and_made_the_same() {
    let frame = FrameRef::parse(&PYMAVLINK_HEARTBEAT).expect("a frame");
    let authentic = authenticate(frame, &key()).expect("authentic");
    assert_eq!(authentic.stamp().timestamp, at(TICKS));

    let payload = &PYMAVLINK_HEARTBEAT[10..19];
    let mut ours = Frame::new(frame.header(), payload).expect("a frame");
    sign_frame(&mut ours, &key(), authentic.stamp()).expect("signed");
    assert_eq!(ours.as_bytes(), PYMAVLINK_HEARTBEAT);
}

#[test]
fn the_profiles_do_not_understand_each_other() {
    let frame = FrameRef::parse(&PYMAVLINK_HEARTBEAT).expect("a frame");
    let other = SigningKey::<Hmac>::from_passphrase(PASSPHRASE).expect("a key");
    let verdict = authenticate(frame, &other).map(drop);
    assert_eq!(verdict, Err(VerifyError::BadTag));
    assert_ne!(other.fingerprint(), key().fingerprint());
}
