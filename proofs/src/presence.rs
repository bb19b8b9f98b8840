//! D2: a key comes into a device only with somebody's presence, or with proof that its sender has the key in use.

use mavlink_signing::field::HEADER_SIZE;
use mavlink_signing::{
    FrameRef, KeyRing, Profile, SetupSigning, SignError, Timestamp, Window, authenticate,
};
use mavseal_relay::{Presence, RejectReason};

use crate::wire::known_and_undamaged;

/// An end that keeps SETUP_SIGNING, before one comes in on its local side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Before {
    /// System and component of this end.
    pub end: [u8; 2],
    /// Whether somebody is there.
    pub presence: Presence,
    /// The stamp of the last SETUP_SIGNING that was signed with the key in use.
    pub last: Option<Timestamp>,
    /// The first timestamp of the key in use that may be accepted.
    pub floor: Timestamp,
    /// The time, which this end knows.
    pub now: Timestamp,
}

/// D2, one SETUP_SIGNING from any state: it is kept if and only if it is for this end, undamaged, and either presence is
/// shown and it is not signed, or it is signed with the key in use, within a minute of the time, not below the floor, and
/// later than any before. A former key, or one that is only offered, is no proof, and a forged signature is none where presence is shown either. It never goes on to the
/// link; otherwise the rejection names the first that is wrong. What is kept is what it says.
///
/// `found` is the rejection, and what was kept. Returns the stamp of the last that was signed, after it.
///
/// # Panics
///
/// If the property does not hold.
pub fn only_with_presence_or_proof<P: Profile>(
    before: Before,
    frame: FrameRef<'_>,
    keys: &KeyRing<P>,
    found: (RejectReason, Option<&SetupSigning>),
) -> Option<Timestamp> {
    let bytes = frame.as_bytes();
    let payload = &bytes[HEADER_SIZE..HEADER_SIZE + usize::from(bytes[1])];
    let read = SetupSigning::from_payload(payload).ok();
    let ours = read.filter(|it| [it.target_system, it.target_component] == before.end);
    let mut last = before.last;
    let allowed = if frame.is_signed() {
        match authenticate(frame, keys.signing()) {
            Err(error) => Err(error.into()),
            Ok(authentic) => {
                let timestamp = authentic.stamp().timestamp;
                let window = Window::ONE_MINUTE.check(timestamp, before.now);
                if last.is_some_and(|it| timestamp <= it) {
                    Err(RejectReason::Replayed)
                } else if let Err(error) = window {
                    Err(error.into())
                } else if timestamp < before.floor {
                    Err(RejectReason::Replayed)
                } else {
                    last = Some(timestamp);
                    Ok(())
                }
            }
        }
    } else {
        match known_and_undamaged(bytes) {
            Err(SignError::UnknownMessage(_)) => Err(RejectReason::UnknownMessage),
            Err(_) => Err(RejectReason::BadChecksum),
            Ok(_) if before.presence == Presence::Absent && ours.is_some() => {
                Err(RejectReason::NoPresence)
            }
            Ok(_) => Ok(()),
        }
    };
    let (rejection, kept) = found;
    assert_eq!(
        rejection,
        allowed.err().unwrap_or(RejectReason::SetupSigning)
    );
    let expected = ours.filter(|_| allowed.is_ok());
    assert_eq!(kept.is_some(), expected.is_some());
    if let (Some(kept), Some(expected)) = (kept, expected) {
        assert_eq!(kept.secret_key, expected.secret_key);
        assert_eq!(kept.initial_timestamp, expected.initial_timestamp);
        assert_eq!(kept.target_system, expected.target_system);
        assert_eq!(kept.target_component, expected.target_component);
    }
    last
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keeper::Model;
    use crate::model::HEARTBEAT;
    use mavlink_signing::{
        Frame, Header, Hmac, KeySlot, MessageId, ReplayGuard, RolloverState, SigningKey, Stamp,
        Stamper, sign_frame,
    };
    use mavseal_relay::{Endpoint, Event, ForwardMode, LineEvent, Relay, Senders, Side};
    use proptest::prelude::*;

    const END: [u8; 2] = [1, 1];
    const FLOOR: u64 = 20;

    fn at(ticks: u64) -> Timestamp {
        Timestamp::from_ticks(ticks).expect("48 bits")
    }

    /// Key 0 is in use no longer, key 1 is, key 2 is nobody's.
    fn key(number: u8) -> SigningKey<Hmac> {
        SigningKey::new(&[number + 7; 32]).expect("a key")
    }

    /// What comes in on the local side.
    #[derive(Clone, Copy, Debug)]
    enum Arrives {
        /// A SETUP_SIGNING for a system and component; signed with a key and at a time, or not; damaged, or not.
        Setup([u8; 2], Option<(u8, u64)>, bool),
        /// Another packet, damaged or not.
        Other(bool),
        /// Nothing; somebody comes or goes.
        Nobody(Presence),
    }

    struct Device {
        relay: Relay<Hmac>,
        clock: Model,
        before: Before,
    }

    impl Device {
        fn new(presence: Presence) -> Self {
            let keys = KeyRing::resume(KeySlot::A, key(0), key(1), RolloverState::Applied);
            let receiver = ReplayGuard::new(2, Window::STRICT);
            let relay = Relay::new(keys, Stamper::new(1), receiver, ForwardMode::KeepSignature);
            let mut relay = relay.expect("two link ids").senders(Senders::Any);
            relay.keep_setup(END[0], END[1]);
            relay.set_presence(presence);
            let floor = at(FLOOR);
            Self {
                relay,
                clock: Model {
                    now: floor,
                    follows: false,
                    marks: [0, 0],
                    floors: [Timestamp::ZERO, floor],
                    ahead: 0,
                    broken: false,
                    heard: 0,
                },
                before: Before {
                    end: END,
                    presence,
                    last: None,
                    floor,
                    now: floor,
                },
            }
        }

        /// What becomes of a packet: the rejection, if it is one.
        fn receive(&mut self, bytes: &[u8]) -> Option<RejectReason> {
            let mut rejection = None;
            let Self { relay, clock, .. } = self;
            let mut observe = |event| {
                if let Event::Rejected(_, reason) = event {
                    rejection = Some(reason);
                }
            };
            let taken = relay.received(Side::Local, bytes, clock, &mut observe);
            assert_eq!(taken, bytes.len());
            let sent = relay.pending(Side::Link).len();
            relay.sent(Side::Link, sent, clock, &mut observe);
            relay.line_event(Side::Local, LineEvent::Idle, clock, &mut observe);
            rejection
        }

        /// Whether a key was kept.
        fn arrives(&mut self, this: Arrives) -> bool {
            match this {
                Arrives::Nobody(presence) => {
                    self.relay.set_presence(presence);
                    self.before.presence = presence;
                    false
                }
                Arrives::Other(damaged) => {
                    let header = Header {
                        message_id: MessageId::from(4),
                        ..HEARTBEAT
                    };
                    let frame = Frame::new(header, &[1, 2, 3]).expect("a frame");
                    let mut bytes = frame.as_bytes().to_vec();
                    bytes[11] ^= u8::from(damaged);
                    assert_eq!(self.receive(&bytes).is_some(), damaged);
                    if self.before.presence == Presence::AtStart {
                        self.before.presence = Presence::Absent;
                    }
                    assert!(self.relay.take_setup().is_none());
                    false
                }
                Arrives::Setup([target_system, target_component], signed, damaged) => {
                    let setup = SetupSigning {
                        target_system,
                        target_component,
                        secret_key: [3; 32],
                        initial_timestamp: at(5),
                    };
                    let mut frame = setup.to_frame(HEARTBEAT).expect("a frame");
                    if let Some((number, ticks)) = signed {
                        let timestamp = at(ticks);
                        let link_id = number;
                        let stamp = Stamp { link_id, timestamp };
                        sign_frame(&mut frame, &key(number), stamp).expect("not signed yet");
                    }
                    let mut bytes = frame.as_bytes().to_vec();
                    // One byte of the new key: the decoder finds it, and it counts as something else.
                    bytes[30] ^= u8::from(damaged);
                    let rejection = self.receive(&bytes).expect("it never goes on");
                    let kept = self.relay.take_setup();
                    if damaged {
                        assert_eq!(rejection, RejectReason::BadChecksum);
                        assert!(kept.is_none());
                        if self.before.presence == Presence::AtStart {
                            self.before.presence = Presence::Absent;
                        }
                        return false;
                    }
                    let frame = FrameRef::parse(&bytes).expect("a whole frame");
                    let found = (rejection, kept.as_ref());
                    let keys = self.relay.keys();
                    let last = only_with_presence_or_proof(self.before, frame, keys, found);
                    self.before.last = last;
                    kept.is_some()
                }
            }
        }
    }

    fn presence() -> impl Strategy<Value = Presence> {
        let all = [Presence::Absent, Presence::AtStart, Presence::Shown];
        prop::sample::select(all.to_vec())
    }

    fn arrives() -> impl Strategy<Value = Arrives> {
        let signed = proptest::option::of((0..3_u8, 15..40_u64));
        let damaged = proptest::bool::weighted(0.1);
        let setup = ([1..3_u8, 1..3_u8], signed, damaged);
        prop_oneof![
            6 => setup.prop_map(|(target, signed, damaged)| Arrives::Setup(target, signed, damaged)),
            1 => proptest::bool::weighted(0.3).prop_map(Arrives::Other),
            1 => presence().prop_map(Arrives::Nobody),
        ]
    }

    proptest! {
        #[test]
        fn d2_random(
            start in presence(),
            all in proptest::collection::vec(arrives(), 0..20),
        ) {
            let mut device = Device::new(start);
            for this in all {
                device.arrives(this);
            }
        }
    }

    #[test]
    fn d2_who_may_give_a_key() {
        let plain = Arrives::Setup(END, None, false);
        let signed = |number, ticks| Arrives::Setup(END, Some((number, ticks)), false);
        let kept = |presence, this| Device::new(presence).arrives(this);
        for presence in [Presence::Absent, Presence::AtStart, Presence::Shown] {
            assert_eq!(kept(presence, plain), presence != Presence::Absent);
            assert!(kept(presence, signed(1, FLOOR)), "with the key in use");
            assert!(
                !kept(presence, signed(1, FLOOR - 1)),
                "from before a restart"
            );
            let minute = Window::ONE_MINUTE.ahead;
            assert!(kept(presence, signed(1, FLOOR + minute)));
            assert!(
                !kept(presence, signed(1, FLOOR + minute + 1)),
                "stamped ahead"
            );
            assert!(!kept(presence, signed(0, FLOOR)), "with a former key");
            assert!(!kept(presence, signed(2, FLOOR)), "with another");
            for other in [[2, 1], [1, 2]] {
                let this = Arrives::Setup(other, None, false);
                assert!(!kept(presence, this), "for another");
            }
        }
    }

    #[test]
    fn d2_once() {
        let signed = |ticks| Arrives::Setup(END, Some((1, ticks)), false);
        let mut device = Device::new(Presence::Absent);
        let kept = [30, 30, 29, 31].map(|ticks| device.arrives(signed(ticks)));
        assert_eq!(kept, [true, false, false, true]);
        // One for somebody else counts too.
        let other = Arrives::Setup([2, 1], Some((1, 40)), false);
        assert!(!device.arrives(other));
        assert!(!device.arrives(signed(40)));
    }

    /// Presence that was shown by switching on ends with the first packet that is no SETUP_SIGNING, whole or not.
    #[test]
    fn d2_at_start() {
        let plain = Arrives::Setup(END, None, false);
        for damaged in [false, true] {
            let mut device = Device::new(Presence::AtStart);
            assert!(device.arrives(plain));
            assert!(device.arrives(plain));
            device.arrives(Arrives::Other(damaged));
            assert!(!device.arrives(plain));
            device.arrives(Arrives::Nobody(Presence::Shown));
            device.arrives(Arrives::Other(damaged));
            assert!(device.arrives(plain));
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::keeper::Model;
    use crate::model::{any_key, any_slot, any_timestamp};
    use mavlink_signing::field::MAGIC;
    use mavlink_signing::{Packet, RolloverState, Stamper};
    use mavseal_relay::{Senders, Signer};

    /// A SETUP_SIGNING without cut zeros, and what became of it. Any are: the sender, the first byte of the timestamp, the
    /// targets, the first byte of the key, the checksum, and the signature. The others are copied, and looked at by nobody.
    fn came<const SIZE: usize>(flags: u8, keys: &KeyRing<crate::model::AnyTag>) -> (Before, bool) {
        let mut bytes = [7; SIZE];
        [bytes[0], bytes[1], bytes[2]] = [MAGIC, 42, flags];
        [bytes[7], bytes[8], bytes[9]] = [0, 1, 0];
        [bytes[16], bytes[17]] = [0, 0];
        for at in [5, 6, 10, 18, 19, 20].into_iter().chain(52..SIZE) {
            bytes[at] = kani::any();
        }
        let frame = FrameRef::parse(&bytes).expect("a whole frame");
        let presence = match kani::any() {
            0_u8 => Presence::Absent,
            1 => Presence::AtStart,
            _ => Presence::Shown,
        };
        let floors = [any_timestamp(), any_timestamp()];
        let before = Before {
            end: kani::any(),
            presence,
            last: kani::any::<bool>().then(any_timestamp),
            floor: *keys.signing_slot().of(&floors),
            now: any_timestamp(),
        };
        let mut clock = Model {
            now: before.now,
            follows: false,
            marks: [0, 0],
            floors,
            ahead: 0,
            broken: false,
            heard: 0,
        };
        let signer = Signer::new(Stamper::new(kani::any())).for_senders(Senders::Any);
        let mut signer = signer.keeping(before.end, before.presence, before.last);
        let rejection = signer.sign(Packet::Mavlink2(frame), keys, &mut clock).err();
        let rejection = rejection.expect("it never goes on");
        let kept = signer.kept();
        only_with_presence_or_proof(before, frame, keys, (rejection, kept.as_ref()));
        (before, kept.is_some())
    }

    #[kani::proof]
    #[kani::unwind(44)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn d2_not_signed() {
        let keys = KeyRing::in_slot(any_slot(), any_key());
        let (before, kept) = came::<54>(0, &keys);
        kani::cover!(kept && before.presence == Presence::AtStart, "at the start");
        kani::cover!(
            kept && before.presence == Presence::Shown,
            "somebody is there"
        );
        kani::cover!(
            !kept && before.presence == Presence::Shown,
            "for another, or damaged"
        );
    }

    #[kani::proof]
    #[kani::unwind(44)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn d2_signed() {
        let phase = if kani::any() {
            RolloverState::Offered
        } else {
            RolloverState::Confirmed
        };
        let keys = KeyRing::resume(any_slot(), any_key(), any_key(), phase);
        let (before, kept) = came::<67>(1, &keys);
        kani::cover!(kept && before.presence == Presence::Absent, "proved");
        kani::cover!(!kept && before.presence == Presence::Shown, "no proof");
        kani::cover!(kept && before.last.is_some(), "once more");
    }
}
