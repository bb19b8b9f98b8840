//! U1: a policy decides about what is unsigned, and about nothing else.

use core::cell::Cell;

use mavlink_signing::{
    Claim, FrameRef, KeySlot, Packet, Profile, SETUP_SIGNING, SignError, SigningKey, Timestamp,
    VerifyError, accept_unsigned, authenticate,
};
use mavseal_relay::{ForwardMode, Forwarded, RejectReason, Verifier};

use crate::model::Resumed;
use crate::wire::known_and_undamaged;

/// U1: a frame is accepted if and only if it is unsigned, known and undamaged, and the policy says so.
/// Otherwise the error names the first that is wrong. The policy is asked once if it decides, and not at
/// all if it does not. It is told what the frame says and the link it came in on. What is accepted is
/// the frame as it came.
///
/// # Errors
///
/// The verdict, where it is a rejection.
///
/// # Panics
///
/// If the property does not hold.
pub fn policy_decides(
    received: FrameRef<'_>,
    link_id: u8,
    accepts: bool,
) -> Result<(), VerifyError> {
    let asked = Cell::new(0_u8);
    let header = received.header();
    let policy = |claim: Claim| {
        asked.set(asked.get() + 1);
        let Claim {
            link_id: link,
            system_id,
            component_id,
            message_id,
        } = claim;
        assert_eq!(link, link_id);
        assert_eq!(
            (system_id, component_id),
            (header.system_id, header.component_id)
        );
        assert_eq!(message_id, header.message_id);
        accepts
    };
    let accepted = accept_unsigned(received, link_id, &policy);
    let before = match known_and_undamaged(received.as_bytes()) {
        _ if received.as_bytes()[2] != 0 => Err(VerifyError::Signed),
        Err(SignError::UnknownMessage(id)) => Err(VerifyError::UnknownMessage(id)),
        Err(_) => Err(VerifyError::BadChecksum),
        Ok(_) => Ok(()),
    };
    assert_eq!(asked.get(), u8::from(before.is_ok()));
    let expected = match before {
        Ok(()) if !accepts => Err(VerifyError::NotSigned),
        before => before,
    };
    let verdict = accepted.map(|unsigned| {
        assert_eq!(unsigned.header(), header);
        let (bytes, original) = (unsigned.as_bytes(), received.as_bytes());
        assert_eq!(
            (bytes.as_ptr(), bytes.len()),
            (original.as_ptr(), original.len())
        );
        let payload = unsigned.payload();
        assert_eq!(payload.as_ptr(), original[10..].as_ptr());
        assert_eq!(payload.len() + 12, original.len());
    });
    assert_eq!(verdict, expected);
    verdict
}

/// What the policy is told of the link.
const LINK_ID: u8 = 3;

