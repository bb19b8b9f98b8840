//! The time and the memory of one end of a link: a clock, and a mark in flash.

use core::{fmt, mem};

use embedded_storage::nor_flash::NorFlash;
use mavlink_signing::{
    Clock, Fingerprint, KeyRing, KeySlot, LinkClock, NotStored, Profile, RESERVATION, SyncState,
    TICKS_PER_SECOND, TimeSource, Timestamp, Verified, Window,
};
use mavseal_store::{
    Binding, Contents, HighWaterMark, Journal, MarkError, OpenError, ProvisionError, Region,
};

/// How far beyond the timestamps in use the first mark after a restart is stored: 10 milliseconds, in ticks
/// of 10 microseconds. No end starts again as fast.
pub const FIRST_RESERVATION: u64 = TICKS_PER_SECOND / 100;

/// What the records of a mark of timestamps are.
const KIND: u8 = 1;

/// Why a time that was told is not believed. The source is at fault. The clock is as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum TimeError {
    /// It has passed: this end has used or accepted timestamps more than the [`RESERVATION`] and the window of
    /// [`Window::ONE_MINUTE`] behind which it lies. A real-time clock without a battery tells such times. Or a wrong
    /// source was believed before.
    BehindMark,
    /// It lies beyond the [ceiling](Clock::CEILING).
    BeyondCeiling,
}

impl fmt::Display for TimeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::BehindMark => "the time told has passed: later timestamps have been used",
            Self::BeyondCeiling => "the time told is too far ahead to be right",
        })
    }
}

impl core::error::Error for TimeError {}

/// A [`Clock`] on a timer, and for each key a [`HighWaterMark`] above every timestamp that this end has used or
/// accepted under it. [`LinkMemory`](crate::LinkMemory) opens it together with the keys.
///
/// After a restart, stamps begin at the mark, and no frame from before it is accepted, of no stream. Stamper and
/// receiver need not know of it: [`LinkClock::floor`].
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
///
/// A new key has a mark of its own, which begins with it: [`LinkClock::begin_key`]. Whoever has an old key cannot
/// spoil it.
pub struct PersistentClock<F, T> {
    clock: Clock,
    marks: [KeyMark<F>; 2],
    /// Where the newest key is, and the one that the clock follows.
    newest: KeySlot,
    followed: KeySlot,
    region: Region,
    timer: T,
    started: u64,
}

/// The mark of the key in one slot.
enum KeyMark<F> {
    /// There is no key in the slot.
    Unused(F),
    /// Its mark, and what it was at the start, or the first timestamp of a new key; beyond 48 bits if all are used up.
    Of(HighWaterMark<F>, u64),
    /// The flash failed when a new key was to be remembered.
    Failed,
}

impl<F: NorFlash> KeyMark<F> {
    const fn floor(&self) -> Timestamp {
        match self {
            Self::Of(_, floor) => match Timestamp::from_ticks(*floor) {
                Some(floor) => floor,
                None => Timestamp::MAX,
            },
            _ => Timestamp::MAX,
        }
    }

    /// Above everything used or accepted.
    fn stored(&self) -> u64 {
        match self {
            Self::Of(mark, _) => mark.get(),
            _ => 0,
        }
    }
}

/// What the flash knows of a key that is provisioned again: it goes on there. The flash is handed back, so that all code
/// exists for one type of it.
fn known<F: NorFlash>(flash: F, region: Region, key: Fingerprint) -> Result<(F, u64), OpenError> {
    let (journal, contents) = Journal::open(flash, region, binding(key))?;
    let stored = match contents {
        Contents::Record(mark) => u64::from_le_bytes(mark),
        _ => 0,
    };
    Ok((journal.into_flash(), stored))
}

fn binding(key: Fingerprint) -> Binding {
    Binding::new(KIND, key.0)
}

