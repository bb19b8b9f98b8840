//! Packages that overtake one another, and counters that are passed over.

use mavlink_commsec::{
    AesGcm, EpochCounter, EpochHeader, EpochSenderId, MAX_PASSED_OVER, OpenError, Opener, Package,
    REORDER_WINDOW, Sealer, SealingKey, SenderId,
};

use crate::common::{assert_rejected, hex, key};
use crate::vectors::{BASE_KEY, BASE_SALT};

const FIVE: SenderId = SenderId(5);

/// The package with this counter.
fn package(counter: u32) -> Package {
    let key = key(BASE_KEY, BASE_SALT);
    let mut sealer: Sealer = Sealer::resume(key, FIVE, counter);
    sealer.seal(&[3; 80]).expect("a counter is left")
}

/// A receiver that has heard everything up to `last`.
fn opener(last: u32) -> Opener<1> {
    let mut opener = Opener::new();
    let resumed = opener.resume(key(BASE_KEY, BASE_SALT), &[(FIVE, last)]);
    resumed.expect("there is room");
    opener
}

fn opens(opener: &mut Opener<1>, counter: u32) -> bool {
    let [(_, last)] = opener.senders().collect::<Vec<_>>()[..] else {
        panic!("one sender")
    };
    match opener.open(package(counter).as_bytes()) {
        Ok(opened) => {
            assert_eq!(opened.counter(), counter);
            true
        }
        Err(error) => {
            assert_eq!(error, OpenError::Stale { counter, last });
            false
        }
    }
}

/// Each counter behind the newest, once, up to 64 of them.
#[test]
fn each_place_behind_the_newest() {
    for place in 1..=REORDER_WINDOW + 3 {
        let mut opener = opener(1000);
        assert!(opens(&mut opener, 1100));
        let accepted = place <= REORDER_WINDOW;
        assert_eq!(opens(&mut opener, 1100 - place), accepted, "{place} behind");
        let behind = 1_u64.checked_shl(place - 1).unwrap_or(0);
        assert_eq!(opener.behind(FIVE), Some(behind));
        assert!(!opens(&mut opener, 1100 - place), "{place} behind, again");
        assert!(!opens(&mut opener, 1100));
    }
    assert_eq!(opener(0).behind(SenderId(6)), None);
    assert_eq!(opener(0).passed_over(SenderId(6)), None);
}

/// After a jump of any length what was accepted before it is known, and the rest still comes.
#[test]
fn each_jump() {
    for jump in 1..=REORDER_WINDOW + 3 {
        let mut opener = opener(1000);
        for counter in [1101, 1103] {
            assert!(opens(&mut opener, counter));
        }
        let newest = 1103 + jump;
        assert!(opens(&mut opener, newest));
        for counter in 1030..=newest {
            let seen = [1101, 1103, newest].contains(&counter);
            let fresh = !seen && newest - counter <= REORDER_WINDOW;
            assert_eq!(opens(&mut opener, counter), fresh, "jump {jump}, {counter}");
        }
    }
}

/// What a receiver was resumed with stays rejected, also when it comes to lie in the window.
#[test]
fn nothing_below_the_mark() {
    for last in [0, 1, 40, 63, 64, 65, 200] {
        let mut opener = opener(last);
        assert!(opens(&mut opener, last + 60));
        for counter in 1..=last + 60 {
            let fresh = counter > last && counter < last + 60;
            assert_eq!(opens(&mut opener, counter), fresh, "{counter} after {last}");
        }
    }
}

/// A forged package sets no bit.
#[test]
fn a_wrong_tag_changes_nothing() {
    let mut opener = opener(0);
    assert!(opens(&mut opener, 50));
    let mut forged = *package(45).as_bytes();
    forged[90] ^= 1;
    let before = opener.behind(FIVE);
    assert_rejected(&mut opener, &forged, OpenError::BadTag);
    assert_eq!(opener.behind(FIVE), before);
    assert!(opens(&mut opener, 45));
}

/// In a new epoch the window begins anew; older epochs are over.
#[test]
fn the_window_is_within_an_epoch() {
    let key = || SealingKey::new(&hex(BASE_KEY), BASE_SALT).expect("a key");
    let id = EpochSenderId(5);
    let sealed = |epoch: u64, count: usize| -> Vec<Package> {
        let mut sealer: Sealer<AesGcm, EpochHeader> = Sealer::begin(key(), id, epoch).expect("one");
        let packages = (0..count).map(|_| sealer.seal(&[1; 80]).expect("a counter is left"));
        packages.collect()
    };
    let (old, new) = (sealed(3, 5), sealed(4, 70));
    let mut opener = Opener::<1, AesGcm, EpochHeader>::new();
    let last = EpochCounter {
        epoch: 3,
        counter: 2,
    };
    opener.resume(key(), &[(id, last)]).expect("room");
    let mut opens = |package: &Package| opener.open(package.as_bytes()).is_ok();
    assert!(opens(&old[4]) && opens(&old[3]) && !opens(&old[3]));
    assert!(!opens(&old[1]));
    assert!(opens(&new[69]));
    assert!(!opens(&old[2]));
    for (at, package) in new.iter().enumerate() {
        assert_eq!(opens(package), at != 69 && at >= 5, "{at}");
    }
    // 69 were passed over in the new epoch, which counts as 2^16; 2 in the old one.
    assert_eq!(opener.passed_over(id), Some((1 << 16) + 69 + 2));
}

