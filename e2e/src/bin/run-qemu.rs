//! Runs firmware in QEMU, prints its log and ends with its status.

use std::{path::PathBuf, process::ExitCode, time::Duration};

use anyhow::Result;
use clap::Parser;
use mavseal_e2e::Machine;

/// Runs firmware in QEMU, prints its log and ends with its status
#[derive(Parser)]
#[command(name = "cargo xtask run-qemu")]
struct Options {
    /// The firmware, an ELF file
    elf: PathBuf,
    /// Give up after this many seconds
    #[arg(long, value_name = "SECONDS")]
    timeout: Option<u64>,
    /// The TCP port of this machine that UART 0 listens on; a second time for UART 1
    #[arg(long, value_name = "PORT")]
    serial: Vec<u16>,
}

fn main() -> Result<ExitCode> {
    let options = Options::parse();
    let serial = |port| format!("tcp:127.0.0.1:{port},server=on,wait=off,nodelay=on");
    let mut serial: Vec<String> = options.serial.iter().map(serial).collect();
    serial.resize(serial.len().max(2), "null".to_owned());
    let mut machine = Machine::launch(&options.elf, &serial, &[], |line| println!("{line}"))?;
    let status = machine.wait(options.timeout.map(Duration::from_secs))?;
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(code.map_or(ExitCode::FAILURE, ExitCode::from))
}
