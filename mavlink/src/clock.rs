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

/// The time in a payload of SYSTEM_TIME: 8 bytes of microseconds since 1970, little-endian. Its trailing
/// zeros may be cut. `None` if it is longer than 12 bytes, or the time is before 2015: the sender does not
/// know it.
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
pub enum TimeSource {
    /// Anybody who can change what it says could also change this program. Such sources are a real-time
    /// clock on the board and the operating system. It sets the clock, forward or back, up to the
    /// [ceiling](Clock::CEILING).
    Trusted,
    /// Others can change what it says: GNSS, which is easy to spoof, and SYSTEM_TIME. It moves the clock
    /// forward by small steps, and never syncs it.
    Bounded,
}

/// Whether a clock knows the time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SyncState {
    /// No [trusted](TimeSource::Trusted) source has set it, or too long ago. It stays near the stamps of
    /// peers.
    Unsynced,
    /// A trusted source has set it, no longer ago than [`Clock::holdover`].
    Synced,
}

/// The time at one end of a link, counted on a timer from the last update. It goes with
/// [`Window::ONE_MINUTE`].
///
/// | clock | a frame in the window | a frame outside of it |
/// |---|---|---|
/// | [`SyncState::Synced`] | slews it | is rejected, and moves nothing |
/// | [`SyncState::Unsynced`] | keeps it within a [`RESERVATION`] of its stamp | sets it to that; beyond [`Clock::limit`] and the window, is rejected |
///
/// Only authentic frames that are newer than all before get this far. To slew is to move the clock towards
/// the stamp, by no more than a crystal may have drifted since it was set. A reservation is what the sender
/// of a frame may have skipped at a restart. An unsynced clock that took over the stamp itself would run
/// ahead of everybody by one reservation for each restart.
///
/// An unsynced clock cannot reject a frame as too old. If it tried, two drifting boards or one replayed
/// recording could lock the link forever. The price has two parts:
///
/// * It cannot tell how long a frame has been on its way; order alone protects it. A recording that this
///   end never heard is accepted, once and in order.
///
/// * A peer with a wrong clock takes it along, by up to [`Clock::MAX_STEP`] in all until a restart. It never goes back
///   behind what it has accepted and stamped. Until that time has come, peers with the right time reject its frames.
///   After a restart it rejects theirs. A new key ends that: [`Clock::begin`].
///
/// A board that reads a clock does not pay it.
///
/// All moments of the timer are ticks of 10 microseconds, from anywhere, and never go back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Clock {
    /// The time when the timer showed `since`.
    time: Timestamp,
    since: u64,
    /// Whether a trusted source set it, when the timer showed `set`.
    synced: bool,
    /// When it was last set, or began. Steps and slews are counted from here.
    set: u64,
    /// Ticks that bounded sources have moved it since.
    stepped: u64,
    /// Ticks that peers have slewed it since, either way.
    slewed: u64,
    drift: u32,
    /// The time from which peers may take it ahead, when the timer showed `anchored`. Before [`Clock::RELEASE`]: nobody
    /// has said yet what time it is.
    anchor: Timestamp,
    anchored: u64,
    ceiling: Timestamp,
    /// The latest stamp that it has followed: it does not go back behind it.
    latest: Timestamp,
}

impl Clock {
    /// The most that bounded sources move the clock until a trusted one sets it: a second, in ticks of 10
    /// microseconds.
    pub const MAX_BOUNDED_STEP: u64 = TICKS_PER_SECOND;

    /// The most that peers take an unsynced clock forward, in all frames until a restart or a new key: 365 days, in
    /// ticks of 10 microseconds. A board without a clock that was off for longer needs a new key.
    ///
    /// A clock that began with a time before [`Clock::RELEASE`], and that nobody has told the time, has nothing to count
    /// from. It is bounded by the ceiling alone: an old recording must not be what it counts from.
    pub const MAX_STEP: u64 = 365 * 24 * 3600 * TICKS_PER_SECOND;

    /// The beginning of 2026: before this version was made, so before any time that is right.
    pub const RELEASE: Timestamp = year(1_767_225_600);

    /// The beginning of 2046, 20 years later, unless [said otherwise](Clock::until): nothing sets the clock beyond it.
    /// So no frame and no source uses up the stamps of a key, which end in 2104.
    pub const CEILING: Timestamp = year(2_398_377_600);

    /// How wrong a timer on a crystal may be, unless [said otherwise](Clock::drifting): one tick in 2^12,
    /// which is 244 parts in a million.
    pub const CRYSTAL: u32 = 12;

    /// A clock that nobody has set. It begins with `earliest`, a time that has certainly passed: the mark
    /// from before the restart less the [`RESERVATION`], or [`Timestamp::ZERO`].
    #[must_use]
    pub const fn unsynced(earliest: Timestamp, timer: u64) -> Self {
        Self {
            time: earliest,
            since: timer,
            synced: false,
            set: timer,
            stepped: 0,
            slewed: 0,
            drift: Self::CRYSTAL,
            anchor: earliest,
            anchored: timer,
            ceiling: Self::CEILING,
            latest: Timestamp::ZERO,
        }
    }

