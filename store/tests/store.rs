//! The store over a flash in RAM: cut, failing, spoiled, full.

use std::error::Error;

use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};
use mavseal_store::{
    HighWaterMark, Journal, OpenError, Region, ReserveError, StoreError,
    model::{Flash, PAGE_SIZE, WORD_SIZE},
};

const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};
/// Bytes of a key record: state, and two keys.
const LONG: usize = 72;

type Memory = Flash<2>;

fn open<const N: usize>(flash: &mut Memory) -> (Journal<&mut Memory, N>, Option<[u8; N]>) {
    Journal::open(flash, REGION).expect("a region that fits")
}

fn newest<const N: usize>(flash: &mut Memory) -> Option<[u8; N]> {
    open(flash).1
}

fn numbered<const N: usize>(number: u32) -> [u8; N] {
    let mut contents = [0x5A; N];
    contents[..4].copy_from_slice(&number.to_le_bytes());
    contents
}

#[test]
fn what_was_stored_last_is_found() {
    let mut flash = Memory::default();
    assert_eq!(newest::<8>(&mut flash), None);
    for number in 0..1000_u32 {
        let (mut journal, found) = open::<8>(&mut flash);
        assert_eq!(found, number.checked_sub(1).map(numbered));
        journal.append(&numbered(number)).expect("stored");
        assert_eq!(journal.newest(), Some(numbered(number)));
    }
    // 128 records of 16 bytes in a page; the first needs no erase.
    assert_eq!(flash.writes(), 2000);
    assert_eq!(flash.erases(), 1000 / 128);
}

#[test]
fn a_record_lies_in_the_flash_as_described() {
    let mut flash = Memory::default();
    let (mut journal, _) = open::<8>(&mut flash);
    journal.append(&141_u64.to_le_bytes()).expect("stored");
    let mut record = [0; 16];
    flash.read(0, &mut record).expect("written");
    // Contents, sequence number, and the CRC-32 of both, as zlib computes it.
    let described = [
        &[141, 0, 0, 0, 0, 0, 0, 0][..],
        &[0; 4],
        &0x85BD_A861_u32.to_le_bytes(),
    ];
    assert_eq!(record, *described.concat());

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
    let parts = [0xFFFF_FFFE_u32, 0x694A_6866].map(u32::to_le_bytes);
    let record = [&7_u64.to_le_bytes()[..], &parts.concat()].concat();
    flash.write(0, &record).expect("erased");
    let (mut journal, found) = open::<8>(&mut flash);
    assert_eq!(found, Some(7_u64.to_le_bytes()));
    assert_eq!(journal.append(&[8; 8]), Err(StoreError::Exhausted));
    assert_eq!(journal.newest(), found);
}

