//! Clocks that are set, followed, spoofed and forgotten; the whole of a key's change.

use mavlink_signing::{
    Authenticate, Clock, FrameRef, KEY_SIZE, KeyChange, KeyChangeError, KeyError, KeyRing,
    KeyStore, LinkClock, NotStored, RESERVATION, ReplayGuard, RolloverState, Stamper, SyncState,
    TICKS_PER_SECOND, TimeSource, Timestamp, Verified, VerifyError, Window, authenticate,
    system_time,
};

use crate::common::{LINK_ID, NOW, at, key, signed};

const SECOND: u64 = TICKS_PER_SECOND;
const DAY: u64 = 24 * 3600 * SECOND;

/// A clock, the timer that it runs on, and a receiver.
struct End {
    clock: Clock,
    timer: u64,
    receiver: ReplayGuard,
}

impl LinkClock for End {
    fn now(&mut self) -> Timestamp {
        self.clock.now(self.timer)
    }

    fn monotonic(&mut self) -> u64 {
        self.timer
    }

    fn reference_time(&mut self, stamp: Timestamp) -> Timestamp {
        self.clock.reference_time(stamp, self.timer)
    }

    fn on_accepted(&mut self, frame: &Verified<'_>) {
        self.clock.on_accepted(frame, self.timer);
    }
}

impl End {
    /// Without a clock, its mark at [`NOW`], its timer at a number of its own.
    fn new() -> Self {
        let timer = 1_234_567;
        Self {
            clock: Clock::unsynced(at(NOW - RESERVATION), timer),
            timer,
            receiver: ReplayGuard::resume(LINK_ID, Window::ONE_MINUTE, at(NOW)),
        }
    }

    fn synced() -> Self {
        let mut end = Self::new();
        end.clock.update(TimeSource::Trusted, at(NOW), end.timer);
        end
    }

    fn hears(&mut self, ticks: u64) -> Result<(), VerifyError> {
        let frame = signed(&[1], ticks);
        let frame = FrameRef::parse(frame.as_bytes()).expect("whole");
        let authentic = authenticate(frame, &key()).expect("undamaged");
        let mut receiver = ReplayGuard::resume(LINK_ID, self.receiver.window(), Timestamp::ZERO);
        std::mem::swap(&mut receiver, &mut self.receiver);
        let verdict = self.admit(&mut receiver, authentic).map(drop);
        self.receiver = receiver;
        verdict
    }

    fn sync(&self) -> SyncState {
        self.clock.sync(self.timer)
    }

    fn ticks(&self) -> u64 {
        self.clock.now(self.timer).ticks()
    }
}

#[test]
fn a_board_from_the_shed_takes_the_time_of_the_first_frame_above_its_mark() {
    let mut end = End::new();
    assert_eq!(end.sync(), SyncState::Unsynced);
    // What was accepted before the restart is below the mark, and says nothing about the time.
    assert_eq!(end.hears(NOW - 1), Err(VerifyError::Replayed));
    assert_eq!(end.ticks(), NOW - RESERVATION);
    assert_eq!(end.hears(NOW + 7 * DAY), Ok(()));
    assert_eq!(end.ticks(), NOW + 7 * DAY - RESERVATION);
    assert_eq!(
        end.sync(),
        SyncState::Unsynced,
        "nobody trusted has told it"
    );
}

#[test]
fn a_replay_from_the_week_in_the_shed_does_not_lock_anybody_out() {
    let mut end = End::new();
    assert_eq!(end.hears(NOW + 3 * DAY), Ok(()));
    assert_eq!(end.hears(NOW + 7 * DAY), Ok(()));
    assert_eq!(end.hears(NOW + 4 * DAY), Err(VerifyError::Replayed));
    assert_eq!(end.ticks(), NOW + 7 * DAY - RESERVATION);
}

#[test]
fn an_unsynced_clock_stays_within_a_reservation_of_what_it_hears() {
    let mut end = End::new();
    let mut last = NOW + DAY;
    assert_eq!(end.hears(last), Ok(()));
    for (passed, stamp, time) in [
        // The sender skipped a reservation: it takes nobody along.
        (0, 0, -10),
        (5, 4, -9),
        (30, 5, 10),
        (3, 3, 10),
        (1, 60, -10),
        (1000, 1, 10),
    ] {
        end.timer += passed * SECOND;
        last += stamp * SECOND + 1;
        assert_eq!(end.hears(last), Ok(()));
        let off = end.ticks() as i64 - last as i64;
        assert_eq!(
            (off as f64 / SECOND as f64).round() as i64,
            time,
            "{passed} {stamp}"
        );
    }
}

