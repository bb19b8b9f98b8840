//! The peripherals of the MPS2-AN500 that the firmware uses: a timer, two UARTs and a watchdog that never ends
//! (Arm DDI 0479), and a debugger that tells the time.

use std::{cell::RefCell, collections::VecDeque, rc::Rc};

use armagnac::{
    core::{MapConflict, Processor},
    memory::{Env, MemoryAccessError, MemoryInterface},
};

const TIMER: u32 = 0x4000_0000;
const UARTS: [u32; 2] = [0x4000_4000, 0x4000_5000];
const WATCHDOG: u32 = 0x4000_8000;
const GROUP_SIZE: u32 = 0x1000;

const TIMER_VALUE: u32 = 0x04;
const UART_DATA: u32 = 0x00;
const UART_STATE: u32 = 0x04;
const RECEIVE_FULL: u32 = 1 << 1;
const RECEIVE_OVERRUN: u32 = 1 << 3;

/// Cycles of the timer in a tick of 10 microseconds.
const CYCLES_PER_TICK: u64 = 250;
pub(crate) const TICKS_PER_SECOND: u64 = 100_000;

/// When the board is switched on, in seconds since 1970, and the beginning of 2015.
const START: u32 = 1_800_000_000;
const EPOCH: u32 = 1_420_070_400;

/// What is connected to the board.
#[derive(Default)]
pub(crate) struct Mps2 {
    pub(crate) uarts: [Uart; 2],
    /// Looks at the UARTs since a byte moved or waited last.
    pub(crate) quiet: u32,
    cycles: u64,
}

/// One serial port.
#[derive(Default)]
pub(crate) struct Uart {
    /// Bytes that are on their way to the firmware.
    pub(crate) to: VecDeque<u8>,
    /// Bytes that it has sent.
    pub(crate) sent: Vec<u8>,
    /// Whether a byte was lost before those.
    pub(crate) overrun: bool,
}

impl Mps2 {
    /// Connects it with a processor.
    pub(crate) fn map(
        this: &Rc<RefCell<Self>>,
        processor: &mut Processor,
    ) -> Result<(), MapConflict> {
        for start in [TIMER, UARTS[0], UARTS[1], WATCHDOG] {
            let all = Rc::clone(this);
            processor.map_iface(start, Rc::new(RefCell::new(Group { start, all })))?;
        }
        Ok(())
    }

    /// The time of day in seconds since 1970. A second passes at each call, as firmware waits for the next.
    pub(crate) fn next_second(&mut self) -> u32 {
        self.pass(TICKS_PER_SECOND);
        START + (self.cycles / CYCLES_PER_TICK / TICKS_PER_SECOND) as u32
    }

    /// The time of day in ticks of 10 microseconds since 2015.
    pub(crate) fn now(&self) -> u64 {
        u64::from(START - EPOCH) * TICKS_PER_SECOND + self.cycles / CYCLES_PER_TICK
    }

    /// Lets `ticks` of 10 microseconds pass.
    pub(crate) fn pass(&mut self, ticks: u64) {
        self.cycles += ticks * CYCLES_PER_TICK;
    }
}

/// One group of registers, as the processor sees it.
struct Group {
    start: u32,
    all: Rc<RefCell<Mps2>>,
}

impl MemoryInterface for Group {
    fn read_u32le(&mut self, offset: u32, _: &mut Env) -> Result<u32, MemoryAccessError> {
        let board = &mut *self.all.borrow_mut();
        if (self.start, offset) == (TIMER, TIMER_VALUE) {
            // It counts down. Each look takes a tick.
            board.cycles += CYCLES_PER_TICK;
            return Ok(u32::MAX.wrapping_sub(board.cycles as u32));
        }
        let uart = UARTS.iter().position(|start| *start == self.start);
        let uart = uart.map(|uart| &mut board.uarts[uart]);
        match (uart, offset) {
            (Some(uart), UART_DATA) => {
                board.quiet = 0;
                let byte = uart.to.pop_front();
                byte.map(u32::from).ok_or(MemoryAccessError::Illegal)
            }
            (Some(uart), UART_STATE) => {
                let full = if uart.to.is_empty() { 0 } else { RECEIVE_FULL };
                let overrun = if uart.overrun { RECEIVE_OVERRUN } else { 0 };
                let waits = board.uarts.iter().any(|uart| !uart.to.is_empty());
                board.quiet = if waits { 0 } else { board.quiet + 1 };
                Ok(full | overrun)
            }
            _ => Err(MemoryAccessError::InvalidAddress),
        }
    }

    fn write_u32le(
        &mut self,
        offset: u32,
        value: u32,
        _: &mut Env,
    ) -> Result<(), MemoryAccessError> {
        let board = &mut *self.all.borrow_mut();
        let uart = UARTS.iter().position(|start| *start == self.start);
        match (uart.map(|uart| &mut board.uarts[uart]), offset) {
            (Some(uart), UART_DATA) => {
                board.quiet = 0;
                uart.sent.push(value as u8);
            }
            (Some(uart), UART_STATE) => uart.overrun &= value & RECEIVE_OVERRUN == 0,
            // Control, interval and speed, which the firmware sets once, and the watchdog.
            _ => {}
        }
        Ok(())
    }

    fn size(&self) -> u32 {
        GROUP_SIZE
    }
}
