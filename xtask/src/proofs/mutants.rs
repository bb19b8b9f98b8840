//! `cargo xtask proofs --mutants`: broken code must be noticed by its proofs and by its property tests.

use std::{collections::BTreeSet, fs, process::Command, sync::Mutex};

use anyhow::{Context, Result, bail, ensure};

use super::{
    Run,
    kani::{self, Verdict},
    plan::{Canary, Mutant, id_of},
    process,
    results::{Fates, Outcome, Results, Trial},
    table,
    workshop::Workshop,
};

/// Tries the mutants that concern the ids chosen, and the controls first; with `stale`, only those that
/// are not noticed yet on these sources.
///
/// # Errors
/// If a mutant is not noticed, or the checks themselves misbehave.
pub(crate) fn run(run: &Run, stale: bool) -> Result<()> {
    if run.kani.is_none() {
        println!(
            "cargo kani is not installed: only the property tests are tried, nothing is proved"
        );
    }
    let all = &run.project.mutants;
    let chosen = |mutant: &&Mutant| mutant.ids().iter().any(|id| run.wanted(id));
    let (canaries, mutants): (Vec<_>, Vec<_>) =
        all.iter().partition(|mutant| mutant.control.is_some());
    let mut mutants: Vec<_> = mutants.into_iter().filter(chosen).collect();
    if stale {
        let results = Results::load(&run.root)?;
        let noticed = |mutant: &Mutant| {
            let ids = mutant.ids().into_iter().filter(|id| run.wanted(id));
            let mut fates = ids.map(|id| table::fate(&run.project, &results, mutant, &id));
            fates.all(|fate| fate.is_ok_and(|fate| fate == table::KILLED))
        };
        mutants.retain(|mutant| !noticed(mutant));
    }

    let unproved = baseline(run, &canaries, &mutants)?;
    let attempt = |workshop: &Workshop, mutant: &Mutant, harnesses: &[String], twins: &_| {
        attempt(run, workshop, mutant, harnesses, twins, &unproved)
    };
    let first = run.snapshot.workshop(0)?;
    for control in canaries {
        let (harnesses, twins) = (control.kills.clone(), control.twins());
        let trial = attempt(&first, control, &harnesses, &twins)?;
        let expected = match control.control {
            Some(Canary::Survives) => Outcome::Survived,
            _ => Outcome::Killed,
        };
        ensure!(
            trial.fates().all(|(_, fate)| *fate == expected),
            "the run is void: control {} should be {expected:?}: {}",
            control.name,
            summary(&trial)
        );
        println!("control {}: {expected:?}, as it must", control.name);
    }

    let survivors = Mutex::new(Vec::new());
    run.in_parallel(mutants, |workshop, mutant| {
        let wanted = |name: &String| id_of(name).is_some_and(|id| run.wanted(&id));
        let harnesses: Vec<_> = mutant.kills.iter().filter(|n| wanted(n)).cloned().collect();
        let twins = mutant.twins().into_iter().filter(wanted).collect();
        let trial = attempt(workshop, mutant, &harnesses, &twins)?;
        println!("{}: {}", mutant.name, summary(&trial));
        if !trial.killed() {
            let mut survivors = survivors.lock().unwrap_or_else(|e| e.into_inner());
            survivors.push(mutant.name.clone());
        }
        run.record(|results| merge(results, &mutant.name, trial))
    })?;
    let survivors = survivors.into_inner().unwrap_or_else(|e| e.into_inner());
    ensure!(
        survivors.is_empty(),
        "not noticed: {}",
        survivors.join(", ")
    );
    Ok(())
}

/// Adds a trial of some harnesses and property tests to what is known of the others.
fn merge(results: &mut Results, name: &str, trial: Trial) {
    let known = results.mutants.entry(name.to_owned()).or_default();
    known.harnesses.merge(trial.harnesses);
    known.twins.merge(trial.twins);
}

/// What notices a mutant must not complain about the code as it is. Says which harnesses do; what
/// they make of a mutant means nothing.
fn baseline(run: &Run, canaries: &[&Mutant], mutants: &[&Mutant]) -> Result<BTreeSet<String>> {
    let all = || canaries.iter().chain(mutants);
    let prefixes: BTreeSet<_> = all().flat_map(|mutant| mutant.twins()).collect();
    let names: BTreeSet<_> = all().flat_map(|mutant| &mutant.kills).collect();
    let first = run.snapshot.workshop(0)?;
    for prefix in prefixes {
        match twins(run, &first, &prefix)? {
            Outcome::Survived => {}
            other => {
                bail!("the run is void: property tests {prefix}* without any mutant: {other:?}")
            }
        }
    }
    println!("property tests pass on the code as it is");
    if run.kani.is_none() {
        return Ok(BTreeSet::new());
    }
    let results = Results::load(&run.root)?;
    let mut unproved = Vec::new();
    for name in names {
        let harness = run.project.found.harness(name).context("no harness")?;
        let known = table::fresh(&run.project, &results, harness);
        if !known.is_ok_and(|proof| proof.verdict == Verdict::Verified) {
            unproved.push(harness);
        }
    }
    run.prove(unproved)
}

