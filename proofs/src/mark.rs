//! T2: the mark in flash is above everything that was used before, whenever the power fails.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use mavseal_store::{
    Binding, HighWaterMark, Journal, MarkError, ProvisionError, Region, ReserveError, StoreError,
};

/// Bytes of a word.
const WORD: usize = 8;
/// How often the first mark is written: in so many cuts in a row, but one, it is known to be cut.
const COPIES: usize = if cfg!(kani) { 2 } else { 4 };
/// Records of a page, of 16 bytes each. In proofs the first mark fills it.
const RECORDS: usize = if cfg!(kani) { 2 } else { 8 };
/// Words of a page.
const PAGE: usize = 2 * RECORDS;
/// Words of the flash: two pages.
pub const WORDS: usize = 2 * PAGE;
/// The two pages.
pub const REGION: Region = Region {
    start: 0,
    page_size: (PAGE * WORD) as u32,
};
/// What the marks are for.
pub const BINDING: Binding = Binding::new(KIND, KEY);
const KIND: u8 = 1;
const KEY: [u8; 4] = [2, 3, 5, 7];

/// A flash for two pages of eight records each, in proofs of two, whose power fails at a step.
///
/// The smallest that has everything: a record and its copy in a page, a full page, an erase.
#[derive(Clone, Copy, Debug)]
pub struct Small {
    words: [Word; WORDS],
    cut: Cut,
    power: bool,
    /// Whether it erases no page any more.
    pub worn: bool,
    /// Whether it writes no zeros over what was written.
    pub strict: bool,
}

/// Where the power fails, and what is left of each word that was under way.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub struct Cut {
    /// Words written and pages erased before; in the next one the power fails.
    pub after: u8,
    /// What becomes of the word, or of the words of the page, in turn. By its remainder of 4: as it was, as it
    /// was to be, unreadable, or readable in the next run alone.
    pub left: [u8; 4],
}

impl Cut {
    /// The power does not fail.
    pub const NONE: Self = Self {
        after: u8::MAX,
        left: [0; 4],
    };
}

/// No enumeration with contents: a solver knows the parts of a structure better.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Word {
    state: State,
    bytes: [u8; WORD],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Erased,
    Written,
    /// Reads well in the run after the cut, and in no other.
    Weak,
    /// Has been read in that run.
    WeakRead,
    Bad,
}

const ERASED: Word = Word {
    state: State::Erased,
    bytes: [0xFF; WORD],
};

impl Default for Small {
    fn default() -> Self {
        Self {
            words: [ERASED; WORDS],
            cut: Cut::NONE,
            power: true,
            worn: false,
            strict: false,
        }
    }
}

impl Small {
    /// Power on, until `cut`. After a cut that left a word readable for a while, the next one leaves
    /// none. If every record of a page were of that kind, none could be relied on.
    pub fn restart(&mut self, mut cut: Cut) {
        if self.words.iter().any(|word| word.state == State::Weak) {
            for left in &mut cut.left {
                if *left % 4 == 3 {
                    *left = 2;
                }
            }
        }
        for word in &mut self.words {
            word.state = match word.state {
                State::Weak => State::WeakRead,
                State::WeakRead => State::Bad,
                other => other,
            };
        }
        self.cut = cut;
        self.power = true;
    }

    /// Makes the word unreadable that is at this place of all.
    pub fn spoil(&mut self, word: usize) {
        self.words[word].state = State::Bad;
    }

    /// Whether these bytes are anywhere in it and can be read.
    #[must_use]
    pub fn holds(&self, bytes: [u8; WORD]) -> bool {
        let mut words = self.words.iter();
        words.any(|word| word.state != State::Bad && word.bytes == bytes)
    }

    /// One step; whether it is done as a whole.
    fn step(&mut self) -> Result<bool, NorFlashErrorKind> {
        if !self.power {
            return Err(NorFlashErrorKind::Other);
        }
        match self.cut.after.checked_sub(1) {
            Some(after) => self.cut.after = after,
            None => self.power = false,
        }
        Ok(self.power)
    }
}

/// What the cut leaves of `before`, on its way to `after`.
fn left(before: Word, after: Word, left: u8) -> Word {
    let state = |word: Word, state| Word { state, ..word };
    match left % 4 {
        0 => before,
        1 => after,
        2 => state(before, State::Bad),
        _ if after.state == State::Written => state(after, State::Weak),
        _ if before.state == State::Written => state(before, State::Weak),
        _ => state(before, State::Bad),
    }
}

