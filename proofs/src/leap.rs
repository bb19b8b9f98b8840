//! D3: how far a clock can be taken: by frames never beyond its limit, which does not move with them.

use mavlink_signing::{
    Clock, Frame, FrameRef, Profile, RESERVATION, ReplayGuard, SigningKey, Stamp, SyncState,
    TimeSource, Timestamp, VerifyError, Window, authenticate, sign_frame,
};

use crate::model::HEARTBEAT;

/// What may happen to a clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// An authentic frame arrives that is newer than all before.
    Frame(Timestamp),
    /// A source tells the time.
    Told(TimeSource, Timestamp),
    /// A new key begins at this timestamp.
    Begin(Timestamp),
    /// The newest key comes again with this one.
    Again(Timestamp),
}

/// What is known of a clock, without what it shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Known {
    /// Where it began, or was set, and what the timer showed then.
    pub anchor: (Timestamp, u64),
    /// What the timer showed when it began or was set, and whether a trusted source set it.
    pub set: (u64, bool),
    /// How far bounded sources have moved it since, and peers while it knew the time.
    pub moved: [u64; 2],
    /// Its timer is wrong by one tick in 2^`drift`, at most 2^32.
    pub drift: u32,
    /// Beyond which nothing sets it.
    pub ceiling: Timestamp,
    /// The latest stamp accepted since.
    pub latest: Timestamp,
}

impl Known {
    /// Of [`Clock::unsynced`].
    #[must_use]
    pub const fn new(earliest: Timestamp, timer: u64) -> Self {
        Self {
            anchor: (earliest, timer),
            set: (timer, false),
            moved: [0, 0],
            drift: Clock::CRYSTAL,
            ceiling: Clock::CEILING,
            latest: Timestamp::ZERO,
        }
    }

    fn sync(&self, timer: u64) -> SyncState {
        let (set, by_trusted) = self.set;
        // 7.5 seconds of drift.
        if by_trusted && timer.saturating_sub(set) <= 750_000 << self.drift {
            SyncState::Synced
        } else {
            SyncState::Unsynced
        }
    }

    /// A year beyond where it would be by itself, nothing beyond the ceiling. A clock that began with a time before this
    /// software was made has nothing to count from.
    fn limit(&self, timer: u64) -> Timestamp {
        let (anchor, anchored) = self.anchor;
        if anchor < Clock::RELEASE {
            return self.ceiling;
        }
        let running = timer.saturating_sub(anchored);
        let ticks = running.saturating_add(365 * 24 * 3600 * 100_000);
        anchor.saturating_add(ticks).min(self.ceiling)
    }

    const fn restarted(self, time: Timestamp, timer: u64, by_trusted: bool) -> Self {
        Self {
            anchor: (time, timer),
            set: (timer, by_trusted),
            moved: [0, 0],
            latest: Timestamp::ZERO,
            ..self
        }
    }
}

