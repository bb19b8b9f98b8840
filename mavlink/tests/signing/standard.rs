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

fn heartbeat(message_id: MessageId) -> Header {
    Header {
        compat_flags: 0,
        sequence: 0,
        system_id: 7,
        component_id: 1,
        message_id,
    }
}

fn unsigned_frame(id: u8) -> Frame {
    Frame::new(heartbeat(id.into()), &[1, 2, 3]).expect("a frame")
}

#[test]
fn a_policy_is_asked_about_undamaged_unsigned_frames_alone() {
    let verdict = |bytes: &[u8], policy: &dyn Fn(Claim) -> bool| {
        let frame = FrameRef::parse(bytes).expect("a frame");
        accept_unsigned(frame, 3, &policy).map(|unsigned| unsigned.payload().len())
    };
    let frame = unsigned_frame(0);
    let claim = Claim {
        link_id: 3,
        system_id: 7,
        component_id: 1,
        message_id: MessageId::from(0),
    };
    assert_eq!(verdict(frame.as_bytes(), &|asked| asked == claim), Ok(3));
    assert_eq!(
        verdict(frame.as_bytes(), &|_| false),
        Err(VerifyError::NotSigned)
    );

    let never = |_: Claim| -> bool { panic!("asked") };
    let mut damaged = frame.as_bytes().to_vec();
    damaged[10] ^= 1;
    assert_eq!(verdict(&damaged, &never), Err(VerifyError::BadChecksum));
    // Right or wrong, a signature is not the policy's business.
    let mut forged = PYMAVLINK_HEARTBEAT;
    forged[33] ^= 1;
    for signed in [PYMAVLINK_HEARTBEAT, forged] {
        assert_eq!(verdict(&signed, &never), Err(VerifyError::Signed));
    }
}

#[test]
fn presets_accept_what_they_are_named_after() {
    let accepted = |policy: &dyn UnsignedPolicy, id: u8, link_id: u8| {
        policy.accepts(Claim {
            link_id,
            system_id: 1,
            component_id: 1,
            message_id: id.into(),
        })
    };
    assert!(!accepted(&RejectUnsigned, 109, 0));
    assert!(accepted(&AllowRadioStatus, 109, 0));
    assert!(!accepted(&AllowRadioStatus, 0, 0));
    assert!(accepted(&AllowLink { link_id: 2 }, 0, 2));
    assert!(!accepted(&AllowLink { link_id: 2 }, 109, 1));
}

fn setup() -> SetupSigning {
    SetupSigning {
        target_system: 1,
        target_component: 0,
        secret_key: core::array::from_fn(|i| i as u8),
        initial_timestamp: at(TICKS),
    }
}

#[test]
#[cfg(not(feature = "common"))]
fn setup_signing_is_built_only_where_the_dialect_has_it() {
    let built = setup().to_frame(heartbeat(0.into())).map(drop);
    let known = dialect::crc_extra(SETUP_SIGNING).ok_or(SignError::UnknownMessage(SETUP_SIGNING));
    assert_eq!(built, known.map(drop));
}

#[test]
#[cfg(feature = "common")]
fn setup_signing_is_built_and_read_and_not_shown() {
    let frame = setup().to_frame(heartbeat(0.into())).expect("known");
    let bytes = frame.as_bytes();
    assert_eq!(bytes[7..10], [0, 1, 0]);
    let read = SetupSigning::from_payload(&bytes[10..bytes.len() - 2]).expect("a key");
    assert_eq!(read.secret_key, setup().secret_key);
    assert_eq!((read.target_system, read.target_component), (1, 0));
    assert_eq!(read.initial_timestamp, at(TICKS));
    let rejected = |payload| SetupSigning::from_payload(payload).expect_err("rejected");
    let (long, late) = (rejected(&[7; 43]), rejected(&[0xFF; 42]));
    assert_eq!(long, SetupError::TooLong(43));
    assert_eq!(late, SetupError::TimestampTooLong(u64::MAX));
    assert_eq!(
        long.to_string(),
        "SETUP_SIGNING has 42 bytes of payload, this has 43"
    );
    assert_eq!(
        late.to_string(),
        "a timestamp has 6 bytes, 0xFFFFFFFFFFFFFFFF has more"
    );
    let shown = format!("{:?}", setup());
    assert!(
        shown.contains("target_system: 1") && !shown.contains("31"),
        "{shown}"
    );
}

#[test]
fn a_log_holds_neither_signature_nor_key() {
    let signed = FrameRef::parse(&PYMAVLINK_HEARTBEAT).expect("a frame");
    let logged = redact_for_log(signed).expect("undamaged");
    assert!(!logged.is_signed());
    let payload = &PYMAVLINK_HEARTBEAT[10..19];
    assert_eq!(
        logged,
        Frame::new(signed.header(), payload).expect("a frame")
    );

    let mut damaged = PYMAVLINK_HEARTBEAT;
    damaged[12] ^= 1;
    let damaged = FrameRef::parse(&damaged).expect("a frame");
    assert_eq!(redact_for_log(damaged), Err(SignError::BadChecksum));
}

#[test]
#[cfg(feature = "common")]
fn a_log_does_not_hold_the_key_of_setup_signing() {
    // How many zeros a key ends with is not to be seen either.
    for key in [[7; 32], [0; 32]] {
        let setup = SetupSigning {
            secret_key: key,
            ..setup()
        };
        let frame = setup.to_frame(heartbeat(0.into())).expect("known");
        let received = FrameRef::parse(frame.as_bytes()).expect("a frame");
        let logged = redact_for_log(received).expect("undamaged");
        let masked = &logged.as_bytes()[10..52];
        assert_eq!(masked[10..], [0xFF; 32]);
        assert_eq!(masked[..10], [5, 4, 3, 2, 1, 0, 0, 0, 1, 0]);
    }
}

#[test]
fn fingerprints_tell_keys_apart() {
    let other = SigningKey::<Standard>::from_passphrase("correct horse battery stable");
    assert_ne!(other.expect("a key").fingerprint(), key().fingerprint());
    assert_eq!(key().fingerprint(), key().fingerprint());
    let shown = key().fingerprint().to_string();
    assert!(shown.len() == 9 && shown.as_bytes()[4] == b'-', "{shown}");
}
