//! The generated part of verification.md: what is claimed, and what came out.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    path::Path,
};

use anyhow::Result;

use super::{
    census::Project,
    kani::Verdict,
    plan::{Mutant, Property},
    results::{Outcome, Proof, Results},
    scan::Harness,
};
use crate::page::{Page, row};

/// The part of the page that is written here.
const PART: &str = "table";

/// Writes the tables of verification.md.
///
/// # Errors
/// If the page has no place for them.
pub(crate) fn write(root: &Path, project: &Project, results: &Results) -> Result<()> {
    Page::load(root, PART)?.write(root, &render(project, results)?)
}

/// Whether verification.md says what the results say.
///
/// # Errors
/// If it does not.
pub(crate) fn check(root: &Path, project: &Project, results: &Results) -> Result<()> {
    let verb = "cargo xtask proofs --table";
    Page::load(root, PART)?.check(&render(project, results)?, verb)
}

fn render(project: &Project, results: &Results) -> Result<String> {
    let mut text =
        String::from("\n| id | property | after | bound | models |\n|---|---|---|---|---|\n");
    for property in &project.plan.properties {
        let models = match property.models.as_slice() {
            [] => "none".to_owned(),
            models => models.join("; "),
        };
        let Property {
            id,
            statement,
            section,
            bound,
            ..
        } = property;
        row(&mut text, &[id, statement, section, bound, &models]);
    }
    text += "\n| id | harness | result | covers | mutants | solver | time | memory |\n";
    text += "|---|---|---|---|---|---|---|---|\n";
    for property in &project.plan.properties {
        let cells = outcome(project, results, property)?;
        row(&mut text, &cells.each_ref().map(String::as_str));
    }
    text.push('\n');
    conditions(project, results, &mut text);
    text.push('\n');
    Ok(text)
}

/// The second table's row of a property.
fn outcome(project: &Project, results: &Results, property: &Property) -> Result<[String; 8]> {
    let id = property.id.clone();
    let mutants = mutants(project, results, &id)?;
    let harnesses = project.harnesses_of(&id);
    if let Some(reason) = &property.no_harness {
        let none = || "-".to_owned();
        return Ok([
            id,
            none(),
            reason.clone(),
            none(),
            mutants,
            none(),
            none(),
            none(),
        ]);
    }
    let proofs: Vec<_> = harnesses
        .iter()
        .filter_map(|harness| fresh(project, results, harness).ok())
        .filter(|proof| proof.seconds.is_some())
        .collect();
    let all = proofs.len() == harnesses.len() && !proofs.is_empty();
    // Numbers only where every harness has one: a sum of some would look like all.
    let sum = |value: &dyn Fn(&Proof) -> String| {
        if all {
            value(proofs[0])
        } else {
            "-".to_owned()
        }
    };
    let covers = sum(&|_| {
        let satisfied: usize = proofs.iter().map(|proof| proof.covers_satisfied).sum();
        let covers: usize = proofs.iter().map(|proof| proof.covers).sum();
        format!("{satisfied}/{covers}")
    });
    let solvers: BTreeSet<_> = harnesses.iter().map(|h| h.solver.as_str()).collect();
    let time = sum(&|_| {
        let seconds: Option<f64> = proofs.iter().map(|proof| proof.seconds).sum();
        seconds.map_or_else(|| "-".to_owned(), |seconds| format!("{seconds:.1} s"))
    });
    let memory = sum(&|_| {
        let memory = proofs.iter().map(|proof| proof.memory_mb);
        let memory = memory.collect::<Option<Vec<_>>>();
        let most = memory.and_then(|memory| memory.into_iter().max());
        most.map_or_else(
            || "not measured".to_owned(),
            |megabytes| format!("{megabytes} MB"),
        )
    });
    Ok([
        id,
        names(&harnesses),
        verdict(project, results, &harnesses),
        covers,
        mutants,
        solvers.into_iter().collect::<Vec<_>>().join(", "),
        time,
        memory,
    ])
}

/// The harnesses by name; of many, what their names have in common.
fn names(harnesses: &[&Harness]) -> String {
    if harnesses.len() <= 3 {
        let names = harnesses
            .iter()
            .map(|harness| format!("`{}`", harness.name()));
        return names.collect::<Vec<_>>().join(", ");
    }
    let first = harnesses[0].name();
    let common = |end: &usize| {
        harnesses
            .iter()
            .all(|h| h.name().get(..*end) == first.get(..*end))
    };
    let end = (0..=first.len()).rev().find(common).unwrap_or(0);
    format!("`{}*` ({})", &first[..end], harnesses.len())
}

/// What is to be said of all harnesses of a property: the worst.
fn verdict(project: &Project, results: &Results, harnesses: &[&Harness]) -> String {
    let mut said: BTreeMap<String, usize> = BTreeMap::new();
    for harness in harnesses {
        let text = match fresh(project, results, harness) {
            Err(why) => why,
            Ok(Proof {
                verdict: Verdict::Verified,
                ..
            }) => "verified".to_owned(),
            Ok(proof) => {
                let reason = proof.reason.as_deref().unwrap_or_default();
                format!("**{:?}** `{}`: {reason}", proof.verdict, harness.name())
            }
        };
        *said.entry(text).or_default() += 1;
    }
    let said = said.into_iter().map(|(text, count)| match count {
        n if n == harnesses.len() => text,
        n => format!("{n} {text}"),
    });
    said.collect::<Vec<_>>().join("; ")
}

