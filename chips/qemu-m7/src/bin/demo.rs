//! The signing demonstration: the smallest firmware that signs and verifies.

#![no_std]
#![no_main]

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m_rt::entry;
use mavseal_demo::{Memory, run};
use mavseal_qemu_m7::{exit, warn};

/// What a debugger finds when the demonstration is over: 1 for success, 2 for failure.
#[used]
static VERDICT: AtomicU32 = AtomicU32::new(0);

#[entry]
fn main() -> ! {
    static mut MEMORY: Memory = Memory::new();
    let result = run(MEMORY, |_| {});
    VERDICT.store(if result.is_ok() { 1 } else { 2 }, Ordering::Relaxed);
    if cfg!(feature = "logging") {
        if result.is_err() {
            warn!("The demonstration failed");
        }
        exit(i32::from(result.is_err()));
    }
    loop {
        cortex_m::asm::wfi();
    }
}
