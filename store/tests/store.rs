//! The store over a flash in RAM: cut, failing, spoiled, full.

use std::error::Error;
use std::ops::Range;

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use mavseal_store::{
    Binding, Contents, HighWaterMark, Journal, MarkError, OpenError, ProvisionError, Region,
    ReserveError, StoreError,
    model::{Failure, Flash, PAGE_SIZE, WORD_SIZE},
};

const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};
const BINDING: Binding = Binding::new(1, [0xA1, 0xB2, 0xC3, 0xD4]);
/// Bytes of a key record: state, and two keys.
const LONG: usize = 72;

type Memory = Flash<2>;

fn open<const N: usize>(flash: &mut Memory) -> (Journal<&mut Memory, N>, Contents<N>) {
    Journal::open(flash, REGION, BINDING).expect("a region that fits")
}

fn contents<const N: usize>(flash: &mut Memory) -> Contents<N> {
    open(flash).1
}

fn newest<const N: usize>(flash: &mut Memory) -> Option<[u8; N]> {
    match contents(flash) {
        Contents::Record(record) => Some(record),
        _ => None,
    }
}

fn open_mark(flash: &mut Memory) -> Result<HighWaterMark<&mut Memory>, MarkError> {
    HighWaterMark::open(flash, REGION, BINDING)
}

fn first_mark(flash: &mut Memory, first: u64) -> HighWaterMark<&mut Memory> {
    HighWaterMark::provision(flash, REGION, BINDING, first).expect("stored")
}

/// A flash that is worn out in places.
#[derive(Clone, Default)]
struct Worn {
    flash: Memory,
    /// The page, 0 or 1, that is not erased any more.
    keeps: Option<u32>,
    /// Whether no word is written over another, zeros neither.
    strict: bool,
    /// The bytes that are not written any more.
    refuses: Range<u32>,
}

impl ErrorType for Worn {
    type Error = Failure;
}

