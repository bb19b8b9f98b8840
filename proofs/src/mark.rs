//! T2: the mark in flash is above everything that was used before, whenever the power fails.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use mavseal_store::{HighWaterMark, Region, ReserveError};

/// Bytes of a word.
const WORD: usize = 8;
/// Words of a page: two records of 16 bytes.
const PAGE: usize = 4;
/// Words of the flash: two pages.
const WORDS: usize = 2 * PAGE;

/// A flash for two pages of two marks each, whose power fails at a step.
///
/// The smallest that has everything: a record before another in its page, a full page, an erase.
#[derive(Clone, Copy, Debug)]
pub struct Small {
    words: [Word; WORDS],
    cut: Cut,
    power: bool,
}

/// Where the power fails, and what is left of each word that was under way.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub struct Cut {
    /// Words written and pages erased before; in the next one the power fails.
    pub after: u8,
    /// What becomes of the word, or of the words of the page. By its remainder of 4: as it was, as it
    /// was to be, unreadable, or readable in the next run alone.
    pub left: [u8; PAGE],
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
            cut: Cut {
                after: u8::MAX,
                left: [0; PAGE],
            },
            power: true,
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
        let whole = self.step()?;
        let first = from as usize / WORD;
        for (word, fate) in self.words[first..].iter_mut().zip(self.cut.left) {
            *word = if whole {
                ERASED
            } else {
                left(*word, ERASED, fate)
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
            if self.words[at].state != State::Erased {
                return Err(NorFlashErrorKind::Other);
            }
            if !whole {
                self.words[at] = left(ERASED, after, self.cut.left[0]);
                return Err(NorFlashErrorKind::Other);
            }
            self.words[at] = after;
        }
        Ok(())
    }
}

/// T2, over runs that end wherever the power fails: the mark that a run finds is above every value that
/// was used in any run before. A value is used only below the mark. The mark is rejected only when there
/// is no power, and stays then. A start after the last run finds such a mark too. Returns the last value
/// that was used, and that mark.
///
/// A run takes `uses` values, the first of them the mark itself, each one more than the one before.
///
/// # Panics
///
/// If the property does not hold.
pub fn runs(flash: &mut Small, cuts: &[Cut], uses: u8, ahead: u64) -> (Option<u64>, u64) {
    let region = Region {
        start: 0,
        page_size: (PAGE * WORD) as u32,
    };
    let mut used = None;
    for cut in cuts {
        flash.restart(*cut);
        let mut mark = HighWaterMark::open(&mut *flash, region).expect("the region fits");
        let start = mark.get();
        assert!(used.is_none_or(|used| start > used));
        let mut power = true;
        for value in (start..).take(uses.into()) {
            let before = mark.get();
            match mark.reserve(value, ahead) {
                Ok(()) => {
                    assert!(power);
                    assert!(mark.get() > value);
                    used = Some(value);
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
    flash.restart(Cut {
        after: u8::MAX,
        left: [0; PAGE],
    });
    let found = HighWaterMark::open(flash, region)
        .expect("the region fits")
        .get();
    assert!(used.is_none_or(|used| found > used));
    (used, found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cut() -> impl Strategy<Value = Cut> {
        let after = prop_oneof![4 => 0..8_u8, 1 => 8..40_u8];
        (after, any::<[u8; PAGE]>()).prop_map(|(after, left)| Cut { after, left })
    }

    proptest! {
        #[test]
        fn t2_random(
            cuts in proptest::collection::vec(cut(), 1..30),
            uses in 1..6_u8,
            ahead in 0..4_u64,
        ) {
            runs(&mut Small::default(), &cuts, uses, ahead);
        }
    }

    /// One cut anywhere, with everything that it can leave, then another, then one that leaves nothing.
    #[test]
    fn t2_every_cut() {
        let none = Cut {
            after: u8::MAX,
            left: [0; PAGE],
        };
        for after in 0..14 {
            for left in 0..4 {
                for next in 0..4 {
                    for then in 0..4 {
                        let first = Cut {
                            after,
                            left: [left, next, left, next],
                        };
                        let second = Cut {
                            after: next,
                            left: [then; PAGE],
                        };
                        let cuts = [first, second, none, none];
                        let used = runs(&mut Small::default(), &cuts, 5, 0);
                        assert!(used.0.is_some());
                    }
                }
            }
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;

    /// A run fills a page with two marks. In the next, the power fails at step `AT`, whatever is left of
    /// the word, or of the page. The steps before are then known to the solver. Gives the mark that is
    /// found.
    fn cut_at<const AT: u8>() -> u64 {
        let cut = |after, left| Cut { after, left };
        let cuts = [cut(u8::MAX, [0; PAGE]), cut(AT, kani::any())];
        let (used, found) = runs(&mut Small::default(), &cuts, 2, 0);
        assert_eq!(used, Some(if AT < 3 { 1 } else { 2 }));
        found
    }

    macro_rules! cuts {
        ($($name:ident $at:literal $mark:literal $or:literal;)*) => {$(
            #[kani::proof]
            #[kani::unwind(20)]
            fn $name() {
                let found = cut_at::<$at>();
                kani::cover!(found == $mark, "the mark before");
                kani::cover!(found == $or, "the mark that was being stored");
            }
        )*};
    }

    // Steps 1 and 2 are the words of a record, 3 and 4 those of the next. The mark is in the first.
    cuts! {
        t2_cut_in_the_second_word 2 2 3;
        t2_cut_in_the_last_word 4 3 4;
    }

    /// In the erase of the other page, and in the first word of a record: the mark is the one before.
    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_cut_in_the_erase() {
        assert_eq!(cut_at::<0>(), 2);
        kani::cover!(true, "found");
    }

    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_cut_in_the_first_word() {
        assert_eq!(cut_at::<1>(), 2);
        kani::cover!(true, "found");
    }
}
