//! L1: nothing from the link side is signed; nothing unverified leaves on the local side.

use mavlink_signing::dialect::crc_extra;
use mavlink_signing::{
    FrameRef, Packet, Profile, SETUP_SIGNING, SigningKey, Stamper, Timestamp, VerifyError,
    authenticate,
};
use mavseal_relay::{ForwardMode, Forwarded, RejectReason, Signer, Verifier};

use crate::model::Resumed;

/// L1, towards the local side: a packet is handed on only if it is verified, by a receiver in the
/// same state; unsigned, or byte for byte as received, as `forward` says. Returns the rejection.
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
            let same = match forward {
                ForwardMode::KeepSignature => original.len(),
                // All but flag, checksum and signature.
                ForwardMode::StripSignature => {
                    assert!(!frame.is_signed());
                    assert_eq!(bytes.len(), original.len() - 13);
                    bytes.len() - 2
                }
            };
            if index < same && (index != 2 || forward == ForwardMode::KeepSignature) {
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
    match crc_extra(received.header().message_id) {
        None => RejectReason::UnknownMessage,
        Some(extra) if !received.checksum_matches(extra) => RejectReason::BadChecksum,
        Some(_) => RejectReason::NotSigned,
    }
}

/// L1, towards the link side: a packet is signed only if it is a frame without signature; what
/// leaves carries the stamper's link id and the same header and payload. Returns the rejection.
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
    let link_id = stamper.link_id();
    let frame = Signer::new(stamper).sign(packet, key, &mut { now })?;
    let Packet::Mavlink2(received) = packet else {
        panic!("a MAVLink 1 packet was signed");
    };
    assert!(!received.is_signed());
    assert_ne!(received.header().message_id, SETUP_SIGNING);
    let bytes = frame.as_bytes();
    assert_eq!(bytes.len(), received.as_bytes().len() + 13);
    assert_eq!(bytes[bytes.len() - 13], link_id);
    let same = received.as_bytes().len() - 2;
    if index < same && index != 2 {
        assert_eq!(bytes[index], received.as_bytes()[index]);
    }
    let parsed = FrameRef::parse(bytes).expect("a whole frame");
    assert!(parsed.is_signed());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::HEARTBEAT;
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
        ) {
            let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
            let other = SigningKey::<Hmac>::new(&[8; 32]).expect("a key");
            let mut frame = Frame::new(HEARTBEAT, &payload).expect("a frame");
            if signed {
                let stamp = Stamp { link_id, timestamp: at(times[0]) };
                sign_frame(&mut frame, if other_key { &other } else { &key }, stamp).expect("signed");
            }
            let packet = Packet::parse(frame.as_bytes(), crc_extra).expect("a packet");
            let window = Window { past: 15, ahead: 15 };
            let receiver = Resumed { link_id: 2, window, first: at(times[1]) };
            let forward = if whole { ForwardMode::KeepSignature } else { ForwardMode::StripSignature };
            for index in 0..frame.as_bytes().len() {
                let left = only_verified_leaves(packet, &key, receiver, forward, at(times[2]), index);
                prop_assert!(left.is_err() || (signed && !other_key && link_id == 2));
                let stamper = Stamper::new(1);
                let signing = only_unsigned_is_signed(packet, &key, stamper, at(times[2]), index);
                prop_assert_eq!(signing.is_err(), signed);
            }
        }
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
    use crate::model::{AnyTag, any_prefix, set_checksum};
    use crate::replay::any_timestamp;
    use mavlink_signing::field::{MAGIC, MAGIC_V1, MAX_FRAME_SIZE};

    fn any_key() -> SigningKey<AnyTag> {
        let mut secret: [u8; 32] = kani::any();
        secret[31] = 1;
        SigningKey::new(&secret).expect("not zero")
    }

    /// Any frame of `SIZE` bytes with these flags: an array of that size, so that the solver knows
    /// how long it is.
    fn any_frame<const SIZE: usize>(flags: u8, payload_length: usize) -> [u8; SIZE] {
        let mut bytes: [u8; SIZE] = kani::any();
        [bytes[0], bytes[1], bytes[2]] = [MAGIC, payload_length as u8, flags];
        bytes
    }

    fn leaves<const SIZE: usize>() {
        set_checksum(kani::any());
        let bytes: [u8; SIZE] = any_frame(1, SIZE - 25);
        let Ok(packet) = Packet::parse(&bytes, |_| Some(0)) else {
            return;
        };
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
        kani::cover!(left == Err(RejectReason::Replayed), "replayed");
        kani::cover!(left == Err(RejectReason::SetupSigning), "SETUP_SIGNING");
    }

    fn signs<const SIZE: usize>() {
        set_checksum(kani::any());
        let bytes: [u8; SIZE] = any_frame(0, SIZE - 12);
        let Ok(packet) = Packet::parse(&bytes, |_| Some(0)) else {
            return;
        };
        let stamper = Stamper::resume(kani::any(), any_timestamp());
        let (now, index) = (any_timestamp(), kani::any());
        let signing = only_unsigned_is_signed(packet, &any_key(), stamper, now, index);
        kani::cover!(signing.is_ok(), "signed");
        kani::cover!(signing == Err(RejectReason::UnknownMessage), "unknown");
        kani::cover!(signing == Err(RejectReason::SetupSigning), "SETUP_SIGNING");
    }

    // The harness's number is the payload's length, the literal the frame's.
    crate::for_payload_lengths! { leaves:
        l1_only_verified_leaves_0 25 unwind 33,
        l1_only_verified_leaves_9 34 unwind 36,
    }

    crate::for_payload_lengths! { signs:
        l1_only_unsigned_is_signed_0 12 unwind 33,
        l1_only_unsigned_is_signed_9 21 unwind 33,
    }

    /// What neither side lets through, of every length.
    #[kani::proof]
    #[kani::unwind(33)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn l1_the_wrong_kind_is_rejected() {
        set_checksum(kani::any());
        let mut bytes: [u8; MAX_FRAME_SIZE] = kani::any();
        let mavlink1 = kani::any();
        let signed = kani::any();
        bytes[0] = if mavlink1 { MAGIC_V1 } else { MAGIC };
        let bytes = any_prefix(&bytes);
        let Ok(packet) = Packet::parse(bytes, |_| Some(0)) else {
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
            kani::cover!(!mavlink1, "not signed");
        }
    }
}
