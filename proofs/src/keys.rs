//! K1: while a key is changed, never are both ends deaf, and no key is used before it may be.

use mavlink_signing::{
    Authenticate, Frame, FrameRef, KeyChangeError, KeyRing, KeySlot, Profile, ReplayGuard,
    RolloverState, SigningKey, Stamp, Timestamp, Window, sign_frame,
};

use crate::key_memory::{FIRST, key};
pub use crate::key_memory::{Memory, Model, bytes};
use crate::model::HEARTBEAT;

/// Which end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub enum Side {
    /// Offers keys.
    Initiator,
    /// Takes them over.
    Responder,
}

/// What may happen to a link whose key is changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub enum Event {
    /// The initiator offers a key that it has never offered before; SETUP_SIGNING is on its way.
    Offer,
    /// A SETUP_SIGNING arrives at the responder: 0 is the last that was sent, 1 the one before. It may
    /// be lost and arrive again, but does not arrive after a later one.
    Setup(u8),
    /// The end sends a frame.
    Send(Side),
    /// A frame of the other end arrives: 0 is the last that was sent, 1 the one before.
    Hear(Side, u8),
    /// The end goes over to the new key if it has heard it.
    Confirm(Side),
    /// The end is asked to drop the old key.
    Retire(Side),
    /// The initiator takes its offer back, and sends the old key again.
    Withdraw,
    /// The end loses its power and starts again, with what it has stored.
    Restart(Side),
    /// The next thing that the end stores is not; `true`: it is found after a restart all the same.
    Fail(Side, bool),
}

/// A frame, and the number of the key that it is signed with.
struct Sent {
    frame: Frame,
    key: u8,
}

struct End<P, M> {
    keys: KeyRing<P>,
    memory: M,
    receiver: ReplayGuard,
    link_id: u8,
    sent: Vec<Sent>,
    /// The highest key that it has been given, or has heard from the other end.
    may_use: u8,
}

impl<P: Profile, M: Memory> End<P, M> {
    fn new(link_id: u8, memory: M) -> Self {
        let window = Window {
            past: u64::MAX,
            ahead: u64::MAX,
        };
        Self {
            keys: key::<P>(FIRST).into(),
            memory,
            receiver: ReplayGuard::new(3 - link_id, window),
            link_id,
            sent: Vec::new(),
            may_use: FIRST,
        }
    }

    /// A frame that it would send now.
    fn frame(&self) -> Frame {
        let mut frame = Frame::new(HEARTBEAT, &[]).expect("in every dialect");
        let ticks = self.sent.len() as u64 + 1;
        let stamp = Stamp {
            link_id: self.link_id,
            timestamp: Timestamp::from_ticks(ticks).expect("48 bits"),
        };
        sign_frame(&mut frame, self.keys.signing(), stamp).expect("not signed yet");
        frame
    }

    fn accepts(&self, frame: &Frame) -> bool {
        let frame = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
        self.keys.authenticate(frame).is_ok()
    }

    /// Which key is in each slot. One more than `last` may be: an offer that failed and left its trace.
    fn slots(&self, last: u8) -> [Option<u8>; 2] {
        let number = |slot| self.keys.key(slot).map(|key| number_of(key, last + 1));
        [KeySlot::A, KeySlot::B].map(number)
    }

    /// Takes a frame in, as a link does.
    fn hear(&mut self, sent: &Sent) {
        let frame = FrameRef::parse(sent.frame.as_bytes()).expect("a whole frame");
        let Ok(authentic) = self.keys.authenticate(frame) else {
            return;
        };
        if let Ok(verified) = self.receiver.admit(authentic, Timestamp::ZERO) {
            self.keys.on_accepted(&verified);
            self.may_use = self.may_use.max(sent.key);
        }
    }

    /// Which of the keys up to `last` it signs with.
    fn signs_with(&self, last: u8) -> u8 {
        number_of(self.keys.signing(), last)
    }
}

/// The number of `this`, which is one of the keys up to `last`.
fn number_of<P: Profile>(this: &SigningKey<P>, last: u8) -> u8 {
    let is_it = |number: &u8| key::<P>(*number).fingerprint() == this.fingerprint();
    let found = (FIRST..=last).rev().find(is_it);
    found.expect("one of the keys that there are")
}