impl ErrorType for Small {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Small {
    const READ_SIZE: usize = WORD;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        let first = offset as usize / WORD;
        for (word, bytes) in self.words[first..].iter().zip(bytes.chunks_exact_mut(WORD)) {
            if word.state == State::Bad {
                return Err(NorFlashErrorKind::Other);
            }
            bytes.copy_from_slice(&word.bytes);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        WORDS * WORD
    }
}

impl NorFlash for Small {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = PAGE * WORD;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        if self.worn {
            return Err(NorFlashErrorKind::Other);
        }
        let whole = self.step()?;
        let first = from as usize / WORD;
        for (at, word) in self.words[first..].iter_mut().take(PAGE).enumerate() {
            *word = if whole {
                ERASED
            } else {
                left(*word, ERASED, self.cut.left[at % 4])
            };
        }
        if whole {
            Ok(())
        } else {
            Err(NorFlashErrorKind::Other)
        }
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        let first = offset as usize / WORD;
        for (at, bytes) in (first..).zip(bytes.chunks_exact(WORD)) {
            let mut after = Word {
                state: State::Written,
                bytes: [0; WORD],
            };
            after.bytes.copy_from_slice(bytes);
            let whole = self.step()?;
            let before = self.words[at];
            let zeros = after.bytes == [0; WORD] && !self.strict;
            if before.state != State::Erased && !zeros {
                return Err(NorFlashErrorKind::Other);
            }
            if !whole {
                self.words[at] = left(before, after, self.cut.left[0]);
                return Err(NorFlashErrorKind::Other);
            }
            self.words[at] = after;
        }
        Ok(())
    }
}

/// Where the first mark begins.
pub const FIRST: u64 = 5;

fn open(flash: &mut Small) -> Result<HighWaterMark<&mut Small>, MarkError> {
    HighWaterMark::open(flash, REGION, BINDING)
}

fn provision(flash: &mut Small) -> Result<HighWaterMark<&mut Small>, ProvisionError> {
    HighWaterMark::provision(flash, REGION, BINDING, FIRST)
}

/// T2, over runs that end wherever the power fails: the mark that a run finds is above every value that
/// was used in any run before. A value is used only below the mark. The mark is rejected only when there
/// is no power, and stays then. A start after the last run finds such a mark too. Where none is found, the run
/// provisions the first: that is never so after one was stored, and it is [`MarkError::NotProvisioned`] however
/// one run was cut in storing it, or three in a row. Returns the last value that was used, and the mark.
///
/// A run takes `uses` values, the first of them the mark itself, each one more than the one before.
///
/// # Panics
///
/// If the property does not hold.
pub fn runs(
    flash: &mut Small,
    cuts: &[Cut],
    uses: u8,
    ahead: u64,
) -> (Option<u64>, Result<u64, MarkError>) {
    let mut used = None;
    let mut stored = false;
    for (number, cut) in cuts.iter().enumerate() {
        flash.restart(*cut);
        let mut mark = match open(flash) {
            Ok(mark) => {
                check(Ok(mark.get()), stored, number, used);
                mark
            }
            Err(error) => {
                check(Err(error), stored, number, used);
                let Ok(mark) = provision(flash) else {
                    assert!(!flash.power, "rejected under power");
                    continue;
                };
                stored = true;
                mark
            }
        };
        let start = mark.get();
        let mut power = true;
        for value in (start..).take(uses.into()) {
            let before = mark.get();
            match mark.reserve(value, ahead) {
                Ok(()) => {
                    assert!(power);
                    assert!(mark.get() > value);
                    used = Some(value);
                    stored = true;
                }
                Err(error) => {
                    assert!(matches!(error, ReserveError::Store(_)));
                    assert_eq!(mark.get(), before);
                    power = false;
                    break;
                }
            }
        }
        let flash = mark.into_flash();
        assert!(power || !flash.power, "rejected under power");
    }
    flash.restart(Cut::NONE);
    let found = open(flash).map(|mark| mark.get());
    check(found, stored, cuts.len(), used);
    (used, found)
}

/// What the start after `cuts` runs may find.
fn check(found: Result<u64, MarkError>, stored: bool, cuts: usize, used: Option<u64>) {
    match found {
        Ok(start) => assert!(start >= FIRST && used.is_none_or(|used| start > used)),
        Err(error) => {
            assert!(!stored, "a mark is lost");
            // So many cuts in a row look like damage.
            assert!(error == MarkError::NotProvisioned || cuts >= COPIES);
        }
    }
}

/// T2, with one word that cannot be read: the mark that is found is above `used`. Whether there is one.
///
/// # Panics
///
/// If the property does not hold.
#[must_use]
pub fn spoiled(mut flash: Small, word: usize, used: Option<u64>) -> bool {
    flash.spoil(word);
    match open(&mut flash) {
        Ok(mark) => {
            assert!(used.is_none_or(|used| mark.get() > used));
            true
        }
        // No mark is not a mark of zero. Nor is it one that never was.
        Err(error) => {
            assert!(used.is_none() || error == MarkError::Unreadable);
            false
        }
    }
}

