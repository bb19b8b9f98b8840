//! A journal of records of any one size, so that the code exists once for all sizes.

use embedded_storage::nor_flash::{NorFlash, NorFlashError};
use zeroize::Zeroize;

use crate::error::{OpenError, StoreError};
use crate::journal::Region;
use crate::record::{Binding, Buffer, ERASED, Found, MAX_RECORD_SIZE, copy, emit, parse};

/// How often a record is written: two words that cannot be read are needed to lose it.
const COPIES: u32 = 2;
/// How often a record is written in a page that is erased, and how many places at least are not blank ever after.
/// With fewer, and none that can be read, the first write was cut. So many cuts in a row, but one, are told from
/// damage. For proofs a page has two places.
pub(crate) const COPIES_FIRST: u32 = if cfg!(kani) { 2 } else { 4 };
/// How many writes fail in a call before the flash counts as broken.
const ATTEMPTS: u8 = 4;

/// Which record: the page, 0 or 1, and the place in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    page: u32,
    slot: u32,
}

pub(crate) struct Pages<F> {
    pub(crate) flash: F,
    pub(crate) region: Region,
    binding: Binding,
    /// Bytes of a record.
    size: u32,
    /// Records in a page.
    slots: u32,
    /// Places that were not blank, and those written since.
    pub(crate) used: u32,
    /// The record that counts, and a copy of it.
    pub(crate) newest: Option<Place>,
    spare: Option<Place>,
    /// Where the next record goes; after its page if that is full.
    pub(crate) next: Place,
    /// The sequence number of the first record in the page of `next`: how many places the pages had that were
    /// erased so far.
    base: u32,
}

impl<F: NorFlash> Pages<F> {
    /// What is written and read at once.
    const WORD: usize = if F::WRITE_SIZE > F::READ_SIZE {
        F::WRITE_SIZE
    } else {
        F::READ_SIZE
    };

    pub(crate) fn new(
        flash: F,
        region: Region,
        binding: Binding,
        record_size: usize,
    ) -> Result<Self, OpenError> {
        check::<F>(&flash, region, record_size)?;
        // `check` has seen that it fits.
        let size = record_size as u32;
        Ok(Self {
            flash,
            region,
            binding,
            size,
            slots: region.page_size / size,
            used: 0,
            newest: None,
            spare: None,
            next: Place { page: 0, slot: 0 },
            base: 0,
        })
    }

    /// Finds the record that counts and copies its contents. Returns whether there is one.
    pub(crate) fn scan(&mut self, contents: &mut [u8]) -> bool {
        let mut highest = None;
        // For each page the place after the last that is not blank.
        let mut ends = [0; 2];
        // Whether a page holds nothing that can be read, though something is in it.
        let mut torn = [false; 2];
        let mut buffer = [0; MAX_RECORD_SIZE];
        for (page, (end, torn)) in (0..).zip(ends.iter_mut().zip(&mut torn)) {
            let mut readable = false;
            for slot in 0..self.slots {
                let place = Place { page, slot };
                match self.read(place, &mut buffer) {
                    Found::Blank => continue,
                    Found::Garbage => {}
                    Found::Record(read, sequence) => {
                        readable = true;
                        if highest.is_none_or(|highest| sequence > highest) {
                            let copied = highest.is_some() && contents == read;
                            self.spare = self.newest.filter(|_| copied);
                            highest = Some(sequence);
                            self.newest = Some(place);
                            copy(contents, read);
                        }
                    }
                }
                self.used += 1;
                *end = slot + 1;
            }
            *torn = *end > 0 && !readable;
        }
        buffer.zeroize();
        let [first, second] = ends;
        let newest = self.newest.unwrap_or(self.next);
        let slot = if newest.page == 0 { first } else { second };
        self.next = Place {
            page: newest.page,
            slot,
        };
        self.base = highest.unwrap_or(0).saturating_sub(newest.slot);
        let [first, second] = torn;
        let other_torn = if newest.page == 0 { second } else { first };
        if other_torn && highest.is_some() {
            // A cut may have left a record there that can be read the next time. What is stored from now on is newer: a
            // page is begun no more than two pages ahead.
            self.base = self.base.saturating_add(3 * self.slots);
        }
        highest.is_some()
    }