/// Whoever has the key takes 2^26 counters away, and no more; what is rejected changes nothing.
#[test]
fn jumps_are_bounded_in_sum() {
    let mut opener = opener(0);
    let far = MAX_PASSED_OVER + 2;
    for counter in [far, u32::MAX - 1] {
        assert_rejected(
            &mut opener,
            package(counter).as_bytes(),
            OpenError::JumpTooFar(FIVE),
        );
    }
    assert!(opens(&mut opener, 1));
    assert_eq!(opener.passed_over(FIVE), Some(0));
    let half = MAX_PASSED_OVER / 2;
    assert!(opens(&mut opener, half));
    assert_eq!(opener.passed_over(FIVE), Some(half - 2));
    // The rest, but for one.
    let rest = MAX_PASSED_OVER - (half - 2);
    assert_rejected(
        &mut opener,
        package(half + rest + 2).as_bytes(),
        OpenError::JumpTooFar(FIVE),
    );
    assert!(opens(&mut opener, half + rest + 1));
    assert_eq!(opener.passed_over(FIVE), Some(MAX_PASSED_OVER));
    // From now on each counter must come, in any order.
    let next = half + rest + 2;
    assert!(opens(&mut opener, next));
    assert!(opener.open(package(next + 2).as_bytes()).is_err());
    assert!(opens(&mut opener, next + 1));
    assert!(opens(&mut opener, next + 2));
}

/// Starts of a sender that nobody heard count, too.
#[test]
fn epochs_passed_over_are_bounded() {
    let key = || SealingKey::new(&hex(BASE_KEY), BASE_SALT).expect("a key");
    let id = EpochSenderId(5);
    let mut opener = Opener::<1, AesGcm, EpochHeader>::new();
    opener.permit(key(), &[id]).expect("room");
    for (epoch, accepted) in [(1025, false), (1024, true), (1025, false)] {
        let mut sealer: Sealer<AesGcm, EpochHeader> = Sealer::begin(key(), id, epoch).expect("one");
        let package = sealer.seal(&[1; 80]).expect("a counter is left");
        let error = opener.open(package.as_bytes()).err();
        let jump = OpenError::JumpTooFar(SenderId(5));
        assert_eq!(error, (!accepted).then_some(jump), "{epoch}");
    }
}

/// Counters that follow a clock: what lies outside is rejected, with the same package accepted when its time has come.
#[test]
fn only_what_a_clock_can_have() {
    let mut opener = opener(0);
    let far = 3 * MAX_PASSED_OVER;
    let now = |counter: u32| counter - 10..=counter + 10;
    let package = package(far);
    let mut at = |counter| {
        let opened = opener.open_between(package.as_bytes(), now(counter));
        opened.map(|opened| opened.counter())
    };
    assert_eq!(at(far + 11), Err(OpenError::TooOld(FIVE)));
    assert_eq!(at(far - 11), Err(OpenError::FromFuture(FIVE)));
    assert_eq!(at(far - 10), Ok(far));
    let stale = OpenError::Stale {
        counter: far,
        last: far,
    };
    assert_eq!(at(far), Err(stale));
    assert_eq!(opener.passed_over(FIVE), Some(0));
    assert_eq!(opener.failed_opens(FIVE), Some(0));
    // Either edge, behind the newest too.
    let mut opener = self::opener(0);
    for (counter, at) in [(far, far + 10), (far - 20, far - 10)] {
        let package = self::package(counter);
        assert!(opener.open_between(package.as_bytes(), now(at)).is_ok());
    }
}

/// A limit that is set later counts what was before.
#[test]
fn the_limit_can_be_set() {
    let mut opener = opener(0);
    let mut forged = *package(45).as_bytes();
    forged[90] ^= 1;
    assert_rejected(&mut opener, &forged, OpenError::BadTag);
    opener.set_limit(1);
    assert_rejected(&mut opener, &forged, OpenError::IntegrityLimitReached);
    opener.set_limit(2);
    assert_rejected(&mut opener, &forged, OpenError::BadTag);
}