/// The result of a harness, if it is one of these sources and of the pinned Kani.
pub(crate) fn fresh<'a>(
    project: &Project,
    results: &'a Results,
    harness: &Harness,
) -> Result<&'a Proof, String> {
    let pinned = &project.plan.kani;
    match results.harnesses.get(harness.name()) {
        None => Err("written, not yet run".to_owned()),
        Some(proof) if proof.sources != project.sources(harness) => {
            Err("stale, run again".to_owned())
        }
        Some(proof) if proof.conditions.kani != *pinned => {
            let kani = &proof.conditions.kani;
            Err(format!("run with Kani {kani}, not {pinned}: run again"))
        }
        Some(proof) => Ok(proof),
    }
}

/// How many of the property's mutants both its harnesses and its property tests noticed.
fn mutants(project: &Project, results: &Results, id: &str) -> Result<String> {
    let mutants = project.mutants_of(id);
    let mut killed = 0;
    let mut others: BTreeMap<&str, usize> = BTreeMap::new();
    for mutant in &mutants {
        match fate(project, results, mutant, id)? {
            KILLED => killed += 1,
            other => *others.entry(other).or_default() += 1,
        }
    }
    let mut text = format!("{killed}/{}", mutants.len());
    for (other, count) in others {
        let _ = write!(text, ", {count} {other}");
    }
    Ok(text)
}

/// What became of a mutant whose harnesses and property tests all noticed it.
pub(crate) const KILLED: &str = "killed";

/// What the harnesses and property tests of the property `id` made of `mutant`, in words.
pub(crate) fn fate(
    project: &Project,
    results: &Results,
    mutant: &Mutant,
    id: &str,
) -> Result<&'static str> {
    let Some(trial) = results.mutants.get(&mutant.name) else {
        return Ok("not yet run");
    };
    let [by_harnesses, by_twins] = project.sources_of_mutant(mutant)?;
    let proved = mutant.kills.is_empty() || trial.harnesses.sources == by_harnesses;
    if !proved || trial.twins.sources != by_twins {
        return Ok("stale");
    }
    let prefix = id.to_lowercase() + "_";
    let harnesses = mutant
        .kills
        .iter()
        .map(|name| (name, trial.harnesses.fates.get(name)));
    let twins = mutant.twins();
    let twins = twins.iter().map(|name| (name, trial.twins.fates.get(name)));
    let fates = harnesses
        .chain(twins)
        .filter(|(name, _)| name.starts_with(&prefix));
    let fates: Vec<_> = fates.map(|(_, fate)| fate).collect();
    Ok(if fates.contains(&Some(&Outcome::Survived)) {
        "**survived**"
    } else if fates.contains(&None) {
        "not yet run"
    } else if fates.iter().all(|fate| *fate == Some(&Outcome::Killed)) {
        KILLED
    } else {
        "**without verdict**"
    })
}

/// With what, when and in what time the results came about.
fn conditions(project: &Project, results: &Results, text: &mut String) {
    let mut runs: BTreeMap<_, BTreeSet<&str>> = BTreeMap::new();
    for harness in &project.found.harnesses {
        let proof = fresh(project, results, harness).ok();
        if let Some(proof) = proof.filter(|proof| proof.seconds.is_some()) {
            let c = &proof.conditions;
            let with = (&c.kani, &c.cbmc, &c.rustc, c.cores);
            runs.entry(with).or_default().insert(&c.date);
        }
    }
    if runs.is_empty() {
        text.push_str("No result of these sources yet.\n");
    }
    let known = |version: &Option<String>| version.clone().unwrap_or_else(|| "unknown".to_owned());
    for ((kani, cbmc, rustc, cores), dates) in &runs {
        let (cbmc, rustc) = (known(cbmc), known(rustc));
        let dates = Vec::from_iter(dates.iter().copied()).join(", ");
        let _ = writeln!(
            text,
            "Kani {kani}, CBMC {cbmc}, rustc {rustc}, {cores} cores, {dates}. Time is the \
             solver's, memory the peak of all processes of one harness."
        );
    }
    if let Some(run) = &results.full_run {
        let minutes = run.seconds / 60.0;
        let _ = writeln!(
            text,
            "The last full run took {minutes:.1} minutes, {} harnesses at a time on {} cores, {}.",
            run.jobs, run.cores, run.date
        );
    } else if !runs.is_empty() {
        text.push_str("These are of several runs, each of a part.\n");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_harnesses_are_named_by_what_they_share() {
        let all: Vec<_> = [
            "s1_length_0",
            "s1_length_12",
            "s1_length_255",
            "s1_length_4",
        ]
        .map(|name| Harness {
            package: "p".into(),
            path: format!("sign::harness::{name}"),
            solver: "cadical".into(),
            stubbed: false,
        })
        .into();
        let refs: Vec<_> = all.iter().collect();
        assert_eq!(names(&refs), "`s1_length_*` (4)");
        assert_eq!(names(&refs[..1]), "`s1_length_0`");
    }
}
