//! Commands whose work is done elsewhere: what they need is found or got, then cargo goes on.

use std::{env, ffi::OsString, os::unix::process::CommandExt, process};

use anyhow::{Context, Result, ensure};
use clap::{Args, Subcommand};

use crate::setup::{self, root, target_dir};

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Measure signing and verifying beside peers and the floor, and hold them to their bars
    Bench(Options),
    /// Send recorded telemetry through the signer on an emulated Cortex-M7, and attack it
    Demo(Options),
    /// Build the shipped firmware images and hold them to their budgets
    Firmware(Options),
    /// Hold the standard's signature and sealed packages against other implementations, message by message
    /// and live
    Interop(Options),
    /// Make fresh keys for a sealed link, or check those in a key file
    Keys(Options),
    /// Run firmware in QEMU, print its log and exit with its status
    RunQemu(Options),
}

/// Options of what goes on; its `--help` tells them.
#[derive(Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Options {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    options: Vec<OsString>,
}

/// Goes on as cargo in a folder, whose configuration counts, or as the program that it builds where the caller is, as
/// its options may be paths. So a signal to this process reaches what goes on.
///
/// # Errors
/// If something is missing that it needs, or does not build. It then ends with the status of what goes on.
pub(crate) fn run(command: &Command) -> Result<()> {
    let (needs, folder, words, options) = match command {
        Command::Bench(it) => ("venv", "interop", "run -p mavseal-bench --", it),
        Command::Demo(it) => ("qemu m7", ".", "run -p mavseal-e2e --example demo --", it),
        Command::Firmware(it) => {
            let budgets = "test -p mavseal-chips-host --test firmware budgets -- --nocapture";
            ("m7 m0", ".", budgets, it)
        }
        Command::Interop(it) => ("venv qemu m7", "interop", "run -p mavseal-interop --", it),
        Command::Keys(it) => ("", ".", "build -p mavseal-keys --bin mavseal-keys", it),
        Command::RunQemu(it) => ("qemu", ".", "build -p mavseal-e2e --bin run-qemu", it),
    };
    for need in needs.split_whitespace() {
        match need {
            "qemu" => setup::qemu()?,
            "venv" => setup::venv()?,
            "m7" => setup::target("thumbv7em-none-eabihf")?,
            _ => setup::target("thumbv6m-none-eabi")?,
        }
    }
    let (verb, words) = words.split_once(' ').unwrap_or_default();
    let mut cargo = process::Command::new(env::var_os("CARGO").unwrap_or("cargo".into()));
    cargo.current_dir(root().join(folder));
    cargo.args([verb, "--locked"]).args(words.split(' '));
    if verb == "build" {
        ensure!(cargo.status()?.success(), "it does not build: {words}");
        let name = words.rsplit(' ').next().unwrap_or_default();
        cargo = process::Command::new(target_dir()?.join("debug").join(name));
    }
    Err(cargo.args(&options.options).exec()).context(words)
}
