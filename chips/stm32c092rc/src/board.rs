//! The board's clock and pins, by the registers (RM0490, the reference manual of the STM32C0).
//!
//! stm32-metapac gives them names and types, and leaves nothing of itself in the image: no check, no
//! panic, no state.

use stm32_metapac::flash::vals::Latency;
use stm32_metapac::gpio::vals::Moder;
use stm32_metapac::rcc::vals::Hsidiv;
use stm32_metapac::{FLASH, GPIOA, RCC, USART2};

/// The processor's and the peripherals' clock, in hertz.
const CLOCK_HZ: u32 = 48_000_000;
const BAUD: u32 = 115_200;

/// The transmitter of USART 2 on port A.
const TRANSMIT_PIN: usize = 2;
const TRANSMIT_FUNCTION: u8 = 1;
/// The green light, LD1, on port A.
const LIGHT_PIN: usize = 5;

/// What the board has that firmware uses.
pub struct Board {
    /// The serial port that the debugger's USB plug shows, 115,200 baud.
    pub serial: Serial,
    /// The green light.
    pub light: Light,
}

impl Board {
    /// Sets the clock to 48 MHz and the pins to their use.
    #[must_use]
    pub fn start() -> Self {
        // After reset the clock is 12 MHz. Above 24 MHz the flash needs a wait state (RM0490, read
        // access latency), and has it before the clock changes.
        FLASH.acr().modify(|acr| acr.set_latency(Latency::WS1));
        while FLASH.acr().read().latency() != Latency::WS1 {}
        RCC.cr().modify(|cr| cr.set_hsidiv(Hsidiv::DIV1));

        RCC.gpioenr().modify(|enable| enable.set_gpioaen(true));
        RCC.apbenr1().modify(|enable| enable.set_usart2en(true));
        GPIOA
            .afr(0)
            .modify(|function| function.set_afr(TRANSMIT_PIN, TRANSMIT_FUNCTION));
        GPIOA.moder().modify(|mode| {
            mode.set_moder(TRANSMIT_PIN, Moder::ALTERNATE);
            mode.set_moder(LIGHT_PIN, Moder::OUTPUT);
        });
        USART2
            .brr()
            .write(|divider| divider.set_brr((CLOCK_HZ / BAUD) as u16));
        USART2.cr1().write(|control| {
            control.set_te(true);
            control.set_ue(true);
        });
        Self {
            serial: Serial(()),
            light: Light(()),
        }
    }
}

/// A serial port that only sends.
pub struct Serial(());

impl Serial {
    /// Sends `bytes`; comes back when all are on their way.
    pub fn send(&mut self, bytes: &[u8]) {
        for byte in bytes {
            while !USART2.isr().read().txe() {}
            USART2.tdr().write(|data| data.set_dr((*byte).into()));
        }
    }
}

/// A light, dark after reset.
pub struct Light(());

impl Light {
    /// Switches it on.
    pub fn on(&mut self) {
        GPIOA.bsrr().write(|set| set.set_bs(LIGHT_PIN, true));
    }
}
