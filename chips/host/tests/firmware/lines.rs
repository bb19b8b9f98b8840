//! An image for QEMU's board between two serial lines.

use std::mem;

use anyhow::{Result, ensure};
use mavseal_chips_host::Image;

use crate::{elf::Elf, emulator::Machine, mps2::TICKS_PER_SECOND};

/// UART 0.
pub(crate) const LOCAL: usize = 0;
/// UART 1.
pub(crate) const RADIO: usize = 1;

/// Looks at its UARTs after which the firmware has done all that it has to for a packet.
const LOOKS: u32 = 20;
/// The same for a packet that is given up, where one may begin at each byte.
const MANY_LOOKS: u32 = 300 * LOOKS;

/// What the vehicle of a sealed link asks its radio every second.
const ASKS: [u8; 5] = *b"\x7E\x01B\r\x7E";

/// The image, and its lines.
pub(crate) struct Lines {
    pub(crate) machine: Machine,
}

impl Lines {
    /// Switches it on.
    pub(crate) fn start(image: &Image, elf: &Elf) -> Result<Self> {
        let machine = Machine::reset(image.chip, elf)?;
        Ok(Self { machine })
    }

    /// What comes out of the other side for `bytes` on this one, or came since it was looked at last.
    /// Questions to the radio are left out.
    pub(crate) fn pass(&mut self, side: usize, bytes: &[u8]) -> Result<Vec<u8>> {
        self.machine.mps2.borrow_mut().uarts[side].to.extend(bytes);
        self.machine.run_to_quiet(LOOKS)?;
        let mut board = self.machine.mps2.borrow_mut();
        let mut sent = mem::take(&mut board.uarts[1 - side].sent);
        let asks = |sent: &[u8]| sent.windows(ASKS.len()).position(|part| part == ASKS);
        while let Some(at) = asks(&sent) {
            sent.drain(at..at + ASKS.len());
        }
        Ok(sent)
    }

    /// Time passes.
    pub(crate) fn passes(&mut self, seconds: u64) {
        let mut board = self.machine.mps2.borrow_mut();
        board.pass(seconds * TICKS_PER_SECOND);
    }

    /// Nothing comes out of the other side for `bytes` on this one.
    pub(crate) fn rejected(&mut self, side: usize, bytes: &[u8]) -> Result<()> {
        let came = self.pass(side, bytes)?;
        ensure!(came.is_empty(), "{came:02x?} came out for {bytes:02x?}");
        Ok(())
    }

    /// Silence on all lines: a packet that has begun is given up.
    pub(crate) fn silence(&mut self) -> Result<()> {
        self.passes(11);
        self.machine.run_to_quiet(MANY_LOOKS)
    }

    /// A byte of `packet` is lost.
    pub(crate) fn loses_a_byte(&mut self, side: usize, packet: &[u8]) -> Result<()> {
        let (before, after) = packet.split_at(packet.len() / 2);
        self.rejected(side, before)?;
        self.machine.mps2.borrow_mut().uarts[side].overrun = true;
        self.rejected(side, &after[1..])?;
        self.silence()
    }

    /// Bytes of no packet, some of which begin like one.
    pub(crate) fn noise(&mut self) -> Result<()> {
        for side in [LOCAL, RADIO] {
            for byte in [0x55, 0xFD, 0xFE] {
                self.rejected(side, &[byte; 300])?;
                self.silence()?;
            }
        }
        Ok(())
    }
}