#[test]
fn a_trusted_clock_rejects_the_future_and_is_not_moved_by_it() {
    let mut end = End::synced();
    assert_eq!(
        end.hears(NOW + Window::ONE_MINUTE.ahead + 1),
        Err(VerifyError::FromFuture)
    );
    assert_eq!(end.ticks(), NOW);
    assert_eq!(end.hears(NOW + Window::ONE_MINUTE.ahead), Ok(()));
    assert_eq!(
        end.ticks(),
        NOW,
        "no time has passed in which it could have drifted"
    );
    assert_eq!(end.sync(), SyncState::Synced);
}

#[test]
fn frames_in_the_window_slew_a_clock_as_far_as_a_crystal_drifts() {
    for ahead in [30 * SECOND as i64, -30 * SECOND as i64] {
        let mut end = End::synced();
        let start = end.timer;
        let mut moved = 0;
        for minute in 1..=60_u64 {
            end.timer = start + minute * 60 * SECOND;
            let expected = NOW + minute * 60 * SECOND;
            let before = end.ticks();
            assert_eq!(end.hears(expected.saturating_add_signed(ahead)), Ok(()));
            moved += before.abs_diff(end.ticks());
            let off = end.ticks() as i64 - expected as i64;
            assert_eq!(off.signum(), ahead.signum());
            assert!(off.unsigned_abs() <= (minute * 60 * SECOND) >> Clock::CRYSTAL);
        }
        assert_eq!(moved, (3600 * SECOND) >> Clock::CRYSTAL);
    }
}

#[test]
fn trusted_sources_set_a_clock_either_way() {
    let mut end = End::new();
    for told in [NOW + DAY, NOW - DAY] {
        end.clock.update(TimeSource::Trusted, at(told), end.timer);
        assert_eq!((end.sync(), end.ticks()), (SyncState::Synced, told));
    }
    // SETUP_SIGNING without a timestamp.
    end.clock
        .update(TimeSource::Trusted, Timestamp::ZERO, end.timer);
    assert_eq!(end.ticks(), NOW - DAY);
}

#[test]
fn a_spoofed_receiver_moves_a_clock_by_little_and_never_back() {
    for mut end in [End::new(), End::synced()] {
        let (sync, start) = (end.sync(), end.ticks());
        assert_eq!(
            end.clock
                .update(TimeSource::Bounded, Timestamp::ZERO, end.timer),
            0
        );
        assert_eq!(end.ticks(), start);
        let moved: u64 = (0..1000)
            .map(|_| {
                end.clock
                    .update(TimeSource::Bounded, at(NOW + 3650 * DAY), end.timer)
            })
            .sum();
        assert_eq!((moved, end.ticks()), (SECOND, start + SECOND));
        assert_eq!(end.sync(), sync, "and does not sync it");
        end.timer += 3600 * SECOND;
        assert_eq!(
            end.clock
                .update(TimeSource::Bounded, at(NOW + 3650 * DAY), end.timer),
            0
        );
        assert_eq!(end.ticks(), start + 3601 * SECOND);
    }
}

#[test]
fn a_clock_is_believed_for_its_holdover() {
    let mut end = End::synced();
    assert_eq!(end.clock.holdover() / SECOND, 30_720);
    end.timer += end.clock.holdover();
    assert_eq!(end.sync(), SyncState::Synced);
    assert_eq!(end.hears(NOW + 2 * DAY), Err(VerifyError::FromFuture));
    end.timer += 1;
    assert_eq!(end.sync(), SyncState::Unsynced);
    assert_eq!(end.hears(NOW + 2 * DAY), Ok(()));
    assert_eq!(end.ticks(), NOW + 2 * DAY - RESERVATION);

    // Frames of peers do not prolong it. A worse timer is believed for less long.
    let mut end = End::synced();
    end.clock = end.clock.drifting(6);
    assert_eq!(end.clock.holdover() / SECOND, 480);
    end.timer += 450 * SECOND;
    assert_eq!(end.hears(NOW + 450 * SECOND), Ok(()));
    assert_eq!(end.sync(), SyncState::Synced);
    end.timer += 450 * SECOND;
    assert_eq!(end.sync(), SyncState::Unsynced);
}

