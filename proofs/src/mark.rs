//! T2: the mark in flash is above everything that was used before, whenever the power fails.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use mavseal_store::{Mark, Region, ReserveError};

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
    /// What becomes of the word, or of the words of the page; by its remainder of 4: as it was, as it was
    /// to be, unreadable, or readable in the next run and in no other.
    pub left: [u8; PAGE],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Word {
    Erased,
    Written([u8; WORD]),
    /// Reads well in the run after the cut, `true` then, and in no other.
    Weak([u8; WORD], bool),
    Bad,
}

impl Default for Small {
    fn default() -> Self {
        Self {
            words: [Word::Erased; WORDS],
            cut: Cut {
                after: u8::MAX,
                left: [0; PAGE],
            },
            power: true,
        }
    }
}

impl Small {
    /// Power on, until `cut`. After a cut that left a word readable for a while, the next one leaves none:
    /// if every record of a page were of that kind, one after the other, none could be relied on.
    pub fn restart(&mut self, mut cut: Cut) {
        let weak = |word: &Word| matches!(word, Word::Weak(_, false));
        if self.words.iter().any(weak) {
            for left in &mut cut.left {
                if *left % 4 == 3 {
                    *left = 2;
                }
            }
        }
        for word in &mut self.words {
            *word = match *word {
                Word::Weak(bytes, false) => Word::Weak(bytes, true),
                Word::Weak(_, true) => Word::Bad,
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
    match left % 4 {
        0 => before,
        1 => after,
        2 => Word::Bad,
        _ => match (before, after) {
            (_, Word::Written(bytes)) | (Word::Written(bytes), _) => Word::Weak(bytes, false),
            _ => Word::Bad,
        },
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
            match word {
                Word::Erased => bytes.fill(0xFF),
                Word::Written(word) | Word::Weak(word, _) => bytes.copy_from_slice(word),
                Word::Bad => return Err(NorFlashErrorKind::Other),
            }
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
                Word::Erased
            } else {
                left(*word, Word::Erased, fate)
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
            let mut word = [0; WORD];
            word.copy_from_slice(bytes);
            let whole = self.step()?;
            if self.words[at] != Word::Erased {
                return Err(NorFlashErrorKind::Other);
            }
            let after = Word::Written(word);
            if !whole {
                self.words[at] = left(Word::Erased, after, self.cut.left[0]);
                return Err(NorFlashErrorKind::Other);
            }
            self.words[at] = after;
        }
        Ok(())
    }
}

/// T2, over runs that end wherever the power fails: the mark that a run finds is above every value that was
/// used in any run before; a value is used only below the mark; the mark is refused only when there is no
/// power, and stays then. Returns the last value that was used.
///
/// A run takes `uses` values, the first of them the mark itself, each one more than the one before.
///
/// # Panics
///
/// If the property does not hold.
pub fn runs(flash: &mut Small, cuts: &[Cut], uses: u8, ahead: u64) -> Option<u64> {
    let region = Region {
        start: 0,
        page_size: (PAGE * WORD) as u32,
    };
    let mut used = None;
    for cut in cuts {
        flash.restart(*cut);
        let mut mark = Mark::open(&mut *flash, region).expect("the region fits");
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
        assert!(power || !flash.power, "refused under power");
    }
    used
}

#[cfg(test)]
mod twins {
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
                        assert!(used.is_some());
                    }
                }
            }
        }
    }
}

#[cfg(kani)]
mod harness {
    use super::*;

    fn any_cut() -> Cut {
        Cut {
            after: kani::any(),
            left: kani::any(),
        }
    }

    /// The power fails anywhere in a run that fills a page, and anywhere in the next.
    #[kani::proof]
    #[kani::unwind(20)]
    fn t2_two_cuts() {
        let cuts = [any_cut(), any_cut(), any_cut()];
        kani::assume(cuts[0].after <= 8 && cuts[1].after <= 3);
        let used = runs(&mut Small::default(), &cuts, 2, 0);
        kani::cover!(used.is_none(), "nothing was used");
        kani::cover!(used == Some(5), "no cut counted");
    }
}
