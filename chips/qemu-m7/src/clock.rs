//! Wall-clock time: the host's, asked once over semihosting, then the board's timer.

use mavlink_signing::{TICKS_PER_SECOND, Timestamp};
use mavseal_relay::Clock;
use semihosting::sys::arm_compat::sys_time;
use volatile_register::RW;

use crate::uart::CLOCK_HZ;

/// Timer cycles in a tick of 10 microseconds.
const CYCLES_PER_TICK: u64 = CLOCK_HZ as u64 / TICKS_PER_SECOND;
/// TIMER 0 in the board's memory map (Arm DAI 0400).
const TIMER_0: usize = 0x4000_0000;
const CONTROL_ENABLE: u32 = 1 << 0;

/// A CMSDK APB timer (Arm DDI 0479, section 4.1): counts down from `reload`, for ever.
#[repr(C)]
struct Registers {
    control: RW<u32>,
    value: RW<u32>,
    reload: RW<u32>,
}

/// The time of day, in signing time.
///
/// Stands for the real-time clock that this board does not have. It must be read at least every
/// 171 seconds, when the timer comes round.
pub struct WallClock {
    timer: &'static Registers,
    start: Timestamp,
    cycles: u64,
    value: u32,
}

impl WallClock {
    /// Waits for the host's clock to begin a second and goes on from there; at most one second.
    ///
    /// To be called once. `None` without a debugger or emulator that tells the time, or with one
    /// that tells a time before 2015.
    #[must_use]
    pub fn synced() -> Option<Self> {
        // SAFETY: a CMSDK APB timer is at this address and nothing else in the firmware uses it.
        let timer = unsafe { &*(TIMER_0 as *const Registers) };
        // SAFETY: these registers have no effect on memory.
        unsafe {
            timer.reload.write(u32::MAX);
            timer.value.write(u32::MAX);
            timer.control.write(CONTROL_ENABLE);
        }
        let before = sys_time().ok()?;
        let seconds = loop {
            let seconds = sys_time().ok()?;
            if seconds != before {
                break seconds;
            }
        };
        Some(Self {
            timer,
            start: Timestamp::from_unix_micros(seconds as u64 * 1_000_000)?,
            cycles: 0,
            value: timer.value.read(),
        })
    }
}

impl Clock for WallClock {
    fn now(&mut self) -> Timestamp {
        let value = self.timer.value.read();
        self.cycles += u64::from(self.value.wrapping_sub(value));
        self.value = value;
        self.start.saturating_add(self.cycles / CYCLES_PER_TICK)
    }
}
