//! A mark that is stored by time: as far ahead of use as counters go up in some seconds.

use embedded_storage::nor_flash::NorFlash;
use mavlink_signing::TICKS_PER_SECOND;
use mavseal_store::{HighWaterMark, ReserveError};

/// How far a mark is stored ahead of the counters in use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pace {
    /// A mark is stored about this often, in ticks of 10 microseconds.
    pub period: u64,
    /// At least so many counters ahead. It is that at each start, and at most twice as far with each mark.
    pub least: u64,
    /// At most so many.
    pub most: u64,
}

impl Pace {
    /// Of the counters that this end seals with: every 60 s, 256 to 65,536 ahead.
    pub const SENT: Self = Self {
        period: 60 * TICKS_PER_SECOND,
        least: 256,
        most: 1 << 16,
    };
    /// The same where they follow a clock, which goes up by 64 a second: every 20 s, 256 to 1,280 ahead. A mark further
    /// ahead would be far from the clock after a restart.
    pub const SENT_WITH_CLOCK: Self = Self {
        period: 20 * TICKS_PER_SECOND,
        least: 256,
        most: 20 * 64,
    };
    /// Of the counters accepted of a peer: every 10 s, 8 to 16,384 ahead.
    pub const ACCEPTED: Self = Self {
        period: 10 * TICKS_PER_SECOND,
        least: 8,
        most: 1 << 14,
    };

    /// The same where they follow a clock: every 10 s, 8 to 640 ahead.
    pub const ACCEPTED_WITH_CLOCK: Self = Self {
        most: 10 * 64,
        ..Self::ACCEPTED
    };

    /// How far ahead the next mark is stored, when the last was stored `ahead`, `ticks` ago, and `used` counters
    /// have gone by.
    fn next(self, ahead: u64, used: u64, ticks: u64) -> u64 {
        let expected = used.saturating_mul(self.period) / ticks.max(1);
        // Not `clamp`, which panics where the least is more than the most.
        let most = ahead.saturating_mul(2).max(self.least).min(self.most);
        expected.max(self.least).min(most)
    }
}

/// A mark, and how far ahead it is stored.
pub(super) struct PacedMark<F> {
    mark: HighWaterMark<F>,
    pub(super) pace: Pace,
    /// The counter for which it was last stored in this run, when, and how far ahead.
    stored: Option<(u64, u64, u64)>,
}

impl<F: NorFlash> PacedMark<F> {
    pub(super) const fn new(mark: HighWaterMark<F>, pace: Pace) -> Self {
        Self {
            mark,
            pace,
            stored: None,
        }
    }

    /// Makes sure that the mark is above `counter`, at `now`.
    pub(super) fn reserve(&mut self, counter: u32, now: u64) -> Result<(), ReserveError> {
        let counter = u64::from(counter);
        if counter < self.mark.get() {
            return Ok(());
        }
        let ahead = self.stored.map_or(self.pace.least, |(before, at, ahead)| {
            let used = counter.saturating_sub(before);
            self.pace.next(ahead, used, now.saturating_sub(at))
        });
        self.mark.reserve(counter, ahead)?;
        self.stored = Some((counter, now, ahead));
        Ok(())
    }

    pub(super) fn erases(&self) -> u32 {
        self.mark.erases()
    }

    pub(super) fn into_flash(self) -> F {
        self.mark.into_flash()
    }
}
