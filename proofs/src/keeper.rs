//! T1 and R3 over a restart: what was used before it is not used after it, of the key in either slot.

use mavlink_signing::{
    AntiReplay, Authentic, Authenticate, Frame, FrameRef, KeySlot, KeyUse, LinkClock, Links,
    NotStored, Profile, ReplayGuard, SignError, SigningKey, Stamp, Stamper, StreamTable, Timestamp,
    VerifyError, Window, authenticate, sign_frame,
};

use crate::key_memory::{self, FIRST, ring};
use crate::model::{HEARTBEAT, Resumed};

/// A keeper whose memory is one number for each slot. T2 says that one in flash is as good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Model {
    /// What the clock shows.
    pub now: Timestamp,
    /// Whether it follows frames, as a clock does that nobody has set.
    pub follows: bool,
    /// The stored marks: above everything that was ever used under the key in a slot. One more than
    /// [`Timestamp::MAX`] is the last.
    pub marks: [u64; 2],
    /// The first timestamp of each slot that may be used.
    pub floors: [Timestamp; 2],
    /// How far ahead a mark is stored.
    pub ahead: u32,
    /// The memory does not store.
    pub broken: bool,
    /// Frames learned from.
    pub heard: u8,
}

impl LinkClock for Model {
    fn now(&mut self) -> Timestamp {
        self.now
    }

    fn monotonic(&mut self) -> u64 {
        self.now.ticks()
    }

    fn reference_time(&mut self, stamp: Timestamp) -> Timestamp {
        if self.follows { stamp } else { self.now }
    }

    fn floor(&self, slot: KeySlot) -> Timestamp {
        *slot.of(&self.floors)
    }

    fn reserve(&mut self, slot: KeySlot, stamp: Timestamp) -> Result<(), NotStored> {
        let mark = slot.of_mut(&mut self.marks);
        if stamp.ticks() < *mark {
            return Ok(());
        }
        if self.broken {
            return Err(NotStored);
        }
        *mark = stamp.ticks() + 1 + u64::from(self.ahead);
        Ok(())
    }

    fn on_accepted(&mut self, _: &mavlink_signing::Verified<'_>) {
        self.heard += 1;
    }
}

impl Model {
    /// Above everything that was used under the key in `slot`.
    #[must_use]
    pub const fn mark(&self, slot: KeySlot) -> u64 {
        *slot.of(&self.marks)
    }

    /// The same after a restart, when the clock shows `now`; `None` if the slot has no timestamp left.
    fn restarted(self, slot: KeySlot, now: Timestamp) -> Option<Self> {
        let mut floors = [Timestamp::MAX; 2];
        *slot.of_mut(&mut floors) = Timestamp::from_ticks(self.mark(slot))?;
        Some(Self {
            now,
            floors,
            ..self
        })
    }
}

/// T1, over a restart, from any state: a stamp is given only with a mark above it stored, of the key that it is for, and
/// none below that key's floor. Every stamp after a restart is greater, whatever the clock shows then. When the mark
/// cannot be stored, none is given and nothing has changed.
///
/// # Errors
///
/// Why there was no stamp.
///
/// # Panics
///
/// If the property does not hold.
pub fn stamps(
    slot: KeySlot,
    first: Timestamp,
    keeper: &mut Model,
    after: Timestamp,
) -> Result<(), SignError> {
    let resumed = || Stamper::resume(1, first).in_slot(slot);
    let mut stamper = resumed();
    let before = *keeper;
    let given = keeper.stamp(&mut stamper);
    let other = slot.other();
    assert_eq!(keeper.mark(other), before.mark(other), "another key's");
    match given {
        Ok(stamp) => {
            let expected = first.max(before.now).max(before.floor(slot));
            assert_eq!(stamp.timestamp, expected);
            assert_eq!(stamp.link_id, 1);
            assert!(keeper.mark(slot) > stamp.timestamp.ticks());
            if let Some(mut restarted) = keeper.restarted(slot, after) {
                restarted.broken = false;
                let mut stamper = Stamper::new(1).in_slot(slot);
                let next = restarted.stamp(&mut stamper);
                let next = next.expect("the first is never rejected");
                assert!(next.timestamp > stamp.timestamp);
            }
            Ok(())
        }
        Err(error) => {
            assert_eq!(error, SignError::NotStored);
            assert_eq!(stamper, resumed());
            assert_eq!(*keeper, before);
            Err(error)
        }
    }
}

