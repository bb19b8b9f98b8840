//! L1: nothing from the secure side is signed; nothing unverified leaves on the plain side.

use mavlink_signing::{
    FrameRef, Packet, Profile, Replay, SigningKey, Stamper, Timestamp, VerifyError, authenticate,
};
use mavseal_relay::{Forward, Refusal, Signer, Verifier};

/// L1, towards the plain side: a packet is handed on only if it is verified, by a receiver in the
/// same state; unsigned, or byte for byte as received, as `forward` says. Returns the refusal.
///
/// That the relay gives packets of the secure side to [`Verifier`] alone, which holds no stamper,
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
    mut replay: Replay,
    forward: Forward,
    now: Timestamp,
    index: usize,
) -> Result<(), Refusal> {
    let handed_on = Verifier::new(replay, forward).verify(packet, key, now);
    let Packet::Mavlink2(received) = packet else {
        assert_eq!(handed_on, Err(Refusal::Mavlink1));
        return Err(Refusal::Mavlink1);
    };
    let verdict: Result<_, VerifyError> =
        authenticate(received, key).and_then(|authentic| replay.admit(authentic, now));
    match handed_on {
        Ok(frame) => {
            assert!(verdict.is_ok());
            let (bytes, original) = (frame.as_bytes(), received.as_bytes());
            let same = match forward {
                Forward::Whole => original.len(),
                // All but flag, checksum and signature.
                Forward::Stripped => {
                    assert!(!frame.is_signed());
                    assert_eq!(bytes.len(), original.len() - 13);
                    bytes.len() - 2
                }
            };
            if index < same && (index != 2 || forward == Forward::Whole) {
                assert_eq!(bytes[index], original[index]);
            }
            Ok(())
        }
        Err(refusal) => {
            assert_eq!(verdict.err().map(Refusal::from), Some(refusal));
            Err(refusal)
        }
    }
}

/// L1, towards the secure side: a packet is signed only if it is a frame without signature; what
/// leaves carries the stamper's link id and the same header and payload. Returns the refusal.
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
) -> Result<(), Refusal> {
    let link_id = stamper.link_id();
    let frame = Signer::new(stamper).sign(packet, key, now)?;
    let Packet::Mavlink2(received) = packet else {
        panic!("a MAVLink 1 packet was signed");
    };
    assert!(!received.is_signed());
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
mod twins {
    use super::*;
    use crate::HEARTBEAT;
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
            let replay = Replay::resume(2, window, at(times[1]));
            let forward = if whole { Forward::Whole } else { Forward::Stripped };
            for index in 0..frame.as_bytes().len() {
                let left = only_verified_leaves(packet, &key, replay, forward, at(times[2]), index);
                prop_assert!(left.is_err() || (signed && !other_key && link_id == 2));
                let stamper = Stamper::new(1);
                let signing = only_unsigned_is_signed(packet, &key, stamper, at(times[2]), index);
                prop_assert_eq!(signing.is_err(), signed);
            }
        }
    }

    #[test]
    fn l1_mavlink1() {
        let heartbeat = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];
        let packet = Packet::parse(&heartbeat, crc_extra).expect("a packet");
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let now = at(5);
        let signing = only_unsigned_is_signed(packet, &key, Stamper::new(1), now, 0);
        assert_eq!(signing, Err(Refusal::Mavlink1));
        let replay = Replay::new(2, Window::SEED);
        let left = only_verified_leaves(packet, &key, replay, Forward::Whole, now, 0);
        assert_eq!(left, Err(Refusal::Mavlink1));
    }
}

#[cfg(kani)]
mod harness {
    use super::*;
    use crate::model::{AnyTag, set_checksum};
    use crate::replay::any_timestamp;
    use mavlink_signing::Window;

    /// Any packet with a payload of `LENGTH` bytes, signed or not, of either version.
    fn passes<const LENGTH: usize>() {
        set_checksum(kani::any());
        let header: [u8; 10] = kani::any();
        let mut bytes = [0; 280];
        bytes[..10].copy_from_slice(&header);
        bytes[1] = LENGTH as u8;
        let rest: [u8; 270] = kani::any();
        bytes[10..].copy_from_slice(&rest);
        let Ok(packet) = Packet::parse(&bytes, |_| Some(0)) else {
            return;
        };
        let mut secret: [u8; 32] = kani::any();
        secret[31] = 1;
        let key = SigningKey::<AnyTag>::new(&secret).expect("a key");
        let (now, index) = (any_timestamp(), kani::any());
        if kani::any() {
            let stamper = Stamper::resume(kani::any(), any_timestamp());
            let signing = only_unsigned_is_signed(packet, &key, stamper, now, index);
            kani::cover!(signing.is_ok(), "signed");
            kani::cover!(signing == Err(Refusal::AlreadySigned), "already signed");
            kani::cover!(signing == Err(Refusal::Mavlink1), "MAVLink 1");
        } else {
            let window = Window {
                past: kani::any(),
                ahead: kani::any(),
            };
            let replay = Replay::resume(kani::any(), window, any_timestamp());
            let whole = kani::any();
            let forward = if whole {
                Forward::Whole
            } else {
                Forward::Stripped
            };
            let left = only_verified_leaves(packet, &key, replay, forward, now, index);
            kani::cover!(left.is_ok() && whole, "whole");
            kani::cover!(left.is_ok() && !whole, "stripped");
            kani::cover!(left == Err(Refusal::NotSigned), "not signed");
            kani::cover!(left == Err(Refusal::Replayed), "replayed");
        }
    }

    crate::for_payload_lengths! { passes:
        l1_passes_0 0,
        l1_passes_9 9,
        l1_passes_255 255,
    }
}
