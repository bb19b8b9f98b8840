//! Why a region holds no journal, and why a record is not stored.

use core::fmt;

use embedded_storage::nor_flash::NorFlashErrorKind;

/// Why a region cannot hold a journal. The layout of the flash is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum OpenError {
    /// Start or size of the pages is no multiple of what is erased at once, or the size is zero.
    NotAligned,
    /// The region ends after the end of the flash.
    OutOfBounds,
    /// A record is not a whole number of the flash's words, or a page has no room for four of them. Or it has
    /// more than 128 bytes, with its 8 of sequence number and checksum.
    RecordSize,
}

/// Why a record is not stored. The flash is at fault, or worn out.
///
/// What was stored before is still there, but for [`StoreError::Remains`]. After a restart either that is found
/// or what was to be stored: a failed write may have left its record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StoreError {
    /// The flash failed to erase a page, for this reason.
    Erase(#[cfg_attr(feature = "defmt", defmt(Debug2Format))] NorFlashErrorKind),
    /// What was written reads as something else, or not at all, in several places.
    Write,
    /// All sequence numbers are used up: 2^32 - 1 places.
    Exhausted,
    /// What was to be stored is stored and counts. But something older can still be read from the flash: it
    /// could neither be erased nor overwritten.
    Remains,
}

impl fmt::Display for OpenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotAligned => "the pages are not whole units of what the flash erases",
            Self::OutOfBounds => "the pages end behind the flash",
            Self::RecordSize => "a record is not whole words of the flash, or too long",
        })
    }
}

impl fmt::Display for StoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Erase(kind) => write!(f, "the flash does not erase a page: {kind}"),
            Self::Write => f.write_str("the flash does not hold what is written to it"),
            Self::Exhausted => f.write_str("all sequence numbers are used up"),
            Self::Remains => f.write_str("the flash keeps what was to be erased from it"),
        }
    }
}

impl core::error::Error for OpenError {}
impl core::error::Error for StoreError {}
