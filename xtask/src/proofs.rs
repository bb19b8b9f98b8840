//! `cargo xtask proofs`: Kani on every harness, and what Kani lets pass fails.

pub(crate) mod kani;
mod mutants;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    sync::atomic::{AtomicUsize, Ordering},
};

use anyhow::{Result, ensure};
use clap::Args;

use crate::{
    sources::{Sources, find_all, share, text},
    test::not_run,
};
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

/// Runs what the options say.
///
/// # Errors
/// If a harness is not verified, or a mutant is missed; which has been printed.
pub(crate) fn run(options: &Options) -> Result<()> {
    let version = kani::installed();
    match &version {
        Some(version) if version == KANI => {}
        Some(other) => println!("This is Kani {other}; continuous integration has {KANI}."),
        None => println!("cargo install --locked kani-verifier@{KANI} && cargo kani setup"),
    }
    if options.mutants {
        return mutants::run(version.is_some(), &options.only, options.jobs);
    }
    if version.is_none() {
        not_run("Kani is missing");
    }
    let sources = Sources::now()?;
    let tree = sources.worktree(0)?;
    let (harnesses, ids) = (kani::list(&tree)?, ids(&tree)?);
    let with: BTreeSet<_> = harnesses.keys().map(|name| id_of(name)).collect();
    let wrong: Vec<_> = with.symmetric_difference(&ids).collect();
    ensure!(wrong.is_empty(), "not both a harness and a row: {wrong:?}");

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

/// Runs harnesses, given by their names and paths, keeps and prints the results.
fn prove(sources: &Sources, harnesses: BTreeMap<String, String>, jobs: usize) -> Result<()> {
    let (of, done) = (harnesses.len(), AtomicUsize::new(1));
    let one = |worker, (name, path): (String, String)| {
        let log = sources.results.join(format!("logs/{name}.log"));
        let proof = kani::prove(&sources.worktree(worker)?, &path, &log)?;
        sources.record(RESULTS, &name, &proof)?;
        let number = done.fetch_add(1, Ordering::Relaxed);
        println!("[{number}/{of}] {}", row(&name, &proof));
        Ok((name, proof))
    };
    let proofs = share(jobs.min(of), harnesses.into_iter().collect(), one)?;
    let proofs = proofs.into_iter().collect();
    println!("{}", table(&proofs));
    let failed = proofs.iter().filter(|(_, proof)| !proof.verified());
    let failed: Vec<_> = failed.map(|(name, _)| name).collect();
    ensure!(failed.is_empty(), "not verified: {failed:?}");
    Ok(())
}

/// A table of `proofs`, in Markdown.
pub(crate) fn table(proofs: &BTreeMap<String, Proof>) -> String {
    let head = "| harness | verdict | covers | checks | solver | time | memory |";
    let rows: Vec<_> = proofs.iter().map(|(name, it)| row(name, it)).collect();
    format!("{head}\n|---|---|---|---|---|---|---|\n{}", rows.join("\n"))
}

fn row(name: &str, proof: &Proof) -> String {
    let ([n, of], checks, solver) = (proof.covers, proof.checks, &proof.solver);
    let verdict = format!("{:?} {}", proof.verdict, proof.reason);
    let took = format!("{:.1} s | {} MB", proof.seconds, proof.memory_mb);
    format!("| `{name}` | {verdict} | {n}/{of} | {checks} | {solver} | {took} |")
}

/// The ids of the properties: the first cells in the table of verification.md.
pub(crate) fn ids(tree: &Path) -> Result<BTreeSet<String>> {
    let ids = find_all(
        r"(?m)^\| \*\*([A-Z]\d)\*\* \|",
        &text(tree, "verification.md")?,
    );
    Ok(ids.into_iter().collect())
}

/// The property of a harness or property test: `w1_parse_any` belongs to `W1`.
pub(crate) fn id_of(name: &str) -> String {
    name.split('_').next().unwrap_or_default().to_uppercase()
}
