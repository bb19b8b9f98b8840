//! The MPS2-AN500 board as QEMU emulates it: two UARTs, a timer, semihosting, and flashes made of RAM.
//!
//! Everything about security is in `mavlink-signing` and `mavseal-relay`; here is only what another
//! board has in another way.

#![no_std]

use core::sync::atomic::{AtomicBool, Ordering};

mod clock;
mod flash;
mod log;
mod panic;
mod uart;
mod vectors;

// Linked for what they define: the critical section, and where defmt's log goes.
use cortex_m as _;
#[cfg(feature = "logging")]
use defmt_semihosting as _;

pub use clock::{Timer, Uptime, WallClock};
pub use flash::{COUNTERS, Flash, PAGE_SIZE};
pub use log::{Runs, log_rejected};
pub use mavseal_demo::{DEMO_KEY, DEMO_PASSPHRASE, info, warn};
pub use semihosting::process::exit;
pub use uart::{Overrun, Uart};

/// The board's peripherals.
pub struct Board {
    /// UART 0 and UART 1, one for each side of the relay.
    pub uarts: [Uart; 2],
    /// The timer that the wall clock runs on.
    pub timer: Timer,
    /// Flashes for the relay's marks, one for the key in each slot, and one for its keys.
    pub flashes: [Flash; 3],
    /// Flashes for the counters of a sealed link: the vehicle's own, then those of its stations.
    pub counters: [Flash; COUNTERS],
}

impl Board {
    /// The board, once; `None` for everybody after the first.
    #[must_use]
    pub fn take() -> Option<Self> {
        static TAKEN: AtomicBool = AtomicBool::new(false);
        if TAKEN.swap(true, Ordering::Relaxed) {
            return None;
        }
        // SAFETY: the addresses are those of UART 0, UART 1 and TIMER 0 in the board's memory map
        // (Arm DAI 0400), CMSDK APB peripherals all; nobody else has them, now or later. The flashes are
        // made here alone.
        unsafe {
            let [mark_a, mark_b, keys, counters @ ..] = Flash::new();
            Some(Self {
                uarts: [Uart::new(0x4000_4000), Uart::new(0x4000_5000)],
                timer: Timer::new(0x4000_0000),
                flashes: [mark_a, mark_b, keys],
                counters,
            })
        }
    }
}
