//! Flash memory, modelled in RAM that a reset of the emulated machine leaves as it is.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// Bytes of a word, which is written at once.
const WORD_SIZE: usize = 8;
/// Bytes of a page, which is erased at once.
pub const PAGE_SIZE: usize = 2048;
/// Bytes of one flash: two pages.
const SIZE: usize = 2 * PAGE_SIZE;
/// How many counters of a sealed link there is a flash for: those of a vehicle and 8 stations.
pub const COUNTERS: usize = 9;
/// How many flashes there are: three for the relay, and those.
const COUNT: usize = 3 + COUNTERS;
/// What erased bytes read as.
const ERASED: u8 = 0xFF;

/// What stands before the flashes once they have been erased for the first time.
const MADE: [u8; WORD_SIZE] = *b"mavseal\0";

/// All flashes, behind the word that says that they are there.
type Contents = ([u8; WORD_SIZE], [[u8; SIZE]; COUNT]);

#[repr(C, align(8))]
struct Memory(UnsafeCell<MaybeUninit<Contents>>);

// SAFETY: `Flash::new` is the only one that reaches it, and its caller promises to be alone.
unsafe impl Sync for Memory {}

/// Not cleared at the start.
// SAFETY: the section is one that cortex-m-rt's linker script has, and neither loads nor clears.
#[unsafe(link_section = ".uninit.flash")]
static MEMORY: Memory = Memory(UnsafeCell::new(MaybeUninit::uninit()));

/// Two pages of 2 KB, written in words of 8 bytes, as the STM32C0 has them.
pub struct Flash(&'static mut [u8; SIZE]);

impl Flash {
    /// All flashes: two for the relay's marks, one for its keys, one for each counter of a sealed link. They are
    /// erased when the machine has just been switched on, as those of a new board are.
    ///
    /// # Safety
    ///
    /// Called once in a run of the program.
    pub(crate) unsafe fn new() -> [Self; COUNT] {
        // SAFETY: the caller's promise; every byte of RAM holds some value, which nobody but this program
        // changes, and a `u8` may be any.
        let (made, flashes) = unsafe { (*MEMORY.0.get()).assume_init_mut() };
        if *made != MADE {
            for flash in &mut *flashes {
                flash.fill(ERASED);
            }
            *made = MADE;
        }
        flashes.each_mut().map(Self)
    }

    fn part(&mut self, from: u32, length: usize) -> Result<&mut [u8], NorFlashErrorKind> {
        let from = from as usize;
        let part = self.0.get_mut(from..from.saturating_add(length));
        part.ok_or(NorFlashErrorKind::OutOfBounds)
    }
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        let part = self.part(offset, bytes.len())?;
        for (byte, read) in bytes.iter_mut().zip(part) {
            *byte = *read;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        SIZE
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = WORD_SIZE;
    const ERASE_SIZE: usize = PAGE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        let length = to.saturating_sub(from) as usize;
        self.part(from, length)?.fill(ERASED);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        let part = self.part(offset, bytes.len())?;
        if part.iter().any(|byte| *byte != ERASED) {
            return Err(NorFlashErrorKind::Other);
        }
        for (written, byte) in part.iter_mut().zip(bytes) {
            *written = *byte;
        }
        Ok(())
    }
}