    /// The same clock, which nothing sets beyond `ceiling`: when the firmware was built and some years more.
    #[must_use]
    pub const fn until(mut self, ceiling: Timestamp) -> Self {
        self.ceiling = ceiling;
        self
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
    pub const fn sync(&self, timer: u64) -> SyncState {
        if self.synced && timer.saturating_sub(self.set) <= self.holdover() {
            SyncState::Synced
        } else {
            SyncState::Unsynced
        }
    }

    /// How long a trusted source is believed without being asked again, in ticks of 10 microseconds: 8
    /// hours and a half on a crystal.
    ///
    /// After this time two such clocks are at most half of [`Window::ONE_MINUTE`] apart. Each is off by
    /// what it may drift, and by as much again as peers may have slewed it.
    #[must_use]
    pub const fn holdover(&self) -> u64 {
        (Window::ONE_MINUTE.past / 8) << self.drift
    }

    /// Beyond which nothing sets it.
    #[must_use]
    pub const fn ceiling(&self) -> Timestamp {
        self.ceiling
    }

    /// Whether `time` may be right: from [`Clock::RELEASE`] to the ceiling.
    #[must_use]
    pub fn is_plausible(&self, time: Timestamp) -> bool {
        (Self::RELEASE..=self.ceiling).contains(&time)
    }

    /// Takes `time` from `source`. Returns the ticks that the clock went forward.
    ///
    /// A bounded source moves it by [`Clock::MAX_BOUNDED_STEP`] in all until a trusted one sets it, however
    /// often it is asked. A time behind the clock changes nothing, unless the source is trusted.
    /// [`Timestamp::ZERO`], and what lies beyond the ceiling, never changes anything.
    pub fn update(&mut self, source: TimeSource, time: Timestamp, timer: u64) -> u64 {
        if time == Timestamp::ZERO || time > self.ceiling {
            return 0;
        }
        let ahead = time.ticks_since(self.now(timer));
        match source {
            TimeSource::Trusted => {
                self.restart(time, timer);
                self.synced = true;
                ahead
            }
            TimeSource::Bounded => {
                let step = ahead.min(Self::MAX_BOUNDED_STEP.saturating_sub(self.stepped));
                self.time = self.now(timer).saturating_add(step);
                self.since = timer;
                self.stepped = self.stepped.saturating_add(step);
                step
            }
        }
    }

    /// A new key is in use, with `initial` as its first timestamp, such as the `initial_timestamp` of a
    /// [`SetupSigning`](crate::SetupSigning). A clock that is not synced begins anew there, if the time
    /// [may be right](Clock::is_plausible); whatever took it away before has no effect any longer. It is not
    /// synced by it, and a synced one is not touched.
    pub fn begin(&mut self, initial: Timestamp, timer: u64) {
        if self.sync(timer) == SyncState::Unsynced && self.is_plausible(initial) {
            self.restart(initial, timer);
        }
    }

    /// The newest key came again, with `initial` as the time now: a clock that is not synced shows it at least, if it
    /// [may be right](Clock::is_plausible).
    pub fn raise(&mut self, initial: Timestamp, timer: u64) {
        if initial > self.now(timer) {
            self.begin(initial, timer);
        }
    }

    const fn restart(&mut self, time: Timestamp, timer: u64) {
        let (drift, ceiling) = (self.drift, self.ceiling);
        *self = Self::unsynced(time, timer).drifting(drift).until(ceiling);
    }

    /// What follows is signed with another key: it may take the clock back.
    pub const fn follow_anew(&mut self) {
        self.latest = Timestamp::ZERO;
    }

    /// How far peers can take a clock that is not synced: [`Clock::MAX_STEP`] beyond where it would be without them,
    /// and never beyond the ceiling.
    #[must_use]
    pub fn limit(&self, timer: u64) -> Timestamp {
        if self.anchor < Self::RELEASE {
            return self.ceiling;
        }
        let running = timer.saturating_sub(self.anchored);
        let limit = self
            .anchor
            .saturating_add(running.saturating_add(Self::MAX_STEP));
        limit.min(self.ceiling)
    }

    /// The moment to compare `stamp`, of an authentic frame, with. A synced clock gives its time. An
    /// unsynced one gives the stamp itself, but no more than its [`limit`](Clock::limit).
    #[must_use]
    pub fn reference_time(&self, stamp: Timestamp, timer: u64) -> Timestamp {
        match self.sync(timer) {
            SyncState::Synced => self.now(timer),
            SyncState::Unsynced => stamp.min(self.limit(timer)),
        }
    }

    /// Learns from a frame that was accepted.
    pub fn on_accepted(&mut self, frame: &Verified<'_>, timer: u64) {
        let stamp = frame.stamp().timestamp;
        let now = self.now(timer);
        self.latest = self.latest.max(stamp);
        match self.sync(timer) {
            SyncState::Unsynced => {
                let latest = stamp.saturating_add(RESERVATION);
                let least = earlier(self.latest, RESERVATION);
                self.time = now.clamp(earlier(stamp, RESERVATION), latest).max(least);
                self.since = timer;
            }
            SyncState::Synced => {
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
}

#[cfg(kani)]
#[cfg_attr(test, mutants::skip)]
impl Clock {
    /// For proofs: anchored there, set then by a trusted source or not, and moved so far since by bounded sources and by
    /// peers.
    #[must_use]
    pub const fn holding(
        mut self,
        anchor: (Timestamp, u64),
        set: (u64, bool),
        moved: [u64; 2],
        latest: Timestamp,
    ) -> Self {
        self.latest = latest;
        (self.anchor, self.anchored) = anchor;
        (self.set, self.synced) = set;
        [self.stepped, self.slewed] = moved;
        self
    }
}

/// A moment in seconds since 1970, which lies in the range.
const fn year(unix_seconds: u64) -> Timestamp {
    match Timestamp::from_unix_seconds(unix_seconds) {
        Some(time) => time,
        None => Timestamp::MAX,
    }
}

/// `ticks` before `time`, at least the beginning of time.
fn earlier(time: Timestamp, ticks: u64) -> Timestamp {
    let ticks = time.ticks().saturating_sub(ticks);
    Timestamp::from_ticks(ticks).unwrap_or(Timestamp::ZERO)
}
