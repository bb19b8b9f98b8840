//! Records in flash of which the newest counts, whole, whenever the power fails.

use core::fmt;

use crc::{CRC_32_ISO_HDLC, Crc, NoTable};
use embedded_storage::nor_flash::{NorFlash, NorFlashError, NorFlashErrorKind};
use zeroize::Zeroize;

/// Bytes of a record's sequence number, little-endian.
const SEQUENCE_SIZE: usize = 4;
/// Bytes of a record's checksum, little-endian: CRC-32 over contents and sequence number.
const CHECKSUM_SIZE: usize = 4;
/// Bytes of a record after its contents: 8.
const TRAILER_SIZE: usize = SEQUENCE_SIZE + CHECKSUM_SIZE;
/// Most bytes of a record, so that it fits into a buffer on the stack.
const MAX_RECORD_SIZE: usize = 128;
/// What every byte of erased flash reads as.
const ERASED: u8 = 0xFF;
/// How often a record is written anew, each time elsewhere, before the flash counts as broken.
const ATTEMPTS: u8 = 4;

/// Without table: 16 bytes are checked every few seconds.
const CHECKSUM: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

/// Two equal pages of flash, one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Region {
    /// Offset of the first page in the flash, in bytes; a multiple of what is erased at once.
    pub start: u32,
    /// Bytes of each page; a multiple of what is erased at once. Twice as many bytes wear half as fast.
    pub page_size: u32,
}

/// Why a region cannot hold a journal. Whoever laid out the flash is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum OpenError {
    /// Start or size of the pages is no multiple of what is erased at once, or the size is zero.
    NotAligned,
    /// The region ends behind the flash.
    OutOfBounds,
    /// A record is not a whole number of the flash's words, does not fit into a page, or has more
    /// than 128 bytes with its 8 of sequence number and checksum.
    RecordSize,
}

/// Why a record is not stored. The flash is at fault, or worn out.
///
/// What was stored before is still there. After a restart either that is found or what was to be
/// stored: the flash has said that the write failed, not that it left no trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StoreError {
    /// The flash refused to erase a page, for this reason.
    Erase(#[cfg_attr(feature = "defmt", defmt(Debug2Format))] NorFlashErrorKind),
    /// What was written reads as something else, or not at all, in several places.
    Write,
    /// All sequence numbers are used up: 2^32 - 2 records.
    Exhausted,
}

/// Which record: the page, 0 or 1, and the place in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    page: u32,
    slot: u32,
}

/// What one record's place holds.
enum Found<const N: usize> {
    Blank,
    /// A torn write, a word with a bad ECC, or half an erase.
    Garbage,
    Record([u8; N], u32),
}

/// A journal of records with `N` bytes each, in two pages of flash.
///
/// A record is its `N` bytes, a sequence number and a checksum over both. Records are appended to one
/// page; when it is full, the other is erased and written from its beginning. The sequence number counts
/// places, also those where a write failed, so that no two records have the same. The highest counts. So
///
/// * what was stored last is in flash at every moment: the page that holds it is never erased;
/// * a write that the power cuts leaves the record before it;
/// * a word that cannot be read makes its record garbage, and no other;
/// * a record that does not read as it was written, or of which the flash says so, is written again in
///   the next place.
#[derive(Debug)]
pub struct Journal<F, const N: usize> {
    flash: F,
    region: Region,
    /// The record that counts.
    newest: Option<Place>,
    /// Where the next record goes; behind its page if that is full.
    next: Place,
    /// The sequence number of the first record in the page of `next`.
    base: u32,
}

impl<F: NorFlash, const N: usize> Journal<F, N> {
    const RECORD_SIZE: usize = N + TRAILER_SIZE;

    /// The journal that `region` of `flash` holds, and what was stored there last; `None` if nothing ever
    /// was, or nothing can be read. Nothing is written.
    ///
    /// What a cut write has left may be found by one restart and not by the next: store it again before
    /// relying on it for longer than this one.
    ///
    /// # Errors
    ///
    /// [`OpenError`]. That something cannot be read is no error: it does not count.
    pub fn open(flash: F, region: Region) -> Result<(Self, Option<[u8; N]>), OpenError> {
        check::<F>(&flash, region, Self::RECORD_SIZE)?;
        let mut journal = Self {
            flash,
            region,
            newest: None,
            next: Place { page: 0, slot: 0 },
            base: 0,
        };
        let newest = journal.scan();
        Ok((journal, newest))
    }

    /// Whether it holds no record that can be read: nothing was ever stored, or all of it is lost.
    pub const fn is_empty(&self) -> bool {
        self.newest.is_none()
    }

    /// The flash, for what else it holds.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// What was stored last, read again; `None` if nothing was, or if it can no longer be read.
    pub fn newest(&mut self) -> Option<[u8; N]> {
        match self.read(self.newest?) {
            Found::Record(contents, _) => Some(contents),
            Found::Blank | Found::Garbage => None,
        }
    }