/// R3, one step from any state: a frame is accepted only with a mark above its stamp stored, of the key that it was
/// signed with, and none below that key's floor. A receiver that starts at the mark, of one stream or of many, rejects
/// it and everything before it. That holds for this stream and for new ones. What is rejected stores nothing and
/// changes nothing. A frame that cannot be remembered is rejected.
///
/// A frame of a former key neither follows the clock nor sets it: it is compared with the time as it is.
///
/// # Errors
///
/// The verdict, where it is a rejection.
///
/// # Panics
///
/// If the property does not hold.
pub fn accepts<P: Profile>(
    used: KeyUse,
    before: Resumed,
    mut keeper: Model,
    stamp: Stamp,
    earlier: Stamp,
    after: Timestamp,
) -> Result<(), VerifyError> {
    let key = &key_memory::key::<P>(FIRST);
    let keys = ring::<P>(used);
    let slot = used.slot;
    let mut receiver = before.replay();
    let untouched = keeper;
    let frame = signed(key, stamp);
    let received = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
    let frame_of_key = keys.authenticate(received).expect("signed with this key");
    assert_eq!(frame_of_key.key(), used);
    let verdict = keeper.admit(&mut receiver, frame_of_key).map(drop);

    let now = if keeper.follows && !used.former {
        stamp.timestamp
    } else {
        keeper.now
    };
    let in_order = before.replay().check(&authentic(&frame, key), now);
    let covered = stamp.timestamp.ticks() < untouched.mark(slot);
    let expected = match in_order {
        Err(error) => Err(error),
        Ok(()) if stamp.timestamp < untouched.floor(slot) => Err(VerifyError::Replayed),
        Ok(()) if keeper.broken && !covered => Err(VerifyError::NotStored),
        Ok(()) => Ok(()),
    };
    assert_eq!(verdict, expected);
    if let Err(error) = verdict {
        assert_eq!(receiver, before.replay());
        assert_eq!(keeper, untouched);
        return Err(error);
    }
    assert!(keeper.mark(slot) > stamp.timestamp.ticks());
    assert!(keeper.mark(slot) >= untouched.mark(slot));
    assert_eq!(keeper.mark(slot.other()), untouched.mark(slot.other()));
    assert_eq!(keeper.heard, untouched.heard + u8::from(!used.former));
    assert_eq!(receiver.last(), Some(stamp.timestamp));
    let Some(restarted) = keeper.restarted(slot, after) else {
        return Ok(());
    };
    let floor = restarted.floor(slot);
    // After a restart, with whatever clock and window: it, or what is not newer than it, comes again.
    if earlier.timestamp <= stamp.timestamp {
        let frame = signed(key, earlier);
        let window = Window {
            past: u64::MAX,
            ahead: u64::MAX,
        };
        let replay = ReplayGuard::resume(earlier.link_id, window, floor);
        rejects(replay, authentic(&frame, key), after);
        let streams = StreamTable::<1>::resume(Links::Any, window, floor);
        rejects(streams, authentic(&frame, key), after);
    }
    Ok(())
}

fn rejects(mut receiver: impl AntiReplay, frame: Authentic<'_>, now: Timestamp) {
    let verdict = receiver.admit(frame, now).map(drop);
    assert_eq!(verdict, Err(VerifyError::Replayed));
}

fn signed<P: Profile>(key: &SigningKey<P>, stamp: Stamp) -> Frame {
    let mut frame = Frame::new(HEARTBEAT, &[]).expect("in every dialect");
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    frame
}