/// D3, one step from any state, when the timer shows `timer`. A clock that does not know the time accepts no frame that
/// is stamped more than the window beyond its limit; it then shows no later time than before, or than the limit and the
/// window less a reservation, and does not go back farther than a reservation behind the latest stamp that it has accepted.
/// The limit, now and at any time `later`, does not move with frames. So a year is what all frames together can do, until
/// a trusted source tells the time, or a new key begins.
///
/// A clock that knows the time is moved by frames towards their stamps, in all by no more than it may have drifted. A
/// source that is not trusted moves it forward by a second in all. Nothing sets it beyond the ceiling. A new key starts
/// it anew only if it does not know the time, and at a time that may be right; it does not know the time after that. The
/// same key again takes it forward alone.
///
/// # Errors
///
/// Why a frame is rejected.
///
/// # Panics
///
/// If the property does not hold.
pub fn step<P: Profile>(
    key: &SigningKey<P>,
    clock: &mut Clock,
    known: &mut Known,
    step: Step,
    timer: u64,
    later: u64,
) -> Result<(), VerifyError> {
    let (before, now, limit) = (*clock, clock.now(timer), clock.limit(timer));
    let (sync, was) = (clock.sync(timer), *known);
    assert_eq!(sync, known.sync(timer));
    assert_eq!(limit, known.limit(timer));
    assert!(limit <= known.ceiling);
    let verdict = match step {
        Step::Frame(stamp) => hears(key, clock, known, stamp, timer),
        Step::Told(source, time) => {
            let right = time != Timestamp::ZERO && time <= known.ceiling;
            let went = clock.update(source, time, timer);
            let left = 100_000_u64.saturating_sub(known.moved[0]);
            let expected = match source {
                _ if !right => 0,
                TimeSource::Trusted => time.ticks_since(now),
                TimeSource::Bounded => time.ticks_since(now).min(left),
            };
            assert_eq!(went, expected);
            if !right {
                assert_eq!(*clock, before);
            } else if source == TimeSource::Trusted {
                assert_eq!(clock.now(timer), time);
                *known = known.restarted(time, timer, true);
            } else {
                assert_eq!(clock.now(timer), now.saturating_add(went));
                known.moved[0] += went;
            }
            Ok(())
        }
        Step::Begin(initial) | Step::Again(initial) => {
            let again = matches!(step, Step::Again(_));
            if again {
                clock.raise(initial, timer);
            } else {
                clock.begin(initial, timer);
            }
            let right = Clock::RELEASE <= initial && initial <= known.ceiling;
            let right = right && (!again || initial > now);
            if sync == SyncState::Unsynced && right {
                assert_eq!(clock.now(timer), initial);
                *known = known.restarted(initial, timer, false);
            } else {
                assert_eq!(*clock, before);
            }
            Ok(())
        }
    };
    assert_eq!(clock.sync(timer), known.sync(timer));
    assert_eq!(clock.ceiling(), was.ceiling);
    let later = later.max(timer);
    let (limit, old) = (clock.limit(later), before.limit(later));
    assert_eq!(limit, known.limit(later));
    if matches!(step, Step::Frame(_) | Step::Told(TimeSource::Bounded, _)) {
        assert_eq!(limit, old, "it does not move");
    }
    verdict
}

