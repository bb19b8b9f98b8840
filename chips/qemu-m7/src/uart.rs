//! The CMSDK APB UART (Arm DDI 0479, section 4.3), polled.

use core::fmt;

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};
use volatile_register::RW;

/// The peripheral clock, in hertz.
pub(crate) const CLOCK_HZ: u32 = 25_000_000;
const BAUD: u32 = 115_200;

const STATE_TRANSMIT_FULL: u32 = 1 << 0;
const STATE_RECEIVE_FULL: u32 = 1 << 1;
const STATE_RECEIVE_OVERRUN: u32 = 1 << 3;
const CONTROL_TRANSMIT: u32 = 1 << 0;
const CONTROL_RECEIVE: u32 = 1 << 1;

#[repr(C)]
struct Registers {
    data: RW<u32>,
    state: RW<u32>,
    control: RW<u32>,
    interrupt: RW<u32>,
    baud_divider: RW<u32>,
}

/// A UART without interrupts: one byte each way, flow control by QEMU.
pub struct Uart(&'static Registers);

impl Uart {
    /// The UART whose registers are at `address`, switched on.
    ///
    /// # Safety
    ///
    /// A CMSDK APB UART is at `address`, and nobody else uses it.
    pub(crate) unsafe fn new(address: usize) -> Self {
        // SAFETY: the caller's promise.
        let registers = unsafe { &*(address as *const Registers) };
        // SAFETY: these registers have no effect on memory.
        unsafe {
            registers.baud_divider.write(CLOCK_HZ / BAUD);
            registers.control.write(CONTROL_TRANSMIT | CONTROL_RECEIVE);
        }
        Self(registers)
    }

    fn is(&self, state: u32) -> bool {
        self.0.state.read() & state != 0
    }
}

/// A byte arrived before the one before it was read: at least one is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "logging", derive(defmt::Format))]
pub struct Overrun;

impl fmt::Display for Overrun {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a received byte was overrun by the next")
    }
}

impl core::error::Error for Overrun {}

impl embedded_io::Error for Overrun {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for Uart {
    type Error = Overrun;
}

impl ReadReady for Uart {
    fn read_ready(&mut self) -> Result<bool, Overrun> {
        if self.is(STATE_RECEIVE_OVERRUN) {
            // SAFETY: writing the bit clears it and does nothing else.
            unsafe { self.0.state.write(STATE_RECEIVE_OVERRUN) };
            return Err(Overrun);
        }
        Ok(self.is(STATE_RECEIVE_FULL))
    }
}

impl Read for Uart {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Overrun> {
        let mut count = 0;
        for slot in buffer {
            // An overrun is told by the next `read_ready`: these bytes are whole.
            if count > 0 && !self.is(STATE_RECEIVE_FULL) {
                break;
            }
            while !self.is(STATE_RECEIVE_FULL) {}
            [*slot, ..] = self.0.data.read().to_le_bytes();
            count += 1;
        }
        Ok(count)
    }
}

impl WriteReady for Uart {
    fn write_ready(&mut self) -> Result<bool, Overrun> {
        Ok(!self.is(STATE_TRANSMIT_FULL))
    }
}

impl Write for Uart {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Overrun> {
        let mut count = 0;
        for byte in bytes {
            if count > 0 && self.is(STATE_TRANSMIT_FULL) {
                break;
            }
            while self.is(STATE_TRANSMIT_FULL) {}
            // SAFETY: writing sends the byte and does nothing else.
            unsafe { self.0.data.write((*byte).into()) };
            count += 1;
        }
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), Overrun> {
        while self.is(STATE_TRANSMIT_FULL) {}
        Ok(())
    }
}