    /// Stores `contents`: afterwards they are [`Journal::newest`], also after a restart.
    ///
    /// Takes one write of `N + 8` bytes; an erase before it when a page is full.
    ///
    /// # Errors
    ///
    /// [`StoreError`]; what was stored before still counts.
    pub fn append(&mut self, contents: &[u8; N]) -> Result<(), StoreError> {
        let mut erased = false;
        for _ in 0..ATTEMPTS {
            if self.next.slot >= self.slots() {
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

    /// Stores `contents` and erases everything that was stored before: for keys that are given up.
    ///
    /// Takes two erases and a write.
    ///
    /// # Errors
    ///
    /// [`StoreError`]. If the last erase fails, `contents` count already, and what was stored before
    /// can still be read from the flash.
    pub fn replace(&mut self, contents: &[u8; N]) -> Result<(), StoreError> {
        self.next.slot = self.slots();
        self.append(contents)?;
        // `append` has gone to the other page, or returned.
        self.erase(self.next.page ^ 1)
    }

    /// Records in a page.
    fn slots(&self) -> u32 {
        // `check` has seen that both fit.
        self.region.page_size / (Self::RECORD_SIZE as u32)
    }

    fn scan(&mut self) -> Option<[u8; N]> {
        let mut highest: Option<([u8; N], u32)> = None;
        // For each page the place after the last that is not blank.
        let mut ends = [0; 2];
        for (page, end) in (0..).zip(&mut ends) {
            for slot in 0..self.slots() {
                let place = Place { page, slot };
                match self.read(place) {
                    Found::Blank => continue,
                    Found::Garbage => {}
                    Found::Record(mut contents, sequence) => {
                        if highest.is_none_or(|(_, highest)| sequence > highest) {
                            highest = Some((contents, sequence));
                            self.newest = Some(place);
                        }
                        contents.zeroize();
                    }
                }
                *end = slot + 1;
            }
        }
        let [first, second] = ends;
        let page = self.newest.map_or(0, |newest| newest.page);
        let slot = if page == 0 { first } else { second };
        self.next = Place { page, slot };
        let (contents, sequence) = highest?;
        let slot = self.newest.map_or(0, |newest| newest.slot);
        self.base = sequence.saturating_sub(slot);
        Some(contents)
    }

    fn read(&mut self, place: Place) -> Found<N> {
        let mut buffer = [0; MAX_RECORD_SIZE];
        let offset = self.offset(place);
        let record = buffer.get_mut(..Self::RECORD_SIZE).unwrap_or_default();
        let found = match self.flash.read(offset, record) {
            Ok(()) => parse(record),
            Err(_) => Found::Garbage,
        };
        record.zeroize();
        found
    }

    /// Goes to the other page than the one that holds what counts, and erases it.
    fn turn_page(&mut self) -> Result<(), StoreError> {
        let kept = self.newest.map_or(self.next.page, |newest| newest.page);
        let page = kept ^ 1;
        self.erase(page)?;
        // Otherwise it is this very page again, and no record of it is left.
        if self.next.page == kept {
            self.base = self.base.saturating_add(self.slots());
        }
        self.next = Place { page, slot: 0 };
        Ok(())
    }

    fn erase(&mut self, page: u32) -> Result<(), StoreError> {
        let from = self.offset(Place { page, slot: 0 });
        let erased = self.flash.erase(from, from + self.region.page_size);
        erased.map_err(|error| StoreError::Erase(error.kind()))
    }

    /// Writes a record into the next place; whether it reads as it was written.
    fn try_append(&mut self, contents: &[u8; N]) -> Result<bool, StoreError> {
        let place = self.next;
        // The last one is that of erased flash.
        let sequence = self
            .base
            .checked_add(place.slot)
            .filter(|it| *it < u32::MAX);
        let sequence = sequence.ok_or(StoreError::Exhausted)?;
        // A failed write may have left a record all the same: the next one is newer than it.
        self.next.slot += 1;
        let mut buffer = [0; MAX_RECORD_SIZE];
        let record = buffer.get_mut(..Self::RECORD_SIZE).unwrap_or_default();
        emit(record, contents, sequence);
        let offset = self.offset(place);
        let said = self.flash.write(offset, record).is_ok();
        record.zeroize();
        let read = match self.read(place) {
            Found::Record(mut read, number) => {
                let same = read == *contents && number == sequence;
                read.zeroize();
                same
            }
            Found::Blank | Found::Garbage => false,
        };
        // Both: what the flash calls a failure may be readable now and not later.
        let written = said && read;
        if written {
            self.newest = Some(place);
        }
        Ok(written)
    }

    fn offset(&self, place: Place) -> u32 {
        let page = self.region.start + place.page * self.region.page_size;
        page + place.slot * (Self::RECORD_SIZE as u32)
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
    let sequence = sequence.to_le_bytes();
    let mut digest = CHECKSUM.digest();
    digest.update(contents);
    digest.update(&sequence);
    let checksum = digest.finalize().to_le_bytes();
    let parts = contents.iter().chain(&sequence).chain(&checksum);
    for (slot, byte) in record.iter_mut().zip(parts) {
        *slot = *byte;
    }
}

fn parse<const N: usize>(record: &[u8]) -> Found<N> {
    if record.iter().all(|byte| *byte == ERASED) {
        return Found::Blank;
    }
    let Some((covered, checksum)) = record.split_last_chunk::<CHECKSUM_SIZE>() else {
        return Found::Garbage;
    };
    let Some((contents, sequence)) = covered.split_last_chunk::<SEQUENCE_SIZE>() else {
        return Found::Garbage;
    };
    if CHECKSUM.checksum(covered) != u32::from_le_bytes(*checksum) {
        return Found::Garbage;
    }
    match <[u8; N]>::try_from(contents) {
        Ok(contents) => Found::Record(contents, u32::from_le_bytes(*sequence)),
        Err(_) => Found::Garbage,
    }
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