/// K1 in every history: at no moment are both ends deaf to each other; without a withdrawal neither is.
/// The initiator signs with a new key only when it has heard it, the responder only when it was given
/// it. An old key is dropped by `Retire` alone, which is rejected until the other end was heard with the
/// new one. What is rejected changes nothing. A key keeps its slot for as long as an end has it, over restarts
/// too, and the two of a change have one each. Returns how many changes were brought to their end, at both ends.
///
/// # Panics
///
/// If the property does not hold.
pub fn change<P: Profile, M: Memory>(memories: [M; 2], events: &[Event]) -> u8 {
    let [ours, theirs] = memories;
    let mut initiator = End::<P, M>::new(1, ours);
    let mut responder = End::<P, M>::new(2, theirs);
    // Key 0 is that of a SETUP_SIGNING which asks to stop signing.
    let mut setups = Vec::new();
    let mut arrived = 0;
    let mut last = FIRST;
    let mut clean = true;
    let mut changes = 0;
    for event in events {
        let before =
            [&initiator, &responder].map(|end| (end.keys.rollover_state(), end.signs_with(last)));
        let slots = [&initiator, &responder].map(|end| end.slots(last));
        let signed = [&initiator, &responder].map(End::frame);
        let result = match *event {
            Event::Offer => {
                let offered = initiator
                    .keys
                    .offer(&bytes(last + 1), &mut initiator.memory);
                if offered.is_ok() {
                    last += 1;
                    setups.push(last);
                }
                offered
            }
            Event::Setup(back) => match setups.len().checked_sub(usize::from(back) + 1) {
                None => responder.keys.apply(&bytes(0), &mut responder.memory),
                Some(at) if at < arrived => Ok(()),
                Some(at) => {
                    arrived = at;
                    let number = setups[at];
                    // It may be stored though it is rejected.
                    responder.may_use = responder.may_use.max(number);
                    responder.keys.apply(&bytes(number), &mut responder.memory)
                }
            },
            Event::Send(side) => {
                let end = of(side, &mut initiator, &mut responder).0;
                let sent = Sent {
                    frame: end.frame(),
                    key: end.signs_with(last),
                };
                end.sent.push(sent);
                Ok(())
            }
            Event::Hear(side, back) => {
                let (end, other) = of(side, &mut initiator, &mut responder);
                if let Some(sent) = newest(&other.sent, back) {
                    end.hear(sent);
                }
                Ok(())
            }
            Event::Confirm(side) => {
                let end = of(side, &mut initiator, &mut responder).0;
                end.keys.confirm(&mut end.memory)
            }
            Event::Retire(side) => {
                let end = of(side, &mut initiator, &mut responder).0;
                let phase = end.keys.rollover_state();
                let retired = end.keys.retire(&mut end.memory);
                if retired.is_ok() {
                    assert_eq!(phase, RolloverState::Confirmed);
                    changes += 1;
                }
                retired
            }
            Event::Withdraw => {
                let withdrawn = initiator.keys.withdraw(&mut initiator.memory);
                // Also when it failed: a restart may find it done.
                if withdrawn != Err(KeyChangeError::NotOffered) {
                    clean = false;
                }
                if withdrawn.is_ok() {
                    setups.push(initiator.signs_with(last));
                }
                withdrawn
            }
            Event::Restart(side) => {
                let end = of(side, &mut initiator, &mut responder).0;
                end.keys = end.memory.restart();
                Ok(())
            }
            Event::Fail(side, trace) => {
                of(side, &mut initiator, &mut responder)
                    .0
                    .memory
                    .fail(trace);
                Ok(())
            }
        };
        let after =
            [&initiator, &responder].map(|end| (end.keys.rollover_state(), end.signs_with(last)));
        if result.is_err() {
            assert_eq!(before, after, "{event:?} was rejected: {result:?}");
        }
        let slots_after = [&initiator, &responder].map(|end| end.slots(last));
        for ([a, b], [old_a, old_b]) in slots_after.into_iter().zip(slots) {
            assert_ne!(a, b, "two keys");
            assert!(a.is_none() || a != old_b, "{event:?} moved a key");
            assert!(b.is_none() || b != old_a, "{event:?} moved a key");
        }
        let deaf = [
            !initiator.accepts(&responder.frame()),
            !responder.accepts(&initiator.frame()),
        ];
        assert!(deaf != [true, true], "both are deaf after {event:?}");
        assert!(!clean || deaf == [false, false], "{deaf:?} after {event:?}");
        // What signed before is still accepted, unless a key was dropped or a restart found it so.
        let drops = matches!(
            event,
            Event::Retire(_) | Event::Withdraw | Event::Setup(_) | Event::Restart(_)
        );
        for (end, frame) in [&initiator, &responder].into_iter().zip(&signed) {
            assert!(
                end.accepts(frame) || (drops && result.is_ok()),
                "{event:?} dropped a key: {result:?}"
            );
        }
        for (end, (_, number)) in [&initiator, &responder].into_iter().zip(after) {
            assert!(number <= end.may_use, "key {number} is used too early");
        }
    }
    changes
}

fn newest<T>(all: &[T], back: u8) -> Option<&T> {
    all.len()
        .checked_sub(usize::from(back) + 1)
        .and_then(|at| all.get(at))
}

fn of<'a, P, M>(
    side: Side,
    initiator: &'a mut End<P, M>,
    responder: &'a mut End<P, M>,
) -> (&'a mut End<P, M>, &'a End<P, M>) {
    match side {
        Side::Initiator => (initiator, responder),
        Side::Responder => (responder, initiator),
    }
}