/// Tries one mutant in a worker's copy, and leaves the copy as it was.
fn attempt(
    run: &Run,
    workshop: &Workshop,
    mutant: &Mutant,
    harnesses: &[String],
    prefixes: &BTreeSet<String>,
    unproved: &BTreeSet<String>,
) -> Result<Trial> {
    run.snapshot.restore(workshop)?;
    let path = workshop.tree.join(&mutant.file);
    let before = fs::read_to_string(&path).with_context(|| mutant.file.clone())?;
    let after = mutant.apply(&before).map_err(anyhow::Error::msg)?;
    fs::write(&path, after)?;

    let [by_harnesses, by_twins] = run.project.sources_of_mutant(mutant)?;
    let mut trial = Trial {
        harnesses: Fates::new(by_harnesses)?,
        twins: Fates::new(by_twins)?,
    };
    for prefix in prefixes {
        let fate = twins(run, workshop, prefix)?;
        trial.twins.fates.insert(prefix.clone(), fate);
    }
    if run.kani.is_some() {
        for name in harnesses {
            let fate = if unproved.contains(name) {
                Outcome::Error("the code as it is is not proved".to_owned())
            } else {
                proof(run, workshop, name)?
            };
            trial.harnesses.fates.insert(name.clone(), fate);
        }
    }
    run.snapshot.restore(workshop)?;
    ensure!(
        fs::read_to_string(&path)? == before,
        "{} is still changed",
        mutant.file
    );
    Ok(trial)
}

/// What a harness makes of the code in a worker's copy.
fn proof(run: &Run, workshop: &Workshop, name: &str) -> Result<Outcome> {
    let harness = run.project.found.harness(name).context("no harness")?;
    let run = kani::run(&workshop.tree, &workshop.kani, harness, run.limits())?;
    Ok(match run.verdict {
        Verdict::Verified => Outcome::Survived,
        Verdict::Refuted => Outcome::Killed,
        // That a cover is lost shows nothing about the assertions.
        verdict => Outcome::Error(format!("{verdict:?}: {}", run.reason.unwrap_or_default())),
    })
}

/// What the property tests `prefix*` make of the code in a worker's copy.
fn twins(run: &Run, workshop: &Workshop, prefix: &str) -> Result<Outcome> {
    let mut fates = Vec::new();
    for twins in run.project.twins(prefix) {
        let mut cargo = Command::new("cargo");
        cargo.current_dir(&workshop.tree);
        cargo.args(["test", "--locked", "--no-fail-fast", "-p", twins.package]);
        cargo.arg("--target-dir").arg(&workshop.test);
        let ours = match twins.doctests {
            None => {
                cargo.args(["--lib", "--tests", "--", prefix]);
                prefix
            }
            Some(file) => {
                cargo.args(["--doc", "--", file]);
                file
            }
        };
        let ended = process::run(&mut cargo, run.limits())?;
        fates.push(match ended.stopped {
            Some(_) => Outcome::Error("the property tests took too much".to_owned()),
            None => {
                fate_of_tests(&ended.stdout, ours, ended.status.success()).unwrap_or_else(|| {
                    let error = ended.stderr.lines().find(|line| line.starts_with("error"));
                    Outcome::Error(
                        error
                            .unwrap_or("the property tests gave no verdict")
                            .to_owned(),
                    )
                })
            }
        });
    }
    let killed = fates.contains(&Outcome::Killed);
    let other = fates.into_iter().find(|fate| *fate != Outcome::Survived);
    Ok(match other {
        _ if killed => Outcome::Killed,
        Some(error) => error,
        None => Outcome::Survived,
    })
}

/// Reads what `cargo test` printed: a kill is a test that failed and whose name begins with
/// `ours`. None without a verdict: then it did not compile, or no such test was run.
fn fate_of_tests(output: &str, ours: &str, success: bool) -> Option<Outcome> {
    let results = output.lines().filter_map(|line| {
        let (name, result) = line.strip_prefix("test ")?.split_once(" ... ")?;
        let function = name.rsplit("::").next()?;
        let is_ours = function.starts_with(ours) || name.starts_with(ours);
        is_ours.then_some(result)
    });
    let (mut passed, mut failed) = (0, 0);
    for result in results {
        match result {
            "ok" => passed += 1,
            "FAILED" => failed += 1,
            _ => {}
        }
    }
    match (passed, failed, success) {
        (_, 1.., false) => Some(Outcome::Killed),
        (1.., 0, true) => Some(Outcome::Survived),
        _ => None,
    }
}

fn summary(trial: &Trial) -> String {
    let harnesses = trial.harnesses.fates.iter();
    let twins = trial.twins.fates.iter();
    let fates = harnesses
        .map(|(name, fate)| format!("{name} {fate:?}"))
        .chain(twins.map(|(prefix, fate)| format!("property tests {prefix}* {fate:?}")));
    fates.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_failed_twin_is_a_kill() {
        let fate = |output, success| fate_of_tests(output, "v1_", success);
        let passed = "test verify::property tests::v1_random ... ok";
        let failed = "test verify::property tests::v1_edges ... FAILED";
        assert_eq!(fate(passed, true), Some(Outcome::Survived));
        let both = format!("{passed}\n{failed}");
        assert_eq!(fate(&both, false), Some(Outcome::Killed));
        let other = "test verify::property tests::w1_v1_edges ... FAILED";
        for (output, success) in [(other, false), ("", true), ("", false), (passed, false)] {
            assert_eq!(fate(output, success), None, "{output}");
        }
        let doctest = "test proofs/src/a.rs - a (line 20) - compile fail ... FAILED";
        let fate = fate_of_tests(doctest, "proofs/src/a.rs", false);
        assert_eq!(fate, Some(Outcome::Killed));
    }
}
