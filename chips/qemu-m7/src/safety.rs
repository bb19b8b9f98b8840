//! What resets the board when its program cannot go on: a fault, a stack that overflows, a hang.

use core::arch::naked_asm;

use cortex_m::asm::{dsb, isb};
use cortex_m::peripheral::{MPU, SCB, scb::Exception};
use volatile_register::RW;

use crate::uart::CLOCK_HZ;

/// Takes every exception: this firmware enables none that is not a fault.
///
/// Asks for a reset (Armv7-M ARM, B3.2.6, AIRCR) without a stack: that may be what is at fault.
// SAFETY: the name is the one that cortex-m-rt's linker script looks for; it ends with the reset.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn DefaultHandler() -> ! {
    naked_asm!(
        "ldr r0, =0xE000ED0C", // AIRCR
        "ldr r1, =0x05FA0004", // VECTKEY, SYSRESETREQ
        "str r1, [r0]",
        "dsb",
        "1: b 1b",
    )
}

/// The one exception that has a handler of its own.
// SAFETY: as above.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    naked_asm!("b {}", sym DefaultHandler)
}

/// Bytes below the stack that nobody may touch. The whole stack of each program is smaller (`chips/host` measures it),
/// so that no function's part of it reaches over them.
const GUARD_SIZE: u32 = 16 * 1024;
/// A region of so many bytes, to which nobody has access and which holds no code (Armv7-M ARM, B3.5.9, `MPU_RASR`).
const GUARD: u32 = REGION_NEVER_EXECUTED | (GUARD_SIZE.ilog2() - 1) << 1 | REGION_ENABLE;
const REGION_NEVER_EXECUTED: u32 = 1 << 28;
const REGION_ENABLE: u32 = 1 << 0;
/// In `MPU_RBAR`: it says itself which region it is about, the first.
const REGION_VALID: u32 = 1 << 4;
/// In `MPU_CTRL`: what no region is about stays as it is.
const DEFAULT_MAP: u32 = 1 << 2;
const MPU_ENABLE: u32 = 1 << 0;

/// Makes an access below the stack a fault.
pub(crate) fn guard_stack(mpu: &MPU, scb: &mut SCB) {
    unsafe extern "C" {
        /// Where the linker puts nothing more.
        static _stack_end: u8;
    }
    let end = (&raw const _stack_end).addr() as u32;
    let guard = end.wrapping_add(GUARD_SIZE - 1) & !(GUARD_SIZE - 1);
    // SAFETY: no variable is there, and the stack has never been so deep.
    unsafe {
        mpu.rbar.write(guard | REGION_VALID);
        mpu.rasr.write(GUARD);
        mpu.ctrl.write(DEFAULT_MAP | MPU_ENABLE);
    }
    // As a HardFault, it could not be taken: the stack for its frame is what is missing.
    scb.enable(Exception::MemoryManagement);
    dsb();
    isb();
}

/// Resets the board if it is not fed for so long: ten seconds, as the machine that emulates the board may be busy.
const TIMEOUT: u32 = 10 * CLOCK_HZ;
const CONTROL_INTERRUPT: u32 = 1 << 0;
const CONTROL_RESET: u32 = 1 << 1;

#[repr(C)]
struct Registers {
    load: RW<u32>,
    value: RW<u32>,
    control: RW<u32>,
}

/// The CMSDK APB watchdog (Arm DDI 0479, APB watchdog): at its end a non-maskable interrupt, which resets; if that
/// does not, a reset after the same time again.
pub struct Watchdog(&'static Registers);

impl Watchdog {
    /// The watchdog whose registers are at `address`, not running.
    ///
    /// # Safety
    ///
    /// A CMSDK APB watchdog is at `address`, and nobody else uses it.
    pub(crate) unsafe fn new(address: usize) -> Self {
        // SAFETY: the caller's promise.
        Self(unsafe { &*(address as *const Registers) })
    }

    /// Gives the program ten seconds from now. The first call starts it, and nothing stops it.
    pub fn feed(&mut self) {
        // SAFETY: these registers have no effect on memory.
        unsafe {
            self.0.load.write(TIMEOUT);
            self.0.control.write(CONTROL_INTERRUPT | CONTROL_RESET);
        }
    }
}
