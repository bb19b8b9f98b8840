//! Wall-clock time: the host's, asked once over semihosting, then the board's timer.

use mavlink_signing::{LinkClock, TICKS_PER_SECOND, Timestamp};
use semihosting::sys::arm_compat::sys_time;
use volatile_register::RW;

use crate::uart::CLOCK_HZ;

/// Timer cycles in a tick of 10 microseconds.
const CYCLES_PER_TICK: u32 = CLOCK_HZ / TICKS_PER_SECOND as u32;
const CONTROL_ENABLE: u32 = 1 << 0;

#[repr(C)]
struct Registers {
    control: RW<u32>,
    value: RW<u32>,
    reload: RW<u32>,
}

/// A CMSDK APB timer (Arm DDI 0479, section 4.1) that counts down from 2^32 - 1, for ever.
pub struct Timer(&'static Registers);

impl Timer {
    /// The timer whose registers are at `address`, running.
    ///
    /// # Safety
    ///
    /// A CMSDK APB timer is at `address`, and nobody else uses it.
    pub(crate) unsafe fn new(address: usize) -> Self {
        // SAFETY: the caller's promise.
        let registers = unsafe { &*(address as *const Registers) };
        // SAFETY: these registers have no effect on memory.
        unsafe {
            registers.reload.write(u32::MAX);
            registers.value.write(u32::MAX);
            registers.control.write(CONTROL_ENABLE);
        }
        Self(registers)
    }

    fn value(&self) -> u32 {
        self.0.value.read()
    }
}

/// The time since the start, in ticks of 10 microseconds.
///
/// It must be read at least every 171 seconds, when the timer comes round.
pub struct Uptime {
    timer: Timer,
    /// The last whole tick, and what the timer showed when it began.
    now: u64,
    value: u32,
}

impl Uptime {
    /// The time since now.
    #[must_use]
    pub fn new(timer: Timer) -> Self {
        Self {
            now: 0,
            value: timer.value(),
            timer,
        }
    }

    /// Ticks of 10 microseconds, which never go back.
    // In a place of its own: it is asked at many.
    #[inline(never)]
    pub fn ticks(&mut self) -> u64 {
        let ticks = self.value.wrapping_sub(self.timer.value()) / CYCLES_PER_TICK;
        self.value = self.value.wrapping_sub(ticks * CYCLES_PER_TICK);
        self.now = self.now.saturating_add(ticks.into());
        self.now
    }
}

/// For an endpoint that measures silence and asks for no time of day.
impl LinkClock for Uptime {
    fn now(&mut self) -> Timestamp {
        Timestamp::ZERO.saturating_add(self.ticks())
    }

    fn monotonic(&mut self) -> u64 {
        self.ticks()
    }
}

/// The time of day, in signing time.
///
/// Stands for the real-time clock that this board does not have. It must be read as often as
/// [`Uptime`].
pub struct WallClock {
    uptime: Uptime,
    start: Timestamp,
}

impl WallClock {
    /// Waits for the host's clock to begin a second and goes on from there; at most one second.
    ///
    /// `None` without a debugger or emulator that tells the time, or with one that tells a time
    /// before 2015.
    #[must_use]
    pub fn synced(timer: Timer) -> Option<Self> {
        let before = sys_time().ok()?;
        let seconds = loop {
            let seconds = sys_time().ok()?;
            if seconds != before {
                break seconds;
            }
        };
        Some(Self {
            start: Timestamp::from_unix_seconds(seconds as u64)?,
            uptime: Uptime::new(timer),
        })
    }

    /// The time of day.
    // As `Uptime::ticks`.
    #[inline(never)]
    pub fn now(&mut self) -> Timestamp {
        self.start.saturating_add(self.uptime.ticks())
    }
}
