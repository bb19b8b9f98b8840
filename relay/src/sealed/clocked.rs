//! Counters that follow a clock.

use core::ops::RangeInclusive;

use mavlink_signing::{LinkClock, TICKS_PER_SECOND, Timestamp};

/// How many counters there are in a second of the clock: 64.
pub const COUNTERS_PER_SECOND: u32 = 64;
/// How far a package's counter may be from the receiver's clock, either way: 60 s, in counters.
pub const MAX_AGE: u32 = 60 * COUNTERS_PER_SECOND;
/// How far a sender's counters run ahead of its clock: 30 s, in counters. With the 20 s that a mark is ahead after a
/// restart, that stays within [`MAX_AGE`], and leaves 10 s for clocks that differ.
pub const MAX_LEAD: u32 = 30 * COUNTERS_PER_SECOND;

/// A moment: by the timer, and by the clock if counters follow it.
#[derive(Clone, Copy)]
pub(super) struct Moment {
    /// Ticks of 10 microseconds since any start.
    pub(super) ticks: u64,
    pub(super) clock: Option<CounterClock>,
}

impl Moment {
    pub(super) fn of(clock: &mut impl LinkClock, origin: Option<Timestamp>) -> Self {
        let ticks = clock.monotonic();
        let clock = origin.map(|origin| CounterClock::of(clock.now(), origin));
        Self { ticks, clock }
    }
}

/// What the clock says, as a counter.
#[derive(Clone, Copy)]
pub(super) struct CounterClock(u32);

impl CounterClock {
    fn of(now: Timestamp, origin: Timestamp) -> Self {
        let ticks = now.ticks().saturating_sub(origin.ticks());
        let counters = ticks.saturating_mul(COUNTERS_PER_SECOND.into()) / TICKS_PER_SECOND;
        // Behind all counters nothing is sealed.
        Self(u32::try_from(counters).unwrap_or(u32::MAX))
    }

    pub(super) const fn counter(self) -> u32 {
        self.0
    }

    /// Whether a sender must wait before it uses `counter`.
    pub(super) const fn is_too_far_ahead(self, counter: u32) -> bool {
        counter > self.0.saturating_add(MAX_LEAD)
    }

    /// The counters that a package may have now.
    pub(super) const fn fresh(self) -> RangeInclusive<u32> {
        self.0.saturating_sub(MAX_AGE)..=self.0.saturating_add(MAX_AGE)
    }
}
