//! `cargo xtask proofs --mutants`: what harnesses and property tests make of broken code.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    process::Command,
};

use anyhow::{Context, Result, ensure};

use super::{RESULTS, kani, kani::Proof, kani::Verdict, prove};
use crate::{
    mutants::{Mutant, Outcome, each},
    sources::Sources,
};

/// Tries each mutant with the harnesses and property tests that must notice it; without Kani, with the tests alone.
pub(super) fn run(kani: bool, only: &[String], jobs: usize) -> Result<()> {
    let sources = Sources::now()?;
    let tree = sources.worktree(0)?;
    let mutants = Mutant::load(&tree, only)?;
    // What fails on the code as it is notices nothing.
    for all in ["", ".rs"] {
        let output = tests(&tree, &[all.to_owned()].into())?;
        let passed = output.contains("test result: ok") && !output.contains("test result: FAILED");
        ensure!(passed, "property tests fail without a mutant: {output}");
    }
    let mut harnesses = BTreeMap::new();
    if kani {
        harnesses = kani::list(&tree)?;
        let known: BTreeMap<String, Proof> = sources.read(RESULTS)?;
        let mut unproved = BTreeMap::new();
        for name in mutants.iter().flat_map(|mutant| &mutant.kills) {
            let path = harnesses
                .get(name)
                .with_context(|| format!("no harness {name}"))?;
            if !known.get(name).is_some_and(Proof::verified) {
                unproved.insert(name.clone(), path.clone());
            }
        }
        if !unproved.is_empty() {
            prove(&sources, unproved, jobs)?;
        }
    }
    each(&sources, "proofs-mutants", mutants, jobs, |mutant, tree| {
        let mut outcomes = BTreeMap::new();
        let prefixes = mutant.tests();
        let output = tests(tree, &prefixes)?;
        for prefix in &prefixes {
            outcomes.insert(format!("{prefix}*"), of_tests(&output, prefix));
        }
        for name in &mutant.kills {
            let Some(path) = harnesses.get(name) else {
                outcomes.insert(name.clone(), Outcome::KaniNotRun);
                continue;
            };
            let log = sources
                .results
                .join(format!("logs/{}/{name}.log", mutant.name));
            let proof = kani::prove(tree, path, &log)?;
            let outcome = match proof.verdict {
                Verdict::Refuted => Outcome::Caught,
                Verdict::Verified => Outcome::Missed,
                // A cover that is lost shows nothing about the assertions.
                verdict => Outcome::Error(format!("{verdict:?}: {}", proof.reason)),
            };
            outcomes.insert(name.clone(), outcome);
        }
        Ok(outcomes)
    })
}
/// What the property tests of these names print, or the documentation tests of these files.
fn tests(tree: &Path, filters: &BTreeSet<String>) -> Result<String> {
    let files = filters.iter().any(|filter| filter.ends_with(".rs"));
    // With some mutants a test does not end.
    let mut cargo = Command::new("timeout");
    cargo.args(["900", "cargo", "test", "--locked", "-p", "mavseal-proofs"]);
    cargo
        .args([if files { "--doc" } else { "--lib" }, "--"])
        .args(filters);
    let output = cargo.current_dir(tree).output()?;
    let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
    Ok(text(&output.stdout) + &text(&output.stderr))
}

/// What `cargo test` says of the tests whose names begin with `prefix`: one of them that failed has caught the
/// mutant. Without any, it is an error: it did not compile, or there is no such test.
fn of_tests(output: &str, prefix: &str) -> Outcome {
    let results = output.lines().filter_map(|line| {
        let (name, result) = line.strip_prefix("test ")?.split_once(" ... ")?;
        let ours = name.contains(&format!("::{prefix}")) || name.starts_with(prefix);
        ours.then_some(result)
    });
    let results: Vec<_> = results.collect();
    if results.contains(&"FAILED") {
        Outcome::Caught
    } else if results.contains(&"ok") && output.contains("test result: ok") {
        Outcome::Missed
    } else {
        let error = output.lines().find(|line| line.starts_with("error"));
        Outcome::Error(error.unwrap_or("no such test").to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_failed_test_has_caught_it() {
        let passed = "test verify::tests::v1_random ... ok\ntest result: ok.";
        assert_eq!(of_tests(passed, "v1_"), Outcome::Missed);
        let failed = "test verify::tests::v1_edges ... FAILED\ntest a::v1_random ... ok";
        assert_eq!(of_tests(failed, "v1_"), Outcome::Caught);
        for other in [
            "test a::w1_v1_edges ... FAILED",
            "",
            "error: x",
            "test a::v1_a ... ok",
        ] {
            assert!(
                matches!(of_tests(other, "v1_"), Outcome::Error(_)),
                "{other}"
            );
        }
        let doctest = "test proofs/src/a.rs - a (line 20) - compile fail ... FAILED";
        assert_eq!(of_tests(doctest, "proofs/src/a.rs"), Outcome::Caught);
    }
}
