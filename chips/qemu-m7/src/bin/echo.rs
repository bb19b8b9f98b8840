//! Copies bytes between the UARTs and signs nothing: what the demonstration must not mistake for
//! the relay.

#![no_std]
#![no_main]

use cortex_m_rt::entry;
use embedded_io::{Read, ReadReady, Write};
use mavseal_qemu_m7::{Board, Uart, exit, info};

#[entry]
fn main() -> ! {
    let Some(board) = Board::take() else {
        exit(1);
    };
    let [mut local, mut link] = board.uarts;
    info!("Echo: copies, signs nothing");
    loop {
        copy(&mut local, &mut link);
        copy(&mut link, &mut local);
    }
}

fn copy(from: &mut Uart, to: &mut Uart) {
    let mut byte = [0];
    if from.read_ready() == Ok(true) && from.read(&mut byte) == Ok(1) {
        let _ = to.write_all(&byte);
    }
}
