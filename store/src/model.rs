//! A flash memory in RAM for tests: words written once, pages erased, power that fails at any step.
//!
//! As on an STM32, zeros may be written over a word that was written.
//!
//! A cut inside a write leaves the word as it was, whole, or with some of its bits written. Or its bits
//! read one time and not the next. Or its ECC does not fit, so that reading it fails. A cut inside an erase
//! does one of these to every word of the page. A number that the test gives decides which.

use core::fmt;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read,
    check_write,
};

/// Bytes of a word: what is written at once, and has one ECC.
pub const WORD_SIZE: usize = 8;
/// Bytes of a page: what is erased at once.
pub const PAGE_SIZE: usize = 2048;

/// Words of a page.
const WORDS: usize = PAGE_SIZE / WORD_SIZE;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Word {
    /// Never written since it was erased, or as good as that.
    Erased,
    Written([u8; WORD_SIZE]),
    /// Its bits are so weak that one reading succeeds and the next does not.
    Weak([u8; WORD_SIZE]),
    /// Its ECC does not fit its bits.
    Bad,
}

/// Why such a flash fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The request itself is wrong.
    Request(NorFlashErrorKind),
    /// There is no power.
    Power,
    /// A word that is read has a bad ECC.
    Ecc,
    /// A word that is to be written, other than with zeros, is not erased, or the test wants it to fail.
    Write,
    /// The test wants the erase to fail.
    Erase,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self, f)
    }
}

impl core::error::Error for Failure {}

impl NorFlashError for Failure {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Request(kind) => *kind,
            _ => NorFlashErrorKind::Other,
        }
    }
}

/// A flash of `PAGES` pages with 2 KB each, written in words of 8 bytes.
#[derive(Clone, Debug)]
pub struct Flash<const PAGES: usize> {
    words: [[Word; WORDS]; PAGES],
    /// Words written and pages erased until the power fails, inside the next of them.
    steps: Option<u32>,
    power: bool,
    chance: u64,
    writes: u64,
    erases: u64,
    /// Of 256 writes and erases, how many fail without a cut.
    failing: u8,
}

impl<const PAGES: usize> Default for Flash<PAGES> {
    fn default() -> Self {
        Self::new(0)
    }
}

impl<const PAGES: usize> Flash<PAGES> {
    /// An erased flash, under power. All that is left to chance comes from `chance`.
    #[must_use]
    pub const fn new(chance: u64) -> Self {
        Self {
            words: [[Word::Erased; WORDS]; PAGES],
            steps: None,
            power: true,
            chance,
            writes: 0,
            erases: 0,
            failing: 0,
        }
    }

    /// The power will fail inside the word or page that is written or erased after `steps` more.
    pub const fn cut_after(&mut self, steps: u32) {
        self.steps = Some(steps);
    }

    /// Takes the power away now.
    pub const fn cut(&mut self) {
        self.power = false;
    }

    /// Gives the power back.
    pub const fn restart(&mut self) {
        self.power = true;
        self.steps = None;
    }

    /// Whether it has power.
    #[must_use]
    pub const fn has_power(&self) -> bool {
        self.power
    }

    /// Lets so many of 256 writes and erases fail, with all that a cut inside them can leave.
    pub const fn fail(&mut self, of_256: u8) {
        self.failing = of_256;
    }

    /// Makes the word at `offset` one that cannot be read, until its page is erased or it is overwritten.
    pub fn spoil(&mut self, offset: usize) {
        if let Some(word) = self.word(offset / WORD_SIZE) {
            *word = Word::Bad;
        }
    }

    /// Words written so far.
    #[must_use]
    pub const fn writes(&self) -> u64 {
        self.writes
    }

    /// Pages erased so far.
    #[must_use]
    pub const fn erases(&self) -> u64 {
        self.erases
    }

    /// Whether these bytes are anywhere in it, in whole words.
    #[must_use]
    pub fn holds(&self, bytes: &[u8; WORD_SIZE]) -> bool {
        let mut words = self.words.iter().flatten();
        words.any(|word| matches!(word, Word::Written(word) | Word::Weak(word) if word == bytes))
    }

    fn word(&mut self, index: usize) -> Option<&mut Word> {
        self.words.as_flattened_mut().get_mut(index)
    }

