//! L1: nothing from the link side is signed; nothing unverified leaves on the local side; only permitted senders are
//! signed for.

use mavlink_signing::field::{CHECKSUM_SIZE, SIGNATURE_SIZE};
use mavlink_signing::{
    FrameRef, Header, KeyRing, KeySlot, Packet, Profile, SETUP_SIGNING, SignError, SigningKey,
    Stamper, Timestamp, VerifyError, authenticate,
};
use mavseal_relay::{ForwardMode, Forwarded, RejectReason, Senders, Signer, Verifier};

use crate::model::{HEARTBEAT, Resumed};
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
    let mut verifier = Verifier::new(KeySlot::A, receiver.replay(), forward);
    let handed_on = verifier.verify(packet, &mut &*key, &mut { now });
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

/// The local side: its signer, and what is known of it.
#[derive(Debug)]
pub struct LocalSide {
    signer: Signer,
    /// Gives the stamps that the signer must give.
    twin: Stamper,
    senders: Senders,
    /// The system whose HEARTBEAT came first.
    learnt: Option<u8>,
}

impl LocalSide {
    /// A signer with the stamps from `first` on, for the key in `slot`, in the name of `senders`.
    #[must_use]
    pub const fn new(link_id: u8, slot: KeySlot, first: Timestamp, senders: Senders) -> Self {
        Self {
            signer: Signer::new(Stamper::resume(link_id, first).in_slot(slot)).for_senders(senders),
            twin: Stamper::resume(link_id, first).in_slot(slot),
            senders,
            learnt: None,
        }
    }

    /// Whether a packet with this header is signed, where each end signs in its own name.
    fn permits(&self, header: Header) -> bool {
        let (system_id, component_id) = (header.system_id, header.component_id);
        match (self.senders, self.learnt) {
            (Senders::Any, _) => true,
            (Senders::System(only), _) => only == system_id,
            (Senders::Listed(all), _) => all
                .iter()
                .any(|(system, component)| (*system, *component) == (system_id, component_id)),
            (_, Some(learnt)) => learnt == system_id,
            // Not even learnt yet: nothing but a HEARTBEAT.
            (_, None) => header.message_id == HEARTBEAT.message_id,
        }
    }

    /// Why a frame of the local side is not signed, unless it is, or no stamp is left.
    fn specified(&self, frame: FrameRef<'_>) -> Result<(), RejectReason> {
        if frame.header().message_id == SETUP_SIGNING {
            return Err(RejectReason::SetupSigning);
        }
        if frame.as_bytes()[2] != 0 {
            return Err(RejectReason::AlreadySigned);
        }
        if !self.permits(frame.header()) {
            return Err(RejectReason::ForeignSender);
        }
        match known_and_undamaged(frame.as_bytes()) {
            Err(SignError::UnknownMessage(_)) => Err(RejectReason::UnknownMessage),
            Err(_) => Err(RejectReason::BadChecksum),
            Ok(_) => Ok(()),
        }
    }
}