/// Power fails inside each step of many writes, with everything that it can leave.
fn survives_every_cut<const N: usize>(records: u32) {
    let steps = records * (N as u32 + 8) / WORD_SIZE as u32 + 8;
    for chance in 0..if N == 8 { 3 } else { 12 } {
        for cut in 0..steps {
            let mut flash = Memory::new(chance);
            flash.cut_after(cut);
            let (mut journal, _) = open::<N>(&mut flash);
            let mut stored = None;
            let mut tried = None;
            for number in 0..records {
                tried = Some(number);
                if journal.append(&numbered(number)).is_err() {
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
    survives_every_cut::<8>(270);
}

#[test]
fn long_records_survive_every_cut() {
    survives_every_cut::<LONG>(52);
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
            let found = found.map_or(0, u64::from_le_bytes);
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
fn a_record_that_cannot_be_read_does_not_count() {
    let mut flash = Memory::default();
    let (mut journal, _) = open::<8>(&mut flash);
    journal.append(&[1; 8]).expect("stored");
    journal.append(&[2; 8]).expect("stored");
    for word in [2, 3] {
        let mut flash = flash.clone();
        flash.spoil(word * WORD_SIZE);
        let (mut journal, found) = open::<8>(&mut flash);
        assert_eq!(found, Some([1; 8]));
        journal.append(&[3; 8]).expect("stored behind it");
        assert_eq!(newest(&mut flash), Some([3; 8]));
    }
    // Places that cannot be written are passed over, four in a call.
    for word in 4..20 {
        flash.spoil(word * WORD_SIZE);
    }
    let (mut journal, _) = open::<8>(&mut flash);
    journal.append(&[4; 8]).expect("stored behind them");
    assert_eq!(newest(&mut flash), Some([4; 8]));
}

#[test]
fn a_flash_that_fails_now_and_then_is_good_enough() {
    for chance in 0..20 {
        let mut flash = Memory::new(chance);
        flash.fail(40);
        let mut stored: Option<[u8; 8]> = None;
        let mut failed = Vec::new();
        for number in 0..400_u64 {
            let (mut journal, found) = open::<8>(&mut flash);
            assert!(found == stored || found.is_some_and(|found| failed.contains(&found)));
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
    journal.append(&[1; 8]).expect("stored");
    flash.fail(255);
    for _ in 0..1000 {
        let (mut journal, found) = open::<8>(&mut flash);
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

#[test]
fn what_a_cut_has_left_is_forgotten() {
    for chance in 0..100 {
        for cut in 0..12 {
            let mut flash = Memory::new(chance);
            let (mut journal, _) = open::<LONG>(&mut flash);
            assert!(journal.is_empty());
            journal.forget().expect("nothing to do");
            journal.append(&[0x11; LONG]).expect("stored");
            assert!(!journal.is_empty());
            journal.forget().expect("nothing to do");
            assert_eq!(flash.erases(), 0);
            flash.cut_after(cut);
            let (mut journal, _) = open::<LONG>(&mut flash);
            let _ = journal.replace(&[0x22; LONG]);
            flash.restart();
            let (mut journal, found) = open::<LONG>(&mut flash);
            let found = found.expect("one or the other");
            // As its readers do: what is found is stored anew before anything relies on it.
            journal.append(&found).expect("stored");
            journal.forget().expect("erased");
            let other = [found[0] ^ 0x33; WORD_SIZE];
            assert!(!flash.holds(&other));
            assert_eq!(newest(&mut flash), Some(found));
        }
    }
}

#[test]
fn what_cannot_be_read_is_not_nothing() {
    let mut flash = Memory::default();
    let (mut journal, _) = open::<8>(&mut flash);
    journal.append(&[1; 8]).expect("stored");
    assert!(!open::<8>(&mut flash).0.is_empty());
    flash.spoil(0);
    let (journal, found) = open::<8>(&mut flash);
    assert!(found.is_none() && !journal.is_empty());
    let shown = format!("{journal:?}");
    assert!(
        shown.starts_with("Journal") && !shown.contains("Bad"),
        "{shown}"
    );
}

#[test]
fn a_cut_replacement_leaves_one_or_the_other() {
    for chance in 0..200 {
        for cut in 0..14 {
            let mut flash = Memory::new(chance);
            let (mut journal, _) = open::<LONG>(&mut flash);
            journal.append(&[0x11; LONG]).expect("stored");
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
        Journal::<_, 8>::open(Memory::default(), region).err()
    };
    assert_eq!(open(0, 2048), None);
    assert_eq!(open(0, 0), Some(OpenError::NotAligned));
    assert_eq!(open(0, 1024), Some(OpenError::NotAligned));
    assert_eq!(open(8, 2048), Some(OpenError::NotAligned));
    assert_eq!(open(2048, 2048), Some(OpenError::OutOfBounds));
    assert_eq!(open(0, 4096), Some(OpenError::OutOfBounds));
    assert_eq!(open(0, 1 << 31), Some(OpenError::OutOfBounds));
    let odd = Journal::<_, 9>::open(Memory::default(), REGION);
    assert_eq!(odd.err(), Some(OpenError::RecordSize));
    let long = Journal::<_, 128>::open(Memory::default(), REGION);
    assert_eq!(long.err(), Some(OpenError::RecordSize));
}

#[test]
fn a_mark_is_above_everything_used_before_a_restart() {
    for chance in 0..50 {
        let mut flash = Memory::new(chance);
        let mut used = None;
        for round in 0..40_u32 {
            flash.restart();
            flash.cut_after(round * 5 % 11);
            let mut mark = HighWaterMark::open(&mut flash, REGION).expect("fits");
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
fn a_mark_costs_one_write_for_each_reservation() {
    let mut flash = Memory::default();
    let mut mark = HighWaterMark::open(&mut flash, REGION).expect("fits");
    for value in 0..10_000 {
        mark.reserve(value, 100).expect("reserved");
    }
    assert_eq!(flash.writes(), 2 * 100);
}

#[test]
fn the_last_values() {
    let mut flash = Memory::default();
    let mut mark = HighWaterMark::open(&mut flash, REGION).expect("fits");
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
        ]
    );
    let store = ReserveError::Store(StoreError::Write);
    let source = store.source().and_then(|source| source.downcast_ref());
    assert_eq!(source, Some(&StoreError::Write));
    assert!(ReserveError::Exhausted.source().is_none());
}
