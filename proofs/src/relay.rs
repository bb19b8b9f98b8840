//! L1: nothing from the link side is signed; nothing unverified leaves on the local side.

use mavlink_signing::field::{CHECKSUM_SIZE, SIGNATURE_SIZE};
use mavlink_signing::{
    FrameRef, Packet, Profile, SETUP_SIGNING, SignError, SigningKey, Stamper, Timestamp,
    VerifyError, authenticate,
};
use mavseal_relay::{ForwardMode, Forwarded, RejectReason, Signer, Verifier};

use crate::model::Resumed;
use crate::wire::known_and_undamaged;

/// L1, towards the local side: a packet is handed on only if it is verified, by a receiver in the same
/// state. It leaves byte for byte as received, or stripped, as `forward` says. A stripped frame has the
/// same bytes, but for the flag and a new checksum, which is right. Returns the rejection.
///
/// That the relay gives packets of the link side to [`Verifier`] alone, which holds no stamper,
/// is a matter of its types.
///
/// # Errors
///
/// What [`Verifier::verify`] says.
///
/// # Panics
///
/// If the property does not hold.
pub fn only_verified_leaves<P: Profile>(
    packet: Packet<'_>,
    key: &SigningKey<P>,
    receiver: Resumed,
    forward: ForwardMode,
    now: Timestamp,
    index: usize,
) -> Result<(), RejectReason> {
    let handed_on =
        Verifier::new(receiver.replay(), forward).verify(packet, &mut &*key, &mut { now });
    let Packet::Mavlink2(received) = packet else {
        assert_eq!(handed_on, Err(RejectReason::Mavlink1));
        return Err(RejectReason::Mavlink1);
    };
    if received.header().message_id == SETUP_SIGNING {
        assert_eq!(handed_on, Err(RejectReason::SetupSigning));
        return Err(RejectReason::SetupSigning);
    }
    if !received.is_signed() {
        let rejection = unsigned_rejection(received);
        assert_eq!(handed_on, Err(rejection));
        return Err(rejection);
    }
    let mut replay = receiver.replay();
    let verdict: Result<_, VerifyError> =
        authenticate(received, key).and_then(|authentic| replay.admit(authentic, now));
    match handed_on {
        Ok(Forwarded::Unsigned(_)) => panic!("handed on without a policy"),
        Ok(Forwarded::Verified(frame)) => {
            assert!(verdict.is_ok());
            let (bytes, original) = (frame.as_bytes(), received.as_bytes());
            match forward {
                ForwardMode::KeepSignature => assert_eq!(bytes.len(), original.len()),
                ForwardMode::StripSignature => {
                    assert_eq!(bytes.len(), original.len() - SIGNATURE_SIZE);
                    assert_eq!(bytes[2], 0);
                    assert!(known_and_undamaged(bytes).is_ok());
                }
            }
            let checksum_at = bytes.len() - CHECKSUM_SIZE;
            let stripped = forward == ForwardMode::StripSignature;
            if index < bytes.len() && !(stripped && (index == 2 || index >= checksum_at)) {
                assert_eq!(bytes[index], original[index]);
            }
            Ok(())
        }
        Err(rejection) => {
            assert_eq!(verdict.err().map(RejectReason::from), Some(rejection));
            Err(rejection)
        }
    }
}

/// Why a frame without signature is rejected where no policy accepts any.
fn unsigned_rejection(received: FrameRef<'_>) -> RejectReason {
    match known_and_undamaged(received.as_bytes()) {
        Err(SignError::UnknownMessage(_)) => RejectReason::UnknownMessage,
        Err(_) => RejectReason::BadChecksum,
        Ok(_) => RejectReason::NotSigned,
    }
}