    pub(crate) fn read_newest(&mut self, contents: &mut [u8]) -> bool {
        let mut buffer = [0; MAX_RECORD_SIZE];
        let mut found = false;
        for place in [self.newest, self.spare].into_iter().flatten() {
            if let (false, Found::Record(read, _)) = (found, self.read(place, &mut buffer)) {
                copy(contents, read);
                found = true;
            }
        }
        buffer.zeroize();
        found
    }

    /// Half of all erases so far, rounded up.
    pub(crate) const fn erases(&self) -> u32 {
        match self.base.checked_div(self.slots) {
            Some(erases) => erases.div_ceil(2),
            // A page has places.
            None => 0,
        }
    }

    pub(crate) fn provision(&mut self, contents: &[u8]) -> Result<(), StoreError> {
        if self.used >= COPIES_FIRST {
            return self.replace(contents);
        }
        let blank = self.used == 0;
        // No erase: a cut in one may leave a page of garbage, which would look like damage.
        self.append(contents)?;
        if blank {
            return Ok(());
        }
        self.sweep(contents)
    }

    pub(crate) fn replace(&mut self, contents: &[u8]) -> Result<(), StoreError> {
        // If that fails, what is left of this page has to do, and what is in it is overwritten.
        let _ = self.turn_page();
        self.count_erase();
        self.append(contents)?;
        self.sweep(contents)
    }

    pub(crate) fn forget(&mut self, contents: &[u8]) -> Result<(), StoreError> {
        let clean = [0, 1].map(|page| self.is_clean(page, contents));
        if clean == [true; 2] {
            return Ok(());
        }
        // What counts may be what a cut has left, and may not be found again.
        self.append(contents)?;
        self.replace(contents)
    }

    /// Writes records of `contents`, each in a place that holds it: more at the beginning of a page, as the other
    /// may be erased next.
    pub(crate) fn append(&mut self, contents: &[u8]) -> Result<(), StoreError> {
        let mut copies = COPIES.max(COPIES_FIRST.saturating_sub(self.next.slot));
        let (mut written, mut failed, mut turned) = (0, 0, false);
        let (mut last, mut before) = (self.newest, None);
        while written < copies {
            if self.next.slot >= self.slots {
                // Once in a call: a page that takes no record would be erased for ever.
                if turned {
                    return Err(StoreError::Write);
                }
                turned = true;
                self.turn_page()?;
                // What was written before may have been in the page that is erased.
                (copies, written) = (COPIES_FIRST, 0);
            }
            let place = self.next;
            if self.try_append(contents)? {
                before = last.filter(|_| written > 0);
                last = Some(place);
                written += 1;
            } else {
                failed += 1;
                if failed == ATTEMPTS {
                    return Err(StoreError::Write);
                }
            }
        }
        // Only now: the page that holds what was stored before was not erased meanwhile.
        (self.newest, self.spare) = (last, before);
        Ok(())
    }

    /// Goes to the other page than the one that holds what counts, and erases it.
    fn turn_page(&mut self) -> Result<(), StoreError> {
        let kept = self.newest.map_or(self.next.page, |newest| newest.page);
        let page = kept ^ 1;
        self.erase(page)?;
        self.count_erase();
        self.next = Place { page, slot: 0 };
        Ok(())
    }

    /// Goes on as if a page had been filled. The next record tells so.
    const fn count_erase(&mut self) {
        self.base = self.base.saturating_add(self.slots);
    }

    fn erase(&mut self, page: u32) -> Result<(), StoreError> {
        let from = self.offset(Place { page, slot: 0 });
        let erased = self.flash.erase(from, from + self.region.page_size);
        erased.map_err(|error| StoreError::Erase(error.kind()))
    }