#[test]
fn a_frame_takes_an_unsynced_clock_so_far_and_no_further() {
    let mut end = End::new();
    let now = end.ticks();
    let most = now + Clock::MAX_STEP + Window::ONE_MINUTE.ahead;
    assert_eq!(end.hears(most + 1), Err(VerifyError::FromFuture));
    assert_eq!(end.ticks(), now);
    assert_eq!(end.hears(most), Ok(()));
    assert_eq!(end.ticks(), most - RESERVATION);

    // A clock that was never told the time, nor heard it, has nothing to count from.
    let mut end = End::new();
    let reference = |clock: &Clock, stamp, timer| clock.reference_time(stamp, timer);
    for begun in [0, Clock::RELEASE.ticks() - 1] {
        end.clock = Clock::unsynced(at(begun), end.timer);
        assert_eq!(reference(&end.clock, at(NOW), end.timer), at(NOW));
        let last = reference(&end.clock, Timestamp::MAX, end.timer);
        assert_eq!(last, Clock::CEILING);
    }
    end.clock = Clock::unsynced(Clock::RELEASE, end.timer);
    let last = Clock::RELEASE.saturating_add(Clock::MAX_STEP);
    assert_eq!(
        reference(&end.clock, at(NOW + DAY), end.timer),
        last.min(at(NOW + DAY))
    );
    assert_eq!(reference(&end.clock, Timestamp::MAX, end.timer), last);
}

/// However many frames: the sum is bounded, and grows with the time that passes alone.
#[test]
fn many_frames_take_an_unsynced_clock_no_further_than_one() {
    for mut end in [End::new(), End::synced()] {
        end.timer += end.clock.holdover() + 1;
        let first = end.ticks();
        let mut stamp = first;
        for _ in 0..100 {
            stamp += 30 * DAY;
            let _ = end.hears(stamp);
        }
        assert!(end.ticks() <= first + Clock::MAX_STEP + Window::ONE_MINUTE.ahead);
        assert!(end.ticks() >= first + 300 * DAY);
        end.timer += 60 * DAY;
        assert_eq!(end.hears(first + Clock::MAX_STEP + 59 * DAY), Ok(()));
    }
    // Nor beyond the ceiling, from wherever.
    let mut end = End::new();
    end.clock = Clock::unsynced(Timestamp::ZERO, end.timer);
    assert_eq!(
        end.hears(Timestamp::MAX.ticks()),
        Err(VerifyError::FromFuture)
    );
    let last = Clock::CEILING.ticks() + Window::ONE_MINUTE.ahead;
    assert_eq!(end.hears(last + 1), Err(VerifyError::FromFuture));
    assert_eq!(end.hears(last), Ok(()));
    let told = end
        .clock
        .update(TimeSource::Trusted, Timestamp::MAX, end.timer);
    assert_eq!((told, end.sync()), (0, SyncState::Unsynced));
}

/// A new key begins anew where it was said, whatever peers did to the clock before.
#[test]
fn a_new_key_frees_a_clock_that_was_led_away() {
    let mut end = End::new();
    assert_eq!(end.hears(NOW + 300 * DAY), Ok(()));
    for nonsense in [Timestamp::ZERO, at(123_456_789), Timestamp::MAX] {
        end.clock.begin(nonsense, end.timer);
        assert_eq!(end.ticks(), NOW + 300 * DAY - RESERVATION);
    }
    end.clock.begin(at(NOW), end.timer);
    assert_eq!((end.ticks(), end.sync()), (NOW, SyncState::Unsynced));
    let mut end = End::synced();
    end.clock.begin(at(NOW + DAY), end.timer);
    assert_eq!(end.ticks(), NOW, "it knows better");
}

#[test]
fn frames_give_a_spoofed_receiver_no_new_steps() {
    let mut end = End::new();
    for minute in 0..10 {
        let stamp = NOW + minute * 60 * SECOND;
        assert_eq!(end.hears(stamp), Ok(()));
        end.clock
            .update(TimeSource::Bounded, Timestamp::MAX, end.timer);
        assert!(end.ticks() <= stamp + SECOND + RESERVATION);
        let moved = end
            .clock
            .update(TimeSource::Bounded, Timestamp::MAX, end.timer);
        assert_eq!(moved, 0);
    }
    let moved = end
        .clock
        .update(TimeSource::Bounded, Timestamp::MAX, end.timer);
    assert_eq!(moved, 0);
}

#[test]
fn ten_minutes_of_silence_then_a_command() {
    let mut stamper = Stamper::new(LINK_ID);
    let mut end = End::synced();
    for seconds in [0, 600] {
        end.timer += seconds * SECOND;
        let now = end.ticks();
        let stamp = stamper.stamp(at(now)).expect("not used up");
        assert_eq!(end.hears(stamp.timestamp.ticks()), Ok(()));
    }
}