/// U1, in the relay, with a policy that accepts everything: a frame leaves as unsigned if and only if it
/// came unsigned, known and undamaged, and is not SETUP_SIGNING. It is then byte for byte the same. The
/// policy is never asked about a signed one. Returns the rejection.
///
/// # Errors
///
/// What [`Verifier::verify`] says.
///
/// # Panics
///
/// If the property does not hold.
pub fn only_unsigned_is_asked_about<P: Profile>(
    received: FrameRef<'_>,
    key: &SigningKey<P>,
    receiver: Resumed,
    now: Timestamp,
    index: usize,
) -> Result<(), RejectReason> {
    let asked = Cell::new(0_u8);
    let header = received.header();
    let policy = |claim: Claim| {
        asked.set(asked.get() + 1);
        assert_eq!(claim.link_id, LINK_ID);
        assert_eq!(claim.system_id, header.system_id);
        assert_eq!(claim.component_id, header.component_id);
        assert_eq!(claim.message_id, header.message_id);
        true
    };
    let verifier = Verifier::new(KeySlot::A, receiver.replay(), ForwardMode::KeepSignature);
    let mut verifier = verifier.accepting(LINK_ID, policy);
    let handed_on = verifier.verify(Packet::Mavlink2(received), &mut &*key, &mut { now });
    let id = header.message_id;
    let unsigned = match known_and_undamaged(received.as_bytes()) {
        _ if received.as_bytes()[2] != 0 => None,
        _ if id == SETUP_SIGNING => Some(Err(RejectReason::SetupSigning)),
        Err(SignError::UnknownMessage(_)) => Some(Err(RejectReason::UnknownMessage)),
        Err(_) => Some(Err(RejectReason::BadChecksum)),
        Ok(_) => Some(Ok(())),
    };
    assert_eq!(asked.get(), u8::from(unsigned == Some(Ok(()))));
    let expected = match unsigned {
        Some(expected) => expected,
        None if id == SETUP_SIGNING => Err(RejectReason::SetupSigning),
        None => {
            let mut replay = receiver.replay();
            let verdict = authenticate(received, key).and_then(|it| replay.admit(it, now));
            verdict.map(drop).map_err(RejectReason::from)
        }
    };
    assert_eq!(handed_on.as_ref().map(drop), expected.as_ref().map(drop));
    let Ok(handed_on) = handed_on else {
        return expected;
    };
    let frame = match handed_on {
        Forwarded::Verified(frame) => {
            assert!(received.is_signed() && id != SETUP_SIGNING);
            assert!(known_and_undamaged(received.as_bytes()).is_ok());
            frame
        }
        Forwarded::Unsigned(frame) => {
            assert!(!received.is_signed());
            frame
        }
    };
    let (bytes, original) = (frame.as_bytes(), received.as_bytes());
    assert_eq!(bytes.len(), original.len());
    if index < bytes.len() {
        assert_eq!(bytes[index], original[index]);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use mavlink_signing::{
        AllowLink, AllowRadioStatus, Frame, Hmac, MessageId, RejectUnsigned, Stamp, UnsignedPolicy,
        Window, sign_frame,
    };
    use proptest::prelude::*;

    fn at(ticks: u64) -> Timestamp {
        Timestamp::from_ticks(ticks).expect("48 bits")
    }

    proptest! {
        #[test]
        fn u1_random(
            payload in proptest::collection::vec(any::<u8>(), 0..=255),
            id in prop_oneof![Just(0_u32), Just(109), Just(256), Just(0xF0_F0F0)],
            signed: bool,
            damaged in proptest::option::of(7..270_usize),
            link_id: u8,
            accepts: bool,
            index in 0..280_usize,
        ) {
            let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
            let mut header = HEARTBEAT;
            // What no dialect knows is written over what one does.
            let unknown = id == 0xF0_F0F0;
            header.message_id = MessageId::new(if unknown { 0 } else { id }).expect("24 bits");
            let mut frame = Frame::new(header, &payload).expect("a known message");
            if signed {
                let stamp = Stamp { link_id: 2, timestamp: at(5) };
                sign_frame(&mut frame, &key, stamp).expect("signed");
            }
            let mut bytes = frame.as_bytes().to_vec();
            if unknown {
                bytes[7..10].fill(0xF0);
            }
            if let Some(byte) = damaged.and_then(|at| bytes.get_mut(at)) {
                *byte ^= 0x10;
            }
            let received = FrameRef::parse(&bytes).expect("a frame");
            let verdict = policy_decides(received, link_id, accepts);
            prop_assert!(verdict.is_err() || (accepts && !signed));
            let receiver = Resumed { link_id: 2, window: Window::STRICT, first: Timestamp::ZERO };
            let handed_on = only_unsigned_is_asked_about(received, &key, receiver, at(5), index);
            prop_assert!(handed_on.is_ok() || damaged.is_some() || unknown || id == 256);
        }
    }

    /// Each bit of a frame without signature, one after the other: no policy is asked about it.
    #[test]
    fn u1_each_bit() {
        let frame = Frame::new(HEARTBEAT, &[1, 2, 3]).expect("a frame");
        for place in 3..frame.as_bytes().len() {
            for bit in 0..8 {
                let mut bytes = frame.as_bytes().to_vec();
                bytes[place] ^= 1 << bit;
                let received = FrameRef::parse(&bytes).expect("a whole frame");
                assert!(policy_decides(received, 1, true).is_err());
            }
        }
    }

    /// What the three policies say.
    #[test]
    fn u1_policies() {
        let claim = |link_id, id| Claim {
            link_id,
            system_id: 1,
            component_id: 2,
            message_id: MessageId::from(id),
        };
        for link_id in 0..=255 {
            for id in 0..=255 {
                let claim = claim(link_id, id);
                assert!(!RejectUnsigned.accepts(claim));
                assert_eq!(AllowRadioStatus.accepts(claim), id == 109);
                let port = AllowLink { link_id: 7 };
                assert_eq!(port.accepts(claim), link_id == 7);
            }
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::{any_key, any_prefix, any_timestamp};
    use mavlink_signing::field::{MAGIC, MAX_FRAME_SIZE};

    #[kani::proof]
    #[kani::unwind(33)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn u1_policy_decides() {
        let bytes: [u8; MAX_FRAME_SIZE] = kani::any();
        let Ok(received) = FrameRef::parse(any_prefix(&bytes)) else {
            return;
        };
        let verdict = policy_decides(received, kani::any(), kani::any());
        kani::cover!(verdict.is_ok(), "accepted");
        kani::cover!(
            verdict == Err(VerifyError::NotSigned),
            "rejected by the policy"
        );
        kani::cover!(verdict == Err(VerifyError::Signed), "signed");
        kani::cover!(verdict == Err(VerifyError::BadChecksum), "damaged");
        kani::cover!(
            matches!(verdict, Err(VerifyError::UnknownMessage(_))),
            "unknown"
        );
    }

    fn leaves<const SIZE: usize>(signed: bool) -> Result<(), RejectReason> {
        let mut bytes: [u8; SIZE] = kani::any();
        let payload_length = if signed { SIZE - 25 } else { SIZE - 12 };
        [bytes[0], bytes[1], bytes[2]] = [MAGIC, payload_length as u8, signed.into()];
        let received = FrameRef::parse(&bytes).expect("a whole frame");
        only_unsigned_is_asked_about(
            received,
            &any_key(),
            Resumed::any(),
            any_timestamp(),
            kani::any(),
        )
    }

    fn signed<const SIZE: usize>() {
        let handed_on = leaves::<SIZE>(true);
        kani::cover!(handed_on.is_ok(), "verified");
        kani::cover!(handed_on == Err(RejectReason::BadTag), "forged");
        kani::cover!(handed_on == Err(RejectReason::BadChecksum), "damaged");
        kani::cover!(handed_on == Err(RejectReason::Replayed), "replayed");
    }

    fn unsigned<const SIZE: usize>() {
        let handed_on = leaves::<SIZE>(false);
        kani::cover!(handed_on.is_ok(), "accepted by the policy");
        kani::cover!(
            handed_on == Err(RejectReason::SetupSigning),
            "SETUP_SIGNING"
        );
        kani::cover!(handed_on == Err(RejectReason::BadChecksum), "damaged");
    }

    // The harness's number is the payload's length, the literal the frame's.
    crate::model::for_payload_lengths! { signed:
        u1_signed_is_not_asked_about_9 34 unwind 36,
    }

    crate::model::for_payload_lengths! { unsigned:
        u1_unsigned_leaves_as_it_came_9 21 unwind 33,
    }
}
