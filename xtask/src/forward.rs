//! Commands whose work is done elsewhere: what they need is found or got, then cargo goes on.

use std::{env, os::unix::process::CommandExt, process::Command};

use anyhow::{Context, Result};

use crate::{
    plays::Options,
    setup::{self, root},
};

/// The tests of `chips/host` that print what the shipped images take.
///
/// # Errors
/// If a compiler is missing. It then ends with the status of the tests.
pub(crate) fn firmware(options: &Options) -> Result<()> {
    setup::target("thumbv7em-none-eabihf")?;
    setup::target("thumbv6m-none-eabi")?;
    let tests = "test --package mavseal-chips-host --test firmware budgets -- --nocapture";
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
    cargo("interop", "run --package mavseal-interop --", options)
}

/// The program in `interop/bench/`.
///
/// # Errors
/// If Python is missing. It then ends with the status of the program.
pub(crate) fn bench(options: &Options) -> Result<()> {
    setup::venv()?;
    cargo("interop", "run --package mavseal-bench --", options)
}

/// The program of `keys/`.
///
/// # Errors
/// If cargo cannot be run. It then ends with the status of the program.
pub(crate) fn keys(options: &Options) -> Result<()> {
    let program = "run --package mavseal-keys --features cli --bin mavseal-keys --";
    cargo(".", program, options)
}

/// Goes on as cargo, with the workspace in `folder`. Paths in the options stay those of the caller's folder.
fn cargo(folder: &str, arguments: &str, options: &Options) -> Result<()> {
    let (verb, arguments) = arguments.split_once(' ').context("a command of cargo")?;
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or("cargo".into()));
    cargo.args([verb, "--quiet", "--locked", "--manifest-path"]);
    cargo.arg(root().join(folder).join("Cargo.toml"));
    cargo.args(arguments.split(' ')).args(&options.options);
    Err(cargo.exec()).context("cargo cannot be run")
}
