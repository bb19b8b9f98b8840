//! The high-water mark, stored ahead of use: what was used before a restart is not used after it.

use core::fmt;

use embedded_storage::nor_flash::NorFlash;

use crate::journal::{Journal, OpenError, Region, StoreError};

/// Bytes of a mark in its record, little-endian.
pub const MARK_SIZE: usize = 8;

/// Why a value must not be used. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ReserveError {
    /// No mark above it could be stored.
    Store(StoreError),
    /// There is no mark above 2^64 - 1.
    Exhausted,
}

impl From<StoreError> for ReserveError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

/// A number in flash above every value that has been used: timestamps, counters, epochs.
///
/// A value is used only after [`HighWaterMark::reserve`] has agreed. After a restart, all that was used
/// before lies below the mark that is found. The price: values that were reserved and not used are lost.
#[derive(Debug)]
pub struct HighWaterMark<F> {
    journal: Journal<F, MARK_SIZE>,
    stored: u64,
}

impl<F: NorFlash> HighWaterMark<F> {
    /// The mark that `region` of `flash` holds. It is 0 if there never was one, or none can be read, as
    /// after a cut in the very first write. Nothing is written.
    ///
    /// # Errors
    ///
    /// [`OpenError`].
    pub fn open(flash: F, region: Region) -> Result<Self, OpenError> {
        // It is safe to start from a mark that the next restart will perhaps not find. Before a value at or
        // above it is used, another mark is stored.
        let (journal, newest) = Journal::open(flash, region)?;
        let stored = newest.map_or(0, u64::from_le_bytes);
        Ok(Self { journal, stored })
    }

    /// Above every value that was ever used. After a restart everything starts here.
    #[must_use]
    pub const fn get(&self) -> u64 {
        self.stored
    }

    /// Makes sure that the mark is above `value`, which may then be used. If it is not yet, a mark of
    /// `value + ahead` is stored first, at least `value + 1`.
    ///
    /// # Errors
    ///
    /// [`ReserveError`]: `value` must not be used.
    pub fn reserve(&mut self, value: u64, ahead: u64) -> Result<(), ReserveError> {
        if value < self.stored {
            return Ok(());
        }
        let least = value.checked_add(1).ok_or(ReserveError::Exhausted)?;
        let mark = value.saturating_add(ahead).max(least);
        self.journal.append(&mark.to_le_bytes())?;
        self.stored = mark;
        Ok(())
    }

    /// The flash, for what else it holds.
    pub fn into_flash(self) -> F {
        self.journal.into_flash()
    }
}

impl fmt::Display for ReserveError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Store(error) => error.fmt(f),
            Self::Exhausted => f.write_str("all values are used up"),
        }
    }
}

impl core::error::Error for ReserveError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Store(error) => Some(error),
            Self::Exhausted => None,
        }
    }
}