impl ReadNorFlash for Worn {
    const READ_SIZE: usize = Memory::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failure> {
        self.flash.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl NorFlash for Worn {
    const WRITE_SIZE: usize = Memory::WRITE_SIZE;
    const ERASE_SIZE: usize = Memory::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        if self.keeps == Some(from / REGION.page_size) {
            return Err(Failure::Erase);
        }
        self.flash.erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        let zeros = bytes.iter().all(|byte| *byte == 0);
        if self.refuses.contains(&offset) || self.strict && zeros {
            return Err(Failure::Write);
        }
        self.flash.write(offset, bytes)
    }
}

/// An erased flash of two pages with any sizes, in bytes: what is written, read and erased at once.
struct Sizes<const WRITE: usize, const READ: usize, const ERASE: usize>;

impl<const WRITE: usize, const READ: usize, const ERASE: usize> ErrorType
    for Sizes<WRITE, READ, ERASE>
{
    type Error = Failure;
}

impl<const WRITE: usize, const READ: usize, const ERASE: usize> ReadNorFlash
    for Sizes<WRITE, READ, ERASE>
{
    const READ_SIZE: usize = READ;

    fn read(&mut self, _: u32, bytes: &mut [u8]) -> Result<(), Failure> {
        bytes.fill(0xFF);
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * ERASE
    }
}

impl<const WRITE: usize, const READ: usize, const ERASE: usize> NorFlash
    for Sizes<WRITE, READ, ERASE>
{
    const WRITE_SIZE: usize = WRITE;
    const ERASE_SIZE: usize = ERASE;

    fn erase(&mut self, _: u32, _: u32) -> Result<(), Failure> {
        Err(Failure::Erase)
    }

    fn write(&mut self, _: u32, _: &[u8]) -> Result<(), Failure> {
        Err(Failure::Write)
    }
}

fn numbered<const N: usize>(number: u32) -> [u8; N] {
    let mut contents = [0x5A; N];
    contents[..4].copy_from_slice(&number.to_le_bytes());
    contents
}

#[test]
fn what_was_stored_last_is_found() {
    let mut flash = Memory::default();
    assert_eq!(contents::<8>(&mut flash), Contents::Blank);
    let (mut journal, _) = open::<8>(&mut flash);
    journal.provision(&numbered(0)).expect("stored");
    for number in 1..1000_u32 {
        let (mut journal, found) = open::<8>(&mut flash);
        assert_eq!(found, Contents::Record(numbered(number - 1)));
        journal.append(&numbered(number)).expect("stored");
        assert_eq!(journal.newest(), Some(numbered(number)));
    }
    // 128 records of 16 bytes in a page, the first four times, each other twice: 63 in a page.
    let pages = 1000_u64.div_ceil(63);
    assert_eq!(flash.writes(), 2 * 2 * (1000 + pages));
    assert_eq!(flash.erases(), pages - 1);
}

#[test]
fn a_record_lies_in_the_flash_as_described() {
    let mut flash = Memory::default();
    let (mut journal, _) = open::<8>(&mut flash);
    journal.provision(&141_u64.to_le_bytes()).expect("stored");
    let mut record = [0; 16];
    flash.read(0, &mut record).expect("written");
    // Contents, sequence number, and the CRC-32 of kind, key and both, as zlib computes it.
    let described = [
        &[141, 0, 0, 0, 0, 0, 0, 0][..],
        &[0; 4],
        &0xA8DF_F62B_u32.to_le_bytes(),
    ];
    assert_eq!(record, *described.concat());
    let mut copy = [0; 16];
    for number in 1..4 {
        flash.read(16 * number, &mut copy).expect("written");
        assert_eq!(copy[..8], record[..8]);
        assert_eq!(copy[8..12], number.to_le_bytes());
    }
    flash.read(64, &mut copy).expect("erased");
    assert_eq!(copy, [0xFF; 16]);

    for damaged in 0..16 {
        let mut flash = Memory::default();
        record[damaged] ^= 0x10;
        flash.write(0, &record).expect("erased");
        assert_eq!(newest::<8>(&mut flash), None, "byte {damaged}");
        record[damaged] ^= 0x10;
    }
}

#[test]
fn the_last_number_is_not_that_of_erased_flash() {
    let mut flash = Memory::default();
    // Number 2^32 - 2, and the CRC-32 as zlib computes it.
    let parts = [0xFFFF_FFFE_u32, 0x4428_362C].map(u32::to_le_bytes);
    let record = [&7_u64.to_le_bytes()[..], &parts.concat()].concat();
    flash.write(0, &record).expect("erased");
    let (mut journal, found) = open::<8>(&mut flash);
    assert_eq!(found, Contents::Record(7_u64.to_le_bytes()));
    assert_eq!(journal.append(&[8; 8]), Err(StoreError::Exhausted));
    assert_eq!(journal.replace(&[8; 8]), Err(StoreError::Exhausted));
    assert_eq!(journal.newest(), Some(7_u64.to_le_bytes()));
}

/// Power fails inside each step of many writes, with everything that it can leave.
fn survives_every_cut<const N: usize>(records: u32) {
    let steps = 2 * (records + 1) * (N as u32 + 8) / WORD_SIZE as u32 + 8;
    for chance in 0..if N == 8 { 3 } else { 12 } {
        for cut in 0..steps {
            let mut flash = Memory::new(chance);
            flash.cut_after(cut);
            let (mut journal, _) = open::<N>(&mut flash);
            let mut stored = None;
            let mut tried = None;
            for number in 0..records {
                tried = Some(number);
                let result = match number {
                    0 => journal.provision(&numbered(number)),
                    _ => journal.append(&numbered(number)),
                };
                if result.is_err() {
                    break;
                }
                stored = Some(number);
            }
            assert_eq!(stored == tried, flash.has_power());
            // Weak bits may be found by one restart and not by another: each alone is right.
            for _ in 0..3 {
                flash.restart();
                let found = newest::<N>(&mut flash);
                let expected = [stored.map(numbered), tried.map(numbered)];
                assert!(expected.contains(&found), "cut {cut}: {found:?}");
            }
            let (mut journal, _) = open::<N>(&mut flash);
            journal.append(&numbered(records)).expect("it goes on");
            assert_eq!(newest::<N>(&mut flash), Some(numbered(records)));
        }
    }
}

#[test]
fn short_records_survive_every_cut() {
    survives_every_cut::<8>(135);
}

#[test]
fn long_records_survive_every_cut() {
    survives_every_cut::<LONG>(27);
}

#[test]
fn cuts_one_after_the_other_are_survived() {
    for chance in 0..50 {
        let mut flash = Memory::new(chance);
        let (mut stored, mut tried) = (0, 0);
        for round in 0..60_u32 {
            flash.restart();
            flash.cut_after(round * 7 % 13 + u32::from(round % 5 == 0) * 300);
            let (mut journal, found) = open::<8>(&mut flash);
            let found = match found {
                Contents::Record(found) => u64::from_le_bytes(found),
                found => {
                    // Nothing was stored so far, and all that is left are cut writes.
                    assert!(stored == 0 && found != Contents::Unreadable || tried > 3);
                    0
                }
            };
            assert!((stored..=tried).contains(&found), "{found} of {stored}");
            // As a mark does: what is found is stored anew before anything relies on it.
            tried = found;
            stored = stored.min(found);
            loop {
                tried += 1;
                if journal.append(&tried.to_le_bytes()).is_err() {
                    break;
                }
                stored = tried;
            }
        }
    }
}

#[test]
fn a_copy_that_cannot_be_read_costs_nothing() {
    let mut flash = Memory::default();
    let (mut journal, _) = open::<8>(&mut flash);
    journal.provision(&[1; 8]).expect("stored");
    journal.append(&[2; 8]).expect("stored");
    // The record is in the fifth place and the sixth.
    for word in 8..12 {
        let mut flash = flash.clone();
        flash.spoil(word * WORD_SIZE);
        let (mut journal, found) = open::<8>(&mut flash);
        assert_eq!(found, Contents::Record([2; 8]));
        journal.append(&[3; 8]).expect("stored behind it");
        assert_eq!(newest(&mut flash), Some([3; 8]));
    }
}

#[test]
fn places_that_cannot_be_written_are_passed_over() {
    // Three in a call, from the fifth on.
    for places in 1..5 {
        let mut worn = Worn {
            refuses: 64..64 + 16 * places,
            ..Worn::default()
        };
        let (mut journal, _) = Journal::<_, 8>::open(&mut worn, REGION, BINDING).expect("fits");
        journal.provision(&[1; 8]).expect("stored before them");
        let stored = journal.append(&[2; 8]);
        if places == 4 {
            assert_eq!(stored, Err(StoreError::Write));
            assert_eq!(journal.newest(), Some([1; 8]));
            continue;
        }
        assert_eq!(stored, Ok(()));
        for copy in [0, 1] {
            let mut flash = worn.flash.clone();
            flash.spoil(64 + 16 * (places as usize + copy));
            assert_eq!(newest(&mut flash), Some([2; 8]));
        }
    }
}

#[test]
fn a_flash_that_fails_now_and_then_is_good_enough() {
    for chance in 0..20 {
        let mut flash = Memory::new(chance);
        flash.fail(40);
        let mut stored: Option<[u8; 8]> = None;
        let mut failed = Vec::new();
        for number in 0..400_u64 {
            let found = newest(&mut flash);
            assert!(found == stored || found.is_some_and(|found| failed.contains(&found)));
            let (mut journal, _) = open::<8>(&mut flash);
            let contents = number.to_le_bytes();
            if journal.append(&contents).is_ok() {
                stored = Some(contents);
                failed.clear();
            } else {
                failed.push(contents);
            }
        }
        assert!(stored.is_some());
    }
}

#[test]
fn a_broken_flash_is_told_and_keeps_what_it_has() {
    let mut flash = Memory::default();
    let (mut journal, _) = open::<8>(&mut flash);
    journal.provision(&[1; 8]).expect("stored");
    flash.fail(255);
    for _ in 0..1000 {
        let found = newest(&mut flash);
        let (mut journal, _) = open::<8>(&mut flash);
        let error = journal.append(&[2; 8]);
        if found != Some([1; 8]) {
            assert_eq!(found, Some([2; 8]), "a write that failed left a record");
        }
        if error.is_ok() {
            break;
        }
        assert!(matches!(
            error,
            Err(StoreError::Write | StoreError::Erase(_))
        ));
    }
}

#[test]
fn what_is_replaced_is_gone() {
    for number in 0..60 {
        let mut flash = Memory::default();
        let (mut journal, _) = open::<LONG>(&mut flash);
        for _ in 0..number {
            journal.append(&[0x11; LONG]).expect("stored");
        }
        journal.replace(&[0x22; LONG]).expect("stored");
        assert_eq!(journal.newest(), Some([0x22; LONG]));
        assert!(!flash.holds(&[0x11; WORD_SIZE]) && flash.holds(&[0x22; WORD_SIZE]));
        assert_eq!(newest(&mut flash), Some([0x22; LONG]));
    }
}

/// Every number of records before, every page that is not erased any more.
#[test]
fn what_is_replaced_is_gone_from_a_page_that_is_not_erased() {
    let mut told = 0;
    for number in 1..30 {
        for (keeps, strict) in [(0, false), (1, false), (0, true), (1, true)] {
            let mut worn = Worn::default();
            let open = |worn| {
                Journal::<_, LONG>::open(worn, REGION, BINDING)
                    .expect("fits")
                    .0
            };
            let mut journal = open(worn);
            for _ in 0..number {
                journal.append(&[0x11; LONG]).expect("stored");
            }
            worn = journal.into_flash();
            worn.keeps = Some(keeps);
            worn.strict = strict;
            let mut journal = open(worn);
            let replaced = journal.replace(&[0x22; LONG]);
            worn = journal.into_flash();
            let kept = worn.flash.holds(&[0x11; WORD_SIZE]);
            match replaced {
                Ok(()) => assert!(!kept),
                Err(StoreError::Remains) => assert!(kept && strict),
                // No room for copies of the new record.
                Err(error) => {
                    assert!(matches!(error, StoreError::Erase(_)));
                    assert!(kept);
                    continue;
                }
            }
            told += u32::from(replaced.is_err());
            assert_eq!(newest(&mut worn.flash), Some([0x22; LONG]));
            let mut journal = open(worn);
            assert_eq!(journal.forget().is_ok(), replaced.is_ok());
        }
    }
    assert!(told > 20, "{told}");
}

#[test]
fn what_a_cut_has_left_is_forgotten() {
    for chance in 0..100 {
        for cut in 0..90 {
            let mut flash = Memory::new(chance);
            let (mut journal, _) = open::<LONG>(&mut flash);
            assert!(journal.is_empty());
            journal.forget().expect("nothing to do");
            journal.provision(&[0x11; LONG]).expect("stored");
            assert!(!journal.is_empty());
            journal.forget().expect("nothing to do");
            assert_eq!((flash.writes(), flash.erases()), (40, 0));
            flash.cut_after(cut);
            let (mut journal, _) = open::<LONG>(&mut flash);
            let _ = journal.replace(&[0x22; LONG]);
            flash.restart();
            // It stores again what it has found, which may be weak.
            let (mut journal, _) = open::<LONG>(&mut flash);
            let found = journal.newest();
            if let Err(error) = journal.forget() {
                // It was weak and could not be read again: nothing is erased for it.
                assert_eq!(error, StoreError::Write);
                assert!((0..20).any(|_| newest::<LONG>(&mut flash).is_some()));
                continue;
            }
            let found = found
                .or_else(|| journal.newest())
                .expect("one or the other");
            let other = [found[0] ^ 0x33; WORD_SIZE];
            assert!(!flash.holds(&other), "cut {cut}");
            assert_eq!(newest(&mut flash), Some(found));
        }
    }
}

/// Another record is in the same page, which is erased too.
#[test]
fn what_is_in_the_page_of_the_newest_is_forgotten_too() {
    let mut flash = Memory::default();
    let (mut journal, _) = open::<LONG>(&mut flash);
    journal.provision(&[0x11; LONG]).expect("stored");
    journal.append(&[0x22; LONG]).expect("stored");
    assert!(flash.holds(&[0x11; WORD_SIZE]));
    let (mut journal, _) = open::<LONG>(&mut flash);
    journal.forget().expect("forgotten");
    assert_eq!(journal.newest(), Some([0x22; LONG]));
    journal.forget().expect("nothing to do");
    assert!(!flash.holds(&[0x11; WORD_SIZE]));
    assert_eq!(flash.erases(), 2);
    assert_eq!(newest(&mut flash), Some([0x22; LONG]));
}

#[test]
fn what_cannot_be_read_is_not_nothing() {
    let mut flash = Memory::default();
    let (mut journal, _) = open::<8>(&mut flash);
    journal.provision(&[1; 8]).expect("stored");
    let (journal, _) = open::<8>(&mut flash);
    assert!(!journal.is_empty());
    for word in (0..8).step_by(2) {
        flash.spoil(word * WORD_SIZE);
    }
    let (mut journal, found) = open::<8>(&mut flash);
    assert_eq!(found, Contents::Unreadable);
    assert!(!journal.is_empty());
    journal.forget().expect("nothing to forget for");
    let shown = format!("{journal:?}");
    assert!(
        shown.starts_with("Journal") && !shown.contains("Bad"),
        "{shown}"
    );
    assert_eq!(flash.erases(), 0);
    assert_eq!(open_mark(&mut flash).err(), Some(MarkError::Unreadable));
}

/// Whatever was stored before: with no word that can be read, there is no mark.
#[test]
fn a_mark_of_which_nothing_can_be_read_is_an_error() {
    for reserves in [0, 1, 10, 63, 64, 200] {
        let mut flash = Memory::default();
        let mut mark = first_mark(&mut flash, 1);
        for value in 1..=reserves {
            mark.reserve(value, 0).expect("reserved");
        }
        for word in 0..2 * PAGE_SIZE / WORD_SIZE {
            flash.spoil(word * WORD_SIZE);
        }
        assert_eq!(contents::<8>(&mut flash), Contents::Unreadable);
        assert_eq!(open_mark(&mut flash).err(), Some(MarkError::Unreadable));
        // Until somebody says where it goes on.
        first_mark(&mut flash, 900);
        assert_eq!(open_mark(&mut flash).expect("there").get(), 900);
    }
}

/// Every word, after any number of reservations: what counts is in another place too.
#[test]
fn one_word_that_cannot_be_read_loses_nothing() {
    for reserves in [0, 1, 2, 61, 62, 63, 64, 126] {
        let mut flash = Memory::default();
        let mut mark = first_mark(&mut flash, 100);
        for value in 100..100 + reserves {
            mark.reserve(value, 0).expect("reserved");
        }
        let stored = mark.get();
        for word in 0..2 * PAGE_SIZE / WORD_SIZE {
            let mut flash = flash.clone();
            flash.spoil(word * WORD_SIZE);
            let mark = open_mark(&mut flash).expect("another copy");
            assert_eq!(mark.get(), stored, "word {word} after {reserves}");
        }
    }
}

/// The same with cuts, so that copies lie in places of any parity: the end of a page is between two of them.
#[test]
fn one_word_that_cannot_be_read_loses_nothing_after_cuts() {
    for chance in 0..8_u32 {
        let mut flash = Memory::new(chance.into());
        first_mark(&mut flash, 100);
        let mut used = 99;
        for round in 0..60 {
            flash.restart();
            flash.cut_after((round * 7 + chance) % 19);
            let Ok(mut mark) = open_mark(&mut flash) else {
                unreachable!("no word is spoiled in what counts");
            };
            for value in mark.get().. {
                if mark.reserve(value, 0).is_err() {
                    break;
                }
                used = value;
            }
            flash.restart();
            if round % 3 != 0 {
                continue;
            }
            for word in 0..2 * PAGE_SIZE / WORD_SIZE {
                let mut flash = flash.clone();
                flash.spoil(word * WORD_SIZE);
                let mark = open_mark(&mut flash).expect("another copy");
                assert!(mark.get() > used, "word {word} in round {round}");
            }
        }
    }
}

#[test]
fn a_record_of_something_else_is_none() {
    let others = [
        Binding::new(2, [0xA1, 0xB2, 0xC3, 0xD4]),
        Binding::new(1, [0xA1, 0xB2, 0xC3, 0xD5]),
        Binding::new(1, [0xA0, 0xB2, 0xC3, 0xD4]),
        Binding::new(0, [0; 4]),
    ];
    for other in others {
        let mut flash = Memory::default();
        let mut mark = first_mark(&mut flash, 7);
        mark.reserve(1000, 0).expect("reserved");
        let open =
            |flash: &mut Memory| HighWaterMark::open(flash, REGION, other).map(|mark| mark.get());
        assert_eq!(open(&mut flash), Err(MarkError::Unreadable));
        // Whoever provisions for it takes it for good.
        let mark = HighWaterMark::provision(&mut flash, REGION, other, 3).expect("stored");
        assert_eq!(mark.get(), 3);
        assert_eq!(open(&mut flash), Ok(3));
        assert_eq!(open_mark(&mut flash).err(), Some(MarkError::Unreadable));
        let both = [7_u64, 1001].map(u64::to_le_bytes);
        assert!(both.iter().all(|mark| !flash.holds(mark)));
    }
    // Nor is one of another length.
    let mut flash = Memory::default();
    let (mut journal, _) = open::<LONG>(&mut flash);
    journal.provision(&[1; LONG]).expect("stored");
    assert_eq!(contents::<8>(&mut flash), Contents::Unreadable);
}

/// A provisioning that is cut in each of its steps: it can be done again, and is never taken for damage.
#[test]
fn a_first_mark_that_is_cut_can_be_provisioned_again() {
    let first = Contents::Record(77_u64.to_le_bytes());
    let (mut blank, mut interrupted, mut stored) = (0, 0, 0);
    for chance in 0..200 {
        // As far as the second and third attempt come is left to chance.
        for cut in 0..8 {
            let mut flash = Memory::new(chance);
            for attempt in 0..3 {
                flash.restart();
                flash.cut_after((cut + attempt * chance as u32) % 8);
                let made = HighWaterMark::provision(&mut flash, REGION, BINDING, 77);
                assert!(attempt > 0 || made.is_err());
                flash.restart();
                // What is weak may be found by one start and not by the next: each alone is right.
                for _ in 0..3 {
                    let found = contents::<8>(&mut flash);
                    match found {
                        Contents::Blank => blank += 1,
                        Contents::Interrupted => interrupted += 1,
                        _ => stored += 1,
                    }
                    let right = [Contents::Blank, Contents::Interrupted, first];
                    assert!(right.contains(&found), "cut {cut}: {found:?}");
                    let mark = HighWaterMark::<&mut Memory>::open(&mut flash, REGION, BINDING);
                    assert!(matches!(
                        mark.map(|mark| mark.get()),
                        Ok(77) | Err(MarkError::NotProvisioned)
                    ));
                }
                assert!(attempt > 0 || flash.erases() == 0);
            }
            first_mark(&mut flash, 77);
            assert_eq!(contents(&mut flash), first);
        }
    }
    let each = [blank, interrupted, stored];
    assert!(each.iter().all(|count| *count > 100), "{each:?}");
}

/// A provisioning in place of something else that is cut: what was there, or nothing, or the new one.
#[test]
fn a_mark_that_is_provisioned_anew_is_never_in_between() {
    let new = Binding::new(1, [9; 4]);
    for chance in 0..20 {
        for cut in 0..14 {
            let mut flash = Memory::new(chance);
            let mut mark = first_mark(&mut flash, 100);
            for value in 100..200 {
                mark.reserve(value, 0).expect("reserved");
            }
            flash.cut_after(cut);
            let made = HighWaterMark::provision(&mut flash, REGION, new, 5).is_ok();
            flash.restart();
            let found = HighWaterMark::open(&mut flash, REGION, new).map(|mark| mark.get());
            assert!(found == Ok(5) || !made && found == Err(MarkError::Unreadable));
            HighWaterMark::provision(&mut flash, REGION, new, 6).expect("again");
            let found = HighWaterMark::open(&mut flash, REGION, new).map(|mark| mark.get());
            assert_eq!(found, Ok(6));
            assert_eq!(open_mark(&mut flash).err(), Some(MarkError::Unreadable));
        }
    }
}

#[test]
fn erases_are_counted() {
    // Marks: each page is erased in turn.
    let mut flash = Memory::default();
    let mut mark = first_mark(&mut flash, 0);
    assert_eq!(mark.erases(), 0);
    for value in 0..2000 {
        mark.reserve(value, 0).expect("reserved");
        let erases = mark.erases();
        let flash = mark.into_flash();
        assert_eq!(u64::from(erases), flash.erases().div_ceil(2));
        mark = open_mark(flash).expect("there");
        assert_eq!(mark.erases(), erases);
    }
    // A new beginning counts on.
    let flash = mark.into_flash();
    mark = first_mark(flash, 0);
    let erases = mark.erases();
    let flash = mark.into_flash();
    assert_eq!(u64::from(erases), flash.erases().div_ceil(2));

    // Keys, which are replaced, and forgotten at each start.
    let mut flash = Memory::default();
    let (mut journal, _) = open::<LONG>(&mut flash);
    journal.provision(&[0; LONG]).expect("stored");
    for number in 0..300 {
        let (mut journal, _) = open::<LONG>(&mut flash);
        if number % 7 == 0 {
            journal.replace(&numbered(number)).expect("stored");
        } else {
            let contents = journal.newest().expect("there");
            journal.append(&contents).expect("stored");
            journal.forget().expect("erased");
        }
        let erases = journal.erases();
        let (journal, _) = open::<LONG>(&mut flash);
        assert_eq!(journal.erases(), erases);
        let real = flash.erases().div_ceil(2);
        assert!(
            (real..=real + 1).contains(&erases.into()),
            "{erases} of {real}"
        );
    }
}

#[test]
fn a_cut_replacement_leaves_one_or_the_other() {
    for chance in 0..200 {
        for cut in 0..44 {
            let mut flash = Memory::new(chance);
            let (mut journal, _) = open::<LONG>(&mut flash);
            journal.provision(&[0x11; LONG]).expect("stored");
            flash.cut_after(cut);
            let (mut journal, _) = open::<LONG>(&mut flash);
            let replaced = journal.replace(&[0x22; LONG]);
            flash.restart();
            let found = newest::<LONG>(&mut flash);
            assert!([Some([0x11; LONG]), Some([0x22; LONG])].contains(&found));
            if replaced.is_ok() {
                assert_eq!(found, Some([0x22; LONG]));
            }
        }
    }
}

#[test]
fn a_region_must_fit() {
    let open = |start, page_size| {
        let region = Region { start, page_size };
        Journal::<_, 8>::open(Memory::default(), region, BINDING).err()
    };
    assert_eq!(open(0, 2048), None);
    assert_eq!(open(0, 0), Some(OpenError::NotAligned));
    assert_eq!(open(0, 1024), Some(OpenError::NotAligned));
    assert_eq!(open(8, 2048), Some(OpenError::NotAligned));
    assert_eq!(open(2048, 2048), Some(OpenError::OutOfBounds));
    assert_eq!(open(0, 4096), Some(OpenError::OutOfBounds));
    assert_eq!(open(0, 1 << 31), Some(OpenError::OutOfBounds));
    let odd = Journal::<_, 9>::open(Memory::default(), REGION, BINDING);
    assert_eq!(odd.err(), Some(OpenError::RecordSize));
    let long = Journal::<_, 128>::open(Memory::default(), REGION, BINDING);
    assert_eq!(long.err(), Some(OpenError::RecordSize));
}

#[test]
fn a_record_must_fit() {
    fn open<F: NorFlash, const N: usize>(flash: F) -> Option<OpenError> {
        let region = Region {
            start: 0,
            page_size: F::ERASE_SIZE as u32,
        };
        Journal::<F, N>::open(flash, region, BINDING).err()
    }
    let wrong = Some(OpenError::RecordSize);
    // A page has four records at least.
    assert_eq!(open::<_, 8>(Sizes::<8, 8, 64>), None);
    assert_eq!(open::<_, 8>(Sizes::<8, 8, 48>), wrong);
    // A record is whole words, to write and to read.
    assert_eq!(open::<_, 8>(Sizes::<4, 16, 64>), None);
    assert_eq!(open::<_, 8>(Sizes::<16, 1, 64>), None);
    assert_eq!(open::<_, 8>(Sizes::<32, 1, 64>), wrong);
    assert_eq!(open::<_, 8>(Sizes::<1, 32, 64>), wrong);
    // And one of these words is whole ones of the other.
    assert_eq!(open::<_, 16>(Sizes::<6, 4, 96>), wrong);
    assert_eq!(open::<_, 16>(Sizes::<6, 3, 96>), None);
}

#[test]
fn a_mark_is_above_everything_used_before_a_restart() {
    for chance in 0..50 {
        let mut flash = Memory::new(chance);
        first_mark(&mut flash, 9);
        let mut used = Some(8);
        for round in 0..40_u32 {
            flash.restart();
            flash.cut_after(round * 5 % 21);
            let mut mark = open_mark(&mut flash).expect("provisioned");
            let start = mark.get();
            assert!(
                used.is_none_or(|used| start > used),
                "{start} after {used:?}"
            );
            for value in (start..).step_by(3) {
                if mark.reserve(value, 10).is_err() {
                    break;
                }
                assert!(mark.get() > value && mark.get() <= value + 10);
                used = Some(value);
            }
        }
    }
}

#[test]
fn a_mark_costs_two_records_for_each_reservation() {
    let mut flash = Memory::default();
    let mut mark = first_mark(&mut flash, 0);
    for value in 0..10_000 {
        mark.reserve(value, 100).expect("reserved");
    }
    assert_eq!(flash.writes(), 2 * 2 * (100 + 1 + 2));
}

#[test]
fn the_last_values() {
    let mut flash = Memory::default();
    let mut mark = first_mark(&mut flash, 0);
    mark.reserve(u64::MAX - 1, 100).expect("reserved");
    assert_eq!(mark.get(), u64::MAX);
    assert_eq!(mark.reserve(u64::MAX, 0), Err(ReserveError::Exhausted));
    mark.reserve(5, 0).expect("below the mark");
}

#[test]
fn what_is_wrong_is_said() {
    let said = [
        OpenError::NotAligned.to_string(),
        OpenError::OutOfBounds.to_string(),
        OpenError::RecordSize.to_string(),
        ReserveError::Store(StoreError::Write).to_string(),
        ReserveError::Exhausted.to_string(),
        StoreError::Exhausted.to_string(),
        StoreError::Remains.to_string(),
        MarkError::Open(OpenError::NotAligned).to_string(),
        MarkError::NotProvisioned.to_string(),
        MarkError::Unreadable.to_string(),
        ProvisionError::Open(OpenError::OutOfBounds).to_string(),
        ProvisionError::Store(StoreError::Write).to_string(),
        format!("{:?}", Contents::Record([7; 8])),
    ];
    assert_eq!(
        said,
        [
            "the pages are not whole units of what the flash erases",
            "the pages end behind the flash",
            "a record is not whole words of the flash, or too long",
            "the flash does not hold what is written to it",
            "all values are used up",
            "all sequence numbers are used up",
            "the flash keeps what was to be erased from it",
            "the pages are not whole units of what the flash erases",
            "the flash holds no mark: none was provisioned",
            "the mark in flash is damaged, or of another key",
            "the pages end behind the flash",
            "the flash does not hold what is written to it",
            "Record(..)",
        ]
    );
    let store = ReserveError::Store(StoreError::Write);
    let source = store.source().and_then(|source| source.downcast_ref());
    assert_eq!(source, Some(&StoreError::Write));
    let fault = OpenError::NotAligned;
    let opened = [
        MarkError::Open(fault).source().is_some(),
        ProvisionError::Open(fault).source().is_some(),
    ];
    assert_eq!(opened, [true; 2]);
    assert!(ProvisionError::Store(StoreError::Write).source().is_some());
    assert!(ReserveError::Exhausted.source().is_none());
    assert!(MarkError::NotProvisioned.source().is_none());
}