/// L1, towards the link side: a packet is signed if and only if it is an undamaged, known frame without
/// signature, not SETUP_SIGNING, and of a sender that is permitted. Otherwise the error names the first that is wrong.
/// What leaves is signed with the key in use and with its next stamp; what is rejected uses up none. It has the same
/// bytes, but for the flag, the signature, and a new checksum, which is right. Returns the rejection.
///
/// Permitted are: all; those of one system; those in a list; or those of the system whose HEARTBEAT came first, and
/// before that nothing but this HEARTBEAT.
///
/// # Errors
///
/// What [`Signer::sign`] says.
///
/// # Panics
///
/// If the property does not hold.
pub fn only_unsigned_is_signed<P: Profile>(
    local: &mut LocalSide,
    packet: Packet<'_>,
    keys: &KeyRing<P>,
    now: Timestamp,
    index: usize,
) -> Result<(), RejectReason> {
    let signing = local.signer.sign(packet, keys, &mut { now });
    let expected = match packet {
        Packet::Mavlink1(_) => Err(RejectReason::Mavlink1),
        Packet::Mavlink2(frame) => local.specified(frame).and_then(|()| {
            local.learnt.get_or_insert(frame.header().system_id);
            local.twin.next(now).map(drop).map_err(RejectReason::from)
        }),
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
    let authentic = authenticate(signed, keys.signing()).expect("signed with the key in use");
    assert_eq!(Ok(authentic.stamp()), local.twin.stamp(now));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_signing::RolloverState::Applied;
    use mavlink_signing::dialect::crc_extra;
    use mavlink_signing::{Frame, Hmac, MessageId, Stamp, Window, sign_frame};
    use proptest::prelude::*;

    fn at(ticks: u64) -> Timestamp {
        Timestamp::from_ticks(ticks).expect("48 bits")
    }

    /// Of every dialect, as HEARTBEAT is.
    const PING: MessageId = MessageId::from_le_bytes([4, 0, 0]);

    fn key() -> SigningKey<Hmac> {
        SigningKey::new(&[7; 32]).expect("a key")
    }

    fn second_key() -> SigningKey<Hmac> {
        SigningKey::new(&[8; 32]).expect("a key")
    }

    /// A local side where everybody is signed for.
    const fn everybody() -> LocalSide {
        LocalSide::new(1, KeySlot::A, Timestamp::ZERO, Senders::Any)
    }

    fn packet(bytes: &[u8]) -> Packet<'_> {
        Packet::Mavlink2(FrameRef::parse(bytes).expect("a whole frame"))
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
            let (key, keys) = (key(), KeyRing::from(key()));
            let other = second_key();
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
                let signing = only_unsigned_is_signed(&mut everybody(), packet, &keys, at(times[2]), index);
                let setup = received.header().message_id == SETUP_SIGNING;
                prop_assert_eq!(signing.is_err(), signed || !right || setup);
            }
        }
    }

    /// Whoever sends what: signed for are those of the rule alone. The slot of the key in use gives the stamps.
    #[test]
    fn l1_senders() {
        const LISTED: &[(u8, u8)] = &[(1, 1), (2, 191)];
        let all = [(1, 1), (1, 2), (2, 1), (2, 191), (255, 190)];
        let frames: Vec<_> = all
            .iter()
            .flat_map(|(system_id, component_id)| {
                [PING, HEARTBEAT.message_id].map(|message_id| {
                    let header = Header {
                        system_id: *system_id,
                        component_id: *component_id,
                        message_id,
                        ..HEARTBEAT
                    };
                    Frame::new(header, &[1]).expect("in every dialect")
                })
            })
            .collect();
        let signed = |slot, senders| {
            let new = || KeyRing::in_slot(slot, key());
            // The key in use is in the other slot.
            let changed = KeyRing::resume(slot.other(), second_key(), key(), Applied);
            [new(), changed].map(|keys| {
                let mut local = LocalSide::new(1, slot, at(9), senders);
                let sign = |frame: &&Frame| {
                    let packet = packet(frame.as_bytes());
                    only_unsigned_is_signed(&mut local, packet, &keys, at(5), 0).is_ok()
                };
                frames.iter().filter(sign).count()
            })
        };
        for slot in [KeySlot::A, KeySlot::B] {
            assert_eq!(signed(slot, Senders::Any), [10, 10]);
            assert_eq!(signed(slot, Senders::System(2)), [4, 4]);
            assert_eq!(signed(slot, Senders::Listed(LISTED)), [4, 4]);
            assert_eq!(signed(slot, Senders::Listed(&[])), [0, 0]);
            // The first PING comes before the HEARTBEAT of system 1.
            assert_eq!(signed(slot, Senders::FirstHeartbeat), [3, 3]);
        }
    }

    proptest! {
        #[test]
        fn l1_senders_random(
            frames in proptest::collection::vec((1..4_u8, 1..4_u8, any::<bool>()), 0..12),
            rule in 0..4_u8,
        ) {
            let listed = Senders::Listed(&[(1, 1), (3, 2)]);
            let rules = [Senders::FirstHeartbeat, Senders::Any, Senders::System(2), listed];
            let mut local = LocalSide::new(1, KeySlot::A, at(9), rules[usize::from(rule)]);
            let keys = KeyRing::from(key());
            for (system_id, component_id, ping) in frames {
                let message_id = if ping { PING } else { HEARTBEAT.message_id };
                let header = Header { system_id, component_id, message_id, ..HEARTBEAT };
                let frame = Frame::new(header, &[1]).expect("in every dialect");
                let _ = only_unsigned_is_signed(&mut local, packet(frame.as_bytes()), &keys, at(5), 0);
            }
        }
    }

    /// Each bit of a frame without signature, one after the other: nothing of it is signed or handed on.
    #[test]
    fn l1_each_bit() {
        let frame = Frame::new(HEARTBEAT, &[1, 2, 3]).expect("a frame");
        let (key, keys) = (key(), KeyRing::from(key()));
        for place in 3..frame.as_bytes().len() {
            for bit in 0..8 {
                let mut bytes = frame.as_bytes().to_vec();
                bytes[place] ^= 1 << bit;
                let packet = packet(&bytes);
                let signing = only_unsigned_is_signed(&mut everybody(), packet, &keys, at(5), 0);
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
        let frame = Frame::new(HEARTBEAT, &[1, 2, 3]).expect("a frame");
        let mut damaged = frame.as_bytes().to_vec();
        damaged[12] ^= 1;
        let mut signed = frame.clone();
        let stamp = Stamp {
            link_id: 9,
            timestamp: at(1),
        };
        sign_frame(&mut signed, &key(), stamp).expect("signed");
        let (mut local, keys) = (everybody(), KeyRing::from(key()));
        let mut signing =
            |bytes| only_unsigned_is_signed(&mut local, packet(bytes), &keys, at(5), 0);
        for rejected in [&damaged, signed.as_bytes()] {
            assert!(signing(rejected).is_err());
        }
        assert_eq!(signing(frame.as_bytes()), Ok(()));
    }

    #[test]
    fn l1_setup_signing() {
        let mut header = HEARTBEAT;
        header.message_id = SETUP_SIGNING;
        let mut frame = Frame::new(header, &[7; 42]).expect("a frame");
        let (key, keys) = (key(), KeyRing::from(key()));
        let packet = Packet::parse(frame.as_bytes(), crc_extra).expect("a packet");
        let signing = only_unsigned_is_signed(&mut everybody(), packet, &keys, at(5), 0);
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
        let (key, keys) = (key(), KeyRing::from(key()));
        let now = at(5);
        let signing = only_unsigned_is_signed(&mut everybody(), packet, &keys, now, 0);
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
    use crate::model::{any_key, any_prefix, any_slot, any_timestamp};
    use mavlink_signing::field::{MAGIC, MAGIC_V1, MAX_FRAME_SIZE};

    /// Any frame of `SIZE` bytes with these flags: an array of that size, so that the solver knows
    /// how long it is.
    fn any_frame<const SIZE: usize>(flags: u8, payload_length: usize) -> [u8; SIZE] {
        let mut bytes: [u8; SIZE] = kani::any();
        [bytes[0], bytes[1], bytes[2]] = [MAGIC, payload_length as u8, flags];
        bytes
    }

    impl LocalSide {
        /// In any state, with any rule.
        fn any(slot: KeySlot) -> Self {
            const LISTED: &[(u8, u8)] = &[(1, 190), (4, 0)];
            let rules = [
                Senders::FirstHeartbeat,
                Senders::Any,
                Senders::System(kani::any()),
                Senders::Listed(LISTED),
            ];
            let rule: usize = kani::any();
            kani::assume(rule < rules.len());
            let new = Self::new(kani::any(), slot, any_timestamp(), rules[rule]);
            let learnt = kani::any();
            Self {
                signer: new.signer.having_learnt(learnt),
                learnt,
                ..new
            }
        }
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
        let slot = any_slot();
        let mut local = LocalSide::any(slot);
        let before = local.learnt;
        let keys = KeyRing::in_slot(slot, any_key());
        let (now, index) = (any_timestamp(), kani::any());
        let signing = only_unsigned_is_signed(&mut local, packet, &keys, now, index);
        let by_heartbeat = local.senders == Senders::FirstHeartbeat;
        kani::cover!(
            signing.is_ok() && by_heartbeat && before.is_none(),
            "the first"
        );
        kani::cover!(signing.is_ok() && !by_heartbeat, "signed");
        kani::cover!(signing == Err(RejectReason::ForeignSender), "foreign");
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
            let mut signer = LocalSide::any(KeySlot::A).signer;
            let keys = KeyRing::from(any_key());
            let rejection = signer.sign(packet, &keys, &mut { now }).err();
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
            let replay = Resumed::any().replay();
            let mut verifier = Verifier::new(KeySlot::A, replay, ForwardMode::KeepSignature);
            let rejection = verifier.verify(packet, &mut &key, &mut { now }).err();
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
