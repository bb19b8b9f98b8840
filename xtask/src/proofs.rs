//! `cargo xtask proofs`: Kani on every harness, and what Kani lets pass fails.

pub(crate) mod kani;
mod mutants;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    sync::Mutex,
};

use anyhow::{Result, bail, ensure};
use clap::Args;
use comfy_table::{Table, presets};
use regex::Regex;

use crate::sources::{Sources, lock, share, text};
use kani::Proof;

/// The version that continuous integration installs; results tell which one was used.
const KANI: &str = "0.67.0";
/// The properties of `--fast`.
const FAST: [&str; 5] = ["C1", "R1", "T1", "V1", "W1"];
/// The name under which results are kept.
pub(crate) const RESULTS: &str = "proofs";

/// Options of `cargo xtask proofs`.
#[derive(Args)]
pub(crate) struct Options {
    /// Only harnesses of this property (V1), or whose names contain this; may be repeated. With --mutants,
    /// mutants of this name
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Only properties that are proved fast: C1, R1, T1, V1, W1
    #[arg(long, conflicts_with = "only")]
    fast: bool,
    /// Break the code in known ways, which harnesses and property tests must notice
    #[arg(long, conflicts_with = "fast")]
    mutants: bool,
    /// Harnesses or mutants at a time
    #[arg(long, value_name = "N", default_value_t = 2)]
    jobs: usize,
}

/// Why nothing is proved, if Kani is missing.
fn missing() -> Option<String> {
    let install = format!("cargo install --locked kani-verifier@{KANI} && cargo kani setup");
    let version = kani::installed();
    if let Some(version) = version.as_ref().filter(|version| *version != KANI) {
        println!("This is Kani {version}; continuous integration has {KANI}.");
    }
    version
        .is_none()
        .then(|| format!("Kani is missing: {install}"))
}

/// Runs what the options say.
///
/// # Errors
/// If a harness is not verified, or a mutant is missed; which has been printed.
pub(crate) fn run(options: &Options) -> Result<()> {
    let missing = missing();
    if options.mutants {
        return mutants::run(missing, &options.only, options.jobs);
    }
    if let Some(missing) = missing {
        bail!(missing);
    }
    let sources = Sources::now()?;
    let tree = sources.worktree(0)?;
    let (harnesses, ids) = (kani::list(&tree)?, ids(&tree)?);
    let with: BTreeSet<_> = harnesses.keys().map(|name| id_of(name)).collect();
    let wrong: Vec<_> = with.symmetric_difference(&ids).collect();
    ensure!(
        wrong.is_empty(),
        "harness without property in verification.md, or the reverse: {wrong:?}"
    );

    let mut chosen = harnesses;
    chosen.retain(|name, _| {
        let id = id_of(name);
        let named = |only: &String| id == only.to_uppercase() || name.contains(only);
        (!options.fast || FAST.contains(&&*id))
            && (options.only.is_empty() || options.only.iter().any(named))
    });
    ensure!(!chosen.is_empty(), "there is no such harness");
    prove(&sources, chosen, options.jobs)
}

/// For `cargo xtask test`: the fast proofs, or why they were not run.
///
/// # Errors
/// As [`run`].
pub(crate) fn fast() -> Result<Option<String>> {
    let missing = missing();
    if missing.is_none() {
        let only = Vec::new();
        run(&Options {
            only,
            fast: true,
            mutants: false,
            jobs: 2,
        })?;
    }
    Ok(missing)
}

/// Runs harnesses, given by their names and paths, keeps and prints the results.
fn prove(sources: &Sources, harnesses: BTreeMap<String, String>, jobs: usize) -> Result<()> {
    let of = harnesses.len();
    let proofs = Mutex::new(BTreeMap::new());
    share(
        jobs.min(of),
        harnesses.into_iter().collect(),
        |worker, (name, path)| {
            let log = sources.results.join(format!("logs/{name}.log"));
            let proof = kani::prove(&sources.worktree(worker)?, &path, &log)?;
            sources.record(RESULTS, &name, &proof)?;
            let mut proofs = lock(&proofs);
            println!(
                "[{}/{of}] {name}: {:?} {}",
                proofs.len() + 1,
                proof.verdict,
                proof.reason
            );
            proofs.insert(name, proof);
            Ok(())
        },
    )?;
    let proofs = lock(&proofs);
    println!("{}", table(&proofs));
    let failed = proofs.iter().filter(|(_, proof)| !proof.verified());
    let failed: Vec<_> = failed.map(|(name, _)| name.as_str()).collect();
    ensure!(failed.is_empty(), "not verified: {}", failed.join(", "));
    Ok(())
}

/// A table of `proofs`, in Markdown.
pub(crate) fn table(proofs: &BTreeMap<String, Proof>) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::ASCII_MARKDOWN);
    table.set_header([
        "harness", "verdict", "covers", "checks", "solver", "time", "memory",
    ]);
    for (name, proof) in proofs {
        table.add_row([
            name.clone(),
            format!("{:?} {}", proof.verdict, proof.reason),
            format!("{}/{}", proof.covers[0], proof.covers[1]),
            proof.checks.to_string(),
            proof.solver.clone(),
            format!("{:.1} s", proof.seconds),
            format!("{} MB", proof.memory_mb),
        ]);
    }
    table
}

/// The ids of the properties: the first cells in the table of verification.md.
pub(crate) fn ids(tree: &Path) -> Result<BTreeSet<String>> {
    let row = Regex::new(r"(?m)^\| \*\*([A-Z]\d)\*\* \|")?;
    let page = text(tree, "verification.md")?;
    Ok(row
        .captures_iter(&page)
        .map(|row| row[1].to_owned())
        .collect())
}

/// The property of a harness or property test: `w1_parse_any` belongs to `W1`.
pub(crate) fn id_of(name: &str) -> String {
    name.split('_').next().unwrap_or_default().to_uppercase()
}