/// L1, towards the link side: a packet is signed if and only if it is an undamaged, known frame without
/// signature, and not SETUP_SIGNING. Otherwise the error names the first that is wrong. What leaves is
/// signed with the stamper's stamp. It has the same bytes, but for the flag, the signature, and a new
/// checksum, which is right. Returns the rejection.
///
/// # Errors
///
/// What [`Signer::sign`] says.
///
/// # Panics
///
/// If the property does not hold.
pub fn only_unsigned_is_signed<P: Profile>(
    packet: Packet<'_>,
    key: &SigningKey<P>,
    stamper: Stamper,
    now: Timestamp,
    index: usize,
) -> Result<(), RejectReason> {
    let stamp = stamper.next(now);
    let signing = Signer::new(stamper).sign(packet, key, &mut { now });
    let expected = match packet {
        Packet::Mavlink1(_) => Err(RejectReason::Mavlink1),
        Packet::Mavlink2(frame) => to_be_signed(frame),
    };
    assert_eq!(signing.as_ref().map(drop), expected.as_ref().map(drop));
    let Ok(frame) = signing else { return expected };
    let original = packet.as_bytes();
    let bytes = frame.as_bytes();
    assert_eq!(bytes.len(), original.len() + SIGNATURE_SIZE);
    assert_eq!(bytes[2], 1);
    assert!(known_and_undamaged(bytes).is_ok());
    let checksum_at = original.len() - CHECKSUM_SIZE;
    if index < checksum_at && index != 2 {
        assert_eq!(bytes[index], original[index]);
    }
    let signed = FrameRef::parse(bytes).expect("a whole frame");
    let authentic = authenticate(signed, key).expect("signed with the key");
    assert_eq!(Ok(authentic.stamp()), stamp);
    Ok(())
}