    /// Leaves nothing but records of `contents`: erases the page that does not hold what counts, unless there is
    /// nothing else in it, and overwrites what is left with zeros.
    fn sweep(&mut self, contents: &[u8]) -> Result<(), StoreError> {
        let kept = self.newest.map_or(self.next.page, |newest| newest.page);
        let other = kept ^ 1;
        if !self.is_clean(other, contents) {
            // If it fails, all that is in it is overwritten.
            let _ = self.erase(other);
        }
        let mut gone = true;
        for page in [other, kept] {
            for slot in 0..self.slots {
                let place = Place { page, slot };
                if !self.is_copy(place, contents) {
                    gone &= self.wipe(place);
                }
            }
        }
        gone.then_some(()).ok_or(StoreError::Remains)
    }

    /// Whether the page holds nothing but records of `contents`, and what was wiped.
    fn is_clean(&mut self, page: u32, contents: &[u8]) -> bool {
        (0..self.slots).all(|slot| {
            let place = Place { page, slot };
            let mut words = self.words(place);
            self.is_copy(place, contents) || words.all(|word| self.is_wiped(word) == Some(true))
        })
    }

    fn is_copy(&mut self, place: Place, contents: &[u8]) -> bool {
        let mut buffer = [0; MAX_RECORD_SIZE];
        let found = self.read(place, &mut buffer);
        let copy = matches!(found, Found::Record(read, _) if read == contents);
        buffer.zeroize();
        copy
    }

    /// Overwrites what is in this place, word by word. Returns whether nothing of it can be read any more.
    fn wipe(&mut self, place: Place) -> bool {
        let mut gone = true;
        for offset in self.words(place) {
            if self.is_wiped(offset) != Some(true) {
                let zeros = [0; MAX_RECORD_SIZE];
                let word = zeros.get(..Self::WORD).unwrap_or_default();
                // Whether it has succeeded is seen below.
                let _ = self.flash.write(offset, word);
            }
            gone &= self.is_wiped(offset) != Some(false);
        }
        gone
    }

    /// Whether the word at `offset` is erased or zero; `None` if it cannot be read.
    fn is_wiped(&mut self, offset: u32) -> Option<bool> {
        let mut buffer = [0; MAX_RECORD_SIZE];
        let word = buffer.get_mut(..Self::WORD).unwrap_or_default();
        let read = self.flash.read(offset, word).is_ok();
        let zero = word.iter().all(|byte| *byte == 0);
        let erased = word.iter().all(|byte| *byte == ERASED);
        buffer.zeroize();
        read.then_some(zero || erased)
    }

    /// Where the words of this place begin.
    fn words(&self, place: Place) -> impl Iterator<Item = u32> + use<F> {
        let from = self.offset(place);
        (from..from + self.size).step_by(Self::WORD)
    }

    fn read<'a>(&mut self, place: Place, buffer: &'a mut Buffer) -> Found<'a> {
        let record = buffer.get_mut(..self.size as usize).unwrap_or_default();
        match self.flash.read(self.offset(place), record) {
            Ok(()) => parse(record, self.binding),
            Err(_) => Found::Garbage,
        }
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
        self.used = self.used.saturating_add(1);
        let mut buffer = [0; MAX_RECORD_SIZE];
        let record = buffer.get_mut(..self.size as usize).unwrap_or_default();
        emit(record, self.binding, contents, sequence);
        let said = self.flash.write(self.offset(place), record).is_ok();
        buffer.zeroize();
        let read = match self.read(place, &mut buffer) {
            Found::Record(read, number) => read == contents && number == sequence,
            Found::Blank | Found::Garbage => false,
        };
        buffer.zeroize();
        // Both: what the flash calls a failure may be readable now and not later.
        Ok(said && read)
    }

    fn offset(&self, place: Place) -> u32 {
        let page = self.region.start + place.page * self.region.page_size;
        page + place.slot * self.size
    }
}

/// Whether the flash has room for two such pages, and each for enough of such records.
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
    let least = record_size.saturating_mul(COPIES_FIRST as usize);
    let fits = record_size <= MAX_RECORD_SIZE && least <= page_size as usize;
    // A word is what is written and read at once: whole units of both.
    let sizes = [F::WRITE_SIZE, F::READ_SIZE];
    let whole = |bytes: usize| sizes.iter().all(|size| bytes.is_multiple_of(*size));
    if !fits || !whole(record_size) || !whole(Pages::<F>::WORD) {
        return Err(OpenError::RecordSize);
    }
    Ok(())
}
