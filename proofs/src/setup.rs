//! M1: keys in transit, and frames in a log.

use mavlink_signing::{
    Frame, FrameRef, Header, SETUP_SIGNING, SetupError, SetupSigning, SignError, redact_for_log,
    without_trailing_zeros,
};

use crate::wire::known_and_undamaged;

/// M1, reading: a payload of up to 42 bytes whose timestamp has 48 bits reads as its fields. They are 8
/// bytes of timestamp, little-endian, target system, target component, and 32 of key; cut zeros are
/// filled in. The error of any other payload says what is wrong.
///
/// # Errors
///
/// What [`SetupSigning::from_payload`] says.
///
/// # Panics
///
/// If the property does not hold.
pub fn read_field_by_field(payload: &[u8]) -> Result<SetupSigning, SetupError> {
    let at = |index: usize| payload.get(index).copied().unwrap_or(0);
    let ticks = |bytes| (0..bytes).fold(0, |all, index| all | u64::from(at(index)) << (8 * index));
    let read = SetupSigning::from_payload(payload);
    match &read {
        Err(SetupError::TooLong(length)) => assert!(payload.len() > 42 && *length == payload.len()),
        Err(error) => {
            assert!(payload.len() <= 42 && (at(6) != 0 || at(7) != 0));
            assert_eq!(*error, SetupError::TimestampTooLong(ticks(8)));
        }
        Ok(setup) => {
            assert!(payload.len() <= 42);
            assert_eq!(setup.initial_timestamp.ticks(), ticks(8));
            assert_eq!(
                (setup.target_system, setup.target_component),
                (at(8), at(9))
            );
            for (index, byte) in setup.secret_key.iter().enumerate() {
                assert_eq!(*byte, at(10 + index));
            }
        }
    }
    read
}

/// M1, building: the frame is unsigned, has the fields of `header` but the message id, and its payload
/// reads as the same again.
///
/// # Panics
///
/// If the property does not hold.
pub fn built_field_by_field(setup: &SetupSigning, header: Header) {
    let frame = setup
        .to_frame(header)
        .expect("a dialect that has the message");
    let bytes = frame.as_bytes();
    let received = FrameRef::parse(bytes).expect("a whole frame");
    assert!(!received.is_signed());
    let expected = Header {
        message_id: SETUP_SIGNING,
        ..header
    };
    assert_eq!(received.header(), expected);
    assert!(known_and_undamaged(bytes).is_ok());
    let payload = &bytes[10..bytes.len() - 2];
    let read = read_field_by_field(payload).expect("what was written");
    assert_eq!(read.initial_timestamp, setup.initial_timestamp);
    assert_eq!(read.target_system, setup.target_system);
    assert_eq!(read.target_component, setup.target_component);
    assert_eq!(read.secret_key, setup.secret_key);
}

/// M1, what is cut: zeros at the end and nothing else. Of a payload of zeros the first stays (MAVLink
/// guide, "Packet Serialization", Payload Truncation).
///
/// # Panics
///
/// If the property does not hold.
pub fn only_zeros_are_cut(payload: &[u8]) {
    let sent = without_trailing_zeros(payload);
    assert_eq!(sent.as_ptr(), payload.as_ptr());
    assert!(sent.len() <= payload.len());
    assert!(sent.len() <= 1 || sent[sent.len() - 1] != 0);
    assert_eq!(sent.is_empty(), payload.is_empty());
    for (index, byte) in payload.iter().enumerate() {
        assert!(index < sent.len() || *byte == 0);
    }
}

