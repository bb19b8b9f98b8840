//! `cargo xtask release-page`: verification/vX.Y.Z.md, from what runs on one commit have left.

use std::{collections::BTreeMap, fmt::Write as _, fs};

use anyhow::{Context, Result, ensure};
use clap::Args;
use xshell::{Shell, cmd};

use crate::{
    fuzz::Run,
    mutants::Outcome,
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
    ensure!(
        sources.committed,
        "the page is about a commit: commit first"
    );
    let proofs: BTreeMap<String, Proof> = sources.read(proofs::RESULTS)?;
    for harness in kani::list(&sources.worktree(0)?)?.keys() {
        ensure!(
            proofs.contains_key(harness),
            "{harness} was not run: cargo xtask proofs"
        );
    }
    let campaign: BTreeMap<String, Run> = sources.read("campaign")?;
    ensure!(
        !campaign.is_empty(),
        "there was no campaign: cargo xtask fuzz campaign"
    );
    let sh = Shell::new()?;
    let machine = cmd!(sh, "sh -c {MACHINE}").quiet().read()?;
    let verified = proofs.values().filter(|proof| proof.verified()).count();
    let covers = |which: usize| -> usize { proofs.values().map(|it| it.covers[which]).sum() };
    let executions: u64 = campaign.values().map(|run| run.executions).sum();
    let seconds: u64 = campaign.values().map(|run| run.seconds).sum();
    let first = proofs.values().next().context("no proof")?;
    let dates = proofs.values().map(|proof| &proof.date);
    let (from, to) = (dates.clone().min(), dates.max());

    let mut page = format!(
        "# Results of version {version}\n\n\
         Made by `cargo xtask release-page {version}`, and not changed since. What has changed in the code:\n\
         `git diff --stat v{version} -- mavlink commsec store relay proofs`.\n\n\
         | | |\n|---|---|\n\
         | commit | `{}` |\n| tools and machine | {}; {} |\n| date | {} to {} |\n\
         | proofs | {verified} of {} harnesses verified, {} of {} covers satisfied |\n\
         | campaign | {executions} executions of {} targets in {seconds} s of targets |\n",
        sources.commit,
        first.tools,
        machine.replace('\n', ", "),
        from.context("no date")?,
        to.context("no date")?,
        proofs.len(),
        covers(0),
        covers(1),
        campaign.len(),
    );
    let mut missed = String::new();
    for command in ["proofs --mutants", "fuzz mutants"] {
        let results = command.replace(" --", "-").replace(' ', "-");
        let outcomes: BTreeMap<String, BTreeMap<String, Outcome>> = sources.read(&results)?;
        ensure!(
            !outcomes.is_empty(),
            "no mutant was tried: cargo xtask {command}"
        );
        writeln!(
            page,
            "| `{command}` | {} mutants and controls |",
            outcomes.len()
        )?;
        for (name, by) in outcomes {
            let wrong = by.iter().filter(|(_, what)| **what != Outcome::Caught);
            missed.extend(wrong.map(|(by, what)| format!("* {name}, by `{by}`: {what:?}\n")));
        }
    }
    for results in ["cores", "tables"] {
        let file = |kind| {
            text(
                &sources.results,
                &format!("{results}/mutants.out/{kind}.txt"),
            )
        };
        let count = |kind| anyhow::Ok(file(kind)?.lines().count());
        let [caught, timeout] = [count("caught")?, count("timeout")?];
        writeln!(
            page,
            "| `cargo mutants`, {results} | {caught} caught, {timeout} by tests that do not end, {} missed |",
            count("missed")?,
        )?;
        missed.extend(file("missed")?.lines().map(|name| format!("* {name}\n")));
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
