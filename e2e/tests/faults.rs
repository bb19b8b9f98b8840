//! A program that does wrong is reset by its board: `chips/qemu-m7/src/bin/faults.rs`.

use std::{
    sync::mpsc,
    time::{Duration, Instant},
};

use anyhow::{Result, ensure};
use mavseal_chips_host::{Chip, Image};
use mavseal_e2e::Machine;

/// Its watchdog waits for ten seconds.
const PATIENCE: Duration = Duration::from_secs(60);
/// What the log has, each line after a reset.
const STARTS: [&str; 5] = [
    "[INFO ] The stack overflows",
    "[INFO ] An instruction is none",
    "[INFO ] The program hangs",
    "[ERROR] panicked at ",
    "[INFO ] Each has reset the board",
];

#[test]
fn each_fault_resets_the_board() -> Result<()> {
    let elf = Image::logging(Chip::QemuM7, "faults", "").build()?;
    let (send, log) = mpsc::channel();
    let begun = Instant::now();
    let said = move |line| drop(send.send((line, begun.elapsed())));
    let mut machine = Machine::launch(&elf, &[], &[], said)?;
    let status = machine.wait(Some(PATIENCE))?;
    let lines: Vec<_> = log.try_iter().collect();
    ensure!(lines.len() == STARTS.len(), "it says {lines:?}");
    for ((line, _), start) in lines.iter().zip(STARTS) {
        ensure!(line.starts_with(start), "it says {lines:?}");
    }
    let hung = lines[3].1 - lines[2].1;
    ensure!(hung > Duration::from_secs(5), "it hung for {hung:?}");
    ensure!(status.success(), "{status}");
    Ok(())
}
