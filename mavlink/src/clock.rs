//! The clock of one end of a link: who may set it, how far, and how long it is believed.

use crate::header::MessageId;
use crate::time::{RESERVATION, TICKS_PER_SECOND, Timestamp, Window};
use crate::verify::Verified;

/// SYSTEM_TIME, message 2.
pub const SYSTEM_TIME: MessageId = MessageId::from_le_bytes([2, 0, 0]);

/// Bytes of `time_unix_usec`, the first field of SYSTEM_TIME, little-endian.
const UNIX_TIME_SIZE: usize = 8;
/// Bytes of SYSTEM_TIME's payload: that, and the milliseconds since boot.
const SYSTEM_TIME_SIZE: usize = UNIX_TIME_SIZE + 4;

/// The time that a payload of SYSTEM_TIME tells, 8 bytes of microseconds since 1970; its trailing zeros
/// may be cut. `None` if it is longer than 12 bytes, or the time before 2015: the sender does not know it.
#[must_use]
pub fn system_time(payload: &[u8]) -> Option<Timestamp> {
    let mut bytes = [0; SYSTEM_TIME_SIZE];
    bytes.get_mut(..payload.len())?.copy_from_slice(payload);
    let (micros, _) = bytes.split_first_chunk::<UNIX_TIME_SIZE>()?;
    Timestamp::from_unix_micros(u64::from_le_bytes(*micros))
}

/// How far a source of time is trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Source {
    /// Whoever can change what it says could also change this program: a real-time clock on the board,
    /// the operating system, [`SetupSigning`](crate::SetupSigning)'s `initial_timestamp` that came in on
    /// a trusted port. Sets the clock, forward or back.
    Trusted,
    /// Others can change what it says: GNSS, which is easy to spoof, and SYSTEM_TIME. Moves the clock
    /// forward by small steps, and never syncs it.
    Bounded,
}

/// Whether a clock knows the time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Sync {
    /// No [trusted](Source::Trusted) source has told it, or too long ago: it keeps near what peers stamp.
    Unsynced,
    /// A trusted source has told it, no longer ago than [`Clock::holdover`].
    Synced,
}

/// The time at one end of a link, counted on a timer from the last moment that somebody told. It goes with
/// [`Window::LINK`].
///
/// | clock | a frame in the window | a frame outside of it |
/// |---|---|---|
/// | [`Sync::Synced`] | slews it | is refused, and moves nothing |
/// | [`Sync::Unsynced`] | keeps it within a [`RESERVATION`] of its stamp | sets it to that |
///
/// Only authentic frames that are newer than all before come so far. To slew is to move the clock towards
/// the stamp by no more than a crystal may have gained or lost since it was set. A reservation is what the
/// sender of a frame may have skipped at a restart; an unsynced clock that took over the stamp itself
/// would run ahead of everybody by one for each restart.
///
/// An unsynced clock has nothing to hold against a frame. If it held its own time against one, two boards
/// that had drifted together, or a frame of last week, recorded and played to it, would make it refuse all
/// honest frames for ever. The price: it cannot tell how long a frame has been on its way, so that order
/// alone protects it; and a peer whose clock is wrong takes it along. A board that has a clock to read, or
/// is set on a trusted port, does not pay it.
///
/// All moments of the timer are ticks of 10 microseconds, from anywhere, and never go back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Clock {
    /// The time when the timer showed `since`.
    time: Timestamp,
    since: u64,
    /// Whether a trusted source has told it, when the timer showed `set`.
    told: bool,
    /// When it was last set; steps and slews are counted from here.
    set: u64,
    /// Ticks that bounded sources have moved it since.
    stepped: u64,
    /// Ticks that peers have slewed it since, either way.
    slewed: u64,
    drift: u32,
}

impl Clock {
    /// The most that bounded sources move the clock until it is set again: a second, in ticks of 10
    /// microseconds.
    pub const STEP: u64 = TICKS_PER_SECOND;

    /// How wrong a timer on a crystal may be, unless [said otherwise](Clock::drifting): one tick in 2^12,
    /// which is 244 parts in a million.
    pub const CRYSTAL: u32 = 12;

