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

/// Who has set a clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Sync {
    /// Nobody since the start, or too long ago: it only counts on from where it was.
    Unsynced,
    /// A peer, with an authentic frame.
    Peer,
    /// A [trusted](Source::Trusted) source.
    Trusted,
}

/// The time at one end of a link, counted on a timer from the last moment that somebody told. It goes with
/// [`Window::LINK`].
///
/// | set by | a frame in its window | a frame ahead of that | a frame behind it |
/// |---|---|---|---|
/// | nobody: [`Sync::Unsynced`] | sets it | sets it | sets it |
/// | a peer: [`Sync::Peer`] | slews it, or sets it forward | sets it | refused |
/// | [`Sync::Trusted`] | slews it | refused | refused |
///
/// Only authentic frames that are newer than all before come so far. A frame sets the clock to a
/// [`RESERVATION`] before its stamp, since its sender may have skipped that much: so a board without a clock
/// is up to a reservation behind its peers, and never ahead, however often they or it restart. To slew is to
/// move the clock towards the stamp by no more than a crystal may have gained or lost.
///
/// A clock that no trusted source has set has nothing to hold against a frame from the future, and must
/// follow it: if it did not, a frame of last week, recorded and played to it, would make it refuse all of
/// today's. The price is that a peer whose clock is wrong takes it along. A board that has a clock to read,
/// or is set on a trusted port, does not pay it.
///
/// All moments of the timer are ticks of 10 microseconds, from anywhere, and never go back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Clock {
    /// The time when the timer showed `since`.
    time: Timestamp,
    since: u64,
    sync: Sync,
    /// When the clock was last known to be right: set, or in the window of an accepted frame.
    confirmed: u64,
    /// When it was last set by somebody that is believed; steps and slews are counted from here.
    set: u64,
    /// Ticks that bounded sources have moved it since.
    stepped: u64,
    /// Ticks that peers have slewed it since, either way.
    slewed: u64,
    drift: u32,
}

impl Clock {
    /// The most that a bounded source moves the clock at once: a second, in ticks of 10 microseconds.
    pub const STEP: u64 = TICKS_PER_SECOND;

    /// How wrong a timer on a crystal may be, unless [said otherwise](Clock::drifting): one tick in 2^12,
    /// which is 244 parts in a million.
    pub const CRYSTAL: u32 = 12;

    /// A clock that nobody has set, which begins with `earliest`: a time that has certainly passed, such as
    /// the mark from before the restart less the [`RESERVATION`], or
    /// [`Timestamp::ZERO`].
    #[must_use]
    pub const fn unsynced(earliest: Timestamp, timer: u64) -> Self {
        Self {
            time: earliest,
            since: timer,
            sync: Sync::Unsynced,
            confirmed: timer,
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

    /// Who has set it, if that was not longer ago than [`Clock::holdover`].
    #[must_use]
    pub const fn sync(&self, timer: u64) -> Sync {
        if timer.saturating_sub(self.confirmed) > self.holdover() {
            Sync::Unsynced
        } else {
            self.sync
        }
    }

    /// How long the clock is believed without being set, and without a frame that is in time: until two
    /// such clocks may be half of [`Window::LINK`] apart. 17 hours on a crystal.
    ///
    /// Without it, two ends that had heard nothing of each other for long would refuse each other for
    /// ever. The price: whoever keeps all frames from an end for so long, and has recorded some that never
    /// arrived, can have them accepted later. An end that asks a trusted source now and then pays nothing.
    #[must_use]
    pub const fn holdover(&self) -> u64 {
        (Window::LINK.past / 4) << self.drift
    }

    /// Takes `time` from `source`. Gives the ticks that the clock went forward.
    ///
    /// A bounded source moves it by [`Clock::STEP`], and by what the timer may have lost, since it was last
    /// set; no more, however often it is asked. A time behind the clock, or [`Timestamp::ZERO`], says
    /// nothing, unless a trusted source tells the former.
    pub fn tell(&mut self, source: Source, time: Timestamp, timer: u64) -> u64 {
        let ahead = time.ticks_since(self.now(timer));
        match source {
            Source::Trusted => {
                if time == Timestamp::ZERO {
                    return 0;
                }
                self.set(Sync::Trusted, time, timer);
                ahead
            }
            Source::Bounded => {
                let most = Self::STEP.saturating_add(self.drifted(timer));
                let step = ahead.min(most.saturating_sub(self.stepped));
                self.time = self.now(timer).saturating_add(step);
                self.since = timer;
                self.stepped = self.stepped.saturating_add(step);
                step
            }
        }
    }

    /// The moment to hold `stamp`, of an authentic frame, against: the time, unless the frame would set it.
    #[must_use]
    pub fn judged_at(&self, stamp: Timestamp, timer: u64) -> Timestamp {
        match self.sync(timer) {
            Sync::Unsynced => stamp,
            Sync::Peer => self.now(timer).max(least(stamp)),
            Sync::Trusted => self.now(timer),
        }
    }

    /// Learns from a frame that was accepted.
    pub fn heard(&mut self, frame: &Verified<'_>, timer: u64) {
        let stamp = frame.stamp().timestamp;
        let now = self.now(timer);
        let sets = match self.sync(timer) {
            Sync::Unsynced => true,
            Sync::Peer => least(stamp) > now,
            Sync::Trusted => false,
        };
        if sets {
            self.set(Sync::Peer, least(stamp), timer);
            return;
        }
        let most = self.drifted(timer).saturating_sub(self.slewed);
        let ahead = stamp.ticks_since(now).min(most);
        let behind = now.ticks_since(stamp).min(most);
        self.slewed = self.slewed.saturating_add(ahead).saturating_add(behind);
        let earlier = now.ticks().saturating_sub(behind);
        self.time = Timestamp::from_ticks(earlier)
            .unwrap_or(now)
            .saturating_add(ahead);
        self.since = timer;
        self.confirmed = timer;
    }

    fn set(&mut self, sync: Sync, time: Timestamp, timer: u64) {
        *self = Self::unsynced(time, timer).drifting(self.drift);
        self.sync = sync;
    }

    /// Ticks by which the timer may be wrong since the clock was set.
    const fn drifted(&self, timer: u64) -> u64 {
        timer.saturating_sub(self.set) >> self.drift
    }
}

/// What time it is at least where a frame is stamped `stamp`: its sender may have skipped a reservation.
fn least(stamp: Timestamp) -> Timestamp {
    let ticks = stamp.ticks().saturating_sub(RESERVATION);
    Timestamp::from_ticks(ticks).unwrap_or(stamp)
}