/// T2, for another kind or key: the marks in `flash` are none of theirs.
///
/// # Panics
///
/// If the property does not hold.
pub fn foreign(flash: &mut Small, other: Binding) {
    let found = HighWaterMark::open(flash, REGION, other);
    assert_eq!(found.err(), Some(MarkError::Unreadable));
}

/// T2, for what is given up: after `count` records of `OLD`, nothing of them can be read when `NEW` has taken
/// their place; or the error says so.
///
/// # Errors
///
/// What the flash gives reason for.
///
/// # Panics
///
/// If the property does not hold.
pub fn forgotten(flash: &mut Small, count: u8, replace: bool) -> Result<(), StoreError> {
    let (worn, strict) = (flash.worn, flash.strict);
    (flash.worn, flash.strict) = (false, false);
    let (mut journal, _) = Journal::open(&mut *flash, REGION, BINDING).expect("the region fits");
    for _ in 0..count {
        journal.append(&OLD).expect("stored");
    }
    (flash.worn, flash.strict) = (worn, strict);
    let (mut journal, _) = Journal::open(&mut *flash, REGION, BINDING).expect("the region fits");
    let given_up = if replace {
        journal.replace(&NEW)
    } else {
        journal.append(&NEW).and_then(|()| journal.forget())
    };
    let newest = journal.newest();
    let held = flash.holds(OLD);
    match given_up {
        Ok(()) => assert!(newest == Some(NEW) && !held),
        Err(StoreError::Remains) => assert!(newest == Some(NEW) && held && worn && strict),
        Err(error) => assert!(matches!(error, StoreError::Erase(_)) && worn),
    }
    given_up
}

/// What is given up, and what takes its place.
const OLD: [u8; WORD] = [0x11; WORD];
const NEW: [u8; WORD] = [0x22; WORD];

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cut() -> impl Strategy<Value = Cut> {
        let after = prop_oneof![4 => 0..14_u8, 1 => 14..60_u8];
        (after, any::<[u8; 4]>()).prop_map(|(after, left)| Cut { after, left })
    }

    proptest! {
        #[test]
        fn t2_random(
            cuts in proptest::collection::vec(cut(), 1..30),
            uses in 1..6_u8,
            ahead in 0..4_u64,
        ) {
            let mut flash = Small::default();
            let (used, found) = runs(&mut flash, &cuts, uses, ahead);
            for word in 0..WORDS {
                let there = spoiled(flash, word, used);
                prop_assert!(!there || found.is_ok());
            }
        }

        /// Without cuts every word has its copy.
        #[test]
        fn t2_one_word(count in 1..6_usize, uses in 0..6_u8, ahead in 0..4_u64) {
            let mut flash = Small::default();
            let (used, _) = runs(&mut flash, &vec![Cut::NONE; count], uses, ahead);
            for word in 0..WORDS {
                prop_assert!(spoiled(flash, word, used));
            }
        }

        #[test]
        fn t2_another_key(key: [u8; 4], uses in 0..6_u8) {
            prop_assume!(key != KEY);
            provisioned_anew(Binding::new(KIND, key), uses);
        }

        #[test]
        fn t2_another_kind(kind: u8, uses in 0..6_u8) {
            prop_assume!(kind != KIND);
            provisioned_anew(Binding::new(kind, KEY), uses);
        }
    }

    /// For another binding the region holds nothing, and once it is provisioned, nothing else.
    fn provisioned_anew(other: Binding, uses: u8) {
        let mut flash = Small::default();
        let _ = runs(&mut flash, &[Cut::NONE], uses, 0);
        foreign(&mut flash, other);
        HighWaterMark::provision(&mut flash, REGION, other, 2).expect("stored");
        let found = HighWaterMark::open(&mut flash, REGION, other).map(|mark| mark.get());
        assert_eq!(found, Ok(2));
        foreign(&mut flash, BINDING);
    }

    /// One cut anywhere, with everything that it can leave, then another, then one that leaves nothing.
    #[test]
    fn t2_every_cut() {
        for after in 0..30 {
            for left in 0..4 {
                for next in 0..12 {
                    for then in 0..4 {
                        let first = Cut {
                            after,
                            left: [left, next, left, next],
                        };
                        let second = Cut {
                            after: next,
                            left: [then; 4],
                        };
                        let cuts = [first, second, Cut::NONE, Cut::NONE];
                        let used = runs(&mut Small::default(), &cuts, 5, 0);
                        assert!(used.0.is_some());
                    }
                }
            }
        }
    }

    /// Any number of records before, in flash that erases and overwrites, or not.
    #[test]
    fn t2_what_is_given_up_is_gone() {
        let mut told = [0; 2];
        for count in 1..20 {
            for bits in 0..8 {
                let [worn, strict, replace] = [1, 2, 4].map(|bit| bits & bit != 0);
                let mut flash = Small::default();
                (flash.worn, flash.strict) = (worn, strict);
                match forgotten(&mut flash, count, replace) {
                    Ok(()) => told[0] += 1,
                    Err(StoreError::Remains) => told[1] += 1,
                    Err(_) => {}
                }
            }
        }
        assert!(told.iter().all(|told| *told > 10), "{told:?}");
    }

    /// Three first marks that are cut, with all that they can leave, are no damage; the fourth is.
    #[test]
    fn t2_first_mark_cut_again_and_again() {
        let mut damaged = 0;
        for after in 0..2 {
            for left in 0..64_u8 {
                let cut = |at: u8| Cut {
                    after: (after + at) % 2,
                    left: [left >> (2 * at) & 3; 4],
                };
                let cuts = [cut(0), cut(1), cut(2)];
                let _ = runs(&mut Small::default(), &cuts, 0, 0);
                let mut flash = Small::default();
                let cuts = [cut(0), cut(1), cut(2), cut(0)];
                let (_, found) = runs(&mut flash, &cuts, 0, 0);
                damaged += u32::from(found == Err(MarkError::Unreadable));
                // It can be provisioned all the same.
                flash.restart(Cut::NONE);
                let mark = provision(&mut flash).expect("stored");
                assert_eq!(mark.get(), FIRST);
                let _ = runs(&mut flash, &[Cut::NONE; 2], 1, 0);
                assert_eq!(open(&mut flash).expect("stored").get(), FIRST + 2);
            }
        }
        assert!(damaged > 0);
    }
}

