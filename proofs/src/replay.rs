//! R1: accepted timestamps strictly increase.

use mavlink_signing::{
    AntiReplay, Frame, FrameRef, Profile, SigningKey, Stamp, Timestamp, VerifyError, authenticate,
    sign_frame,
};

use crate::model::HEARTBEAT;
use crate::model::Resumed;

/// R1, one step from any state: an authentic frame is accepted only for this link, inside the window and
/// later than the last accepted one. It is then the last, and the same frame is rejected the next time.
/// What is rejected changes nothing.
/// Of another link is all that the receiver says it rejects of its own end's.
///
/// Every history is a sequence of such steps, so accepted timestamps strictly increase in every
/// history.
///
/// # Errors
///
/// The verdict, where it is a rejection.
///
/// # Panics
///
/// If the property does not hold.
pub fn step<P: Profile>(
    key: &SigningKey<P>,
    before: Resumed,
    stamp: Stamp,
    now: Timestamp,
) -> Result<(), VerifyError> {
    let mut frame = Frame::new(HEARTBEAT, &[]).expect("in every dialect");
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    let received = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
    let authentic = || authenticate(received, key).expect("signed with this key");

    let mut after = before.replay();
    let verdict = after.admit(authentic(), now).map(drop);
    let (ticks, now_ticks) = (stamp.timestamp.ticks(), now.ticks());
    if verdict.is_ok() {
        assert_eq!(stamp.link_id, before.link_id);
        assert!(stamp.timestamp >= before.first, "newer than the last");
        assert!(ticks <= now_ticks.saturating_add(before.window.ahead));
        assert!(ticks >= now_ticks.saturating_sub(before.window.past));
        assert_eq!(after.last(), Some(stamp.timestamp));

        let again = after.admit(authentic(), now).err();
        assert_eq!(again, Some(VerifyError::Replayed));
        assert_eq!(after.last(), Some(stamp.timestamp));
    } else {
        assert_eq!(after, before.replay());
    }
    // What this end sends itself is one of these frames, when it comes back.
    let rejects_own = AntiReplay::rejects_own(&after, stamp.link_id);
    assert_eq!(rejects_own, stamp.link_id != before.link_id);
    assert!(!rejects_own || verdict.is_err());
    assert_eq!(after.link_id(), before.link_id);
    assert_eq!(after.window(), before.window);
    verdict
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_signing::{Hmac, Window};
    use proptest::prelude::*;

    fn check(first: u64, link_id: u8, window: Window, stamp: u64, now: u64) {
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let at = |ticks| Timestamp::from_ticks(ticks).expect("48 bits");
        let stamp = Stamp {
            link_id,
            timestamp: at(stamp),
        };
        let before = Resumed {
            link_id: 1,
            window,
            first: at(first),
        };
        let _ = step(&key, before, stamp, at(now));
    }

    proptest! {
        #[test]
        fn r1_random(
            times: [u8; 3],
            link_id in 0..3_u8,
            past in 0..200_u64,
            ahead in 0..200_u64,
        ) {
            let [first, stamp, now] = times.map(u64::from);
            check(first, link_id, Window { past, ahead }, stamp, now);
        }
    }

    #[test]
    fn r1_edges() {
        let max = Timestamp::MAX.ticks();
        let moments = [0, 1, 999_999, 1_000_000, 1_000_001, max - 1, max];
        for first in moments {
            for stamp in moments {
                for now in moments {
                    check(first, 1, Window::STRICT, stamp, now);
                    let all = Window {
                        past: u64::MAX,
                        ahead: u64::MAX,
                    };
                    check(first, 1, all, stamp, now);
                }
            }
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::{AnyTag, any_stamp, any_timestamp};

    #[kani::proof]
    #[kani::unwind(33)]
    fn r1_step() {
        let key = SigningKey::<AnyTag>::new(&[1; 32]).expect("a key");
        let before = Resumed::any();
        let stamp = any_stamp();
        let now = any_timestamp();
        let verdict = step(&key, before, stamp, now);
        kani::cover!(verdict.is_ok(), "accepted");
        kani::cover!(
            verdict.is_ok() && stamp.timestamp == Timestamp::MAX,
            "the last of all"
        );
        kani::cover!(verdict == Err(VerifyError::Replayed), "replayed");
        kani::cover!(verdict == Err(VerifyError::TooOld), "too old");
        kani::cover!(verdict == Err(VerifyError::FromFuture), "from the future");
    }
}
