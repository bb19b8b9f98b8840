//! Every developer command of mavseal: `cargo xtask <command>`.

mod check;
mod forward;
mod fuzz;
mod mutants;
mod page;
mod plays;
mod proofs;
mod setup;
mod tables;
mod workers;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(name = "cargo xtask", about = "Every developer command of mavseal")]
struct Cli {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand)]
enum Verb {
    /// Measure signing and verifying beside peers and the floor, and hold them to their bars
    Bench(plays::Options),
    /// Send recorded telemetry through the signer on an emulated Cortex-M7, and attack it
    Demo(plays::Options),
    /// Build the shipped firmware images and hold them to their budgets
    Firmware(plays::Options),
    /// Fuzz every target over the properties, and say what that reaches
    Fuzz(fuzz::Options),
    /// Hold the standard's signature and sealed packages against other implementations, message by message
    /// and live
    Interop(plays::Options),
    /// Make fresh keys for a sealed link, or check those in a key file
    Keys(plays::Options),
    /// Try every small change of the cores, which a test must notice
    Mutants(mutants::Options),
    /// Run the proofs with Kani and write what came out to verification.md
    Proofs(proofs::Options),
    /// Run firmware in QEMU, print its log and exit with its status
    RunQemu(plays::Options),
    /// Check everything that must hold
    Test(check::Options),
    /// Generate the message tables in `mavlink/src/dialect` from the published definitions
    Tables {
        /// Change nothing; fail if a committed table differs
        #[arg(long)]
        check: bool,
    },
}

fn main() -> ExitCode {
    match run(Cli::parse().verb) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(verb: Verb) -> anyhow::Result<()> {
    match verb {
        Verb::Bench(options) => forward::bench(&options),
        Verb::Demo(options) => plays::demo(&options),
        Verb::Firmware(options) => forward::firmware(&options),
        Verb::Fuzz(options) => fuzz::run(&options),
        Verb::Interop(options) => forward::interop(&options),
        Verb::Keys(options) => forward::keys(&options),
        Verb::Mutants(options) => mutants::run(&options),
        Verb::Proofs(options) => proofs::run(&options),
        Verb::RunQemu(options) => plays::run_qemu(&options),
        Verb::Test(options) => check::run(&options),
        Verb::Tables { check } => tables::run(check),
    }
}