#[test]
fn a_burst_is_in_the_window() {
    let mut end = End::synced();
    let mut stamper = Stamper::new(LINK_ID);
    for _ in 0..1000 {
        let stamp = stamper.stamp(at(NOW)).expect("not used up");
        assert_eq!(end.hears(stamp.timestamp.ticks()), Ok(()));
    }
}

#[test]
fn seconds_since_1970() {
    let micros = |seconds: u64| Timestamp::from_unix_micros(seconds.saturating_mul(1_000_000));
    let first = 1_420_070_400;
    let last = first + Timestamp::MAX.ticks() / SECOND;
    for seconds in [0, first - 1, first, first + 1, last - 1, last, last + 1] {
        assert_eq!(Timestamp::from_unix_seconds(seconds), micros(seconds));
    }
    assert_eq!(Timestamp::from_unix_seconds(first), Some(Timestamp::ZERO));
    assert_eq!(Timestamp::from_unix_seconds(first - 1), None);
    assert!(Timestamp::from_unix_seconds(last).is_some());
    assert_eq!(Timestamp::from_unix_seconds(last + 1), None);
    assert_eq!(Timestamp::from_unix_seconds(u64::MAX), None);
}

#[test]
fn system_time_is_microseconds_since_1970() {
    let mut payload = [0; 12];
    payload[..8].copy_from_slice(&at(NOW).unix_micros().to_le_bytes());
    assert_eq!(system_time(&payload), Some(at(NOW)));
    assert_eq!(system_time(&payload[..8]), Some(at(NOW)), "zeros are cut");
    assert_eq!(system_time(&[0]), None, "the sender does not know");
    assert_eq!(system_time(&[&payload[..], &[0]].concat()), None);
}

/// Stores everything, or nothing.
struct Slots {
    broken: bool,
    changes: u32,
}

impl KeyStore for Slots {
    fn store(&mut self, _: KeyChange<'_>) -> Result<(), NotStored> {
        if self.broken {
            return Err(NotStored);
        }
        self.changes += 1;
        Ok(())
    }
}

/// Which of the keys [1; 32] to [9; 32] signs, and which are accepted.
fn used(keys: &KeyRing<mavlink_signing::Hmac>) -> (Vec<u8>, Vec<u8>) {
    use mavlink_signing::{Hmac, SigningKey, Stamp, sign_frame};
    let key = |number: u8| SigningKey::<Hmac>::new(&[number; KEY_SIZE]).expect("a key");
    let frame = |key: &SigningKey<Hmac>| {
        let mut frame = crate::common::unsigned(0, &[1]);
        let stamp = Stamp {
            link_id: LINK_ID,
            timestamp: at(NOW),
        };
        sign_frame(&mut frame, key, stamp).expect("unsigned");
        frame
    };
    let ours = frame(keys.signing());
    let ours = FrameRef::parse(ours.as_bytes()).expect("whole");
    let signs = (1..10).filter(|number| authenticate(ours, &key(*number)).is_ok());
    let accepts = (1..10).filter(|number| {
        let theirs = frame(&key(*number));
        let theirs = FrameRef::parse(theirs.as_bytes()).expect("whole");
        keys.authenticate(theirs).is_ok()
    });
    (signs.collect(), accepts.collect())
}

fn keys(number: u8) -> KeyRing<mavlink_signing::Hmac> {
    mavlink_signing::SigningKey::new(&[number; KEY_SIZE])
        .expect("a key")
        .into()
}

#[test]
fn who_offers_a_key_signs_with_the_old_one_and_who_takes_it_over_with_the_new_one() {
    let mut store = Slots {
        broken: false,
        changes: 0,
    };
    let (mut ours, mut theirs) = (keys(1), keys(1));
    ours.offer(&[2; KEY_SIZE], &mut store).expect("offered");
    assert_eq!(used(&ours), (vec![1], vec![1, 2]));
    theirs.apply(&[2; KEY_SIZE], &mut store).expect("applied");
    assert_eq!(used(&theirs), (vec![2], vec![1, 2]));
    // Both again: SETUP_SIGNING may be lost.
    ours.offer(&[2; KEY_SIZE], &mut store).expect("offered");
    theirs.apply(&[2; KEY_SIZE], &mut store).expect("applied");
    assert_eq!(store.changes, 2);
    for keys in [&mut ours, &mut theirs] {
        assert_eq!(keys.retire(&mut store), Err(KeyChangeError::NotConfirmed));
        keys.confirm(&mut store).expect("nothing to do");
        assert_eq!(keys.retire(&mut store), Err(KeyChangeError::NotConfirmed));
    }
    assert_eq!(store.changes, 2);
}

