//! `cargo xtask firmware`: what the shipped images take, held to their budgets. The tests of `chips/host` do it.

use anyhow::Result;
use clap::Args;
use xshell::{Shell, cmd};

use crate::setup::root;

/// Options of `cargo xtask firmware`.
#[derive(Args)]
pub(crate) struct Options {
    /// Instead, show that wrong tags are rejected in constant time: every value of every byte
    #[arg(long)]
    pub(crate) constant_time: bool,
}

/// Builds the images, runs them on emulated chips and prints the tables.
///
/// # Errors
/// If an image does not build, does wrong, is above its budget, can panic, or logs.
pub(crate) fn run(options: &Options) -> Result<()> {
    let sh = Shell::new()?;
    sh.change_dir(root());
    let test = if options.constant_time {
        "every_wrong_tag"
    } else {
        "budgets"
    };
    let tests = ["--package=mavseal-chips-host", "--test=firmware", test];
    cmd!(
        sh,
        "cargo test --quiet --locked {tests...} -- --include-ignored --nocapture"
    )
    .run()?;
    Ok(())
}