/// A change without mishap, from the offer to the end.
pub const CHANGE: [Event; 10] = [
    Event::Offer,
    Event::Setup(0),
    Event::Send(Side::Responder),
    Event::Hear(Side::Initiator, 0),
    Event::Confirm(Side::Initiator),
    Event::Send(Side::Initiator),
    Event::Hear(Side::Responder, 0),
    Event::Confirm(Side::Responder),
    Event::Retire(Side::Initiator),
    Event::Retire(Side::Responder),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::AnyTag;
    use mavlink_signing::{Hmac, KeyChange, KeyStore, NotStored};
    use mavseal_relay::{FlashKeyStore, KEYS_SIZE};
    use mavseal_store::{
        Region,
        model::{Flash, PAGE_SIZE},
    };
    use proptest::prelude::*;

    const REGION: Region = Region {
        start: 0,
        page_size: PAGE_SIZE as u32,
    };

    /// Keys in flash, as an end of a link has them.
    struct InFlash(Option<FlashKeyStore<Flash<2>>>);

    impl InFlash {
        fn new(chance: u64) -> Self {
            let (mut slots, found) =
                FlashKeyStore::open::<AnyTag>(Flash::new(chance), REGION).expect("fits");
            assert!(found.is_none());
            let _ = slots.provision::<AnyTag>(&bytes(FIRST)).expect("stored");
            Self(Some(slots))
        }
    }

    impl KeyStore for InFlash {
        fn store(&mut self, change: KeyChange<'_>) -> Result<(), NotStored> {
            self.0.as_mut().expect("there").store(change)
        }
    }

    impl Memory for InFlash {
        fn restart<P: Profile>(&mut self) -> KeyRing<P> {
            let mut flash = self.0.take().expect("there").into_flash();
            flash.restart();
            let (slots, keys) = FlashKeyStore::open(flash, REGION).expect("fits");
            self.0 = Some(slots);
            keys.expect("a key was stored")
        }

        fn fail(&mut self, _: bool) {
            let mut flash = self.0.take().expect("there").into_flash();
            // Opening writes the ten words of a record again, twice: inside those of the next one.
            flash.cut_after(23);
            let (slots, _) = FlashKeyStore::open::<AnyTag>(flash, REGION).expect("fits");
            self.0 = Some(slots);
        }
    }

    fn side() -> impl Strategy<Value = Side> {
        prop_oneof![Just(Side::Initiator), Just(Side::Responder)]
    }

    fn event() -> impl Strategy<Value = Event> {
        prop_oneof![
            4 => Just(Event::Offer),
            6 => (0..3_u8).prop_map(Event::Setup),
            8 => side().prop_map(Event::Send),
            8 => (side(), 0..3_u8).prop_map(|(side, back)| Event::Hear(side, back)),
            6 => side().prop_map(Event::Confirm),
            4 => side().prop_map(Event::Retire),
            1 => Just(Event::Withdraw),
            3 => side().prop_map(Event::Restart),
            3 => (side(), any::<bool>()).prop_map(|(side, trace)| Event::Fail(side, trace)),
        ]
    }

    fn check(events: &[Event]) -> u8 {
        change::<Hmac, _>([Model::new(), Model::new()], events)
    }

    proptest! {
        #[test]
        fn k1_random(events in proptest::collection::vec(event(), 0..80)) {
            change::<AnyTag, _>([Model::new(), Model::new()], &events);
        }

        #[test]
        fn k1_in_flash(events in proptest::collection::vec(event(), 0..80), chance: u64) {
            // Power that failed inside a write comes back with a restart alone.
            let events: Vec<_> = events.into_iter().flat_map(|event| match event {
                Event::Fail(side, _) => vec![event, Event::Confirm(side), Event::Restart(side)],
                event => vec![event],
            }).collect();
            let memories = [InFlash::new(chance), InFlash::new(!chance)];
            change::<AnyTag, _>(memories, &events);
        }
    }

    #[test]
    fn k1_without_mishap() {
        assert_eq!(check(&[CHANGE, CHANGE, CHANGE].concat()), 6);
        let memories = [InFlash::new(1), InFlash::new(2)];
        let events = [CHANGE; 20].concat();
        assert_eq!(change::<AnyTag, _>(memories, &events), 40);
    }

    /// A restart of either end, or a store that fails, between any two steps; then all of it again.
    #[test]
    fn k1_each_mishap() {
        for at in 0..CHANGE.len() {
            for side in [Side::Initiator, Side::Responder] {
                for mishap in [
                    Event::Restart(side),
                    Event::Fail(side, true),
                    Event::Fail(side, false),
                ] {
                    let mut events = CHANGE.to_vec();
                    events.insert(at, mishap);
                    events.push(Event::Restart(side));
                    events.extend(CHANGE);
                    assert!(check(&events) >= 2, "{events:?}");
                }
            }
        }
    }

    /// The station that lost its offer, or had it rejected, is heard all the same.
    #[test]
    fn k1_withdrawn() {
        let offered = &CHANGE[..2];
        let withdrawn = [Event::Withdraw, Event::Setup(0)];
        let events = [offered, &withdrawn, &CHANGE].concat();
        assert_eq!(check(&events), 2);
        assert_eq!(KEYS_SIZE, 72);
    }
}
