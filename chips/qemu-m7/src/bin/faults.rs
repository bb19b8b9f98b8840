//! What a program can do wrong, one thing at each start: the board must reset, and it goes on with the next.

#![no_std]
#![no_main]

use core::cell::UnsafeCell;
use core::hint::black_box;
use core::mem::MaybeUninit;

use cortex_m_rt::entry;
use mavseal_qemu_m7::{Board, exit, info};

#[repr(C)]
struct Starts(UnsafeCell<MaybeUninit<u32>>);

// SAFETY: `main` alone reaches it.
unsafe impl Sync for Starts {}

/// How often the board has started: 0 when QEMU is, as its RAM is zero then.
// SAFETY: the section is one that cortex-m-rt's linker script has, and neither loads nor clears.
#[unsafe(link_section = ".uninit.starts")]
static STARTS: Starts = Starts(UnsafeCell::new(MaybeUninit::uninit()));

#[entry]
fn main() -> ! {
    let Some(mut board) = Board::take() else {
        exit(1);
    };
    board.watchdog.feed();
    // SAFETY: every byte of RAM holds some value, and nobody else reaches these.
    let starts = unsafe { (*STARTS.0.get()).assume_init_mut() };
    let start = *starts;
    *starts = start.wrapping_add(1);
    match start {
        0 => {
            info!("The stack overflows");
            info!("{} is never said", overflow(1));
        }
        1 => {
            info!("An instruction is none");
            cortex_m::asm::udf();
        }
        2 => {
            info!("The program hangs");
            #[expect(clippy::empty_loop, reason = "this is the fault")]
            loop {}
        }
        3 => panic!("The program panics"),
        _ => info!("Each has reset the board"),
    }
    exit(0)
}

/// Takes more stack than there is.
#[expect(unconditional_recursion, reason = "this is the fault")]
fn overflow(depth: u32) -> u32 {
    let frame = black_box([depth; 64]);
    overflow(depth.wrapping_add(1)).wrapping_add(frame[0])
}
