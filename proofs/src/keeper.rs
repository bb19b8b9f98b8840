//! T1 and R3 over a restart: what was used before it is not used after it.

use mavlink_signing::{
    AntiReplay, Authentic, Frame, FrameRef, Header, LinkClock, Links, NotStored, Profile,
    ReplayGuard, SignError, SigningKey, Stamp, Stamper, StreamTable, Timestamp, VerifyError,
    Window, authenticate, sign_frame,
};

use crate::model::Resumed;

/// A keeper whose memory is one number. T2 says that the one in flash is as good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Model {
    /// What the clock shows.
    pub now: Timestamp,
    /// The stored mark: above everything that was ever used. One more than [`Timestamp::MAX`] is the last.
    pub mark: u64,
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

    fn reserve(&mut self, stamp: Timestamp) -> Result<(), NotStored> {
        if stamp.ticks() < self.mark {
            return Ok(());
        }
        if self.broken {
            return Err(NotStored);
        }
        self.mark = stamp.ticks() + 1 + u64::from(self.ahead);
        Ok(())
    }

    fn on_accepted(&mut self, _: &mavlink_signing::Verified<'_>) {
        self.heard += 1;
    }
}

impl Model {
    /// Where everything begins after a restart; `None` if nothing is left.
    fn floor(&self) -> Option<Timestamp> {
        Timestamp::from_ticks(self.mark)
    }
}

/// T1, over a restart, from any state: a stamp is given only with a mark above it stored. Every stamp
/// after a restart is greater, whatever the clock shows then. When the mark cannot be stored, none is
/// given and nothing has changed.
///
/// # Errors
///
/// Why there was no stamp.
///
/// # Panics
///
/// If the property does not hold.
pub fn stamps<K: LinkClock>(
    first: Timestamp,
    keeper: &mut K,
    mark: impl Fn(&K) -> u64,
    after: Timestamp,
) -> Result<(), SignError> {
    let mut stamper = Stamper::resume(1, first);
    let (before, now) = (mark(keeper), keeper.now());
    let given = keeper.stamp(&mut stamper);
    match given {
        Ok(stamp) => {
            assert!(stamp.timestamp >= first.max(now));
            assert_eq!(stamp.link_id, 1);
            assert!(mark(keeper) > stamp.timestamp.ticks());
            if let Some(floor) = Timestamp::from_ticks(mark(keeper)) {
                let mut restarted = Stamper::resume(1, floor);
                let next = restarted.stamp(after).expect("the first is never rejected");
                assert!(next.timestamp > stamp.timestamp);
            }
            Ok(())
        }
        Err(error) => {
            assert_eq!(error, SignError::NotStored);
            assert_eq!(stamper, Stamper::resume(1, first));
            assert_eq!(mark(keeper), before);
            Err(error)
        }
    }
}

/// R3, one step from any state: a frame is accepted only with a mark above its stamp stored. A receiver
/// that starts at the mark, of one stream or of many, rejects it and everything before it. That holds
/// for this stream and for new ones. What is rejected stores nothing and changes nothing. A frame that
/// cannot be remembered is rejected.
///
/// # Errors
///
/// The verdict, where it is a rejection.
///
/// # Panics
///
/// If the property does not hold.
pub fn accepts<P: Profile>(
    key: &SigningKey<P>,
    before: Resumed,
    mut keeper: Model,
    stamp: Stamp,
    earlier: Stamp,
    after: Timestamp,
) -> Result<(), VerifyError> {
    let mut receiver = before.replay();
    let untouched = keeper;
    let frame = signed(key, stamp);
    let verdict = keeper
        .admit(&mut receiver, authentic(&frame, key))
        .map(drop);
    match verdict {
        Ok(()) => {
            assert!(keeper.mark > stamp.timestamp.ticks());
            assert!(keeper.mark >= untouched.mark);
            assert_eq!(keeper.heard, untouched.heard + 1);
            assert_eq!(receiver.last(), Some(stamp.timestamp));
        }
        Err(error) => {
            assert_eq!(receiver, before.replay());
            assert_eq!(keeper, untouched);
            let rejected = before.replay().check(&authentic(&frame, key), keeper.now);
            if error == VerifyError::NotStored {
                assert!(keeper.broken && rejected.is_ok());
            } else {
                assert_eq!(rejected, Err(error));
            }
            return Err(error);
        }
    }
    let Some(floor) = keeper.floor() else {
        return Ok(());
    };
    // After a restart, with whatever clock and window: it, and what is not newer than it, comes again.
    for stamp in [stamp, earlier] {
        if stamp.timestamp <= frame_stamp(&frame) {
            let again = signed(key, stamp);
            let window = Window {
                past: u64::MAX,
                ahead: u64::MAX,
            };
            let replay = ReplayGuard::resume(stamp.link_id, window, floor);
            rejects(replay, authentic(&again, key), after);
            let streams = StreamTable::<1>::resume(Links::Any, window, floor);
            rejects(streams, authentic(&again, key), after);
        }
    }
    Ok(())
}