fn authentic<'a, P: Profile>(frame: &'a Frame, key: &SigningKey<P>) -> Authentic<'a> {
    let received = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
    authenticate(received, key).expect("signed with this key")
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_signing::{Hmac, Window};
    use proptest::prelude::*;

    fn at(ticks: u64) -> Timestamp {
        Timestamp::from_ticks(ticks).expect("48 bits")
    }

    const fn slot(b: bool) -> KeySlot {
        if b { KeySlot::B } else { KeySlot::A }
    }

    fn model(now: u64, marks: [u64; 2], floors: [u64; 2], ahead: u8, broken: bool) -> Model {
        Model {
            now: at(now),
            follows: false,
            marks,
            floors: floors.map(at),
            ahead: ahead.into(),
            broken,
            heard: 0,
        }
    }

    proptest! {
        #[test]
        fn t1_restart_random(
            times: [u8; 3],
            marks: [u8; 2],
            floors: [u8; 2],
            ahead: u8,
            broken: bool,
            late: bool,
            b: bool,
        ) {
            let base = if late { Timestamp::MAX.ticks() - 255 } else { 0 };
            let [first, now, after] = times.map(|ticks| base + u64::from(ticks));
            let [marks, floors] = [marks, floors].map(|all| all.map(|it| base + u64::from(it)));
            let mut keeper = model(now, marks, floors, ahead, broken);
            let slot = slot(b);
            let given = stamps(slot, at(first), &mut keeper, at(after));
            let needed = now.max(first).max(*slot.of(&floors)) >= *slot.of(&marks);
            prop_assert_eq!(given.is_err(), broken && needed);
        }

        #[test]
        fn r3_random(
            times: [u8; 4],
            links in [1..3_u8, 1..3_u8],
            marks: [u8; 2],
            floors: [u8; 2],
            ahead: u8,
            flags: [bool; 5],
        ) {
            let [broken, late, follows, b, former] = flags;
            let base = if late { Timestamp::MAX.ticks() - 255 } else { 0 };
            let [first, now, stamp, earlier] = times.map(|ticks| base + u64::from(ticks));
            let window = Window { past: 100, ahead: 100 };
            let before = Resumed { link_id: 1, window, first: at(first) };
            let [stamp, earlier] = [(links[0], stamp), (links[1], earlier)]
                .map(|(link_id, ticks)| Stamp { link_id, timestamp: at(ticks) });
            // Below the floors there is little.
            let floors = floors.map(|it| base + u64::from(it / 4));
            let marks = marks.map(|it| base + u64::from(it));
            let keeper = Model { follows, ..model(now, marks, floors, ahead, broken) };
            let used = KeyUse { slot: slot(b), former };
            for earlier in [stamp, earlier] {
                let _ = accepts::<Hmac>(used, before, keeper, stamp, earlier, at(now));
            }
        }
    }

    #[test]
    fn r3_each_verdict() {
        let verdict = |ticks, mark, broken, former| {
            let before = Resumed {
                link_id: 1,
                window: Window {
                    past: 10,
                    ahead: 10,
                },
                first: at(93),
            };
            let stamp = Stamp {
                link_id: 1,
                timestamp: at(ticks),
            };
            let keeper = Model {
                follows: true,
                ..model(100, [0, mark], [200, 95], 5, broken)
            };
            let used = KeyUse {
                slot: KeySlot::B,
                former,
            };
            accepts::<Hmac>(used, before, keeper, stamp, stamp, at(0))
        };
        for former in [false, true] {
            assert_eq!(verdict(100, 0, false, former), Ok(()));
            assert_eq!(verdict(100, 101, true, former), Ok(()));
            let not_stored = Err(VerifyError::NotStored);
            assert_eq!(verdict(100, 100, true, former), not_stored);
            let replayed = Err(VerifyError::Replayed);
            assert_eq!(verdict(92, 0, true, former), replayed);
            assert_eq!(verdict(94, 0, true, former), replayed, "below the floor");
        }
        assert_eq!(verdict(111, 0, false, false), Ok(()), "it is followed");
        let from_future = Err(VerifyError::FromFuture);
        assert_eq!(verdict(111, 0, false, true), from_future);
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::AnyTag;
    use crate::model::{any_slot, any_stamp, any_timestamp};

    fn any_model() -> Model {
        let marks: [u64; 2] = kani::any();
        kani::assume(marks[0] <= Timestamp::MAX.ticks() + 1);
        kani::assume(marks[1] <= Timestamp::MAX.ticks() + 1);
        Model {
            now: any_timestamp(),
            follows: kani::any(),
            marks,
            floors: [any_timestamp(), any_timestamp()],
            ahead: kani::any(),
            broken: kani::any(),
            heard: 0,
        }
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn t1_restart() {
        let mut keeper = any_model();
        let before = keeper;
        let slot = any_slot();
        let given = stamps(slot, any_timestamp(), &mut keeper, any_timestamp());
        kani::cover!(given.is_ok() && keeper != before, "stored");
        kani::cover!(given.is_ok() && keeper == before, "reserved before");
        kani::cover!(given.is_err(), "not stored");
    }

    fn steps(former: bool) {
        let (before, keeper) = (Resumed::any(), any_model());
        let slot = any_slot();
        let used = KeyUse { slot, former };
        // It may be the same frame again.
        let (stamp, earlier) = (any_stamp(), any_stamp());
        let verdict = accepts::<AnyTag>(used, before, keeper, stamp, earlier, any_timestamp());
        kani::cover!(verdict.is_ok() && earlier == stamp, "the same again");
        kani::cover!(
            verdict.is_ok() && earlier.timestamp < stamp.timestamp,
            "something before it"
        );
        kani::cover!(verdict == Err(VerifyError::NotStored), "not stored");
        kani::cover!(
            verdict == Err(VerifyError::Replayed) && stamp.timestamp >= before.first,
            "below the floor"
        );
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn r3_step() {
        steps(false);
    }

    /// Of a key in whose place another is in use.
    #[kani::proof]
    #[kani::unwind(33)]
    fn r3_former() {
        steps(true);
    }
}
