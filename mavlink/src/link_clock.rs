//! One end of a link in time: its clock, and its memory of what was used before a restart.

use crate::anti_replay::AntiReplay;
use crate::error::{NotStored, SignError, VerifyError};
use crate::time::{Stamp, Stamper, Timestamp};
use crate::verify::{Authentic, Verified};

/// What both directions of a link share: the time, and a mark that survives a restart.
///
/// Any `FnMut() -> Timestamp` is one that remembers nothing and that nobody sets. So is a [`Timestamp`], which
/// stands still.
pub trait LinkClock {
    /// The time now.
    fn now(&mut self) -> Timestamp;

    /// The time since any start, in ticks of 10 microseconds, by a timer that never goes back.
    ///
    /// Silence and deadlines are measured with it: unlike [`now`](Self::now), it does not step when a source or a
    /// frame tells the time.
    fn monotonic(&mut self) -> u64;

    /// The moment to compare `stamp` with, of an authentic frame that may still be rejected. See
    /// [`Clock::reference_time`](crate::Clock::reference_time).
    fn reference_time(&mut self, stamp: Timestamp) -> Timestamp {
        let _ = stamp;
        self.now()
    }

    /// Makes sure that a high-water mark above `stamp` is stored, before `stamp` is used or accepted.
    ///
    /// # Errors
    ///
    /// [`NotStored`]: `stamp` must not be used.
    fn reserve(&mut self, stamp: Timestamp) -> Result<(), NotStored> {
        let _ = stamp;
        Ok(())
    }

    /// Learns from a frame that was accepted.
    fn on_accepted(&mut self, frame: &Verified<'_>) {
        let _ = frame;
    }

    /// The stamp of a frame that is sent now, with a mark above it stored.
    ///
    /// # Errors
    ///
    /// [`SignError::TimestampsExhausted`], [`SignError::NotStored`]. No stamp has been used up then.
    fn stamp(&mut self, stamper: &mut Stamper) -> Result<Stamp, SignError> {
        let now = self.now();
        self.reserve(stamper.next(now)?.timestamp)?;
        stamper.stamp(now)
    }

    /// Accepts `frame` if `receiver` does, with a mark above its stamp stored first.
    ///
    /// # Errors
    ///
    /// Those of [`AntiReplay::admit`], and [`VerifyError::NotStored`]. Nothing has changed then. A mark has
    /// been stored only for a frame that would be accepted.
    fn admit<'a, R: AntiReplay>(
        &mut self,
        receiver: &mut R,
        frame: Authentic<'a>,
    ) -> Result<Verified<'a>, VerifyError> {
        let stamp = frame.stamp().timestamp;
        let now = self.reference_time(stamp);
        receiver.check(&frame, now)?;
        self.reserve(stamp)?;
        let verified = receiver.admit(frame, now)?;
        self.on_accepted(&verified);
        Ok(verified)
    }
}

impl<F: FnMut() -> Timestamp> LinkClock for F {
    fn now(&mut self) -> Timestamp {
        self()
    }

    fn monotonic(&mut self) -> u64 {
        self().ticks()
    }
}

impl LinkClock for Timestamp {
    fn now(&mut self) -> Timestamp {
        *self
    }

    fn monotonic(&mut self) -> u64 {
        self.ticks()
    }
}
