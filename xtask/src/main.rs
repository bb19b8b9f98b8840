//! Every developer command of mavseal: `cargo xtask COMMAND`.

mod forward;
mod fuzz;
mod mutants;
mod proofs;
mod release_page;
mod setup;
mod sources;
mod tables;
mod test;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(name = "cargo xtask", about = "Every developer command of mavseal")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Measure signing and verifying beside peers and the floor, and hold them to their bars
    Bench(forward::Options),
    /// Send recorded telemetry through the signer on an emulated Cortex-M7, and attack it
    Demo(forward::Options),
    /// Build the shipped firmware images and hold them to their budgets
    Firmware(forward::Options),
    /// Fuzz the properties: shortly, for long, with mutants, or to see what is reached
    Fuzz(fuzz::Options),
    /// Hold the standard's signature and sealed packages against other implementations, message by message
    /// and live
    Interop(forward::Options),
    /// Make fresh keys for a sealed link, or check those in a key file
    Keys(forward::Options),
    /// Run the proofs with Kani, or show with mutants that proofs and tests can fail
    Proofs(proofs::Options),
    /// Write verification/vX.Y.Z.md from the results of this commit
    ReleasePage(release_page::Options),
    /// Run firmware in QEMU, print its log and exit with its status
    RunQemu(forward::Options),
    /// Check everything that must hold
    Test(test::Options),
    /// Generate the message tables in `mavlink/src/dialect` from the published definitions
    Tables {
        /// Change nothing; fail if a committed table differs
        #[arg(long)]
        check: bool,
    },
}

fn main() -> ExitCode {
    match run(Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Bench(options) => forward::bench(&options),
        Command::Demo(options) => forward::demo(&options),
        Command::Firmware(options) => forward::firmware(&options),
        Command::Fuzz(options) => fuzz::run(&options),
        Command::Interop(options) => forward::interop(&options),
        Command::Keys(options) => forward::keys(&options),
        Command::Proofs(options) => proofs::run(&options),
        Command::ReleasePage(options) => release_page::run(&options),
        Command::RunQemu(options) => forward::run_qemu(&options),
        Command::Test(options) => test::run(&options),
        Command::Tables { check } => tables::run(check),
    }
}