/// M1, in a log: what comes out is unsigned, has a right checksum, and has the frame's header and
/// payload. Of SETUP_SIGNING the 32 bytes of the key are 0xFF, however many of them were sent. What is
/// damaged or unknown is rejected. `index` is the byte of the payload that is looked at.
///
/// # Errors
///
/// What [`redact_for_log`] says.
///
/// # Panics
///
/// If the property does not hold.
pub fn log_shows_no_secret(received: FrameRef<'_>, index: usize) -> Result<Frame, SignError> {
    let expected = known_and_undamaged(received.as_bytes());
    let redacted = redact_for_log(received);
    assert_eq!(redacted.as_ref().err(), expected.as_ref().err());
    let frame = redacted?;
    let (bytes, original) = (frame.as_bytes(), received.as_bytes());
    assert_eq!(bytes[2], 0);
    assert!(known_and_undamaged(bytes).is_ok());
    assert_eq!(bytes[3..10], original[3..10]);
    let (shown, sent) = (&bytes[10..bytes.len() - 2], usize::from(original[1]));
    if received.header().message_id == SETUP_SIGNING {
        assert_eq!(shown.len(), 42);
        if index < shown.len() {
            let expected = match index {
                10.. => 0xFF,
                _ if index < sent => original[10 + index],
                _ => 0,
            };
            assert_eq!(shown[index], expected);
        }
    } else {
        assert_eq!(shown.len(), sent);
        if index < sent {
            assert_eq!(shown[index], original[10 + index]);
        }
    }
    Ok(frame)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use mavlink_signing::{Hmac, SigningKey, Stamp, Timestamp, sign_frame};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn m1_random(
            mut payload in proptest::collection::vec(any::<u8>(), 0..=48),
            zeros in 0..=48_usize,
            early: bool,
            setup: bool,
            signed: bool,
        ) {
            for byte in payload.iter_mut().rev().take(zeros) {
                *byte = 0;
            }
            if early {
                for byte in payload.iter_mut().skip(6).take(2) {
                    *byte = 0;
                }
            }
            only_zeros_are_cut(&payload);
            if let Ok(setup) = read_field_by_field(&payload) {
                built_field_by_field(&setup, HEARTBEAT);
            }

            let mut header = HEARTBEAT;
            if setup {
                header.message_id = SETUP_SIGNING;
            }
            let mut frame = Frame::new(header, &payload).expect("a frame");
            if signed {
                let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
                let stamp = Stamp { link_id: 1, timestamp: Timestamp::ZERO };
                sign_frame(&mut frame, &key, stamp).expect("signed");
            }
            let received = FrameRef::parse(frame.as_bytes()).expect("a frame");
            for index in 0..payload.len().max(42) {
                prop_assert!(log_shows_no_secret(received, index).is_ok());
            }
        }
    }

    #[test]
    fn m1_damaged() {
        let frame = Frame::new(HEARTBEAT, &[1; 9]).expect("a frame");
        let mut bytes = frame.as_bytes().to_vec();
        bytes[12] ^= 1;
        let received = FrameRef::parse(&bytes).expect("a frame");
        assert_eq!(
            log_shows_no_secret(received, 0),
            Err(SignError::BadChecksum)
        );
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::HEARTBEAT;
    use crate::model::any_timestamp;
    use mavlink_signing::Timestamp;
    use mavlink_signing::field::MAGIC;

    fn read<const LENGTH: usize>() {
        let payload: [u8; LENGTH] = kani::any();
        let read = read_field_by_field(&payload);
        kani::cover!(read.is_ok(), "read");
        let late = matches!(read, Err(SetupError::TimestampTooLong(_)));
        kani::cover!(late, "a timestamp of more than 48 bits");
    }

    fn not_read<const LENGTH: usize>() {
        let payload: [u8; LENGTH] = kani::any();
        let read = read_field_by_field(&payload);
        kani::cover!(matches!(read, Err(SetupError::TooLong(_))), "too long");
    }

    crate::model::for_payload_lengths! { read:
        m1_read_field_by_field_7 7 unwind 44,
        m1_read_field_by_field_42 42 unwind 44,
    }

    crate::model::for_payload_lengths! { not_read:
        m1_read_field_by_field_43 43 unwind 44,
    }

    /// Keys that do not end with zeros: how long the payload is, is then known to the solver.
    #[kani::proof]
    #[kani::unwind(44)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn m1_built_field_by_field() {
        let mut setup = SetupSigning {
            target_system: kani::any(),
            target_component: kani::any(),
            secret_key: kani::any(),
            initial_timestamp: any_timestamp(),
        };
        setup.secret_key[31] = 1;
        built_field_by_field(&setup, HEARTBEAT);
        kani::cover!(
            setup.initial_timestamp == Timestamp::MAX,
            "the last timestamp"
        );
    }

    fn cut<const LENGTH: usize>() {
        let payload: [u8; LENGTH] = kani::any();
        only_zeros_are_cut(&payload);
        let sent = without_trailing_zeros(&payload).len();
        kani::cover!(sent == LENGTH.min(1), "all but the first");
        kani::cover!(sent == LENGTH, "nothing");
    }

    crate::model::for_payload_lengths! { cut:
        m1_only_zeros_are_cut_0 0 unwind 44,
        m1_only_zeros_are_cut_42 42 unwind 44,
    }

    fn shown<const SIZE: usize>() {
        let mut bytes: [u8; SIZE] = kani::any();
        [bytes[0], bytes[1], bytes[2]] = [MAGIC, (SIZE - 25) as u8, 1];
        let received = FrameRef::parse(&bytes).expect("a whole frame");
        let setup = received.header().message_id == SETUP_SIGNING;
        let shown = log_shows_no_secret(received, kani::any()).is_ok();
        let expected = known_and_undamaged(&bytes);
        assert_eq!(shown, expected.is_ok());
        kani::cover!(shown && setup, "SETUP_SIGNING");
        kani::cover!(shown && !setup, "another message");
        kani::cover!(expected == Err(SignError::BadChecksum), "damaged");
        kani::cover!(
            matches!(expected, Err(SignError::UnknownMessage(_))),
            "unknown"
        );
    }

    // The harness's number is the payload's length, the literal that of the signed frame.
    crate::model::for_payload_lengths! { shown:
        m1_log_shows_no_secret_9 34 unwind 44,
        m1_log_shows_no_secret_42 67 unwind 69,
    }
}
