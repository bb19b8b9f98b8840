//! The part of verification.md that is about the mutants.

use std::path::Path;

use anyhow::Result;

use super::{
    CORES,
    outcome::{Count, Hashes, Results, Survivors},
};
use crate::page::{Page, row};

/// The part of the page that is written here.
const PART: &str = "mutants";

/// Writes it.
///
/// # Errors
/// If the page has no place for it.
pub(super) fn write(root: &Path, hashes: &Hashes) -> Result<()> {
    Page::load(root, PART)?.write(root, &render(root, hashes)?)
}

/// Whether it says what the results say.
///
/// # Errors
/// If it does not.
pub(super) fn check(root: &Path, hashes: &Hashes) -> Result<()> {
    Page::load(root, PART)?.check(&render(root, hashes)?, "cargo xtask mutants --table")
}

fn render(root: &Path, hashes: &Hashes) -> Result<String> {
    let Some(results) = Results::load(root)? else {
        return Ok("\nNot yet run.\n\n".to_owned());
    };
    let stale = if results.hashes == *hashes {
        ""
    } else {
        "\n\n**Stale**: code or tests have changed since."
    };
    let Results {
        date,
        minutes,
        cores,
        jobs,
        cargo_mutants,
        rustc,
        ..
    } = &results;
    let again = results.survivors_again.as_ref().map(|date| {
        format!(
            " On {date} those that had survived were tried again with the tests that came since; what had \
             been noticed was not."
        )
    });
    let again = again.unwrap_or_default();
    let table = rows(&results);
    let survivors = survivors(&results, &Survivors::load(root)?);
    Ok(format!(
        "\n{table}\ncargo-mutants {cargo_mutants}, rustc {rustc}, {date}: {minutes:.1} minutes, \
         {jobs} mutants at a time on {cores} cores.{again}{stale}\n\n{survivors}\n"
    ))
}

/// How many mutants met which fate, by package.
pub(super) fn rows(results: &Results) -> String {
    let mut text = "| package | mutants | killed | survived | timeout | unviable | score |\n\
                    |---|---|---|---|---|---|---|\n"
        .to_owned();
    let packages = CORES.map(|package| (package, results.count(Some(package))));
    // What was not tried yet has no row.
    let packages = packages.into_iter().filter(|(_, count)| count.all() > 0);
    for (package, count) in packages.chain([("all", results.count(None))]) {
        let Count {
            killed,
            survived,
            timeout,
            unviable,
        } = count;
        let numbers = [count.all(), killed, survived, timeout, unviable].map(|n| n.to_string());
        let score = format!("{:.1} %", count.score());
        let [all, killed, survived, timeout, unviable] = numbers.each_ref().map(String::as_str);
        row(
            &mut text,
            &[package, all, killed, survived, timeout, unviable, &score],
        );
    }
    text
}

/// What survived, and why it may.
fn survivors(results: &Results, survivors: &Survivors) -> String {
    let mut text = "| survives | as | because |\n|---|---|---|\n".to_owned();
    for (name, mutant) in &results.mutants {
        if mutant.survived() {
            let line = format!("`{}`", mutant.line);
            let reason = survivors.reason(name, mutant);
            row(
                &mut text,
                &[name, &line, reason.unwrap_or("**unexplained**")],
            );
        }
    }
    text
}
