//! `cargo xtask demo` and `cargo xtask run-qemu`: what they need, then the programs of `e2e`.

use std::{ffi::OsString, os::unix::process::CommandExt, process::Command};

use anyhow::{Context, Result};
use clap::Args;

use crate::setup::{self, root};

/// Options of the program; `--help` tells them.
#[derive(Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Options {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    pub(crate) options: Vec<OsString>,
}

/// Plays the demonstration.
///
/// # Errors
/// If something is missing that it needs.
pub(crate) fn demo(options: &Options) -> Result<()> {
    let helps = ["-h", "--help"].map(OsString::from);
    if !options.options.iter().any(|option| helps.contains(option)) {
        setup::qemu()?;
        setup::target("thumbv7em-none-eabihf")?;
    }
    run(&["--example", "demo"], options)
}

/// Runs firmware in QEMU.
///
/// # Errors
/// If something is missing that it needs.
pub(crate) fn run_qemu(options: &Options) -> Result<()> {
    setup::qemu()?;
    run(&["--quiet", "--bin", "run-qemu"], options)
}

/// Goes on as a program of `e2e`, which gets the signals that are for this one.
fn run(program: &[&str], options: &Options) -> Result<()> {
    let manifest = root().join("Cargo.toml");
    let mut cargo = Command::new("cargo");
    cargo.args([
        "run",
        "--locked",
        "--package",
        "mavseal-e2e",
        "--manifest-path",
    ]);
    cargo
        .arg(manifest)
        .args(program)
        .arg("--")
        .args(&options.options);
    Err(cargo.exec()).context("cargo cannot be run")
}