#[test]
fn two_ends_that_both_offer_a_key_do_not_wait_for_each_other() {
    let mut store = Slots {
        broken: false,
        changes: 0,
    };
    let (mut ours, mut theirs) = (keys(1), keys(1));
    for keys in [&mut ours, &mut theirs] {
        keys.offer(&[2; KEY_SIZE], &mut store).expect("offered");
    }
    store.broken = true;
    let not_stored = theirs.apply(&[2; KEY_SIZE], &mut store);
    assert_eq!(not_stored, Err(KeyChangeError::NotStored));
    assert_eq!(theirs.rollover_state(), RolloverState::Offered);
    store.broken = false;
    theirs.apply(&[2; KEY_SIZE], &mut store).expect("applied");
    assert_eq!(theirs.rollover_state(), RolloverState::Applied);
    assert_eq!(used(&theirs), (vec![2], vec![1, 2]));
    assert_eq!(store.changes, 3);
}

#[test]
fn a_confirmed_key_is_not_confirmed_again() {
    let mut store = Slots {
        broken: false,
        changes: 0,
    };
    let mut keys = keys(2);
    let new = signed(&[1], NOW);
    // The key of the frames in these tests.
    keys.apply(&crate::common::KEY, &mut store)
        .expect("applied");
    for heard in [true, false] {
        let frame = FrameRef::parse(new.as_bytes()).expect("whole");
        let authentic = keys.authenticate(frame).expect("signed with it");
        let mut receiver = ReplayGuard::new(LINK_ID, Window::ONE_MINUTE);
        let verified = receiver.admit(authentic, at(NOW)).expect("new");
        keys.on_accepted(&verified);
        assert_eq!(keys.confirm_pending(), heard);
        keys.confirm(&mut store).expect("stored");
        assert_eq!(keys.rollover_state(), RolloverState::Confirmed);
    }
    assert_eq!(store.changes, 2);
}

#[test]
fn a_rejected_key_changes_nothing() {
    let mut store = Slots {
        broken: false,
        changes: 0,
    };
    let zero = Err(KeyChangeError::Key(KeyError::AllZero));
    let mut keys = keys(1);
    assert_eq!(keys.offer(&[0; KEY_SIZE], &mut store), zero);
    assert_eq!(keys.apply(&[0; KEY_SIZE], &mut store), zero);
    assert_eq!(keys.withdraw(&mut store), Err(KeyChangeError::NotOffered));
    store.broken = true;
    let not_stored = Err(KeyChangeError::NotStored);
    assert_eq!(keys.offer(&[2; KEY_SIZE], &mut store), not_stored);
    assert_eq!(keys.apply(&[2; KEY_SIZE], &mut store), not_stored);
    assert_eq!(used(&keys), (vec![1], vec![1]));
    assert_eq!(keys.rollover_state(), RolloverState::Settled);

    store.broken = false;
    keys.offer(&[2; KEY_SIZE], &mut store).expect("offered");
    let under_way = Err(KeyChangeError::UnderWay);
    assert_eq!(keys.offer(&[3; KEY_SIZE], &mut store), under_way);
    assert_eq!(keys.apply(&[3; KEY_SIZE], &mut store), under_way);
    assert_eq!(used(&keys), (vec![1], vec![1, 2]));
    keys.withdraw(&mut store).expect("withdrawn");
    assert_eq!(used(&keys), (vec![1], vec![1]));
}

#[test]
fn the_old_key_again_takes_back_a_key_that_was_never_heard() {
    let mut store = Slots {
        broken: false,
        changes: 0,
    };
    let mut keys = keys(1);
    keys.apply(&[2; KEY_SIZE], &mut store).expect("applied");
    let third = keys.apply(&[3; KEY_SIZE], &mut store);
    assert_eq!(third, Err(KeyChangeError::UnderWay));
    assert_eq!(used(&keys), (vec![2], vec![1, 2]));
    keys.apply(&[1; KEY_SIZE], &mut store).expect("taken back");
    assert_eq!(used(&keys), (vec![1], vec![1]));
    assert_eq!(format!("{keys:?}"), "KeyRing { phase: Settled, .. }");
}
