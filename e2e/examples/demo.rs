//! The demonstration: the firmware in QEMU, its peers, and attackers.

use std::process::ExitCode;

use anyhow::Result;
use clap::{Parser, ValueEnum};
use mavseal_e2e::{relay, sealed::sealed};

/// Sends recorded telemetry through the signer on an emulated Cortex-M7, and attacks it
#[derive(Parser)]
#[command(name = "cargo xtask demo")]
struct Options {
    /// Which firmware to boot; with the echo, which signs nothing, the demonstration fails
    #[arg(long, value_enum, default_value = "relay")]
    firmware: Firmware,
    /// Instead, reset the machine again and again while the link is in use and its key is changed
    #[arg(long, conflicts_with = "firmware")]
    restart: bool,
    /// Instead, seal: one vehicle and two ground stations, over links that lose, double and reorder
    #[arg(long, conflicts_with_all = ["firmware", "restart"])]
    seal: bool,
    /// With --seal: what the links do, as an earlier run printed it
    #[arg(long, requires = "seal")]
    seed: Option<u64>,
    /// With --seal: give the stations other keys than the vehicle; the demonstration fails
    #[arg(long, requires = "seal")]
    other_keys: bool,
    /// Print the firmware's log too
    #[arg(long)]
    log: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Firmware {
    Relay,
    Echo,
}

fn main() -> ExitCode {
    match run(&Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: the demonstration failed: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(options: &Options) -> Result<()> {
    let log = options.log;
    if options.seal {
        return sealed(options.seed, options.other_keys, log);
    }
    let elf = relay::build(match options.firmware {
        Firmware::Relay => "relay",
        Firmware::Echo => "echo",
    })?;
    if options.restart {
        return relay::restart(&elf, log);
    }
    relay::signer(&elf, log)
}
