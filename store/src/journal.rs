//! Records in flash, of which the newest counts, whole, whenever the power fails.

use core::fmt;

use embedded_storage::nor_flash::NorFlash;
use zeroize::Zeroize;

use crate::error::{OpenError, StoreError};
use crate::pages::{COPIES_FIRST, Pages};
use crate::record::{Binding, TRAILER_SIZE};

/// Two equal pages of flash, one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Region {
    /// Offset of the first page in the flash, in bytes; a multiple of what is erased at once.
    pub start: u32,
    /// Bytes of each page; a multiple of what is erased at once. Twice as many bytes wear half as fast.
    pub page_size: u32,
}

/// What is found in a region. A record that is lost is never taken for one that never was.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Contents<const N: usize> {
    /// Nothing: every place for a record is erased.
    Blank,
    /// Fewer than four places are not blank, and none can be read: [`Journal::provision`] was cut before it had
    /// stored anything.
    Interrupted,
    /// Something, and nothing of it can be read: it is damaged, or of another kind, or belongs to another key.
    Unreadable,
    /// What was stored last.
    Record([u8; N]),
}

/// Without the record, which may be a secret.
impl<const N: usize> fmt::Debug for Contents<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Blank => "Blank",
            Self::Interrupted => "Interrupted",
            Self::Unreadable => "Unreadable",
            Self::Record(_) => "Record(..)",
        })
    }
}

/// A journal of records with `N` bytes each, in two pages of flash.
///
/// A record is its `N` bytes, a sequence number and a checksum over its [`Binding`] and both. Records are
/// appended to one page. When it is full, the other is erased and written from its beginning. The sequence
/// number counts places, also those where a write failed, so that no two records have the same. The record with
/// the highest number counts. Each is written twice, in two places. So
///
/// * what was stored last is in flash at every moment: the page that holds it is never erased;
/// * a write that the power cuts leaves the record before it;
/// * a word that cannot be read makes its record garbage, and the other copy counts;
/// * a record that does not read as it was written, or that the flash reports as failed, is written again
///   in the next place.
pub struct Journal<F, const N: usize> {
    pages: Pages<F>,
}

/// Without the flash, which holds what may be a secret.
impl<F, const N: usize> fmt::Debug for Journal<F, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Journal")
            .field("region", &self.pages.region)
            .field("newest", &self.pages.newest)
            .field("next", &self.pages.next)
            .finish_non_exhaustive()
    }
}

impl<F: NorFlash, const N: usize> Journal<F, N> {
    /// The journal of `binding` in `region` of `flash`, and what was stored there last. Nothing is written.
    ///
    /// What a cut write has left may be found by one restart and not by the next. Store it again before you
    /// rely on it for longer than this run.
    ///
    /// # Errors
    ///
    /// [`OpenError`]. A record that cannot be read is no error: it does not count.
    pub fn open(
        flash: F,
        region: Region,
        binding: Binding,
    ) -> Result<(Self, Contents<N>), OpenError> {
        let mut pages = Pages::new(flash, region, binding, N + TRAILER_SIZE)?;
        let mut newest = [0; N];
        let found = pages.scan(&mut newest);
        let contents = match pages.used {
            _ if found => Contents::Record(newest),
            0 => Contents::Blank,
            used if used < COPIES_FIRST => Contents::Interrupted,
            _ => Contents::Unreadable,
        };
        Ok((Self { pages }, contents))
    }

    /// Whether nothing was ever stored: [`Contents::Blank`] or [`Contents::Interrupted`], and no write since.
    /// What cannot be read counts as something.
    pub const fn is_empty(&self) -> bool {
        self.pages.newest.is_none() && self.pages.used < COPIES_FIRST
    }

    /// The flash, for what else it holds.
    pub fn into_flash(self) -> F {
        self.pages.flash
    }

    /// What was stored last, read again. `None` if nothing was, or if it can no longer be read.
    pub fn newest(&mut self) -> Option<[u8; N]> {
        let mut newest = [0; N];
        self.pages.read_newest(&mut newest).then_some(newest)
    }

    /// How often each page was erased so far, rounded up: half of all erases, as far as the sequence numbers tell
    /// of them. Flash is worn out after what its data sheet says, often 10,000.
    pub const fn erases(&self) -> u32 {
        self.pages.erases()
    }

    /// Stores the first record, or starts anew on purpose, whatever the region holds.
    ///
    /// If nothing was stored before, nothing is erased. The record is written twice at least, and until four places
    /// are in use. So up to three cuts in a row leave [`Contents::Blank`], [`Contents::Interrupted`] or the record. Otherwise it does what
    /// [`Journal::replace`] does. If it is cut then, the region may still hold a part of what was there, as far
    /// back as its page goes: who returns to the key before must provision for it too.
    ///
    /// # Errors
    ///
    /// [`StoreError`].
    pub fn provision(&mut self, contents: &[u8; N]) -> Result<(), StoreError> {
        self.pages.provision(contents)
    }

    /// Stores `contents`: afterwards they are [`Journal::newest`], also after a restart, and also if one word
    /// cannot be read any more. The first record of all is stored by [`Journal::provision`].
    ///
    /// Takes two writes of `N + 8` bytes, four in a page that is erased; an erase before one of them when a page
    /// is full.
    ///
    /// # Errors
    ///
    /// [`StoreError`]. What was stored before still counts.
    pub fn append(&mut self, contents: &[u8; N]) -> Result<(), StoreError> {
        self.pages.append(contents)
    }

    /// Stores `contents`, four times, and erases everything that was stored before: for keys that are given up.
    ///
    /// Takes two erases and four writes. What is in a page that no longer erases is overwritten with zeros.
    ///
    /// # Errors
    ///
    /// [`StoreError`]. With [`StoreError::Remains`], `contents` count already, and something older can still be
    /// read from the flash.
    pub fn replace(&mut self, contents: &[u8; N]) -> Result<(), StoreError> {
        self.pages.replace(contents)
    }

    /// Erases everything but what was stored last: stores that again, and [replaces](Journal::replace) all by it;
    /// nothing if there is nothing else. It finishes a replacement that the power cut.
    ///
    /// # Errors
    ///
    /// [`StoreError`]. What was stored last still counts.
    pub fn forget(&mut self) -> Result<(), StoreError> {
        let mut newest = [0; N];
        let forgotten = if self.pages.read_newest(&mut newest) {
            self.pages.forget(&newest)
        } else if self.pages.newest.is_some() {
            // Nothing is erased for what cannot be read.
            Err(StoreError::Write)
        } else {
            Ok(())
        };
        newest.zeroize();
        forgotten
    }
}
