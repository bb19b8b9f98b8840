//! `cargo xtask fuzz`: seeds, smoke tests, campaigns, and what they show.

mod campaign;
mod coverage;
mod engine;
mod mutants;
mod plan;
mod replay;
mod results;
mod scan;
mod seeds;
mod speed;
mod table;

use std::{ffi::OsString, fs, path::PathBuf};

use anyhow::{Result, ensure};
use clap::{Args, Subcommand};

use crate::proofs::results::cores;
use crate::setup::{self, CargoFuzz, root};
use engine::Engine;
use plan::Target;

/// Options of `cargo xtask fuzz`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(subcommand)]
    verb: Verb,
    /// Use the compiler in use, not rustup's nightly
    #[arg(long, global = true)]
    stable: bool,
    /// Only this target; may be repeated
    #[arg(long, global = true, value_name = "TARGET")]
    only: Vec<String>,
    /// Targets at a time [default: one for each core]
    #[arg(long, global = true, value_name = "N")]
    jobs: Option<usize>,
}

#[derive(Subcommand)]
enum Verb {
    /// Every target for some seconds, from its seeds
    Smoke,
    /// Every target, all together for some minutes; writes what came out to verification.md
    Campaign {
        /// How long
        #[arg(long, default_value_t = 60.0)]
        minutes: f64,
    },
    /// Every target over seeds and corpora: which lines and errors of the cores they reach
    Coverage,
    /// Break the code in known ways, which targets must find
    Mutants {
        /// Only this mutant; may be repeated
        #[arg(long, value_name = "NAME")]
        mutant: Vec<String>,
    },
    /// A target against one that does nothing
    Speed,
    /// Write the inputs that fuzzing begins with
    Seeds {
        /// Write nothing; fail if one differs from what is committed
        #[arg(long)]
        check: bool,
    },
    /// Keep of what campaigns left in fuzz/corpus the little that reaches more than the seeds
    Minimise,
    /// Write what came out to verification.md again; run nothing
    Table {
        /// Write nothing; fail if it does not say what the results say
        #[arg(long)]
        check: bool,
    },
}

/// Runs what the options say.
///
/// # Errors
/// If a target fails, or a bar is missed; which has been printed.
pub(crate) fn run(options: &Options) -> Result<()> {
    let jobs = options.jobs.unwrap_or_else(cores).max(1);
    match &options.verb {
        Verb::Table { check: true } => table::check(&root()),
        Verb::Table { check: false } => table::write(&root()),
        Verb::Seeds { check } => seeds::seeds(*check),
        Verb::Minimise => seeds::minimise(&Fuzzer::new(options)?),
        Verb::Coverage => coverage::coverage(),
        Verb::Mutants { mutant } => mutants::mutants(&Fuzzer::new(options)?, mutant, jobs),
        Verb::Speed => speed::speed(&Fuzzer::new(options)?),
        Verb::Smoke => campaign::smoke(&Fuzzer::new(options)?, jobs),
        Verb::Campaign { minutes } => campaign::campaign(&Fuzzer::new(options)?, *minutes, jobs),
    }
}

/// Whether seeds and table are what is committed; runs nothing.
///
/// # Errors
/// If they are not.
pub(crate) fn check() -> Result<()> {
    seeds::seeds(true)?;
    table::check(&root())
}

/// Every target for some seconds; or why not.
///
/// # Errors
/// If a target fails.
pub(crate) fn smoke() -> Result<Option<String>> {
    if let Err(missing) = setup::cargo_fuzz(false) {
        return Ok(Some(format!("{missing:#}")));
    }
    run(&Options {
        verb: Verb::Smoke,
        stable: false,
        only: vec![],
        jobs: None,
    })?;
    Ok(None)
}

/// Arguments with which cargo takes the targets as plain functions, without what needs a C++ compiler.
///
/// # Errors
/// If cargo does not say where it builds.
pub(crate) fn without_engine() -> Result<Vec<OsString>> {
    let arguments = ["--locked", "--no-default-features", "--manifest-path"];
    let mut arguments: Vec<OsString> = arguments.map(Into::into).into();
    arguments.push(root().join("fuzz/Cargo.toml").into());
    arguments.push("--target-dir".into());
    arguments.push(setup::target_dir()?.join("fuzz").into());
    Ok(arguments)
}

/// The targets, built and ready to run.
struct Fuzzer {
    root: PathBuf,
    target_dir: PathBuf,
    cargo_fuzz: CargoFuzz,
    engine: Engine,
    /// Those that are asked for.
    targets: Vec<Target>,
    /// Whether that is every one.
    all: bool,
}

impl Fuzzer {
    fn new(options: &Options) -> Result<Self> {
        let root = fs::canonicalize(root())?;
        let mut targets = plan::targets(&root)?;
        let only = &options.only;
        for name in only {
            let known = targets.iter().any(|target| target.name == *name);
            ensure!(known, "{name} is no target of fuzz/targets.toml");
        }
        targets.retain(|target| only.is_empty() || only.contains(&target.name));
        let cargo_fuzz = setup::cargo_fuzz(options.stable)?;
        let target_dir = setup::target_dir()?.join("fuzz");
        let engine = Engine::new(&cargo_fuzz, &root, &target_dir);
        engine.build(None)?;
        Ok(Self {
            engine,
            root,
            target_dir,
            cargo_fuzz,
            targets,
            all: only.is_empty(),
        })
    }
}
