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

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(name = "cargo xtask", about = "Every developer command of mavseal")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    #[command(flatten)]
    Forward(forward::Command),
    /// Fuzz the properties: shortly, for long, with mutants, or to see what is reached
    Fuzz(fuzz::Options),
    /// Run the proofs with Kani, or show with mutants that proofs and tests can fail
    Proofs(proofs::Options),
    /// Write verification/vX.Y.Z.md from the results of this commit
    ReleasePage(release_page::Options),
    /// Check everything that must hold
    Test(test::Options),
    /// Generate the message tables in `mavlink/src/dialect` from the published definitions
    Tables {
        /// Change nothing; fail if a committed table differs
        #[arg(long)]
        check: bool,
    },
}

fn main() -> anyhow::Result<()> {
    match Cli::parse().command {
        Command::Forward(command) => forward::run(&command),
        Command::Fuzz(options) => fuzz::run(&options),
        Command::Proofs(options) => proofs::run(&options),
        Command::ReleasePage(options) => release_page::run(&options),
        Command::Test(options) => test::run(&options),
        Command::Tables { check } => tables::run(check),
    }
}
