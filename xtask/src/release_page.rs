//! `cargo xtask release-page`: verification/vX.Y.Z.md, from what runs on one commit have left.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    fs, thread,
};

use anyhow::{Context, Result, ensure};
use clap::Args;
use serde_json::Value;
use xshell::{Shell, cmd};

use crate::{
    fuzz::Run,
    mutants::Outcome,
    proofs::{self, kani, kani::Proof},
    setup::root,
    sources::{Sources, text},
};

/// Options of `cargo xtask release-page`.
#[derive(Args)]
pub(crate) struct Options {
    /// The release, as in 0.2.0
    version: String,
}

/// Writes the page. It is not written again: what has changed since, `git diff` says.
///
/// # Errors
/// If the page exists, something is not committed, or results of this commit are missing.
pub(crate) fn run(Options { version }: &Options) -> Result<()> {
    let sh = Shell::new()?;
    let name = format!("verification/v{version}.md");
    let path = root().join(&name);
    ensure!(
        !path.exists(),
        "{name} exists: a page is not changed after its release"
    );
    let sources = Sources::now()?;
    ensure!(
        sources.committed,
        "commit first: the page is about a commit"
    );
    let proofs: BTreeMap<String, Proof> = sources.read(proofs::RESULTS)?;
    let harnesses = kani::list(&sources.worktree(0)?)?;
    let not_run: Vec<_> = harnesses
        .keys()
        .filter(|name| !proofs.contains_key(*name))
        .collect();
    ensure!(
        not_run.is_empty(),
        "cargo xtask proofs has not run {not_run:?}"
    );
    let campaign: BTreeMap<String, Run> = sources.read("campaign")?;
    ensure!(
        !campaign.is_empty(),
        "cargo xtask fuzz campaign was not run"
    );

    let mut missed = String::new();
    let mut mutants = String::new();
    for (results, command) in [
        ("proof-mutants", "proofs --mutants"),
        ("fuzz-mutants", "fuzz mutants"),
    ] {
        let outcomes: BTreeMap<String, BTreeMap<String, Outcome>> = sources.read(results)?;
        ensure!(!outcomes.is_empty(), "cargo xtask {command} was not run");
        let trials = outcomes
            .iter()
            .filter(|(name, _)| !name.starts_with("control-"));
        let all = trials.clone().count();
        let wrong = trials.flat_map(|(name, by)| by.iter().map(move |(by, what)| (name, by, what)));
        for (name, by, what) in wrong.filter(|(.., what)| **what != Outcome::Caught) {
            writeln!(missed, "* {name}, by `{by}`: {what:?}")?;
        }
        writeln!(
            mutants,
            "| `{command}` | {all} mutants, each tried with all that must notice it |"
        )?;
    }
    for folder in ["cores", "tables"] {
        let file = format!("{folder}/mutants.out/outcomes.json");
        let said = text(&sources.results, &file).context("cargo xtask test --all was not run")?;
        let said: Value = serde_json::from_str(&said)?;
        let [caught, timeout, left, unviable, version] = [
            "caught",
            "timeout",
            "missed",
            "unviable",
            "cargo_mutants_version",
        ]
        .map(|key| &said[key]);
        writeln!(
            mutants,
            "| `cargo mutants`, {folder} | {caught} caught, {timeout} by tests that do not end, {left} missed, \
             {unviable} do not compile; cargo-mutants {version} |"
        )?;
        let outcomes = said["outcomes"].as_array().context("outcomes")?;
        for outcome in outcomes
            .iter()
            .filter(|outcome| outcome["summary"] == "MissedMutant")
        {
            writeln!(
                missed,
                "* {}, by any test",
                outcome["scenario"]["Mutant"]["name"]
            )?;
        }
    }
    let set = |get: fn(&Proof) -> &String| {
        let values: BTreeSet<_> = proofs.values().map(get).map(String::as_str).collect();
        values.into_iter().collect::<Vec<_>>().join("; ")
    };
    let cpu = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let cpu = cpu.lines().find_map(|line| line.strip_prefix("model name"));
    let cpu = cpu.unwrap_or_default().trim_matches([':', ' ', '\t']);
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let verified = proofs.values().filter(|proof| proof.verified()).count();
    let covers = |which: usize| {
        proofs
            .values()
            .map(|proof| proof.covers[which])
            .sum::<usize>()
    };
    let executions: u64 = campaign.values().map(|run| run.executions).sum();
    let seconds: u64 = campaign.values().map(|run| run.seconds).sum();
    let found = campaign.iter().filter(|(_, run)| run.finding.is_some());
    for (target, _) in found.clone() {
        writeln!(missed, "* the campaign found something with `{target}`")?;
    }
    if missed.is_empty() {
        missed += "None.\n";
    }
    let rustc = cmd!(sh, "rustc --version").quiet().read()?;
    let page = format!(
        "# Results of version {version}\n\n\
         Made by `cargo xtask release-page {version}` and not changed since. Changes of the code after it:\n\
         `git diff --stat v{version} -- mavlink commsec store relay proofs`.\n\n\
         | | |\n|---|---|\n\
         | commit | `{}` |\n| tools | {rustc}; {} |\n| machine | {cpu}, {cores} cores |\n| dates | {} |\n\
         | proofs | {verified} of {} harnesses verified, {} of {} covers satisfied |\n{mutants}\
         | campaign | {executions} executions of {} targets in {seconds} s, {} findings |\n\n\
         ## Missed\n\n{missed}\n## Harnesses\n\nTime and memory are CBMC's.\n\n{}\n",
        sources.commit,
        set(|proof| &proof.tools),
        set(|proof| &proof.date),
        proofs.len(),
        covers(0),
        covers(1),
        campaign.len(),
        found.count(),
        proofs::table(&proofs),
    );
    fs::write(&path, page).context(name)
}
