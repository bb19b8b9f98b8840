//! The MPS2-AN500 board as QEMU emulates it: two UARTs, a timer, semihosting.
//!
//! Everything about security is in `mavlink-signing` and `mavseal-relay`; here is only what another
//! board has in another way.

#![no_std]

mod clock;
mod log;
mod panic;
mod uart;
mod vectors;

// Linked for what they define: the critical section, and where defmt's log goes.
use cortex_m as _;
#[cfg(feature = "logging")]
use defmt_semihosting as _;

#[cfg(feature = "logging")]
#[doc(hidden)]
pub use defmt;

pub use clock::WallClock;
pub use semihosting::process::exit;
pub use uart::{Overrun, Uart};

/// The key of the demonstrations. It is public: never use it.
pub const DEMO_KEY: [u8; 32] = *include_bytes!("../demo.key");

/// UART 0 and UART 1, one for each side of the relay. To be called once.
#[must_use]
pub fn uarts() -> [Uart; 2] {
    // SAFETY: the addresses are those of UART 0 and UART 1 in the board's memory map (Arm DAI 0400),
    // CMSDK APB UARTs both; nothing else in the firmware touches them.
    unsafe { [Uart::new(0x4000_4000), Uart::new(0x4000_5000)] }
}
