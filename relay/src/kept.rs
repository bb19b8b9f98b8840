//! The time and the memory of one end of a link: a clock, and a mark in flash.

use core::fmt;

use embedded_storage::nor_flash::NorFlash;
use mavlink_signing::{
    Clock, NotStored, RESERVATION, Source, Stamper, Sync, TICKS_PER_SECOND, Timekeeper, Timestamp,
    Verified, Window,
};
use mavseal_store::{Mark, OpenError, Region};

/// How far beyond the timestamps in use the first mark after a restart is stored: 10 milliseconds, in ticks
/// of 10 microseconds. No end starts again as fast.
pub const FIRST_RESERVATION: u64 = TICKS_PER_SECOND / 100;

/// Why an end of a link cannot start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum KeptError {
    /// The flash cannot hold a mark.
    Open(OpenError),
    /// The mark is behind the last 48-bit timestamp: only a new key helps, and to erase the mark with the
    /// old one.
    Exhausted,
}

impl From<OpenError> for KeptError {
    fn from(error: OpenError) -> Self {
        Self::Open(error)
    }
}

impl fmt::Display for KeptError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Open(error) => error.fmt(f),
            Self::Exhausted => f.write_str("all timestamps are used up"),
        }
    }
}

/// A trusted source told a time that has passed: this end has used or accepted timestamps more than the
/// [`RESERVATION`] and the window of [`Window::LINK`] behind which it lies. Either the source is wrong, such as a
/// real-time clock without a battery, or a wrong one was believed before.
///
/// The clock is as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BehindMark;

impl fmt::Display for BehindMark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the time told has passed: later timestamps have been used")
    }
}

impl core::error::Error for BehindMark {}

impl core::error::Error for KeptError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Open(error) => Some(error),
            Self::Exhausted => None,
        }
    }
}

/// A [`Clock`] on a timer, and a [`Mark`] above every timestamp that this end has used or accepted.
///
/// After a restart, stamps begin at the mark, and no frame from before it is accepted, of no stream:
///
/// ```
/// use mavlink_signing::{Replay, Window};
/// use mavseal_relay::Kept;
/// use mavseal_store::{Region, model::Flash};
///
/// let region = Region { start: 0, page_size: 2048 };
/// let kept = Kept::new(Flash::<2>::default(), region, || 0)?;
/// let stamper = kept.stamper(1);
/// let receiver = Replay::resume(2, Window::LINK, kept.floor());
/// # Ok::<(), mavseal_relay::KeptError>(())
/// ```
///
/// A mark is stored ahead of what is used by an eighth of the time since the restart, at least
/// [`FIRST_RESERVATION`] and at most [`RESERVATION`]. So stamps of an end whose power fails again and again
/// do not run away from its clock: each restart skips less than the time that passed since the one before.
/// It takes about 60 writes to come up to the full reservation, then one every 10 seconds.
///
/// The clock begins a reservation before the mark, so that what was reserved and not used does not push it
/// ahead; the stamps begin at the mark all the same, and go on a tick a frame until the clock has come after.
///
/// The price: after a restart, frames of an honest peer are refused for at most the reservation, and by as
/// much longer as the latest timestamp that this end has used or accepted was ahead of the peer's clock; a peer
/// without a clock is up to a reservation behind.
pub struct Kept<F, T> {
    clock: Clock,
    mark: Mark<F>,
    timer: T,
    started: u64,
    floor: Timestamp,
}

impl<F: NorFlash, T: FnMut() -> u64> Kept<F, T> {
    /// The end whose mark is in `region` of `flash`, with a clock that nobody has told the time yet. `timer` gives
    /// ticks of 10 microseconds that never go back.
    ///
    /// # Errors
    ///
    /// [`KeptError`].
    pub fn new(flash: F, region: Region, mut timer: T) -> Result<Self, KeptError> {
        let mark = Mark::open(flash, region)?;
        let floor = Timestamp::from_ticks(mark.get()).ok_or(KeptError::Exhausted)?;
        let earliest = mark.get().saturating_sub(RESERVATION);
        let earliest = Timestamp::from_ticks(earliest).unwrap_or(floor);
        let started = timer();
        Ok(Self {
            clock: Clock::unsynced(earliest, started),
            mark,
            timer,
            started,
            floor,
        })
    }

    /// The same on a timer that is not a crystal's: see [`Clock::drifting`].
    #[must_use]
    pub fn drifting(mut self, drift: u32) -> Self {
        self.clock = self.clock.drifting(drift);
        self
    }

    /// The mark at the start: no stamp before it may be given, or accepted.
    #[must_use]
    pub const fn floor(&self) -> Timestamp {
        self.floor
    }

    /// Stamps for `link_id`, none before [`Kept::floor`]. One for each link id in a run of the program.
    #[must_use]
    pub const fn stamper(&self, link_id: u8) -> Stamper {
        Stamper::resume(link_id, self.floor)
    }

    /// Takes `time` from `source`: [`Clock::tell`]. Ask a trusted one again before [`Clock::holdover`] is over;
    /// hourly, for instance.
    ///
    /// # Errors
    ///
    /// [`BehindMark`]. Believed, such a source would make this end refuse every honest frame.
    pub fn tell(&mut self, source: Source, time: Timestamp) -> Result<u64, BehindMark> {
        let latest = time.saturating_add(RESERVATION + Window::LINK.ahead);
        let tells = source == Source::Trusted && time != Timestamp::ZERO;
        if tells && latest.ticks() < self.mark.get() {
            return Err(BehindMark);
        }
        let now = (self.timer)();
        Ok(self.clock.tell(source, time, now))
    }

    /// Whether the clock knows the time.
    pub fn sync(&mut self) -> Sync {
        let now = (self.timer)();
        self.clock.sync(now)
    }

    /// The flash, for what else it holds.
    pub fn into_flash(self) -> F {
        self.mark.into_flash()
    }
}

impl<F: NorFlash, T: FnMut() -> u64> Timekeeper for Kept<F, T> {
    fn now(&mut self) -> Timestamp {
        let now = (self.timer)();
        self.clock.now(now)
    }

    fn judged_at(&mut self, stamp: Timestamp) -> Timestamp {
        let now = (self.timer)();
        self.clock.judged_at(stamp, now)
    }

    /// Also refuses what lies before [`Kept::floor`], which a stamper or a receiver would let through that was
    /// not made with it.
    fn reserve(&mut self, stamp: Timestamp) -> Result<(), NotStored> {
        if stamp < self.floor {
            return Err(NotStored);
        }
        let running = (self.timer)().saturating_sub(self.started);
        let ahead = (running / 8).clamp(FIRST_RESERVATION, RESERVATION);
        // A mark behind the last timestamp would end the key before its time.
        let ahead = ahead.min(Timestamp::MAX.ticks_since(stamp));
        let reserved = self.mark.reserve(stamp.ticks(), ahead);
        reserved.map_err(|_| NotStored)
    }

    fn heard(&mut self, frame: &Verified<'_>) {
        let now = (self.timer)();
        self.clock.heard(frame, now);
    }
}

impl<F: NorFlash, T: FnMut() -> u64> crate::Clock for Kept<F, T> {
    fn timer(&mut self) -> u64 {
        (self.timer)()
    }
}

impl<F, T> fmt::Debug for Kept<F, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Kept")
            .field("clock", &self.clock)
            .field("floor", &self.floor)
            .finish_non_exhaustive()
    }
}