impl<F: NorFlash, T: FnMut() -> u64> PersistentClock<F, T> {
    /// The marks of `keys` in `flashes`, one for the key in each slot, with a clock that nobody has told the time yet.
    /// `timer` gives ticks of 10 microseconds that never go back.
    ///
    /// # Errors
    ///
    /// [`MarkError`]: a mark was lost, or belongs to another key. Nothing may be signed or accepted then.
    pub fn open<P: Profile>(
        flashes: [F; 2],
        region: Region,
        keys: &KeyRing<P>,
        timer: T,
    ) -> Result<Self, MarkError> {
        let mark = |flash, slot| -> Result<_, MarkError> {
            match keys.key(slot) {
                None => Ok(KeyMark::Unused(flash)),
                Some(key) => {
                    let mark = HighWaterMark::open(flash, region, binding(key.fingerprint()))?;
                    let floor = mark.get();
                    Ok(KeyMark::Of(mark, floor))
                }
            }
        };
        let [a, b] = flashes;
        let marks = [mark(a, KeySlot::A)?, mark(b, KeySlot::B)?];
        Ok(Self::with(marks, region, keys.newest_slot(), timer))
    }

    /// The same for a first key, with which nothing was ever signed or accepted: whatever `flashes` hold of others is
    /// forgotten. If they know this very key, it goes on where it was.
    ///
    /// # Errors
    ///
    /// [`ProvisionError`].
    pub fn provision<P: Profile>(
        flashes: [F; 2],
        region: Region,
        keys: &KeyRing<P>,
        timer: T,
    ) -> Result<Self, ProvisionError> {
        let [mut a, mut b] = flashes;
        // A key that was in use before goes on where it was, in whichever slot.
        let mut firsts = [None; 2];
        for (slot, first) in [KeySlot::A, KeySlot::B].into_iter().zip(&mut firsts) {
            if let Some(key) = keys.key(slot) {
                let key = key.fingerprint();
                let (in_a, in_b);
                (a, in_a) = known(a, region, key)?;
                (b, in_b) = known(b, region, key)?;
                *first = Some((key, in_a.max(in_b)));
            }
        }
        let mark = |flash, first| match first {
            None => Ok(KeyMark::Unused(flash)),
            Some((key, first)) => {
                let mark = HighWaterMark::provision(flash, region, binding(key), first)?;
                Ok::<_, ProvisionError>(KeyMark::Of(mark, first))
            }
        };
        let [first_a, first_b] = firsts;
        let marks = [mark(a, first_a)?, mark(b, first_b)?];
        Ok(Self::with(marks, region, keys.newest_slot(), timer))
    }

    fn with(marks: [KeyMark<F>; 2], region: Region, newest: KeySlot, mut timer: T) -> Self {
        let earliest = newest
            .of(&marks)
            .floor()
            .ticks()
            .saturating_sub(RESERVATION);
        let earliest = Timestamp::from_ticks(earliest).unwrap_or(Timestamp::ZERO);
        let started = timer();
        Self {
            clock: Clock::unsynced(earliest, started),
            marks,
            newest,
            followed: newest,
            region,
            timer,
            started,
        }
    }

    /// The same on a timer that is not a crystal's: see [`Clock::drifting`].
    #[must_use]
    pub fn drifting(mut self, drift: u32) -> Self {
        self.clock = self.clock.drifting(drift);
        self
    }

    /// The same, with another ceiling than [`Clock::CEILING`].
    #[must_use]
    pub fn until(mut self, ceiling: Timestamp) -> Self {
        self.clock = self.clock.until(ceiling);
        self
    }

    /// Takes `time` from `source`: [`Clock::update`]. Ask a trusted one again before [`Clock::holdover`] is over;
    /// hourly, for instance.
    ///
    /// # Errors
    ///
    /// [`TimeError`]. Believed, such a source would make this end reject every honest frame, or be rejected.
    pub fn update(&mut self, source: TimeSource, time: Timestamp) -> Result<u64, TimeError> {
        let latest = time.saturating_add(RESERVATION + Window::ONE_MINUTE.ahead);
        let tells = source == TimeSource::Trusted && time != Timestamp::ZERO;
        if tells && latest.ticks() < self.newest.of(&self.marks).stored() {
            return Err(TimeError::BehindMark);
        }
        let now = (self.timer)();
        if tells && time > self.clock.ceiling() {
            return Err(TimeError::BeyondCeiling);
        }
        Ok(self.clock.update(source, time, now))
    }

