//! R1: accepted timestamps strictly increase.

use mavlink_signing::{
    Frame, FrameRef, Profile, SigningKey, Stamp, Timestamp, VerifyError, authenticate, sign_frame,
};

use crate::HEARTBEAT;
use crate::model::Resumed;

/// R1, one step from any state: an authentic frame is accepted only for this link, inside the
/// window and later than the last accepted one, and is then the last; the same frame is rejected
/// the next time; what is rejected changes nothing.
///
/// Every history is a sequence of such steps, so accepted timestamps strictly increase in every
/// history.
///
/// # Panics
///
/// If the property does not hold.
pub fn step<P: Profile>(key: &SigningKey<P>, before: Resumed, stamp: Stamp, now: Timestamp) {
    let mut frame = Frame::new(HEARTBEAT, &[]).expect("in every dialect");
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    let received = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
    let authentic = || authenticate(received, key).expect("signed with this key");

    let mut after = before.replay();
    let accepted = after.admit(authentic(), now).is_ok();
    let (ticks, now_ticks) = (stamp.timestamp.ticks(), now.ticks());
    if accepted {
        assert_eq!(stamp.link_id, before.link_id);
        assert!(
            before
                .replay()
                .last()
                .is_none_or(|last| ticks > last.ticks())
        );
        assert!(ticks <= now_ticks.saturating_add(before.window.ahead));
        assert!(ticks >= now_ticks.saturating_sub(before.window.past));
        assert_eq!(after.last(), Some(stamp.timestamp));

        let again = after.admit(authentic(), now).err();
        assert_eq!(again, Some(VerifyError::Replayed));
        assert_eq!(after.last(), Some(stamp.timestamp));
    } else {
        assert_eq!(after, before.replay());
    }
    assert_eq!(after.link_id(), before.link_id);
    assert_eq!(after.window(), before.window);
}

/// Any timestamp there is.
#[cfg(kani)]
pub(crate) fn any_timestamp() -> Timestamp {
    Timestamp::from_wire(kani::any())
}

/// Any link and any timestamp.
#[cfg(kani)]
pub(crate) fn any_stamp() -> Stamp {
    Stamp {
        link_id: kani::any(),
        timestamp: any_timestamp(),
    }
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
        step(&key, before, stamp, at(now));
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
    use crate::model::AnyTag;

    #[kani::proof]
    #[kani::unwind(33)]
    fn r1_step() {
        let key = SigningKey::<AnyTag>::new(&[1; 32]).expect("a key");
        let before = Resumed::any();
        let stamp = any_stamp();
        let now = any_timestamp();
        kani::cover!(
            stamp.link_id == before.link_id && stamp.timestamp == now,
            "likely accepted"
        );
        kani::cover!(before.first > stamp.timestamp, "a replay");
        step(&key, before, stamp, now);
    }
}
