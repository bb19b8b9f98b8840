//! The time and the memory of one end of a link: a clock, and a mark in flash.

use core::fmt;

use embedded_storage::nor_flash::NorFlash;
use mavlink_signing::{
    Clock, LinkClock, NotStored, RESERVATION, Stamper, SyncState, TICKS_PER_SECOND, TimeSource,
    Timestamp, Verified, Window,
};
use mavseal_store::{HighWaterMark, OpenError, Region};

/// How far beyond the timestamps in use the first mark after a restart is stored: 10 milliseconds, in ticks
/// of 10 microseconds. No end starts again as fast.
pub const FIRST_RESERVATION: u64 = TICKS_PER_SECOND / 100;

/// Why an end of a link cannot start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PersistentClockError {
    /// The flash cannot hold a mark.
    Open(OpenError),
    /// The mark is behind the last 48-bit timestamp: only a new key helps, and to erase the mark with the
    /// old one.
    Exhausted,
}

impl From<OpenError> for PersistentClockError {
    fn from(error: OpenError) -> Self {
        Self::Open(error)
    }
}

impl fmt::Display for PersistentClockError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Open(error) => error.fmt(f),
            Self::Exhausted => f.write_str("all timestamps are used up"),
        }
    }
}

/// A trusted source told a time that has passed: this end has used or accepted timestamps more than the
/// [`RESERVATION`] and the window of [`Window::ONE_MINUTE`] behind which it lies. Either the source is wrong, such as a
/// real-time clock without a battery, or a wrong one was believed before.
///
/// The clock is as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TimeBehindMark;

impl fmt::Display for TimeBehindMark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the time told has passed: later timestamps have been used")
    }
}

impl core::error::Error for TimeBehindMark {}

impl core::error::Error for PersistentClockError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Open(error) => Some(error),
            Self::Exhausted => None,
        }
    }
}

/// A [`Clock`] on a timer, and a [`HighWaterMark`] above every timestamp that this end has used or accepted.
///
/// After a restart, stamps begin at the mark, and no frame from before it is accepted, of no stream:
///
/// ```
/// use mavlink_signing::{ReplayGuard, Window};
/// use mavseal_relay::PersistentClock;
/// use mavseal_store::{Region, model::Flash};
///
/// let region = Region { start: 0, page_size: 2048 };
/// let kept = PersistentClock::new(Flash::<2>::default(), region, || 0)?;
/// let stamper = kept.stamper(1);
/// let receiver = ReplayGuard::resume(2, Window::ONE_MINUTE, kept.floor());
/// # Ok::<(), mavseal_relay::PersistentClockError>(())
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
/// The price: after a restart, frames of an honest peer are rejected for at most the reservation, and by as
/// much longer as the latest timestamp that this end has used or accepted was ahead of the peer's clock; a peer
/// without a clock is up to a reservation behind.
pub struct PersistentClock<F, T> {
    clock: Clock,
    mark: HighWaterMark<F>,
    timer: T,
    started: u64,
    floor: Timestamp,
}

impl<F: NorFlash, T: FnMut() -> u64> PersistentClock<F, T> {
    /// The end whose mark is in `region` of `flash`, with a clock that nobody has told the time yet. `timer` gives
    /// ticks of 10 microseconds that never go back.
    ///
    /// # Errors
    ///
    /// [`PersistentClockError`].
    pub fn new(flash: F, region: Region, mut timer: T) -> Result<Self, PersistentClockError> {
        let mark = HighWaterMark::open(flash, region)?;
        let floor = Timestamp::from_ticks(mark.get()).ok_or(PersistentClockError::Exhausted)?;
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

    /// Stamps for `link_id`, none before [`PersistentClock::floor`]. One for each link id in a run of the program.
    #[must_use]
    pub const fn stamper(&self, link_id: u8) -> Stamper {
        Stamper::resume(link_id, self.floor)
    }

    /// Takes `time` from `source`: [`Clock::update`]. Ask a trusted one again before [`Clock::holdover`] is over;
    /// hourly, for instance.
    ///
    /// # Errors
    ///
    /// [`TimeBehindMark`]. Believed, such a source would make this end reject every honest frame.
    pub fn update(&mut self, source: TimeSource, time: Timestamp) -> Result<u64, TimeBehindMark> {
        let latest = time.saturating_add(RESERVATION + Window::ONE_MINUTE.ahead);
        let tells = source == TimeSource::Trusted && time != Timestamp::ZERO;
        if tells && latest.ticks() < self.mark.get() {
            return Err(TimeBehindMark);
        }
        let now = (self.timer)();
        Ok(self.clock.update(source, time, now))
    }

    /// Whether the clock knows the time.
    pub fn sync(&mut self) -> SyncState {
        let now = (self.timer)();
        self.clock.sync(now)
    }

    /// The flash, for what else it holds.
    pub fn into_flash(self) -> F {
        self.mark.into_flash()
    }
}

impl<F: NorFlash, T: FnMut() -> u64> LinkClock for PersistentClock<F, T> {
    fn now(&mut self) -> Timestamp {
        let now = (self.timer)();
        self.clock.now(now)
    }

    fn monotonic(&mut self) -> u64 {
        (self.timer)()
    }

    fn reference_time(&mut self, stamp: Timestamp) -> Timestamp {
        let now = (self.timer)();
        self.clock.reference_time(stamp, now)
    }

    /// Also rejects what lies before [`PersistentClock::floor`], which a stamper or a receiver would let through that was
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

    fn on_accepted(&mut self, frame: &Verified<'_>) {
        let now = (self.timer)();
        self.clock.on_accepted(frame, now);
    }
}

impl<F, T> fmt::Debug for PersistentClock<F, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PersistentClock")
            .field("clock", &self.clock)
            .field("floor", &self.floor)
            .finish_non_exhaustive()
    }
}