    /// A number from 0 to 2^64 - 1 (splitmix64).
    const fn draw(&mut self) -> u64 {
        self.chance = self.chance.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.chance ^ (self.chance >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// Counts a step. Returns whether it is done as a whole.
    fn step(&mut self) -> Result<bool, Failure> {
        if !self.power {
            return Err(Failure::Power);
        }
        match &mut self.steps {
            Some(0) => {
                self.power = false;
                return Ok(false);
            }
            Some(steps) => *steps -= 1,
            None => {}
        }
        let [chance, ..] = self.draw().to_le_bytes();
        Ok(chance >= self.failing)
    }

    /// What is left of `before` when the change to `after` is cut.
    fn torn(&mut self, before: Word, after: Word) -> Word {
        match self.draw() % 5 {
            0 => before,
            1 => after,
            2 => Word::Bad,
            3 => match (before, after) {
                (Word::Erased, Word::Written(bytes)) | (Word::Written(bytes), Word::Erased) => {
                    Word::Weak(bytes)
                }
                _ => Word::Bad,
            },
            _ => {
                let bits = |word| match word {
                    Word::Written(bytes) | Word::Weak(bytes) => u64::from_le_bytes(bytes),
                    Word::Erased | Word::Bad => u64::MAX,
                };
                // Each bit is as it was or as it will be.
                let changed = bits(before) ^ bits(after);
                let mixed = bits(before) ^ (changed & self.draw());
                Word::Written(mixed.to_le_bytes())
            }
        }
    }
}

impl<const PAGES: usize> ErrorType for Flash<PAGES> {
    type Error = Failure;
}

impl<const PAGES: usize> ReadNorFlash for Flash<PAGES> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failure> {
        check_read(self, offset, bytes.len()).map_err(Failure::Request)?;
        if !self.power {
            return Err(Failure::Power);
        }
        for (at, byte) in (offset as usize..).zip(bytes) {
            let word = self.word(at / WORD_SIZE).map_or(Word::Bad, |word| *word);
            *byte = match word {
                Word::Erased => 0xFF,
                Word::Bad => return Err(Failure::Ecc),
                Word::Weak(_) if self.draw().is_multiple_of(16) => return Err(Failure::Ecc),
                Word::Written(bytes) | Word::Weak(bytes) => {
                    bytes.get(at % WORD_SIZE).copied().unwrap_or_default()
                }
            };
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        PAGES * PAGE_SIZE
    }
}

impl<const PAGES: usize> NorFlash for Flash<PAGES> {
    const WRITE_SIZE: usize = WORD_SIZE;
    const ERASE_SIZE: usize = PAGE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        check_erase(self, from, to).map_err(Failure::Request)?;
        let pages = from as usize / PAGE_SIZE..to as usize / PAGE_SIZE;
        for page in pages {
            let whole = self.step()?;
            self.erases += 1;
            for index in page * WORDS..(page + 1) * WORDS {
                let before = self.word(index).map_or(Word::Bad, |word| *word);
                let after = if whole {
                    Word::Erased
                } else {
                    self.torn(before, Word::Erased)
                };
                if let Some(word) = self.word(index) {
                    *word = after;
                }
            }
            if !whole {
                return Err(if self.power {
                    Failure::Erase
                } else {
                    Failure::Power
                });
            }
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        check_write(self, offset, bytes.len()).map_err(Failure::Request)?;
        let (chunks, _) = bytes.as_chunks::<WORD_SIZE>();
        for (index, chunk) in (offset as usize / WORD_SIZE..).zip(chunks) {
            let whole = self.step()?;
            self.writes += 1;
            let before = self.word(index).map_or(Word::Bad, |word| *word);
            if before != Word::Erased && *chunk != [0; WORD_SIZE] {
                return Err(Failure::Write);
            }
            let after = Word::Written(*chunk);
            let after = if whole {
                after
            } else {
                self.torn(before, after)
            };
            if let Some(word) = self.word(index) {
                *word = after;
            }
            if !whole {
                return Err(if self.power {
                    Failure::Write
                } else {
                    Failure::Power
                });
            }
        }
        Ok(())
    }
}
