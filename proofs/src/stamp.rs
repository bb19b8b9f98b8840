//! T1: stamps strictly increase and end.

use mavlink_signing::{SignError, Stamper, Timestamp};

/// T1, from any state a sender can be resumed in: the stamp is for the sender's link, not before
/// `first`, not before the clock, and the smallest such. The next one is greater whatever the clock
/// does. After 2^48 - 1 there is none, and the sender stays at its end.
///
/// Returns the two timestamps that were given.
///
/// # Errors
///
/// [`SignError::TimestampsExhausted`], when the second stamp was rejected.
///
/// # Panics
///
/// If the property does not hold.
pub fn two_stamps(
    link_id: u8,
    first: Timestamp,
    now: [Timestamp; 2],
) -> Result<[Timestamp; 2], SignError> {
    let mut stamper = Stamper::resume(link_id, first);
    let one = stamper.stamp(now[0]).expect("the first is never rejected");
    assert_eq!(one.link_id, link_id);
    assert_eq!(one.timestamp, first.max(now[0]));
    assert!(one.timestamp <= Timestamp::MAX);

    match stamper.stamp(now[1]) {
        Ok(two) => {
            assert_eq!(two.link_id, link_id);
            assert!(two.timestamp > one.timestamp);
            assert!(two.timestamp <= Timestamp::MAX);
            let ticks = two.timestamp.ticks();
            assert!(ticks == now[1].ticks() || ticks == one.timestamp.ticks() + 1);
            assert!(ticks >= now[1].ticks());
            Ok([one.timestamp, two.timestamp])
        }
        Err(error) => {
            assert_eq!(error, SignError::TimestampsExhausted);
            assert_eq!(one.timestamp, Timestamp::MAX);
            assert_eq!(stamper.stamp(now[0]), Err(error), "it stays at its end");
            Err(error)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at(ticks: u64) -> Timestamp {
        Timestamp::from_ticks(ticks).expect("48 bits")
    }

    proptest! {
        #[test]
        fn t1_random(first in 0..100_u64, now in [0..100_u64, 0..100_u64], late: bool) {
            // At the beginning of time, or so close to its end that the stamps run out.
            let base = if late { Timestamp::MAX.ticks() - 100 } else { 0 };
            let _ = two_stamps(1, at(base + first), now.map(|ticks| at(base + ticks)));
        }
    }

    #[test]
    fn t1_edges() {
        let max = Timestamp::MAX.ticks();
        let moments = [0, 1, 2, max - 2, max - 1, max].map(at);
        for first in moments {
            for one in moments {
                for two in moments {
                    let ended = first == at(max) || one == at(max);
                    let given = two_stamps(1, first, [one, two]);
                    assert_eq!(given.is_err(), ended);
                }
            }
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::any_timestamp;

    #[kani::proof]
    #[kani::unwind(9)]
    fn t1_two_stamps() {
        let now = [any_timestamp(), any_timestamp()];
        let given = two_stamps(kani::any(), any_timestamp(), now);
        kani::cover!(given.is_err(), "exhausted");
        kani::cover!(
            given.is_ok_and(|[_, two]| two == Timestamp::MAX),
            "the last stamp of all"
        );
        kani::cover!(given.is_ok() && now[1] < now[0], "a clock that goes back");
        kani::cover!(given.is_ok() && now[1] == now[0], "two stamps in one tick");
    }
}
