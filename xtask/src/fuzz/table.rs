//! The part of verification.md that is about fuzzing.

use std::{fmt::Write as _, path::Path};

use anyhow::Result;

use super::plan::{self, Target};
use super::results::{Campaign, Coverage, Fate, Mutants, Results, Run, Speed, sources};
use crate::page::{Page, row};

/// The part of the page that is written here.
const PART: &str = "fuzz";

/// Writes it.
///
/// # Errors
/// If the page has no place for it.
pub(super) fn write(root: &Path) -> Result<()> {
    Page::load(root, PART)?.write(root, &render(root)?)
}

/// Whether it says what the results say.
///
/// # Errors
/// If it does not.
pub(super) fn check(root: &Path) -> Result<()> {
    Page::load(root, PART)?.check(&render(root)?, "cargo xtask fuzz table")
}

fn render(root: &Path) -> Result<String> {
    let results = Results::load(root)?;
    let targets = plan::targets(root)?;
    let sources = sources(root)?;
    let mut text = "\n".to_owned();
    part(
        &mut text,
        &sources,
        "campaign",
        &results.campaign,
        |text, run| {
            campaign(text, run, &targets);
        },
    );
    part(
        &mut text,
        &sources,
        "coverage",
        &results.coverage,
        |text, run| {
            coverage(text, &run.outcome);
        },
    );
    part(&mut text, &sources, "speed", &results.speed, |text, run| {
        speed(text, &run.outcome)
    });
    part(
        &mut text,
        &sources,
        "mutants",
        &results.mutants,
        |text, run| {
            mutants(text, &run.outcome);
        },
    );
    Ok(text)
}

/// One kind of run: what came out, or that there is none, and whether it is one of these sources.
fn part<T>(
    text: &mut String,
    sources: &str,
    verb: &str,
    run: &Option<Run<T>>,
    render: impl FnOnce(&mut String, &Run<T>),
) {
    let Some(run) = run else {
        let _ = writeln!(text, "`cargo xtask fuzz {verb}`: not yet run.\n");
        return;
    };
    let Run {
        date, rustc, cores, ..
    } = run;
    let stale = if run.sources == sources {
        ""
    } else {
        " **Stale: of other sources than these, to be run again.**"
    };
    let _ = writeln!(
        text,
        "`cargo xtask fuzz {verb}`, {date}, {rustc}, {cores} cores.{stale}\n"
    );
    render(text, run);
    text.push('\n');
}

fn campaign(text: &mut String, run: &Run<Campaign>, targets: &[Target]) {
    text.push_str("| target | compares | executions | time | edges | features | findings |\n");
    text.push_str("|---|---|---|---|---|---|---|\n");
    for Target { name, compares, .. } in targets {
        let cells = match run.outcome.targets.get(name) {
            None => ["-"; 5].map(str::to_owned),
            Some(fuzzed) => [
                grouped(fuzzed.executions),
                format!("{:.0} s", fuzzed.seconds),
                fuzzed.edges.to_string(),
                fuzzed.features.to_string(),
                match fuzzed.findings.as_slice() {
                    [] => "none".to_owned(),
                    findings => format!("**{}**: {}", findings.len(), findings.join("; ")),
                },
            ],
        };
        let [executions, time, edges, features, findings] = cells.each_ref().map(String::as_str);
        let name = format!("`{name}`");
        row(
            text,
            &[&name, compares, executions, time, edges, features, findings],
        );
    }
    let Campaign {
        minutes,
        jobs,
        targets,
    } = &run.outcome;
    let executions = targets.values().map(|fuzzed| fuzzed.executions).sum();
    let executions = grouped(executions);
    let _ = writeln!(
        text,
        "\n{minutes:.0} minutes, {jobs} targets at a time, {executions} executions in all. Edges are those of \
         the whole program that libFuzzer counts, of cores, properties and libraries; time is the \
         target's own."
    );
}

fn coverage(text: &mut String, coverage: &Coverage) {
    text.push_str("| of | reached |\n|---|---|\n");
    for (folder, lines) in &coverage.folders {
        row(
            text,
            &[&format!("`{folder}`, all targets"), &lines.to_string()],
        );
    }
    for (target, lines) in &coverage.targets {
        row(text, &[&format!("all, `{target}`"), &lines.to_string()]);
    }
    let missed = |missed: &[String]| match missed {
        [] => "none".to_owned(),
        missed => missed.join(", "),
    };
    text.push_str(
        "\nNot counted: `Display` and `Debug`, and the private `const fn` of `dialect/mod.rs`, which the \
         compiler runs and no program can.\n",
    );
    let _ = writeln!(
        text,
        "Lines that no target reaches: {}.",
        missed(&coverage.missed)
    );
    let _ = writeln!(
        text,
        "Variants of errors that no target reaches, of {}: {}.",
        coverage.errors,
        missed(&coverage.errors_missed)
    );
}

fn speed(text: &mut String, speed: &Speed) {
    let ratio = speed.ratio();
    let target = &speed.target;
    let [per_second, empty] = [speed.per_second, speed.empty_per_second].map(grouped);
    let _ = writeln!(
        text,
        "`{target}`: {per_second} executions a second; a target that does nothing, with the same \
         flags and seeds: {empty}; ratio {ratio:.2}."
    );
}

fn mutants(text: &mut String, mutants: &Mutants) {
    text.push_str("| mutant | found by | after |\n|---|---|---|\n");
    for (name, fate) in &mutants.mutants {
        let (target, seconds) = match fate {
            Fate::Found { target, seconds } => (format!("`{target}`"), format!("{seconds:.1} s")),
            Fate::Survived => ("**none**".to_owned(), "-".to_owned()),
            Fate::Exempt(reason) => (reason.clone(), "-".to_owned()),
        };
        row(text, &[name, &target, &seconds]);
    }
}

/// A number with commas.
pub(super) fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_groups() {
        let all = [0, 12, 123, 1234, 123_456, 1_234_567].map(grouped);
        assert_eq!(all, ["0", "12", "123", "1,234", "123,456", "1,234,567"]);
    }
}
