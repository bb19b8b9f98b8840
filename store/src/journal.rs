//! Records in flash, of which the newest counts, whole, whenever the power fails.

use core::fmt;

#[cfg(not(kani))]
use crc::{CRC_32_ISO_HDLC, Crc, NoTable};
use embedded_storage::nor_flash::{NorFlash, NorFlashError, NorFlashErrorKind};
use zeroize::Zeroize;

/// Bytes of a record's sequence number, little-endian.
const SEQUENCE_SIZE: usize = 4;
/// Bytes of a record's checksum, little-endian: CRC-32 over contents and sequence number.
const CHECKSUM_SIZE: usize = 4;
/// Bytes of a record after its contents: 8.
const TRAILER_SIZE: usize = SEQUENCE_SIZE + CHECKSUM_SIZE;
/// Most bytes of a record, so that it fits into a buffer on the stack. For proofs, those of a mark, as
/// every loop over it is unwound.
const MAX_RECORD_SIZE: usize = if cfg!(kani) { 16 } else { 128 };
/// What every byte of erased flash reads as.
const ERASED: u8 = 0xFF;
/// How often a record is written again, each time elsewhere, before the flash counts as broken.
const ATTEMPTS: u8 = 4;

/// CRC-32 without table: 16 bytes are checked every few seconds.
#[cfg(not(kani))]
fn checksum(covered: &[u8]) -> u32 {
    Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC).checksum(covered)
}

/// For proofs, as Kani 0.67 does not compile the crate `crc`. It depends on every byte and on its place.
#[cfg(kani)]
#[cfg_attr(test, mutants::skip)]
fn checksum(covered: &[u8]) -> u32 {
    covered
        .iter()
        .fold(!0, |sum: u32, byte| sum.rotate_left(5) ^ u32::from(*byte))
}

/// Two equal pages of flash, one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Region {
    /// Offset of the first page in the flash, in bytes; a multiple of what is erased at once.
    pub start: u32,
    /// Bytes of each page; a multiple of what is erased at once. Twice as many bytes wear half as fast.
    pub page_size: u32,
}

/// Why a region cannot hold a journal. The layout of the flash is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum OpenError {
    /// Start or size of the pages is no multiple of what is erased at once, or the size is zero.
    NotAligned,
    /// The region ends after the end of the flash.
    OutOfBounds,
    /// A record is not a whole number of the flash's words, or does not fit into a page. Or it has more
    /// than 128 bytes, with its 8 of sequence number and checksum.
    RecordSize,
}

/// Why a record is not stored. The flash is at fault, or worn out.
///
/// What was stored before is still there. After a restart either that is found or what was to be stored: a
/// failed write may have left its record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StoreError {
    /// The flash failed to erase a page, for this reason.
    Erase(#[cfg_attr(feature = "defmt", defmt(Debug2Format))] NorFlashErrorKind),
    /// What was written reads as something else, or not at all, in several places.
    Write,
    /// All sequence numbers are used up: 2^32 - 1 records.
    Exhausted,
}

/// Which record: the page, 0 or 1, and the place in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    page: u32,
    slot: u32,
}

/// What one record's place holds.
enum Found<'a> {
    Blank,
    /// A torn write, a word with a bad ECC, or half an erase.
    Garbage,
    /// Its contents and its sequence number.
    Record(&'a [u8], u32),
}

/// Where a record is read to, or written from.
type Buffer = [u8; MAX_RECORD_SIZE];

/// A journal of records with `N` bytes each, in two pages of flash.
///
/// A record is its `N` bytes, a sequence number and a checksum over both. Records are appended to one page.
/// When it is full, the other is erased and written from its beginning. The sequence number counts places,
/// also those where a write failed, so that no two records have the same. The record with the highest
/// number counts. So
///
/// * what was stored last is in flash at every moment: the page that holds it is never erased;
/// * a write that the power cuts leaves the record before it;
/// * a word that cannot be read makes its record garbage, and no other;
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
    /// The journal that `region` of `flash` holds, and what was stored there last. That is `None` if
    /// nothing ever was, or nothing can be read. Nothing is written.
    ///
    /// What a cut write has left may be found by one restart and not by the next. Store it again before you
    /// rely on it for longer than this run.
    ///
    /// # Errors
    ///
    /// [`OpenError`]. A record that cannot be read is no error: it does not count.
    pub fn open(flash: F, region: Region) -> Result<(Self, Option<[u8; N]>), OpenError> {
        let mut pages = Pages::new(flash, region, N + TRAILER_SIZE)?;
        let mut newest = [0; N];
        let found = pages.scan(&mut newest);
        Ok((Self { pages }, found.then_some(newest)))
    }

    /// Whether nothing was ever stored: every place for a record is erased. What cannot be read counts as
    /// something.
    pub const fn is_empty(&self) -> bool {
        self.pages.blank
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

    /// Stores `contents`: afterwards they are [`Journal::newest`], also after a restart.
    ///
    /// Takes one write of `N + 8` bytes; an erase before it when a page is full.
    ///
    /// # Errors
    ///
    /// [`StoreError`]. What was stored before still counts.
    pub fn append(&mut self, contents: &[u8; N]) -> Result<(), StoreError> {
        self.pages.append(contents)
    }

    /// Stores `contents` and erases everything that was stored before: for keys that are given up.
    ///
    /// Takes two erases and a write.
    ///
    /// # Errors
    ///
    /// [`StoreError`]. If the last erase fails, `contents` count already, and what was stored before
    /// can still be read from the flash.
    pub fn replace(&mut self, contents: &[u8; N]) -> Result<(), StoreError> {
        self.pages.replace(contents)
    }

    /// Erases the page that does not hold what was stored last, unless it is empty. It finishes a
    /// [`Journal::replace`] that the power cut.
    ///
    /// # Errors
    ///
    /// [`StoreError::Erase`]. What was stored last still counts.
    pub fn forget(&mut self) -> Result<(), StoreError> {
        self.pages.forget()
    }
}

