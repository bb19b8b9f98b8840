//! A microcontroller that runs a firmware image one instruction at a time.

use std::{cell::RefCell, ops::Range, rc::Rc};

use anyhow::{Result, anyhow, ensure};
use armagnac::{
    core::{Config, Emulator, Event, Processor},
    memory::RamMemory,
    registers::CoreRegisters,
};

use super::{Chip, instructions::Decoder, peripherals::Peripherals, program::Program};

/// Instructions after which an image is given up: a demonstration takes a fiftieth.
const MAX_DELAY: u64 = 20_000_000;

/// The instruction `wfi`.
const WAIT_FOR_INTERRUPT: u16 = 0xBF30;
/// The breakpoint that calls a debugger.
const SEMIHOSTING: u8 = 0xAB;

/// A processor with flash, RAM and the peripherals that its firmware uses.
pub(super) struct Machine {
    processor: Processor,
    flash: Vec<u8>,
    flash_start: u32,
    ram: Rc<RefCell<RamMemory>>,
    ram_start: u32,
    /// What is connected to the pins.
    pub(super) peripherals: Rc<RefCell<Peripherals>>,
    executed: u64,
}

/// Registers and RAM at one moment.
pub(super) struct Moment {
    registers: CoreRegisters,
    ram: Vec<u8>,
}

/// One call of a function, from its first instruction to its return.
pub(super) struct Call {
    /// The address of each instruction.
    pub(super) trace: Vec<u32>,
    /// Bytes of stack below the caller's.
    pub(super) stack: u32,
}

impl Machine {
    /// The chip after a reset with `program` in its flash.
    ///
    /// # Errors
    /// If the image does not fit the chip.
    pub(super) fn reset(chip: Chip, program: &Program) -> Result<Machine> {
        let config = match chip {
            Chip::QemuM7 => Config::v7em(),
            Chip::Stm32c092rc => Config::v6m(),
        };
        let mut processor = Processor::new(config);
        processor.instruction_decoder = Box::new(Decoder::new(processor.version));
        let (flash, ram) = memory(chip);
        let taken = |_| anyhow!("two memories at one address");
        let contents = program.flash(&flash)?;
        let memory = RamMemory::new_from_slice(&contents).read_only();
        let memory = Rc::new(RefCell::new(memory));
        processor.map_iface(flash.start, memory).map_err(taken)?;
        let ram_start = ram.start;
        let ram = processor
            .map_ram(ram.start, ram.end - ram.start)
            .map_err(taken)?;
        let peripherals = Rc::new(RefCell::new(Peripherals::default()));
        if chip == Chip::Stm32c092rc {
            Peripherals::map(&peripherals, &mut processor).map_err(taken)?;
        }
        // The first two vectors are the stack's end and the first instruction.
        let vector = |processor: &mut Processor, index: u32| {
            let read = processor.read_u32le_iface(flash.start + 4 * index);
            read.map_err(|error| anyhow!("{error:?}"))
        };
        let stack = vector(&mut processor, 0)?;
        let start = vector(&mut processor, 1)?;
        processor.set_sp(stack);
        processor.set_pc(start & !1);
        processor.registers.psr.set_t(true);
        Ok(Machine {
            processor,
            flash: contents,
            flash_start: flash.start,
            ram,
            ram_start,
            peripherals,
            executed: 0,
        })
    }

    /// Executes one instruction; false at the end, where firmware waits for an interrupt, or tells a
    /// debugger to stop.
    ///
    /// # Errors
    /// If the instruction is a fault.
    pub(super) fn step(&mut self) -> Result<bool> {
        let address = self.pc();
        self.executed += 1;
        ensure!(
            self.executed < MAX_DELAY,
            "it does not end: at {address:#010x}"
        );
        if self.is_at(WAIT_FOR_INTERRUPT) {
            return Ok(false);
        }
        match self.processor.next_event() {
            Ok(Event::Instruction { .. }) => Ok(true),
            Ok(Event::Break(SEMIHOSTING)) => Ok(false),
            Ok(_) => Err(anyhow!("it stops at {address:#010x}")),
            Err(error) => Err(anyhow!("at {address:#010x}: {error:?}")),
        }
    }

    /// Whether the next instruction is this one of 16 bits.
    fn is_at(&self, code: u16) -> bool {
        let offset = self.pc().checked_sub(self.flash_start);
        let next = offset.and_then(|offset| self.flash.get(offset as usize..)?.first_chunk());
        next.is_some_and(|bytes| u16::from_le_bytes(*bytes) == code)
    }

    /// Runs to the instruction at `address`.
    ///
    /// # Errors
    /// If it ends before that.
    pub(super) fn run_to(&mut self, address: u32) -> Result<()> {
        while self.pc() != address {
            ensure!(self.step()?, "it ends before it comes to {address:#010x}");
        }
        Ok(())
    }

    /// Runs the function, at whose first instruction it is, to its return.
    ///
    /// # Errors
    /// If it does not return.
    pub(super) fn call(&mut self) -> Result<Call> {
        let (stack, back) = (self.sp(), self.processor.lr() & !1);
        let (mut trace, mut lowest) = (Vec::new(), stack);
        while self.pc() != back || self.sp() != stack {
            trace.push(self.pc());
            ensure!(self.step()?, "it ends in a call");
            lowest = lowest.min(self.sp());
        }
        let stack = stack - lowest;
        Ok(Call { trace, stack })
    }

    /// The address of the next instruction.
    pub(super) fn pc(&self) -> u32 {
        self.processor.pc()
    }

    /// The stack pointer.
    pub(super) fn sp(&self) -> u32 {
        self.processor.sp()
    }

    /// The bytes of RAM at `addresses`, which must be in RAM.
    pub(super) fn ram(&self, addresses: Range<u32>) -> Vec<u8> {
        let range = self.offsets(addresses);
        self.ram.borrow().data[range].to_vec()
    }

    /// Writes to RAM from `address` on.
    pub(super) fn write_ram(&mut self, address: u32, bytes: &[u8]) {
        let range = self.offsets(address..address + bytes.len() as u32);
        self.ram.borrow_mut().data[range].copy_from_slice(bytes);
    }

    fn offsets(&self, addresses: Range<u32>) -> Range<usize> {
        (addresses.start - self.ram_start) as usize..(addresses.end - self.ram_start) as usize
    }

    /// What can be gone back to.
    pub(super) fn moment(&self) -> Moment {
        Moment {
            registers: self.processor.registers,
            ram: self.ram.borrow().data.clone(),
        }
    }

    /// Goes back to `moment`.
    pub(super) fn go_back(&mut self, moment: &Moment) {
        self.processor.registers = moment.registers;
        self.ram.borrow_mut().data.copy_from_slice(&moment.ram);
        self.executed = 0;
    }
}

/// Where flash and RAM are, as in the chip's `memory.x`.
fn memory(chip: Chip) -> (Range<u32>, Range<u32>) {
    match chip {
        Chip::QemuM7 => (0..4 << 20, 0x2000_0000..0x2040_0000),
        Chip::Stm32c092rc => (0x0800_0000..0x0804_0000, 0x2000_0000..0x2000_7800),
    }
}
