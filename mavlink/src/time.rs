//! Signing time: 48-bit timestamps in ticks of 10 microseconds, windows and stamps.

use crate::error::{SignError, VerifyError};
use crate::field::TIMESTAMP_SIZE;
use crate::key_ring::KeySlot;

/// Ticks of 10 microseconds in a second.
pub const TICKS_PER_SECOND: u64 = 100_000;

/// How far beyond the timestamps in use a mark is stored at most: 10 seconds, in ticks of 10 microseconds.
///
/// An end may reject honest frames for so long after a restart. Twice as long would wear the flash half as
/// much. It is at most half of [`Window::ONE_MINUTE`]'s `ahead`, so that frames stamped from the mark on
/// are accepted at once.
pub const RESERVATION: u64 = 10 * TICKS_PER_SECOND;

const _: () = assert!(RESERVATION <= Window::ONE_MINUTE.ahead / 2);

/// Microseconds in a tick.
const MICROS_PER_TICK: u64 = 10;
/// 2015-01-01T00:00:00Z in seconds since 1970, the zero of signing time.
const EPOCH_UNIX_SECONDS: u64 = 1_420_070_400;
const EPOCH_UNIX_MICROS: u64 = EPOCH_UNIX_SECONDS * 1_000_000;

/// Signing time: ticks of 10 microseconds since 2015-01-01T00:00:00Z, at most 2^48 - 1.
///
/// The range lasts until 2104 (MAVLink guide, "Message Signing", Timestamp Handling).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Timestamp(u64);

impl Timestamp {
    /// The epoch itself.
    pub const ZERO: Self = Self(0);
    /// The last moment that 48 bits can name.
    pub const MAX: Self = Self((1 << 48) - 1);

    /// A timestamp from `ticks` of 10 microseconds since 2015; `None` beyond 48 bits.
    #[must_use]
    pub const fn from_ticks(ticks: u64) -> Option<Self> {
        if ticks <= Self::MAX.0 {
            Some(Self(ticks))
        } else {
            None
        }
    }

    /// A timestamp from microseconds since 1970, rounded down to a tick; `None` before 2015 and
    /// beyond 48 bits.
    #[must_use]
    pub const fn from_unix_micros(micros: u64) -> Option<Self> {
        match micros.checked_sub(EPOCH_UNIX_MICROS) {
            Some(since_epoch) => Self::from_ticks(since_epoch / MICROS_PER_TICK),
            None => None,
        }
    }

    /// A timestamp from whole seconds since 1970; `None` before 2015 and beyond 48 bits. Without a division
    /// of 64 bits, which takes a small part a kilobyte of flash.
    #[must_use]
    pub const fn from_unix_seconds(seconds: u64) -> Option<Self> {
        match seconds.checked_sub(EPOCH_UNIX_SECONDS) {
            Some(since_epoch) => Self::from_ticks(since_epoch.saturating_mul(TICKS_PER_SECOND)),
            None => None,
        }
    }

    /// Ticks of 10 microseconds since 2015.
    #[must_use]
    pub const fn ticks(self) -> u64 {
        self.0
    }

    /// Microseconds since 1970.
    #[must_use]
    pub const fn unix_micros(self) -> u64 {
        EPOCH_UNIX_MICROS + self.0 * MICROS_PER_TICK
    }

    /// This moment and `ticks` more, at most [`Timestamp::MAX`].
    #[must_use]
    pub const fn saturating_add(self, ticks: u64) -> Self {
        match Self::from_ticks(self.0.saturating_add(ticks)) {
            Some(later) => later,
            None => Self::MAX,
        }
    }

    /// Ticks from `earlier` to this moment; zero if `earlier` is later.
    #[must_use]
    pub const fn ticks_since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }

    /// The timestamp in 6 bytes, little-endian, as in a signature.
    #[must_use]
    pub const fn from_wire(wire: [u8; TIMESTAMP_SIZE]) -> Self {
        let [a, b, c, d, e, f] = wire;
        Self(u64::from_le_bytes([a, b, c, d, e, f, 0, 0]))
    }

    /// Its 6 bytes in a signature, little-endian.
    #[must_use]
    pub const fn to_wire(self) -> [u8; TIMESTAMP_SIZE] {
        let [a, b, c, d, e, f, _, _] = self.0.to_le_bytes();
        [a, b, c, d, e, f]
    }
}

/// How far a frame's timestamp may be from the receiver's clock, in ticks of 10 microseconds.
///
/// Both edges belong to the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Window {
    /// Most ticks behind the clock.
    pub past: u64,
    /// Most ticks ahead of the clock.
    pub ahead: u64,
}

impl Window {
    /// 10 seconds (1,000,000 ticks) into the past, nothing into the future.
    ///
    /// The core's default. It needs a clock that both ends share: a sender whose clock is one tick
    /// ahead of the receiver's is rejected.
    pub const STRICT: Self = Self {
        past: 10 * TICKS_PER_SECOND,
        ahead: 0,
    };