/// A journal of records of any one size, so that the code exists once for all sizes.
struct Pages<F> {
    flash: F,
    region: Region,
    /// Bytes of a record.
    size: u32,
    /// Records in a page.
    slots: u32,
    /// Every place was blank, and none was written since.
    blank: bool,
    /// The record that counts.
    newest: Option<Place>,
    /// Where the next record goes; after its page if that is full.
    next: Place,
    /// The sequence number of the first record in the page of `next`.
    base: u32,
}

impl<F: NorFlash> Pages<F> {
    fn new(flash: F, region: Region, record_size: usize) -> Result<Self, OpenError> {
        check::<F>(&flash, region, record_size)?;
        // `check` has seen that it fits.
        let size = record_size as u32;
        Ok(Self {
            flash,
            region,
            size,
            slots: region.page_size / size,
            blank: true,
            newest: None,
            next: Place { page: 0, slot: 0 },
            base: 0,
        })
    }

    /// Finds the record that counts and copies its contents. Returns whether there is one.
    fn scan(&mut self, contents: &mut [u8]) -> bool {
        let mut highest = None;
        // For each page the place after the last that is not blank.
        let mut ends = [0; 2];
        let mut buffer = [0; MAX_RECORD_SIZE];
        for (page, end) in (0..).zip(&mut ends) {
            for slot in 0..self.slots {
                let place = Place { page, slot };
                match self.read(place, &mut buffer) {
                    Found::Blank => continue,
                    Found::Garbage => {}
                    Found::Record(read, sequence) => {
                        if highest.is_none_or(|highest| sequence > highest) {
                            highest = Some(sequence);
                            self.newest = Some(place);
                            copy(contents, read);
                        }
                    }
                }
                *end = slot + 1;
            }
        }
        buffer.zeroize();
        self.blank = ends == [0; 2];
        let [first, second] = ends;
        let newest = self.newest.unwrap_or(self.next);
        let slot = if newest.page == 0 { first } else { second };
        self.next = Place {
            page: newest.page,
            slot,
        };
        self.base = highest.unwrap_or(0).saturating_sub(newest.slot);
        highest.is_some()
    }

    fn read_newest(&mut self, contents: &mut [u8]) -> bool {
        let mut buffer = [0; MAX_RECORD_SIZE];
        let found = match self.newest.map(|newest| self.read(newest, &mut buffer)) {
            Some(Found::Record(read, _)) => {
                copy(contents, read);
                true
            }
            _ => false,
        };
        buffer.zeroize();
        found
    }

    fn append(&mut self, contents: &[u8]) -> Result<(), StoreError> {
        let mut erased = false;
        for _ in 0..ATTEMPTS {
            if self.next.slot >= self.slots {
                // Once in a call: a page that takes no record would be erased for ever.
                if erased {
                    break;
                }
                erased = true;
                self.turn_page()?;
            }
            if self.try_append(contents)? {
                return Ok(());
            }
        }
        Err(StoreError::Write)
    }

    fn replace(&mut self, contents: &[u8]) -> Result<(), StoreError> {
        self.next.slot = self.slots;
        self.append(contents)?;
        // `append` has gone to the other page, or returned.
        self.erase(self.next.page ^ 1)
    }

    fn forget(&mut self) -> Result<(), StoreError> {
        let Some(Place { page, .. }) = self.newest else {
            return Ok(());
        };
        let page = page ^ 1;
        let mut buffer = [0; MAX_RECORD_SIZE];
        let blank = (0..self.slots).all(|slot| {
            let found = self.read(Place { page, slot }, &mut buffer);
            matches!(found, Found::Blank)
        });
        buffer.zeroize();
        if blank {
            return Ok(());
        }
        self.erase(page)
    }

