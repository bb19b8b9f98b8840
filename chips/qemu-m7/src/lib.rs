//! The MPS2-AN500 board as QEMU emulates it: two UARTs, a timer, a watchdog, semihosting, and flashes made
//! of RAM.
//!
//! Everything about security is in `mavlink-signing` and `mavseal-relay`; here is only what another
//! board has in another way.

#![no_std]

mod clock;
mod flash;
mod log;
mod panic;
mod safety;
mod uart;
mod vectors;

// Linked for what it defines: where defmt's log goes.
#[cfg(feature = "logging")]
use defmt_semihosting as _;

pub use clock::{Timer, Uptime, WallClock};
pub use flash::{COUNTERS, Flash, PAGE_SIZE};
pub use log::{Runs, log_rejected};
pub use mavseal_demo::{DEMO_KEY, DEMO_PASSPHRASE, info, warn};
pub use safety::Watchdog;
pub use semihosting::process::exit;
pub use uart::{Overrun, Uart};

/// The board's peripherals.
pub struct Board {
    /// UART 0 and UART 1, one for each side of the relay.
    pub uarts: [Uart; 2],
    /// The timer that the wall clock runs on.
    pub timer: Timer,
    /// What resets the board when the program hangs.
    pub watchdog: Watchdog,
    /// Flashes for the relay's marks, one for the key in each slot, and for its keys.
    pub flashes: [Flash; 3],
    /// Flashes for the counters of a sealed link: the vehicle's own, then those of its stations.
    pub counters: [Flash; COUNTERS],
}

impl Board {
    /// The board, once, with a guard below its stack; `None` for everybody after the first.
    #[must_use]
    pub fn take() -> Option<Self> {
        let mut core = cortex_m::Peripherals::take()?;
        safety::guard_stack(&core.MPU, &mut core.SCB);
        // SAFETY: the addresses are those of UART 0, UART 1, TIMER 0 and the watchdog in the board's memory
        // map (Arm DAI 0400), CMSDK APB peripherals all; nobody else has them, now or later. The flashes are
        // made here alone.
        unsafe {
            let [mark_a, mark_b, keys, counters @ ..] = Flash::new();
            Some(Self {
                uarts: [Uart::new(0x4000_4000), Uart::new(0x4000_5000)],
                timer: Timer::new(0x4000_0000),
                watchdog: Watchdog::new(0x4000_8000),
                flashes: [mark_a, mark_b, keys],
                counters,
            })
        }
    }
}
