//! One end of a link in time: its clock, and its memory of what was used before a restart.

use crate::error::{SignError, VerifyError};
use crate::replay::Admit;
use crate::time::{Stamp, Stamper, Timestamp};
use crate::verify::{Authentic, Verified};

/// A mark could not be stored. The memory is at fault, or worn out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NotStored;

/// What both directions of a link share: the time, and a mark that survives a restart.
///
/// Any `FnMut() -> Timestamp` is one that remembers nothing, and so is a [`Timestamp`], which stands still.
pub trait Timekeeper {
    /// The time now.
    fn now(&mut self) -> Timestamp;

    /// The moment to hold `stamp` against, of an authentic frame that may be refused yet. See
    /// [`Clock::judged_at`](crate::Clock::judged_at).
    fn judged_at(&mut self, stamp: Timestamp) -> Timestamp {
        let _ = stamp;
        self.now()
    }

    /// Makes sure that a mark above `stamp` is stored, before it is used or accepted.
    ///
    /// # Errors
    ///
    /// [`NotStored`]: it must not be used.
    fn reserve(&mut self, stamp: Timestamp) -> Result<(), NotStored> {
        let _ = stamp;
        Ok(())
    }

    /// Learns from a frame that was accepted.
    fn heard(&mut self, frame: &Verified<'_>) {
        let _ = frame;
    }

    /// The stamp of a frame that is sent now, with a mark above it stored.
    ///
    /// # Errors
    ///
    /// [`SignError::ClockExhausted`], [`SignError::NotStored`]; no stamp has been used up then.
    fn stamp(&mut self, stamper: &mut Stamper) -> Result<Stamp, SignError> {
        let now = self.now();
        self.reserve(stamper.next(now)?.timestamp)?;
        stamper.stamp(now)
    }

    /// Lets `frame` through if `receiver` does, with a mark above its stamp stored first.
    ///
    /// # Errors
    ///
    /// Those of [`Admit::admit`], and [`VerifyError::NotStored`]; nothing has changed then, nor been
    /// stored but for a frame that would be accepted.
    fn admit<'a, R: Admit>(
        &mut self,
        receiver: &mut R,
        frame: Authentic<'a>,
    ) -> Result<Verified<'a>, VerifyError> {
        let stamp = frame.stamp().timestamp;
        let now = self.judged_at(stamp);
        receiver.check(&frame, now)?;
        self.reserve(stamp)?;
        let verified = receiver.admit(frame, now)?;
        self.heard(&verified);
        Ok(verified)
    }
}

impl<F: FnMut() -> Timestamp> Timekeeper for F {
    fn now(&mut self) -> Timestamp {
        self()
    }
}

impl Timekeeper for Timestamp {
    fn now(&mut self) -> Timestamp {
        *self
    }
}