    fn read<'a>(&mut self, place: Place, buffer: &'a mut Buffer) -> Found<'a> {
        let record = buffer.get_mut(..self.size as usize).unwrap_or_default();
        match self.flash.read(self.offset(place), record) {
            Ok(()) => parse(record),
            Err(_) => Found::Garbage,
        }
    }

    /// Goes to the other page than the one that holds what counts, and erases it.
    fn turn_page(&mut self) -> Result<(), StoreError> {
        let kept = self.newest.map_or(self.next.page, |newest| newest.page);
        let page = kept ^ 1;
        self.erase(page)?;
        // Otherwise it is this very page again, and no record of it is left.
        if self.next.page == kept {
            self.base = self.base.saturating_add(self.slots);
        }
        self.next = Place { page, slot: 0 };
        Ok(())
    }

    fn erase(&mut self, page: u32) -> Result<(), StoreError> {
        let from = self.offset(Place { page, slot: 0 });
        let erased = self.flash.erase(from, from + self.region.page_size);
        erased.map_err(|error| StoreError::Erase(error.kind()))
    }

    /// Writes a record into the next place. Returns whether it reads as it was written.
    fn try_append(&mut self, contents: &[u8]) -> Result<bool, StoreError> {
        let place = self.next;
        // The last one is that of erased flash.
        let sequence = self
            .base
            .checked_add(place.slot)
            .filter(|it| *it < u32::MAX);
        let sequence = sequence.ok_or(StoreError::Exhausted)?;
        // A failed write may still have left a record: the next one is newer than it.
        self.next.slot += 1;
        self.blank = false;
        let mut buffer = [0; MAX_RECORD_SIZE];
        let record = buffer.get_mut(..self.size as usize).unwrap_or_default();
        emit(record, contents, sequence);
        let said = self.flash.write(self.offset(place), record).is_ok();
        buffer.zeroize();
        let read = match self.read(place, &mut buffer) {
            Found::Record(read, number) => read == contents && number == sequence,
            Found::Blank | Found::Garbage => false,
        };
        buffer.zeroize();
        // Both: what the flash calls a failure may be readable now and not later.
        let written = said && read;
        if written {
            self.newest = Some(place);
        }
        Ok(written)
    }

    fn offset(&self, place: Place) -> u32 {
        let page = self.region.start + place.page * self.region.page_size;
        page + place.slot * self.size
    }
}

fn copy(to: &mut [u8], from: &[u8]) {
    for (slot, byte) in to.iter_mut().zip(from) {
        *slot = *byte;
    }
}

/// Whether the flash has room for two such pages, and each for such a record.
fn check<F: NorFlash>(flash: &F, region: Region, record_size: usize) -> Result<(), OpenError> {
    let Region { start, page_size } = region;
    let unit = u32::try_from(F::ERASE_SIZE).map_err(|_| OpenError::NotAligned)?;
    if page_size == 0 || !page_size.is_multiple_of(unit) || !start.is_multiple_of(unit) {
        return Err(OpenError::NotAligned);
    }
    let end = page_size
        .checked_mul(2)
        .and_then(|size| size.checked_add(start))
        .ok_or(OpenError::OutOfBounds)?;
    if usize::try_from(end).map_or(true, |end| end > flash.capacity()) {
        return Err(OpenError::OutOfBounds);
    }
    let fits = record_size <= MAX_RECORD_SIZE && record_size <= page_size as usize;
    if !fits
        || !record_size.is_multiple_of(F::WRITE_SIZE)
        || !record_size.is_multiple_of(F::READ_SIZE)
    {
        return Err(OpenError::RecordSize);
    }
    Ok(())
}

/// Writes the record of `contents`.
fn emit(record: &mut [u8], contents: &[u8], sequence: u32) {
    if let Some((covered, sum)) = record.split_last_chunk_mut::<CHECKSUM_SIZE>() {
        if let Some((part, number)) = covered.split_last_chunk_mut::<SEQUENCE_SIZE>() {
            copy(part, contents);
            *number = sequence.to_le_bytes();
        }
        *sum = checksum(covered).to_le_bytes();
    }
}

fn parse(record: &[u8]) -> Found<'_> {
    if record.iter().all(|byte| *byte == ERASED) {
        return Found::Blank;
    }
    if let Some((covered, sum)) = record.split_last_chunk::<CHECKSUM_SIZE>()
        && let Some((contents, sequence)) = covered.split_last_chunk::<SEQUENCE_SIZE>()
        && checksum(covered) == u32::from_le_bytes(*sum)
    {
        return Found::Record(contents, u32::from_le_bytes(*sequence));
    }
    Found::Garbage
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
        }
    }
}

impl core::error::Error for OpenError {}
impl core::error::Error for StoreError {}
