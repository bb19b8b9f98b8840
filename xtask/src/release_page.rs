//! `cargo xtask release-page`: verification/vX.Y.Z.md, from what runs on one commit have left.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    fs,
};

use anyhow::{Context, Result, ensure};
use clap::Args;
use xshell::{Shell, cmd};

use crate::{
    fuzz::Run,
    mutants::{Mutant, Outcome},
    proofs::{self, kani, kani::Proof},
    setup::root,
    sources::{Sources, text},
};

/// What a shell says of this machine and its tools.
const MACHINE: &str =
    "rustc --version; cargo mutants --version; cargo-fuzz --version; nproc | sed 's/$/ cores/'
    sed -n 's/^model name.*: //p' /proc/cpuinfo | head -n 1";

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
    let name = format!("verification/v{version}.md");
    let path = root().join(&name);
    ensure!(!path.exists(), "{name} is not changed after its release");
    let sources = Sources::now()?;
    ensure!(sources.committed, "the page is of a commit: commit first");
    let missing = |what| format!("not run on this commit: cargo xtask {what}");
    let proofs: BTreeMap<String, Proof> = sources.read(proofs::RESULTS)?;
    let tree = sources.worktree(0)?;
    let run = |harness| proofs.contains_key(harness);
    ensure!(kani::list(&tree)?.keys().all(run), missing("proofs"));
    let campaign: BTreeMap<String, Run> = sources.read("campaign")?;
    ensure!(!campaign.is_empty(), missing("fuzz campaign"));
    let sh = Shell::new()?;
    let machine = cmd!(sh, "sh -c {MACHINE}").quiet().read()?;
    let verified = proofs.values().filter(|proof| proof.verified()).count();
    let covers = |which: usize| -> usize { proofs.values().map(|it| it.covers[which]).sum() };
    let executions: u64 = campaign.values().map(|run| run.executions).sum();
    let seconds: u64 = campaign.values().map(|run| run.seconds).sum();
    let tools: BTreeSet<_> = proofs.values().map(|proof| &*proof.tools).collect();
    let dates: BTreeSet<_> = proofs.values().map(|proof| &*proof.date).collect();
    let [tools, dates] = [tools, dates].map(|all| Vec::from_iter(all).join(", "));
    let machine = machine.replace('\n', ", ");
    let (harnesses, targets, commit) = (proofs.len(), campaign.len(), &sources.commit);

    let mut page = format!(
        "# Results of version {version}\n\n\
         Made by `cargo xtask release-page {version}`, and not changed since. What has changed in the code:\n\
         `git diff --stat v{version} -- mavlink commsec store relay proofs`.\n\n\
         | | |\n|---|---|\n\
         | commit | `{commit}` |\n| tools | {tools}; {machine} |\n| dates | {dates} |\n\
         | proofs | {verified} of {harnesses} harnesses verified, {} of {} covers satisfied |\n\
         | campaign | {executions} executions of {targets} targets in {seconds} s of targets |\n",
        covers(0),
        covers(1),
    );
    let mut missed = String::new();
    for command in ["proofs --mutants", "fuzz mutants"] {
        let results = command.replace(" --", "-").replace(' ', "-");
        let outcomes: BTreeMap<String, BTreeMap<String, Outcome>> = sources.read(&results)?;
        ensure!(!outcomes.is_empty(), missing(command));
        let all = Mutant::load(&tree, &[])?.len();
        let tried = outcomes.len();
        writeln!(
            page,
            "| `{command}` | {tried} of {all} mutants and controls |"
        )?;
        for (name, by) in outcomes {
            let wrong = by.iter().filter(|(_, what)| **what != Outcome::Caught);
            missed.extend(wrong.map(|(by, what)| format!("* {name}, by `{by}`: {what:?}\n")));
        }
    }
    for results in ["cores", "tables"] {
        let folder = sources.results.join(results).join("mutants.out");
        let file = |kind| text(&folder, kind).context(missing("test --all"));
        let count = |kind| anyhow::Ok(file(kind)?.lines().count());
        let [caught, loops, left] = ["caught.txt", "timeout.txt", "missed.txt"].map(count);
        let (caught, loops, left) = (caught?, loops?, left?);
        let counts = format!("{caught} caught, {loops} by tests that do not end, {left} missed");
        writeln!(page, "| `cargo mutants`, {results} | {counts} |")?;
        missed.extend(
            file("missed.txt")?
                .lines()
                .map(|name| format!("* {name}\n")),
        );
    }
    let found = campaign.iter().filter(|(_, run)| !run.finding.is_empty());
    missed.extend(found.map(|(target, _)| format!("* `{target}` failed in the campaign\n")));
    write!(
        page,
        "\n## Missed\n\nThe control that changes nothing must be here; else only what is wrong.\n\n{missed}\n\
         ## Harnesses\n\nTime and memory are CBMC's.\n\n{}\n",
        proofs::table(&proofs),
    )?;
    fs::write(&path, page).context(name)
}