/// Why a frame of the local side is not signed, unless it is.
fn to_be_signed(frame: FrameRef<'_>) -> Result<(), RejectReason> {
    if frame.header().message_id == SETUP_SIGNING {
        return Err(RejectReason::SetupSigning);
    }
    if frame.as_bytes()[2] != 0 {
        return Err(RejectReason::AlreadySigned);
    }
    match known_and_undamaged(frame.as_bytes()) {
        Err(SignError::UnknownMessage(_)) => Err(RejectReason::UnknownMessage),
        Err(_) => Err(RejectReason::BadChecksum),
        Ok(_) => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use mavlink_signing::dialect::crc_extra;
    use mavlink_signing::{Frame, Hmac, Stamp, Window, sign_frame};
    use proptest::prelude::*;

    fn at(ticks: u64) -> Timestamp {
        Timestamp::from_ticks(ticks).expect("48 bits")
    }

    proptest! {
        #[test]
        fn l1_random(
            payload in proptest::collection::vec(any::<u8>(), 0..=255),
            signed: bool,
            other_key: bool,
            link_id in 1..3_u8,
            times in [0..40_u64, 0..40_u64, 0..40_u64],
            whole: bool,
            // Often no damage, else bits of one byte behind the length and the flags.
            damage in proptest::option::of((any::<prop::sample::Index>(), 1..=255_u8)),
        ) {
            let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
            let other = SigningKey::<Hmac>::new(&[8; 32]).expect("a key");
            let mut frame = Frame::new(HEARTBEAT, &payload).expect("a frame");
            if signed {
                let stamp = Stamp { link_id, timestamp: at(times[0]) };
                sign_frame(&mut frame, if other_key { &other } else { &key }, stamp).expect("signed");
            }
            let mut bytes = frame.as_bytes().to_vec();
            if let Some((at, bits)) = damage {
                let at = 3 + at.index(bytes.len() - 3);
                bytes[at] ^= bits;
            }
            let received = FrameRef::parse(&bytes).expect("a whole frame");
            let right = known_and_undamaged(&bytes).is_ok();
            let packet = Packet::Mavlink2(received);
            let window = Window { past: 15, ahead: 15 };
            let receiver = Resumed { link_id: 2, window, first: at(times[1]) };
            let forward = if whole { ForwardMode::KeepSignature } else { ForwardMode::StripSignature };
            for index in 0..frame.as_bytes().len() {
                let left = only_verified_leaves(packet, &key, receiver, forward, at(times[2]), index);
                let ours = signed && !other_key && link_id == 2 && damage.is_none();
                prop_assert!(left.is_err() || ours);
                let stamper = Stamper::new(1);
                let signing = only_unsigned_is_signed(packet, &key, stamper, at(times[2]), index);
                let setup = received.header().message_id == SETUP_SIGNING;
                prop_assert_eq!(signing.is_err(), signed || !right || setup);
            }
        }
    }

    /// Each bit of a frame without signature, one after the other: nothing of it is signed or handed on.
    #[test]
    fn l1_each_bit() {
        let frame = Frame::new(HEARTBEAT, &[1, 2, 3]).expect("a frame");
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        for place in 3..frame.as_bytes().len() {
            for bit in 0..8 {
                let mut bytes = frame.as_bytes().to_vec();
                bytes[place] ^= 1 << bit;
                let packet = Packet::Mavlink2(FrameRef::parse(&bytes).expect("a whole frame"));
                let signing = only_unsigned_is_signed(packet, &key, Stamper::new(1), at(5), 0);
                assert!(signing.is_err());
                let receiver = Resumed {
                    link_id: 2,
                    window: Window::STRICT,
                    first: Timestamp::ZERO,
                };
                let forward = ForwardMode::StripSignature;
                assert!(only_verified_leaves(packet, &key, receiver, forward, at(5), 0).is_err());
            }
        }
    }

    /// What is rejected uses up no stamp: the next frame has the one that it would have had.
    #[test]
    fn l1_rejected_uses_no_stamp() {
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let frame = Frame::new(HEARTBEAT, &[1, 2, 3]).expect("a frame");
        let mut damaged = frame.as_bytes().to_vec();
        damaged[12] ^= 1;
        let mut signed = frame.clone();
        let stamp = Stamp {
            link_id: 9,
            timestamp: at(1),
        };
        sign_frame(&mut signed, &key, stamp).expect("signed");
        let mut signer = Signer::new(Stamper::new(1));
        let packet = |bytes| Packet::Mavlink2(FrameRef::parse(bytes).expect("a whole frame"));
        for rejected in [&damaged, signed.as_bytes()] {
            let rejection = signer.sign(packet(rejected), &key, &mut { at(5) });
            assert!(rejection.is_err());
        }
        let sent = signer.sign(packet(frame.as_bytes()), &key, &mut { at(5) });
        let sent = sent.expect("signed");
        let sent = FrameRef::parse(sent.as_bytes()).expect("a whole frame");
        assert_eq!(sent.signature().expect("signed").stamp.timestamp, at(5));
    }

    #[test]
    fn l1_setup_signing() {
        let mut header = HEARTBEAT;
        header.message_id = SETUP_SIGNING;
        let mut frame = Frame::new(header, &[7; 42]).expect("a frame");
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let packet = Packet::parse(frame.as_bytes(), crc_extra).expect("a packet");
        let signing = only_unsigned_is_signed(packet, &key, Stamper::new(1), at(5), 0);
        assert_eq!(signing, Err(RejectReason::SetupSigning));
        let receiver = Resumed {
            link_id: 2,
            window: Window::STRICT,
            first: Timestamp::ZERO,
        };
        let stamp = Stamp {
            link_id: 2,
            timestamp: at(5),
        };
        sign_frame(&mut frame, &key, stamp).expect("signed");
        let packet = Packet::parse(frame.as_bytes(), crc_extra).expect("a packet");
        let left =
            only_verified_leaves(packet, &key, receiver, ForwardMode::KeepSignature, at(5), 0);
        assert_eq!(left, Err(RejectReason::SetupSigning));
    }

    #[test]
    fn l1_mavlink1() {
        let heartbeat = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];
        let packet = Packet::parse(&heartbeat, crc_extra).expect("a packet");
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let now = at(5);
        let signing = only_unsigned_is_signed(packet, &key, Stamper::new(1), now, 0);
        assert_eq!(signing, Err(RejectReason::Mavlink1));
        let receiver = Resumed {
            link_id: 2,
            window: Window::STRICT,
            first: Timestamp::ZERO,
        };
        let left = only_verified_leaves(packet, &key, receiver, ForwardMode::KeepSignature, now, 0);
        assert_eq!(left, Err(RejectReason::Mavlink1));
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::{any_key, any_prefix, any_timestamp};
    use mavlink_signing::field::{MAGIC, MAGIC_V1, MAX_FRAME_SIZE};

    /// Any frame of `SIZE` bytes with these flags: an array of that size, so that the solver knows
    /// how long it is.
    fn any_frame<const SIZE: usize>(flags: u8, payload_length: usize) -> [u8; SIZE] {
        let mut bytes: [u8; SIZE] = kani::any();
        [bytes[0], bytes[1], bytes[2]] = [MAGIC, payload_length as u8, flags];
        bytes
    }

    fn leaves<const SIZE: usize>() {
        let bytes: [u8; SIZE] = any_frame(1, SIZE - 25);
        // Not `Packet::parse`, which lets no damaged one through.
        let packet = Packet::Mavlink2(FrameRef::parse(&bytes).expect("a whole frame"));
        let whole = kani::any();
        let forward = if whole {
            ForwardMode::KeepSignature
        } else {
            ForwardMode::StripSignature
        };
        let (now, index) = (any_timestamp(), kani::any());
        let left = only_verified_leaves(packet, &any_key(), Resumed::any(), forward, now, index);
        kani::cover!(left.is_ok() && whole, "whole");
        kani::cover!(left.is_ok() && !whole, "stripped");
        kani::cover!(left == Err(RejectReason::BadChecksum), "damaged");
        kani::cover!(left == Err(RejectReason::BadTag), "forged");
        kani::cover!(left == Err(RejectReason::Replayed), "replayed");
        kani::cover!(left == Err(RejectReason::SetupSigning), "SETUP_SIGNING");
    }

    fn signs<const SIZE: usize>() {
        let bytes: [u8; SIZE] = any_frame(0, SIZE - 12);
        let packet = Packet::Mavlink2(FrameRef::parse(&bytes).expect("a whole frame"));
        let stamper = Stamper::resume(kani::any(), any_timestamp());
        let (now, index) = (any_timestamp(), kani::any());
        let signing = only_unsigned_is_signed(packet, &any_key(), stamper, now, index);
        kani::cover!(signing.is_ok(), "signed");
        kani::cover!(signing == Err(RejectReason::UnknownMessage), "unknown");
        kani::cover!(signing == Err(RejectReason::BadChecksum), "damaged");
        kani::cover!(signing == Err(RejectReason::SetupSigning), "SETUP_SIGNING");
    }

    // The harness's number is the payload's length, the literal the frame's.
    crate::model::for_payload_lengths! { leaves:
        l1_only_verified_leaves_0 25 unwind 33,
        l1_only_verified_leaves_9 34 unwind 36,
    }

    crate::model::for_payload_lengths! { signs:
        l1_only_unsigned_is_signed_0 12 unwind 33,
        l1_only_unsigned_is_signed_9 21 unwind 33,
    }

    /// What neither side lets through, of every length.
    #[kani::proof]
    #[kani::unwind(33)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn l1_the_wrong_kind_is_rejected() {
        let mut bytes: [u8; MAX_FRAME_SIZE] = kani::any();
        let mavlink1 = kani::any();
        let signed = kani::any();
        bytes[0] = if mavlink1 { MAGIC_V1 } else { MAGIC };
        let bytes = any_prefix(&bytes);
        let packet = if mavlink1 {
            Packet::parse(bytes, |_| Some(0)).ok()
        } else {
            FrameRef::parse(bytes).ok().map(Packet::Mavlink2)
        };
        let Some(packet) = packet else {
            return;
        };
        if let Packet::Mavlink2(frame) = packet {
            kani::assume(frame.is_signed() == signed);
            kani::assume(frame.header().message_id != SETUP_SIGNING);
        }
        let (key, now) = (any_key(), any_timestamp());
        if mavlink1 || signed {
            let mut signer = Signer::new(Stamper::resume(kani::any(), any_timestamp()));
            let rejection = signer.sign(packet, &key, &mut { now }).err();
            let expected = if mavlink1 {
                RejectReason::Mavlink1
            } else {
                RejectReason::AlreadySigned
            };
            assert_eq!(rejection, Some(expected));
            kani::cover!(mavlink1, "MAVLink 1, to be signed");
            kani::cover!(
                !mavlink1 && bytes.len() == MAX_FRAME_SIZE,
                "the longest, signed already"
            );
        }
        if mavlink1 || !signed {
            let rejection = Verifier::new(Resumed::any().replay(), ForwardMode::KeepSignature)
                .verify(packet, &mut &key, &mut { now })
                .err();
            let expected = match packet {
                Packet::Mavlink1(_) => RejectReason::Mavlink1,
                Packet::Mavlink2(frame) => unsigned_rejection(frame),
            };
            assert_eq!(rejection, Some(expected));
            kani::cover!(mavlink1, "MAVLink 1, to be verified");
            kani::cover!(rejection == Some(RejectReason::NotSigned), "not signed");
            kani::cover!(
                !mavlink1 && rejection == Some(RejectReason::BadChecksum),
                "damaged, not signed"
            );
        }
    }
}