fn rejects(mut receiver: impl AntiReplay, frame: Authentic<'_>, now: Timestamp) {
    let verdict = receiver.admit(frame, now).map(drop);
    assert_eq!(verdict, Err(VerifyError::Replayed));
}

fn signed<P: Profile>(key: &SigningKey<P>, stamp: Stamp) -> Frame {
    let header = Header {
        system_id: stamp.link_id,
        ..crate::model::HEARTBEAT
    };
    let mut frame = Frame::new(header, &[]).expect("in every dialect");
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    frame
}

fn authentic<'a, P: Profile>(frame: &'a Frame, key: &SigningKey<P>) -> Authentic<'a> {
    let received = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
    authenticate(received, key).expect("signed with this key")
}

fn frame_stamp(frame: &Frame) -> Timestamp {
    let frame = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
    frame.signature().expect("signed").stamp.timestamp
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_signing::{Hmac, Window};
    use proptest::prelude::*;

    fn at(ticks: u64) -> Timestamp {
        Timestamp::from_ticks(ticks).expect("48 bits")
    }

    fn model(now: u64, mark: u64, ahead: u8, broken: bool) -> Model {
        Model {
            now: at(now),
            mark,
            ahead: ahead.into(),
            broken,
            heard: 0,
        }
    }

    proptest! {
        #[test]
        fn t1_restart_random(
            times: [u8; 3],
            mark: u8,
            ahead: u8,
            broken: bool,
            late: bool,
        ) {
            let base = if late { Timestamp::MAX.ticks() - 255 } else { 0 };
            let [first, now, after] = times.map(|ticks| base + u64::from(ticks));
            let mut keeper = model(now, base + u64::from(mark), ahead, broken);
            let given = stamps(at(first), &mut keeper, |keeper| keeper.mark, at(after));
            let needed = now.max(first) >= base + u64::from(mark);
            prop_assert_eq!(given.is_err(), broken && needed);
        }

        #[test]
        fn r3_random(
            times: [u8; 4],
            links in [1..3_u8, 1..3_u8],
            mark: u8,
            ahead: u8,
            broken: bool,
            late: bool,
        ) {
            let base = if late { Timestamp::MAX.ticks() - 255 } else { 0 };
            let [first, now, stamp, earlier] = times.map(|ticks| base + u64::from(ticks));
            let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
            let window = Window { past: 100, ahead: 100 };
            let before = Resumed { link_id: 1, window, first: at(first) };
            let [stamp, earlier] = [(links[0], stamp), (links[1], earlier)]
                .map(|(link_id, ticks)| Stamp { link_id, timestamp: at(ticks) });
            let keeper = model(now, base + u64::from(mark), ahead, broken);
            let _ = accepts(&key, before, keeper, stamp, earlier, at(now));
        }
    }

    #[test]
    fn r3_each_verdict() {
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let verdict = |ticks, mark, broken| {
            let before = Resumed {
                link_id: 1,
                window: Window {
                    past: 10,
                    ahead: 10,
                },
                first: at(95),
            };
            let stamp = Stamp {
                link_id: 1,
                timestamp: at(ticks),
            };
            accepts(
                &key,
                before,
                model(100, mark, 5, broken),
                stamp,
                stamp,
                at(0),
            )
        };
        assert_eq!(verdict(100, 0, false), Ok(()));
        assert_eq!(verdict(100, 101, true), Ok(()));
        assert_eq!(verdict(100, 100, true), Err(VerifyError::NotStored));
        assert_eq!(verdict(94, 0, true), Err(VerifyError::Replayed));
        assert_eq!(verdict(111, 0, true), Err(VerifyError::FromFuture));
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::AnyTag;
    use crate::model::{any_stamp, any_timestamp};

    fn any_model() -> Model {
        let mark = kani::any();
        kani::assume(mark <= Timestamp::MAX.ticks() + 1);
        Model {
            now: any_timestamp(),
            mark,
            ahead: kani::any(),
            broken: kani::any(),
            heard: 0,
        }
    }

    #[kani::proof]
    #[kani::unwind(9)]
    fn t1_restart() {
        let mut keeper = any_model();
        let before = keeper;
        let given = stamps(any_timestamp(), &mut keeper, |it| it.mark, any_timestamp());
        kani::cover!(given.is_ok() && keeper.mark > before.mark, "stored");
        kani::cover!(given.is_ok() && keeper == before, "reserved before");
        kani::cover!(given.is_err(), "not stored");
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn r3_step() {
        let key = SigningKey::<AnyTag>::new(&[1; 32]).expect("a key");
        let before = Resumed::any();
        let keeper = any_model();
        let (stamp, earlier) = (any_stamp(), any_stamp());
        let verdict = accepts(&key, before, keeper, stamp, earlier, any_timestamp());
        kani::cover!(verdict.is_ok(), "accepted");
        kani::cover!(
            verdict.is_ok() && earlier.timestamp < stamp.timestamp,
            "something before it"
        );
        kani::cover!(verdict == Err(VerifyError::NotStored), "not stored");
        kani::cover!(verdict == Err(VerifyError::Replayed), "replayed");
    }
}
