//! W2: what is emitted is parsed, and what is parsed is emitted.

use mavlink_signing::dialect::crc_extra;
use mavlink_signing::{Frame, FrameRef, Header, SignError};

use crate::wire::known_and_undamaged;

/// W2: a frame of `header` and `payload` parses as that, and is unsigned. Its checksum is right, over
/// all between magic byte and checksum. A frame made from what was parsed has the same bytes. `index` is
/// the byte that is compared.
///
/// # Errors
///
/// What [`Frame::new`] says: a message that is not in the dialect, or more than 255 bytes of payload.
///
/// # Panics
///
/// If the property does not hold.
pub fn round_trip(header: Header, payload: &[u8], index: usize) -> Result<(), SignError> {
    let made = Frame::new(header, payload);
    let id = header.message_id;
    let expected = match (crc_extra(id), payload.len()) {
        (_, 256..) => Err(SignError::PayloadTooLong(payload.len())),
        (None, _) => Err(SignError::UnknownMessage(id)),
        (Some(_), _) => Ok(()),
    };
    assert_eq!(made.as_ref().map(drop), expected.as_ref().map(drop));
    let Ok(frame) = made else { return expected };
    let bytes = frame.as_bytes();
    let parsed = FrameRef::parse(bytes).expect("what is emitted parses");
    assert_eq!(parsed.as_bytes().len(), bytes.len());
    assert_eq!(parsed.header(), header);
    assert!(!parsed.is_signed());
    assert_eq!(bytes[1] as usize, payload.len());
    assert!(known_and_undamaged(bytes).is_ok());
    if index < payload.len() {
        assert_eq!(bytes[10 + index], payload[index]);
    }
    let again = Frame::try_from(parsed).expect("its checksum is right");
    assert_eq!(again.as_bytes().len(), bytes.len());
    if index < bytes.len() {
        assert_eq!(again.as_bytes()[index], bytes[index]);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use mavlink_signing::MessageId;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn w2_random(
            bytes: [u8; 7],
            known: bool,
            payload in proptest::collection::vec(any::<u8>(), 0..=255),
        ) {
            let [compat_flags, sequence, system_id, component_id, a, b, c] = bytes;
            let header = Header {
                compat_flags,
                sequence,
                system_id,
                component_id,
                message_id: MessageId::from_le_bytes(if known { [a % 3, 0, 0] } else { [a, b, c] }),
            };
            for index in 0..280 {
                let _ = round_trip(header, &payload, index);
            }
        }
    }

    #[test]
    fn w2_too_long() {
        let made = round_trip(HEARTBEAT, &[0; 256], 0);
        assert_eq!(made, Err(SignError::PayloadTooLong(256)));
    }

    #[test]
    fn w2_every_length() {
        for length in 0..=255 {
            for index in 0..280 {
                round_trip(HEARTBEAT, &vec![0xFD; length], index).expect("known");
            }
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use mavlink_signing::MessageId;

    fn check<const LENGTH: usize>() {
        let header = Header {
            compat_flags: kani::any(),
            sequence: kani::any(),
            system_id: kani::any(),
            component_id: kani::any(),
            message_id: MessageId::from_le_bytes(kani::any()),
        };
        let payload: [u8; LENGTH] = kani::any();
        let made = round_trip(header, &payload, kani::any());
        kani::cover!(made.is_ok(), "a frame");
        kani::cover!(made.is_err(), "a message that is not in the dialect");
    }

    crate::model::for_payload_lengths! { check:
        w2_round_trip_0 0 unwind 33,
        w2_round_trip_1 1 unwind 33,
        w2_round_trip_9 9 unwind 36,
        w2_round_trip_30 30 unwind 57,
    }
}