    /// Whether the clock knows the time.
    pub fn sync(&mut self) -> SyncState {
        let now = (self.timer)();
        self.clock.sync(now)
    }

    /// How often each page of the marks has been erased: a flash of 10,000 erases should be replaced before.
    #[must_use]
    pub fn erases(&self) -> u32 {
        let erases = self.marks.iter().map(|mark| match mark {
            KeyMark::Of(mark, _) => mark.erases(),
            _ => 0,
        });
        erases.max().unwrap_or(0)
    }

    /// The flashes of both slots; `None` for one that failed.
    pub fn into_flashes(self) -> [Option<F>; 2] {
        self.marks.map(|mark| match mark {
            KeyMark::Unused(flash) => Some(flash),
            KeyMark::Of(mark, _) => Some(mark.into_flash()),
            KeyMark::Failed => None,
        })
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

    fn floor(&self, slot: KeySlot) -> Timestamp {
        slot.of(&self.marks).floor()
    }

    /// Also rejects what lies before the floor, and a slot without key.
    fn reserve(&mut self, slot: KeySlot, stamp: Timestamp) -> Result<(), NotStored> {
        let running = (self.timer)().saturating_sub(self.started);
        let ahead = (running / 8).clamp(FIRST_RESERVATION, RESERVATION);
        // A mark behind the last timestamp would end the key before its time.
        let ahead = ahead.min(Timestamp::MAX.ticks_since(stamp));
        match slot.of_mut(&mut self.marks) {
            KeyMark::Of(mark, floor) if stamp.ticks() >= *floor => {
                let reserved = mark.reserve(stamp.ticks(), ahead);
                reserved.map_err(|_| NotStored)
            }
            _ => Err(NotStored),
        }
    }

    /// Where nobody said what time it is, or it cannot be right, the new key goes on where the one in use is: it may
    /// have been in use before.
    fn begin_key(
        &mut self,
        slot: KeySlot,
        key: Fingerprint,
        initial: Timestamp,
    ) -> Result<Timestamp, NotStored> {
        let timer = (self.timer)();
        let used = self.marks.iter().map(KeyMark::stored).max().unwrap_or(0);
        let synced = self.clock.sync(timer) == SyncState::Synced;
        let first = match (self.clock.is_plausible(initial), synced) {
            (true, true) => initial.min(self.clock.now(timer)),
            (true, false) => initial,
            (false, true) => self.clock.now(timer),
            (false, false) => Timestamp::from_ticks(used).unwrap_or(Timestamp::MAX),
        };
        let mark = slot.of_mut(&mut self.marks);
        let flash = match mem::replace(mark, KeyMark::Failed) {
            KeyMark::Unused(flash) => flash,
            KeyMark::Of(mark, _) => mark.into_flash(),
            KeyMark::Failed => return Err(NotStored),
        };
        let (flash, stored) = known(flash, self.region, key).map_err(|_| NotStored)?;
        let first = first.max(Timestamp::from_ticks(stored).unwrap_or(Timestamp::MAX));
        let begun = HighWaterMark::provision(flash, self.region, binding(key), first.ticks());
        *mark = KeyMark::Of(begun.map_err(|_| NotStored)?, first.ticks());
        self.newest = slot;
        self.clock.begin(initial, timer);
        Ok(first)
    }

    fn repeat_key(&mut self, initial: Timestamp, settled: bool) {
        let timer = (self.timer)();
        if settled {
            self.clock.raise(initial, timer);
        } else {
            self.clock.begin(initial, timer);
        }
    }

    fn on_accepted(&mut self, frame: &Verified<'_>) {
        let now = (self.timer)();
        if self.followed != frame.key().slot {
            self.followed = frame.key().slot;
            self.clock.follow_anew();
        }
        self.clock.on_accepted(frame, now);
    }
}

impl<F, T> fmt::Debug for PersistentClock<F, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PersistentClock")
            .field("clock", &self.clock)
            .finish_non_exhaustive()
    }
}