    /// 60 seconds (6,000,000 ticks) either way: the window of a link whose ends remember a mark.
    ///
    /// Past: the minute that the MAVLink guide gives a sender ("Message Signing", Timestamp Handling).
    /// Ahead: for the [`RESERVATION`] that a sender skips at a restart, and for clocks that drift. Also for
    /// bursts, in which stamps run ahead of the clock by a tick a frame.
    pub const ONE_MINUTE: Self = Self {
        past: 60 * TICKS_PER_SECOND,
        ahead: 60 * TICKS_PER_SECOND,
    };

    /// Whether `stamp` lies in the window around `now`.
    ///
    /// # Errors
    ///
    /// [`VerifyError::FromFuture`] or [`VerifyError::TooOld`].
    pub const fn check(self, stamp: Timestamp, now: Timestamp) -> Result<(), VerifyError> {
        if stamp.ticks_since(now) > self.ahead {
            Err(VerifyError::FromFuture)
        } else if now.ticks_since(stamp) > self.past {
            Err(VerifyError::TooOld)
        } else {
            Ok(())
        }
    }
}

/// The link id and timestamp that one frame is signed with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Stamp {
    /// The link, and with it the direction, that the frame is sent on.
    pub link_id: u8,
    /// When it is sent. One sender must never use it twice under one key and link id.
    pub timestamp: Timestamp,
}

/// Gives each frame of one link a timestamp greater than every one before it.
///
/// The clock is asked at every frame, so stamps do not fall behind while nothing is sent. Two frames within
/// a tick get two stamps (MAVLink guide, "Message Signing", Timestamp Handling).
///
/// It is not copied: a copy would give the same stamps again. In a burst it runs ahead of the clock by a
/// tick a frame. A receiver with [`Window::STRICT`] rejects such frames until its clock has caught up.
#[derive(Debug, PartialEq, Eq)]
pub struct Stamper {
    link_id: u8,
    slot: KeySlot,
    fresh: Fresh,
}

impl Stamper {
    /// Stamps for `link_id`, from the first moment that the clock shows.
    #[must_use]
    pub const fn new(link_id: u8) -> Self {
        Self::resume(link_id, Timestamp::ZERO)
    }

    /// Stamps for `link_id`, none before `first`: for a sender that kept a high-water mark over a restart.
    #[must_use]
    pub const fn resume(link_id: u8, first: Timestamp) -> Self {
        Self {
            link_id,
            slot: KeySlot::A,
            fresh: Fresh::from(first),
        }
    }

    /// The same stamps, for the key in this slot.
    #[must_use]
    pub const fn in_slot(mut self, slot: KeySlot) -> Self {
        self.slot = slot;
        self
    }

    /// Which key the stamps are for.
    #[must_use]
    pub const fn slot(&self) -> KeySlot {
        self.slot
    }

    /// The link that the stamps are for.
    #[must_use]
    pub const fn link_id(&self) -> u8 {
        self.link_id
    }

    /// The stamp of a frame that is sent `now`: the clock, or one more than the last stamp, whichever is
    /// later.
    ///
    /// # Errors
    ///
    /// [`SignError::TimestampsExhausted`] once 2^48 - 1 has been given: it never wraps.
    pub fn stamp(&mut self, now: Timestamp) -> Result<Stamp, SignError> {
        let stamp = self.next(now)?;
        self.fresh = Fresh::after(stamp.timestamp);
        Ok(stamp)
    }

    /// What [`Stamper::stamp`] would give; it is not used up.
    ///
    /// # Errors
    ///
    /// As [`Stamper::stamp`].
    pub fn next(&self, now: Timestamp) -> Result<Stamp, SignError> {
        let first = self.fresh.first().ok_or(SignError::TimestampsExhausted)?;
        let timestamp = first.max(now);
        Ok(Stamp {
            link_id: self.link_id,
            timestamp,
        })
    }
}

/// The timestamps that are still fresh: all from a first one on, or none at all.
///
/// Sender and receiver keep the same fact: what has been used is not used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Fresh(u64);

impl Fresh {
    pub(crate) const fn from(first: Timestamp) -> Self {
        Self(first.0)
    }

    pub(crate) const fn after(used: Timestamp) -> Self {
        Self(used.0 + 1)
    }

    /// The first fresh timestamp; `None` when [`Timestamp::MAX`] has been used.
    pub(crate) const fn first(self) -> Option<Timestamp> {
        Timestamp::from_ticks(self.0)
    }

    /// The last used timestamp; `None` when none has been.
    pub(crate) const fn used(self) -> Option<Timestamp> {
        match self.0.checked_sub(1) {
            Some(ticks) => Timestamp::from_ticks(ticks),
            None => None,
        }
    }

    pub(crate) const fn contains(self, stamp: Timestamp) -> bool {
        stamp.0 >= self.0
    }
}
