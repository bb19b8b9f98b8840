//! A microcontroller that runs a firmware image one instruction at a time.

use std::{cell::RefCell, mem, ops::Range, rc::Rc};

use anyhow::{Result, anyhow, ensure};
use armagnac::{
    core::{Config, Emulator, Event, Processor},
    memory::RamMemory,
    registers::CoreRegisters,
};
use mavseal_chips_host::Chip;

use crate::{elf::Elf, instructions::Decoder, mps2::Mps2, stm32c0::Stm32c0};

/// Instructions after which an image is given up: a demonstration takes a fiftieth.
const MAX_DELAY: u64 = 20_000_000;

/// Where RAM begins, on every Cortex-M.
const RAM: u32 = 0x2000_0000;

/// The instruction `wfi`.
const WAIT_FOR_INTERRUPT: u16 = 0xBF30;
/// The breakpoint that calls a debugger, and what it is asked for in R0.
const SEMIHOSTING: u8 = 0xAB;
const SYS_TIME: u32 = 0x11;

/// A processor with flash, RAM and the peripherals that its firmware uses.
pub(crate) struct Machine {
    processor: Processor,
    flash: Vec<u8>,
    flash_start: u32,
    ram: Rc<RefCell<RamMemory>>,
    /// What is connected to the pins of the STM32C092RC.
    pub(crate) stm32c0: Rc<RefCell<Stm32c0>>,
    /// What is connected to the MPS2-AN500.
    pub(crate) mps2: Rc<RefCell<Mps2>>,
    executed: u64,
    /// Whether the instruction at each second byte of flash was executed.
    reached: Vec<bool>,
    /// After the reset.
    start: CoreRegisters,
    /// The lowest stack pointer since then.
    lowest: u32,
}

/// Registers and RAM at one moment.
pub(crate) struct Moment {
    registers: CoreRegisters,
    ram: Vec<u8>,
}

/// One call of a function, from its first instruction to its return.
pub(crate) struct Call {
    /// The address of each instruction.
    pub(crate) trace: Vec<u32>,
    /// Bytes of stack below the caller's.
    pub(crate) stack: u32,
}

impl Machine {
    /// The chip after a reset with `elf` in its flash.
    ///
    /// # Errors
    /// If the image does not fit the chip.
    pub(crate) fn reset(chip: Chip, elf: &Elf) -> Result<Self> {
        let config = match chip {
            Chip::QemuM7 => Config::v7em(),
            Chip::Stm32c092rc => Config::v6m(),
        };
        let mut processor = Processor::new(config);
        processor.instruction_decoder = Box::new(Decoder::new(processor.version));
        let taken = |_| anyhow!("two memories at one address");
        let flash = RamMemory::new_from_slice(&elf.image).read_only();
        let flash = Rc::new(RefCell::new(flash));
        processor.map_iface(elf.start, flash).map_err(taken)?;
        // The first two vectors are the stack's end, which is that of the RAM, and the first instruction.
        let [top, start] = [0, 4].map(|offset| {
            let read = processor.read_u32le_iface(elf.start + offset);
            read.map_err(|error| anyhow!("{error:?}"))
        });
        let top = top?;
        let ram = processor.map_ram(RAM, top - RAM).map_err(taken)?;
        let stm32c0 = Rc::new(RefCell::new(Stm32c0::default()));
        let mps2 = Rc::new(RefCell::new(Mps2::default()));
        match chip {
            Chip::QemuM7 => Mps2::map(&mps2, &mut processor),
            Chip::Stm32c092rc => Stm32c0::map(&stm32c0, &mut processor),
        }
        .map_err(taken)?;
        processor.set_sp(top);
        processor.set_pc(start? & !1);
        processor.registers.psr.set_t(true);
        Ok(Self {
            reached: vec![false; elf.image.len() / 2],
            flash: elf.image.clone(),
            flash_start: elf.start,
            ram,
            stm32c0,
            mps2,
            executed: 0,
            start: processor.registers,
            lowest: top,
            processor,
        })
    }

