//! Commands whose work is done elsewhere: what they need is found or got, then cargo goes on.

use std::{env, ffi::OsString, os::unix::process::CommandExt, process::Command};

use anyhow::{Context, Result, ensure};
use clap::Args;

use crate::setup::{self, root, target_dir};

/// Options of what goes on; its `--help` tells them.
#[derive(Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Options {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    options: Vec<OsString>,
}

/// The demonstration, an example of `e2e/`.
///
/// # Errors
/// If something is missing that it needs. It then ends with the status of the demonstration.
pub(crate) fn demo(options: &Options) -> Result<()> {
    setup::qemu()?;
    setup::target("thumbv7em-none-eabihf")?;
    cargo(
        ".",
        "run --locked --package mavseal-e2e --example demo --",
        options,
    )
}

/// The program of `e2e/` that runs firmware in QEMU.
///
/// # Errors
/// If there is no QEMU. It then ends with the status of the firmware.
pub(crate) fn run_qemu(options: &Options) -> Result<()> {
    setup::qemu()?;
    let build = "build --locked --package mavseal-e2e --bin run-qemu";
    program(build, "run-qemu", options)
}

/// The tests of `chips/host` that print what the shipped images take.
///
/// # Errors
/// If a compiler is missing. It then ends with the status of the tests.
pub(crate) fn firmware(options: &Options) -> Result<()> {
    setup::target("thumbv7em-none-eabihf")?;
    setup::target("thumbv6m-none-eabi")?;
    let tests = "test --locked --package mavseal-chips-host --test firmware budgets -- --nocapture";
    cargo(".", tests, options)
}

/// The program in `interop/`.
///
/// # Errors
/// If something is missing that it needs. It then ends with the status of the program.
pub(crate) fn interop(options: &Options) -> Result<()> {
    setup::venv()?;
    setup::qemu()?;
    setup::target("thumbv7em-none-eabihf")?;
    cargo(
        "interop",
        "run --locked --package mavseal-interop --",
        options,
    )
}

/// The program in `interop/bench/`.
///
/// # Errors
/// If Python is missing. It then ends with the status of the program.
pub(crate) fn bench(options: &Options) -> Result<()> {
    setup::venv()?;
    cargo(
        "interop",
        "run --locked --package mavseal-bench --",
        options,
    )
}

/// The program of `keys/`.
///
/// # Errors
/// If cargo cannot be run. It then ends with the status of the program.
pub(crate) fn keys(options: &Options) -> Result<()> {
    let build = "build --locked --package mavseal-keys --features cli --bin mavseal-keys";
    program(build, "mavseal-keys", options)
}

/// Goes on as cargo in `folder`, whose configuration counts: a signal to this process reaches the program.
fn cargo(folder: &str, arguments: &str, options: &Options) -> Result<()> {
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or("cargo".into()));
    cargo.current_dir(root().join(folder));
    cargo.args(arguments.split(' ')).args(&options.options);
    Err(cargo.exec()).context("cargo cannot be run")
}

/// Builds a program and goes on as that where the caller is, as its options may be paths.
fn program(build: &str, name: &str, options: &Options) -> Result<()> {
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or("cargo".into()));
    cargo.current_dir(root()).args(build.split(' '));
    ensure!(cargo.status()?.success(), "{name} does not build");
    let program = target_dir()?.join("debug").join(name);
    Err(Command::new(program).args(&options.options).exec()).context(name.to_owned())
}