/// A frame, as a link takes it in.
fn hears<P: Profile>(
    key: &SigningKey<P>,
    clock: &mut Clock,
    known: &mut Known,
    timestamp: Timestamp,
    timer: u64,
) -> Result<(), VerifyError> {
    let Window { past, ahead } = Window::ONE_MINUTE;
    let mut frame = Frame::new(HEARTBEAT, &[]).expect("in every dialect");
    let link_id = 1;
    sign_frame(&mut frame, key, Stamp { link_id, timestamp }).expect("not signed yet");
    let received = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
    let authentic = authenticate(received, key).expect("signed with this key");
    let (now, limit, sync) = (clock.now(timer), known.limit(timer), known.sync(timer));
    let reference = clock.reference_time(timestamp, timer);
    let mut receiver = ReplayGuard::new(link_id, Window::ONE_MINUTE);
    let verdict = receiver.admit(authentic, reference);
    let expected = match sync {
        SyncState::Synced if timestamp.ticks_since(now) > ahead => Err(VerifyError::FromFuture),
        SyncState::Synced if now.ticks_since(timestamp) > past => Err(VerifyError::TooOld),
        SyncState::Unsynced if timestamp.ticks_since(limit) > ahead => Err(VerifyError::FromFuture),
        _ => Ok(()),
    };
    assert_eq!(verdict.as_ref().map(drop), expected.as_ref().map(drop));
    let verified = verdict?;
    clock.on_accepted(&verified, timer);
    let after = clock.now(timer);
    known.latest = known.latest.max(timestamp);
    let off = |time: Timestamp| time.ticks().abs_diff(timestamp.ticks());
    match sync {
        SyncState::Unsynced => {
            let least = known.latest.ticks().saturating_sub(RESERVATION);
            assert!(after.ticks() >= least, "not back");
            if after.ticks() > least {
                assert_eq!(off(after), off(now).min(RESERVATION), "as near as it must");
            } else {
                // It would have gone back farther.
                assert!(now.ticks() <= least || timestamp.ticks() + RESERVATION <= least);
            }
            assert!(after <= now.max(limit.saturating_add(ahead - RESERVATION)));
        }
        SyncState::Synced => {
            let (set, _) = known.set;
            let drifted = timer.saturating_sub(set) >> known.drift;
            let moved = after.ticks().abs_diff(now.ticks());
            assert_eq!(moved, off(now).min(drifted.saturating_sub(known.moved[1])));
            assert_eq!(off(after), off(now) - moved, "towards it");
            known.moved[1] += moved;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_signing::{Hmac, TICKS_PER_SECOND};
    use proptest::prelude::*;

    const DAY: u64 = 24 * 3600 * TICKS_PER_SECOND;

    fn key() -> SigningKey<Hmac> {
        SigningKey::new(&[7; 32]).expect("a key")
    }

    /// A clock, and what is known of it.
    struct Watched {
        key: SigningKey<Hmac>,
        clock: Clock,
        known: Known,
        /// When the limit is looked at: now, or in 90 days, in turn.
        ahead: u64,
    }

    impl Watched {
        fn new(earliest: Timestamp) -> Self {
            Self {
                key: key(),
                clock: Clock::unsynced(earliest, 0),
                known: Known::new(earliest, 0),
                ahead: 0,
            }
        }

        fn step(&mut self, this: Step, timer: u64) -> Result<(), VerifyError> {
            let Self {
                key,
                clock,
                known,
                ahead,
            } = self;
            let verdict = step(key, clock, known, this, timer, timer + *ahead);
            *ahead = 90 * DAY - *ahead;
            // All together: a year, a window and a second.
            let (anchor, anchored) = known.anchor;
            if anchor >= Clock::RELEASE {
                let most = timer - anchored + 365 * DAY + 61 * TICKS_PER_SECOND;
                assert!(clock.now(timer) <= anchor.saturating_add(most));
            }
            let ceiling = Clock::CEILING.saturating_add(timer + 61 * TICKS_PER_SECOND);
            assert!(clock.now(timer) <= ceiling.max(known.anchor.0.saturating_add(timer)));
            verdict
        }
    }

    /// Days, from the release on or anywhere, and some ticks.
    fn time() -> impl Strategy<Value = Timestamp> {
        let days = prop_oneof![6 => -2..800_i64, 2 => 7200..7320_i64, 1 => -4000..33_000_i64];
        let ticks = prop_oneof![-9..9_i64, -7_000_000..7_000_000_i64];
        (days, ticks).prop_map(|(days, ticks)| {
            let ticks = days * DAY as i64 + ticks;
            let ticks = Clock::RELEASE.ticks().saturating_add_signed(ticks);
            Timestamp::ZERO.saturating_add(ticks)
        })
    }

    fn any_step() -> impl Strategy<Value = Step> {
        prop_oneof![
            8 => time().prop_map(Step::Frame),
            1 => time().prop_map(|time| Step::Told(TimeSource::Trusted, time)),
            2 => time().prop_map(|time| Step::Told(TimeSource::Bounded, time)),
            1 => time().prop_map(Step::Begin),
            1 => time().prop_map(Step::Again),
        ]
    }

    proptest! {
        #[test]
        fn d3_random(
            earliest in prop_oneof![Just(Timestamp::ZERO), time()],
            steps in proptest::collection::vec((any_step(), 0..48_u32), 0..40),
        ) {
            let mut watched = Watched::new(earliest);
            let mut timer = 0;
            for (this, wait) in steps {
                timer += 1_u64 << wait >> 4;
                let _ = watched.step(this, timer);
            }
        }

        /// Frames that stay near the clock, for as long as it knows the time and after.
        #[test]
        fn d3_near(
            steps in proptest::collection::vec((-7_000_000..7_000_000_i64, 0..36_u32), 0..60),
            synced: bool,
        ) {
            let mut watched = Watched::new(Clock::RELEASE);
            if synced {
                let told = Step::Told(TimeSource::Trusted, Clock::RELEASE);
                let _ = watched.step(told, 0);
            }
            let mut timer = 0;
            for (off, wait) in steps {
                timer += 1_u64 << wait;
                let ticks = watched.clock.now(timer).ticks().saturating_add_signed(off);
                let _ = watched.step(Step::Frame(Timestamp::ZERO.saturating_add(ticks)), timer);
            }
        }
    }

    /// A peer that stamps ever later takes a clock that does not know the time a year along, and no farther.
    #[test]
    fn d3_a_year_in_all() {
        let mut watched = Watched::new(Clock::RELEASE);
        let at = |days| Clock::RELEASE.saturating_add(days * DAY);
        for days in 0..400 {
            let accepted = watched.step(Step::Frame(at(days)), days).is_ok();
            assert_eq!(accepted, days <= 365);
        }
        // A new key ends that, or somebody who knows.
        let _ = watched.step(Step::Begin(at(1)), 400);
        assert_eq!(watched.step(Step::Frame(at(366)), 400), Ok(()));
        let _ = watched.step(Step::Told(TimeSource::Trusted, at(2)), 400);
        let late = watched.step(Step::Frame(at(3)), 400);
        assert_eq!(late, Err(VerifyError::FromFuture));
    }

    /// A clock that never learnt the time is bounded by the ceiling alone: an old recording is not what it counts from.
    /// It does not go back to one either.
    #[test]
    fn d3_the_first_frame() {
        let mut watched = Watched::new(Timestamp::ZERO);
        let beyond = Clock::CEILING.saturating_add(61 * TICKS_PER_SECOND);
        let rejected = watched.step(Step::Frame(beyond), 0);
        assert_eq!(rejected, Err(VerifyError::FromFuture));
        let now = Clock::RELEASE.saturating_add(100 * DAY);
        assert_eq!(watched.step(Step::Frame(now), 0), Ok(()));
        let years_later = now.saturating_add(3 * 366 * DAY);
        assert_eq!(watched.step(Step::Frame(years_later), 1), Ok(()));
        assert_eq!(
            watched.step(Step::Frame(now), 2),
            Ok(()),
            "of another stream"
        );
        assert!(watched.clock.now(2).ticks() >= years_later.ticks() - RESERVATION);
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::{AnyTag, any_timestamp};

    /// A clock in any state, and what is known of it.
    fn any_clock(drift: u32) -> (Clock, Known) {
        let known = Known {
            anchor: (any_timestamp(), kani::any()),
            set: (kani::any(), kani::any()),
            moved: kani::any(),
            drift,
            ceiling: any_timestamp(),
            latest: any_timestamp(),
        };
        let [stepped, slewed] = known.moved;
        // What counts has been counted.
        kani::assume(stepped <= Clock::MAX_BOUNDED_STEP && slewed <= u64::MAX / 2);
        let clock = Clock::unsynced(any_timestamp(), kani::any())
            .drifting(known.drift)
            .until(known.ceiling)
            .holding(known.anchor, known.set, known.moved, known.latest);
        (clock, known)
    }

    /// Any drift that there may be.
    fn any_drift() -> u32 {
        let drift = kani::any();
        kani::assume(drift <= 32);
        drift
    }

    fn one(drift: u32, this: Step, syncs: &[SyncState]) -> (Result<(), VerifyError>, SyncState) {
        let key = SigningKey::<AnyTag>::new(&[1; 32]).expect("a key");
        let (mut clock, mut known) = any_clock(drift);
        let (timer, later) = kani::any();
        let sync = known.sync(timer);
        kani::assume(syncs.contains(&sync));
        // What was accepted lay below the limit and the window.
        let most = known.limit(timer).saturating_add(Window::ONE_MINUTE.ahead);
        kani::assume(known.latest <= most);
        let verdict = step(&key, &mut clock, &mut known, this, timer, later);
        (verdict, sync)
    }

    const BOTH: &[SyncState] = &[SyncState::Synced, SyncState::Unsynced];

    /// On a crystal: of a clock that does not know the time, drift says no more than that.
    #[kani::proof]
    #[kani::unwind(33)]
    fn d3_frame_follows() {
        let frame = Step::Frame(any_timestamp());
        let (verdict, _) = one(Clock::CRYSTAL, frame, &[SyncState::Unsynced]);
        kani::cover!(verdict.is_ok(), "followed");
        kani::cover!(verdict == Err(VerifyError::FromFuture), "beyond the limit");
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn d3_frame_slews() {
        let frame = Step::Frame(any_timestamp());
        let (verdict, _) = one(Clock::CRYSTAL, frame, &[SyncState::Synced]);
        kani::cover!(verdict.is_ok(), "slewed");
        kani::cover!(verdict == Err(VerifyError::TooOld), "too old");
        kani::cover!(verdict == Err(VerifyError::FromFuture), "from the future");
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn d3_told() {
        let source = if kani::any() {
            TimeSource::Trusted
        } else {
            TimeSource::Bounded
        };
        let (_, sync) = one(any_drift(), Step::Told(source, any_timestamp()), BOTH);
        kani::cover!(source == TimeSource::Bounded && sync == SyncState::Synced);
        kani::cover!(source == TimeSource::Trusted && sync == SyncState::Unsynced);
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn d3_begin() {
        let (initial, again) = (any_timestamp(), kani::any());
        let this = if again {
            Step::Again(initial)
        } else {
            Step::Begin(initial)
        };
        let (_, sync) = one(any_drift(), this, BOTH);
        kani::cover!(again, "again");
        kani::cover!(sync == SyncState::Synced, "it knows the time");
        kani::cover!(sync == SyncState::Unsynced, "it does not");
    }
}
