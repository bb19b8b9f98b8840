//! One end of a link in time: its clock, and its memory of what was used before a restart.

use crate::anti_replay::AntiReplay;
use crate::error::{NotStored, SignError, VerifyError};
use crate::key::Fingerprint;
use crate::key_ring::KeySlot;
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

    /// The first timestamp that may be used or accepted under the key in `slot`: a mark from before a restart.
    fn floor(&self, slot: KeySlot) -> Timestamp {
        let _ = slot;
        Timestamp::ZERO
    }

    /// Makes sure that a high-water mark above `stamp` is stored for the key in `slot`, before `stamp` is used or
    /// accepted under it.
    ///
    /// # Errors
    ///
    /// [`NotStored`]: `stamp` must not be used.
    fn reserve(&mut self, slot: KeySlot, stamp: Timestamp) -> Result<(), NotStored> {
        let _ = (slot, stamp);
        Ok(())
    }

    /// A new key comes into `slot`, and with it a new order of stamps: what was remembered of the slot is forgotten.
    /// `initial` is the earliest timestamp to use with it, [`Timestamp::ZERO`] if nobody said. Returns the first
    /// timestamp that may be used or accepted under it.
    ///
    /// # Errors
    ///
    /// [`NotStored`]: the key must not be used.
    fn begin_key(
        &mut self,
        slot: KeySlot,
        key: Fingerprint,
        initial: Timestamp,
    ) -> Result<Timestamp, NotStored> {
        let _ = (slot, key);
        Ok(initial)
    }

    /// The newest key came again, with `initial` as the time. While the key is being changed, a clock that is not synced
    /// begins anew there: its drift may keep the other end from hearing it. Once that is `settled`, it shows it at least.
    fn repeat_key(&mut self, initial: Timestamp, settled: bool) {
        let _ = (initial, settled);
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
        let now = self.now().max(self.floor(stamper.slot()));
        self.reserve(stamper.slot(), stamper.next(now)?.timestamp)?;
        stamper.stamp(now)
    }

    /// Accepts `frame` if `receiver` does, with a mark above its stamp stored first. A frame of a
    /// [former](crate::KeyUse::former) key is compared with the time as it is, and sets no clock.
    ///
    /// # Errors
    ///
    /// Those of [`AntiReplay::admit`], [`VerifyError::Replayed`] below the [`floor`](Self::floor), and
    /// [`VerifyError::NotStored`]. Nothing has changed then. A mark has
    /// been stored only for a frame that would be accepted.
    fn admit<'a, R: AntiReplay>(
        &mut self,
        receiver: &mut R,
        frame: Authentic<'a>,
    ) -> Result<Verified<'a>, VerifyError> {
        let stamp = frame.stamp().timestamp;
        let key = frame.key();
        let now = if key.former {
            self.now()
        } else {
            self.reference_time(stamp)
        };
        receiver.check(&frame, now)?;
        if stamp < self.floor(key.slot) {
            return Err(VerifyError::Replayed);
        }
        self.reserve(key.slot, stamp)?;
        let verified = receiver.admit(frame, now)?;
        if !key.former {
            self.on_accepted(&verified);
        }
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
