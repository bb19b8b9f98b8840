//! The high-water mark, stored ahead of use: what was used before a restart is not used after it.

use core::fmt;

use embedded_storage::nor_flash::NorFlash;

use crate::error::{OpenError, StoreError};
use crate::journal::{Contents, Journal, Region};
use crate::record::Binding;

/// Bytes of a mark in its record, little-endian.
pub const MARK_SIZE: usize = 8;

/// Why there is no mark to begin at. Nothing may be used. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MarkError {
    /// The region cannot hold one.
    Open(OpenError),
    /// There never was one, as far as the flash tells: it is erased, or the first mark was cut. The operator
    /// has to say where the values begin: [`HighWaterMark::provision`].
    NotProvisioned,
    /// The flash is damaged, or what it holds is of another kind or belongs to another key. What was used with
    /// this key is not known: give up the key, or provision above everything that was ever used.
    Unreadable,
}

/// Why no mark is provisioned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ProvisionError {
    /// The region cannot hold one.
    Open(OpenError),
    /// It could not be stored, or not without leaving what was there before.
    Store(StoreError),
}

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

impl From<OpenError> for MarkError {
    fn from(error: OpenError) -> Self {
        Self::Open(error)
    }
}

impl From<OpenError> for ProvisionError {
    fn from(error: OpenError) -> Self {
        Self::Open(error)
    }
}

impl From<StoreError> for ProvisionError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
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
    /// The mark of `binding` that `region` of `flash` holds. Nothing is written.
    ///
    /// # Errors
    ///
    /// [`MarkError`]. There is no mark to fall back to: nothing may be used.
    pub fn open(flash: F, region: Region, binding: Binding) -> Result<Self, MarkError> {
        // It is safe to start from a mark that the next restart will perhaps not find. Before a value at or
        // above it is used, another mark is stored.
        let (journal, contents) = Journal::open(flash, region, binding)?;
        let stored = match contents {
            Contents::Record(mark) => u64::from_le_bytes(mark),
            Contents::Blank | Contents::Interrupted => return Err(MarkError::NotProvisioned),
            Contents::Unreadable => return Err(MarkError::Unreadable),
        };
        Ok(Self { journal, stored })
    }

    /// Stores the first mark of `binding`, which says that every value from `first` on is unused. It takes the
    /// place of whatever the region holds. So only for a key that is new, or on an operator's word: see
    /// [`Journal::provision`].
    ///
    /// # Errors
    ///
    /// [`ProvisionError`].
    pub fn provision(
        flash: F,
        region: Region,
        binding: Binding,
        first: u64,
    ) -> Result<Self, ProvisionError> {
        let (mut journal, _) = Journal::open(flash, region, binding)?;
        journal.provision(&first.to_le_bytes())?;
        Ok(Self {
            journal,
            stored: first,
        })
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

    /// How often each page was erased so far: [`Journal::erases`].
    #[must_use]
    pub const fn erases(&self) -> u32 {
        self.journal.erases()
    }

    /// The flash, for what else it holds.
    pub fn into_flash(self) -> F {
        self.journal.into_flash()
    }
}

impl fmt::Display for MarkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Open(error) => error.fmt(f),
            Self::NotProvisioned => f.write_str("the flash holds no mark: none was provisioned"),
            Self::Unreadable => f.write_str("the mark in flash is damaged, or of another key"),
        }
    }
}

impl fmt::Display for ProvisionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Open(error) => error.fmt(f),
            Self::Store(error) => error.fmt(f),
        }
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

impl core::error::Error for MarkError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Open(error) => Some(error),
            Self::NotProvisioned | Self::Unreadable => None,
        }
    }
}

impl core::error::Error for ProvisionError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Open(error) => Some(error),
            Self::Store(error) => Some(error),
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
