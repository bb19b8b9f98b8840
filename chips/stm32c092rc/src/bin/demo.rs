//! The signing demonstration: the signed frame goes to the serial port, and the light goes on if
//! every step came out as it must.

#![no_std]
#![no_main]

use cortex_m_rt::entry;
use mavseal_demo::{Memory, run, warn};
use mavseal_stm32c092rc::Board;

#[entry]
fn main() -> ! {
    static mut MEMORY: Memory = Memory::new();
    let mut board = Board::start();
    let result = run(MEMORY, |frame| board.serial.send(frame));
    if result.is_ok() {
        board.light.on();
    } else {
        warn!("The demonstration failed");
    }
    #[cfg(feature = "logging")]
    semihosting::process::exit(i32::from(result.is_err()));
    #[cfg(not(feature = "logging"))]
    loop {
        cortex_m::asm::wfi();
    }
}