#[cfg(kani)]
mod verification {
    use super::*;

    fn cut(after: u8) -> Cut {
        let left = kani::any();
        Cut { after, left }
    }

    /// A run provisions the first mark, twice, which fills a page, and uses it, which fills the other. In the
    /// next, the power fails at step `AT`, whatever is left of the word, or of the page. The steps before are
    /// then known to the solver. Gives how far the mark that is found is above the first.
    fn cut_at<const AT: u8>() -> u64 {
        let cuts = [Cut::NONE, cut(AT)];
        let (used, found) = runs(&mut Small::default(), &cuts, 1, 0);
        assert_eq!(used, Some(FIRST));
        found.expect("a mark") - FIRST
    }

    /// In the erase of the other page, and in the first word of a record: the mark is the one before.
    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_cut_in_the_erase() {
        assert_eq!(cut_at::<0>(), 1);
        kani::cover!(true, "found");
    }

    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_cut_in_the_first_word() {
        assert_eq!(cut_at::<1>(), 1);
        kani::cover!(true, "found");
    }

    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_cut_in_the_second_word() {
        let above = cut_at::<2>();
        kani::cover!(above == 1, "the mark before");
        kani::cover!(above == 2, "the mark that was being stored");
    }

    /// In the copy: the record counts.
    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_cut_in_the_copy() {
        assert_eq!(cut_at::<3>(), 2);
        kani::cover!(true, "found");
    }

    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_cut_in_the_last_word() {
        assert_eq!(cut_at::<4>(), 2);
        kani::cover!(true, "found");
    }

    /// In the first record of all: it is there, or can be provisioned.
    fn first_cut_at<const AT: u8>() -> Result<u64, MarkError> {
        let (used, found) = runs(&mut Small::default(), &[cut(AT)], 1, 0);
        assert_eq!(used, None);
        found
    }

    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_cut_in_the_first_mark() {
        let found = first_cut_at::<1>();
        kani::cover!(found == Ok(FIRST), "the mark");
        kani::cover!(found == Err(MarkError::NotProvisioned), "none");
    }

    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_cut_in_the_first_copy() {
        assert_eq!(first_cut_at::<2>(), Ok(FIRST));
        kani::cover!(true, "found");
    }

    /// Any one word cannot be read, after two marks.
    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_one_word() {
        let mut flash = Small::default();
        let (used, _) = runs(&mut flash, &[Cut::NONE], 1, 0);
        let word = kani::any_where(|word| *word < WORDS);
        assert!(spoiled(flash, word, used));
        kani::cover!(word == 0, "a word of the first mark");
        kani::cover!(word == WORDS - 1, "a word of a copy");
    }

    /// Of any other kind, or of any other key.
    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_another_key() {
        let mut flash = Small::default();
        let _ = runs(&mut flash, &[Cut::NONE], 0, 0);
        let own_kind = kani::any();
        let other = if own_kind {
            Binding::new(KIND, kani::any())
        } else {
            Binding::new(kani::any(), KEY)
        };
        kani::assume(other != BINDING);
        foreign(&mut flash, other);
        kani::cover!(own_kind, "another key");
        kani::cover!(!own_kind, "another kind");
    }
}