    /// Executes one instruction; false at the end, where firmware waits for an interrupt, or tells a
    /// debugger to stop.
    ///
    /// # Errors
    /// If the instruction is a fault.
    pub(crate) fn step(&mut self) -> Result<bool> {
        let address = self.pc();
        self.executed += 1;
        ensure!(
            self.executed < MAX_DELAY,
            "it does not end: at {address:#010x}"
        );
        let offset = address.wrapping_sub(self.flash_start) as usize;
        if let Some(reached) = self.reached.get_mut(offset / 2) {
            *reached = true;
        }
        let next = self
            .flash
            .get(offset..)
            .and_then(|bytes| bytes.first_chunk());
        if next.is_some_and(|bytes| u16::from_le_bytes(*bytes) == WAIT_FOR_INTERRUPT) {
            return Ok(false);
        }
        let event = self.processor.next_event();
        self.lowest = self.lowest.min(self.sp());
        match event {
            Ok(Event::Instruction { .. }) => Ok(true),
            Ok(Event::Break(SEMIHOSTING)) if self.processor.registers.r0 == SYS_TIME => {
                self.processor.registers.r0 = self.mps2.borrow_mut().next_second();
                Ok(true)
            }
            Ok(Event::Break(SEMIHOSTING)) => Ok(false),
            Ok(_) => Err(anyhow!("it stops at {address:#010x}")),
            Err(error) => Err(anyhow!("at {address:#010x}: {error:?}")),
        }
    }

    /// Resets it as its button does: RAM stays as it is.
    pub(crate) fn restart(&mut self) {
        self.processor.registers = self.start;
    }

    /// Runs until it has looked at its UARTs `looks` times, and no byte has moved or waits.
    ///
    /// # Errors
    /// If it ends before that.
    pub(crate) fn run_to_quiet(&mut self, looks: u32) -> Result<()> {
        self.executed = 0;
        self.mps2.borrow_mut().quiet = 0;
        while self.mps2.borrow().quiet < looks {
            ensure!(self.step()?, "it ends at {:#010x}", self.pc());
        }
        Ok(())
    }

    /// Runs to the instruction at `address`.
    ///
    /// # Errors
    /// If it ends before that.
    pub(crate) fn run_to(&mut self, address: u32) -> Result<()> {
        while self.pc() != address {
            ensure!(self.step()?, "it ends before it comes to {address:#010x}");
        }
        Ok(())
    }

    /// Runs until something has changed in RAM at `addresses`.
    ///
    /// # Errors
    /// If it ends before that.
    pub(crate) fn run_to_change(&mut self, addresses: &Range<u32>) -> Result<()> {
        let before = self.ram(addresses.clone());
        while self.ram(addresses.clone()) == before {
            ensure!(self.step()?, "it ends and has changed nothing");
        }
        Ok(())
    }

    /// Runs the function, at whose first instruction it is, to its return.
    ///
    /// # Errors
    /// If it does not return.
    pub(crate) fn call(&mut self) -> Result<Call> {
        let (stack, back) = (self.sp(), self.processor.lr() & !1);
        let before = mem::replace(&mut self.lowest, stack);
        let mut trace = Vec::new();
        while self.pc() != back || self.sp() != stack {
            trace.push(self.pc());
            ensure!(self.step()?, "it ends in a call");
        }
        let stack = stack - self.lowest;
        self.lowest = self.lowest.min(before);
        Ok(Call { trace, stack })
    }

    /// Most bytes of stack that were in use at one time since the reset.
    pub(crate) fn stack(&self) -> u32 {
        self.start.sp() - self.lowest
    }

    /// Whether the instruction at `address` was executed.
    pub(crate) fn has_reached(&self, address: u32) -> bool {
        let offset = address.wrapping_sub(self.flash_start) as usize;
        self.reached.get(offset / 2).is_some_and(|reached| *reached)
    }

    /// The address of the next instruction.
    pub(crate) fn pc(&self) -> u32 {
        self.processor.pc()
    }

    fn sp(&self) -> u32 {
        self.processor.sp()
    }

    /// The bytes of RAM at `addresses`, which must be in RAM.
    pub(crate) fn ram(&self, addresses: Range<u32>) -> Vec<u8> {
        let range = self.offsets(addresses);
        self.ram.borrow().data[range].to_vec()
    }

    /// Writes to RAM from `address` on.
    pub(crate) fn write_ram(&mut self, address: u32, bytes: &[u8]) {
        let range = self.offsets(address..address + bytes.len() as u32);
        self.ram.borrow_mut().data[range].copy_from_slice(bytes);
    }

    fn offsets(&self, addresses: Range<u32>) -> Range<usize> {
        (addresses.start - RAM) as usize..(addresses.end - RAM) as usize
    }

    /// What can be gone back to.
    pub(crate) fn moment(&self) -> Moment {
        Moment {
            registers: self.processor.registers,
            ram: self.ram.borrow().data.clone(),
        }
    }

    /// Goes back to `moment`.
    pub(crate) fn go_back(&mut self, moment: &Moment) {
        self.processor.registers = moment.registers;
        self.ram.borrow_mut().data.copy_from_slice(&moment.ram);
        self.executed = 0;
    }
}
