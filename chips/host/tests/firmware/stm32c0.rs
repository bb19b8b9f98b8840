//! The peripherals of an STM32C092RC that the firmware uses, with the rules of RM0490 that it must
//! keep: a register that it has no reason to touch, and one without clock, is a fault.

use std::{cell::RefCell, collections::BTreeMap, rc::Rc};

use armagnac::{
    core::{MapConflict, Processor},
    memory::{Env, MemoryAccessError, MemoryInterface},
};

const RCC: u32 = 0x4002_1000;
const RCC_CR: u32 = RCC;
const RCC_GPIOENR: u32 = RCC + 0x34;
const RCC_APBENR1: u32 = RCC + 0x3C;
const FLASH: u32 = 0x4002_2000;
const FLASH_ACR: u32 = FLASH;
const GPIOA: u32 = 0x5000_0000;
const GPIOA_MODER: u32 = GPIOA;
const GPIOA_BSRR: u32 = GPIOA + 0x18;
const GPIOA_AFRL: u32 = GPIOA + 0x20;
const USART2: u32 = 0x4000_4400;
const USART2_CR1: u32 = USART2;
const USART2_BRR: u32 = USART2 + 0x0C;
const USART2_ISR: u32 = USART2 + 0x1C;
const USART2_TDR: u32 = USART2 + 0x28;

/// Each group of registers: where it begins, and where the bit is that gives it a clock.
const GROUPS: [(u32, Option<Bit>); 4] = [
    (RCC, None),
    (FLASH, None),
    (GPIOA, Some(Bit(RCC_GPIOENR, 0))),
    (USART2, Some(Bit(RCC_APBENR1, 17))),
];
const GROUP_SIZE: u32 = 0x400;

/// The registers that the firmware may touch, as they are after a reset.
const REGISTERS: [(u32, u32); 11] = [
    (RCC_CR, 0x0000_1540),
    (RCC_GPIOENR, 0),
    (RCC_APBENR1, 0),
    (FLASH_ACR, 0x0004_0600),
    (GPIOA_MODER, 0xEBFF_FFFF),
    (GPIOA_BSRR, 0),
    (GPIOA_AFRL, 0),
    (USART2_CR1, 0),
    (USART2_BRR, 0),
    (USART2_ISR, 1 << 7),
    (USART2_TDR, 0),
];

const INTERNAL_HZ: u32 = 48_000_000;
const BAUD: u32 = 115_200;

/// The registers, and what is seen on the pins.
pub(crate) struct Stm32c0 {
    registers: BTreeMap<u32, u32>,
    /// Bytes that the serial port behind USB has sent.
    pub(crate) sent: Vec<u8>,
    /// Whether the light is on.
    pub(crate) light: bool,
}

impl Default for Stm32c0 {
    fn default() -> Self {
        Stm32c0 {
            registers: REGISTERS.into(),
            sent: Vec::new(),
            light: false,
        }
    }
}

impl Stm32c0 {
    /// Connects them with a processor.
    pub(crate) fn map(
        this: &Rc<RefCell<Self>>,
        processor: &mut Processor,
    ) -> Result<(), MapConflict> {
        for (start, clock) in GROUPS {
            let group = Group {
                start,
                clock,
                all: Rc::clone(this),
            };
            processor.map_iface(start, Rc::new(RefCell::new(group)))?;
        }
        Ok(())
    }

    fn get(&self, address: u32) -> Result<u32, MemoryAccessError> {
        let value = self.registers.get(&address);
        value.copied().ok_or(MemoryAccessError::InvalidAddress)
    }

    fn set(&mut self, address: u32, value: u32) -> Result<(), MemoryAccessError> {
        self.get(address)?;
        self.registers.insert(address, value);
        let kept = match address {
            // Above 24 MHz the flash needs a wait state.
            RCC_CR => self.clock_hz()? <= 24_000_000 || self.get(FLASH_ACR)? & 0b111 >= 1,
            GPIOA_BSRR => {
                let output = self.get(GPIOA_MODER)? >> 10 & 0b11 == 0b01;
                self.light = value & 1 << 5 != 0;
                output
            }
            USART2_TDR => {
                self.sent.push(value as u8);
                self.can_send()?
            }
            USART2_ISR => false,
            _ => true,
        };
        kept.then_some(()).ok_or(MemoryAccessError::Illegal)
    }

    /// The clock of processor and peripherals: the internal oscillator, divided.
    fn clock_hz(&self) -> Result<u32, MemoryAccessError> {
        Ok(INTERNAL_HZ >> (self.get(RCC_CR)? >> 11 & 0b111))
    }

    /// Whether the transmitter is on, at the right speed to within 2 %, and has its pin, PA2.
    fn can_send(&self) -> Result<bool, MemoryAccessError> {
        let on = 1 << 0 | 1 << 3;
        let divider = self.get(USART2_BRR)?.max(1);
        let error = (self.clock_hz()? / divider).abs_diff(BAUD);
        Ok(self.get(USART2_CR1)? & on == on
            && error * 50 <= BAUD
            && self.get(GPIOA_MODER)? >> 4 & 0b11 == 0b10
            && self.get(GPIOA_AFRL)? >> 8 & 0b1111 == 1)
    }
}

/// One bit of the register at an address.
#[derive(Clone, Copy)]
struct Bit(u32, u32);

/// One group of registers, as the processor sees it.
struct Group {
    start: u32,
    clock: Option<Bit>,
    all: Rc<RefCell<Stm32c0>>,
}

impl Group {
    fn clocked(&self) -> Result<(), MemoryAccessError> {
        match self.clock {
            Some(Bit(register, bit)) if self.all.borrow().get(register)? >> bit & 1 == 0 => {
                Err(MemoryAccessError::HardwareError)
            }
            _ => Ok(()),
        }
    }
}

impl MemoryInterface for Group {
    fn read_u32le(&mut self, offset: u32, _: &mut Env) -> Result<u32, MemoryAccessError> {
        self.clocked()?;
        self.all.borrow().get(self.start + offset)
    }

    fn write_u32le(
        &mut self,
        offset: u32,
        value: u32,
        _: &mut Env,
    ) -> Result<(), MemoryAccessError> {
        self.clocked()?;
        self.all.borrow_mut().set(self.start + offset, value)
    }

    fn size(&self) -> u32 {
        GROUP_SIZE
    }
}