    /// A clock that nobody has told the time, which begins with `earliest`: a time that has certainly
    /// passed, such as the mark from before the restart less the [`RESERVATION`], or [`Timestamp::ZERO`].
    #[must_use]
    pub const fn unsynced(earliest: Timestamp, timer: u64) -> Self {
        Self {
            time: earliest,
            since: timer,
            told: false,
            set: timer,
            stepped: 0,
            slewed: 0,
            drift: Self::CRYSTAL,
        }
    }

    /// The same clock on a timer that is wrong by up to one tick in 2^`drift`: 6 (1.6 %) for an RC
    /// oscillator. At most 32.
    #[must_use]
    pub const fn drifting(mut self, drift: u32) -> Self {
        self.drift = if drift < 32 { drift } else { 32 };
        self
    }

    /// The time when the timer shows `timer`.
    #[must_use]
    pub const fn now(&self, timer: u64) -> Timestamp {
        self.time.saturating_add(timer.saturating_sub(self.since))
    }

    /// Whether it knows the time.
    #[must_use]
    pub const fn sync(&self, timer: u64) -> Sync {
        if self.told && timer.saturating_sub(self.set) <= self.holdover() {
            Sync::Synced
        } else {
            Sync::Unsynced
        }
    }

    /// How long a trusted source is believed without being asked again: until two such clocks may be half
    /// of [`Window::LINK`] apart. 17 hours on a crystal.
    #[must_use]
    pub const fn holdover(&self) -> u64 {
        (Window::LINK.past / 4) << self.drift
    }

    /// Takes `time` from `source`. Gives the ticks that the clock went forward.
    ///
    /// A bounded source moves it by [`Clock::STEP`] until it is set again; no more, however often it is
    /// asked. A time behind the clock says nothing, unless a trusted source tells it; [`Timestamp::ZERO`]
    /// never does.
    pub fn tell(&mut self, source: Source, time: Timestamp, timer: u64) -> u64 {
        if time == Timestamp::ZERO {
            return 0;
        }
        let ahead = time.ticks_since(self.now(timer));
        match source {
            Source::Trusted => {
                self.set(time, timer);
                self.told = true;
                ahead
            }
            Source::Bounded => {
                let step = ahead.min(Self::STEP.saturating_sub(self.stepped));
                self.time = self.now(timer).saturating_add(step);
                self.since = timer;
                self.stepped = self.stepped.saturating_add(step);
                step
            }
        }
    }

    /// The moment to hold `stamp`, of an authentic frame, against: the time, if the clock knows it.
    #[must_use]
    pub fn judged_at(&self, stamp: Timestamp, timer: u64) -> Timestamp {
        match self.sync(timer) {
            Sync::Unsynced => stamp,
            Sync::Synced => self.now(timer),
        }
    }

    /// Learns from a frame that was accepted.
    pub fn heard(&mut self, frame: &Verified<'_>, timer: u64) {
        let stamp = frame.stamp().timestamp;
        let now = self.now(timer);
        match self.sync(timer) {
            Sync::Unsynced => {
                let latest = stamp.saturating_add(RESERVATION);
                let time = now.clamp(earlier(stamp, RESERVATION), latest);
                if time != now {
                    self.set(time, timer);
                }
            }
            Sync::Synced => {
                let drifted = timer.saturating_sub(self.set) >> self.drift;
                let most = drifted.saturating_sub(self.slewed);
                let ahead = stamp.ticks_since(now).min(most);
                let behind = now.ticks_since(stamp).min(most);
                self.slewed = self.slewed.saturating_add(ahead).saturating_add(behind);
                self.time = earlier(now, behind).saturating_add(ahead);
                self.since = timer;
            }
        }
    }

    fn set(&mut self, time: Timestamp, timer: u64) {
        *self = Self::unsynced(time, timer).drifting(self.drift);
    }
}

/// `ticks` before `time`, at least the beginning of time.
fn earlier(time: Timestamp, ticks: u64) -> Timestamp {
    let ticks = time.ticks().saturating_sub(ticks);
    Timestamp::from_ticks(ticks).unwrap_or(Timestamp::ZERO)
}
