//! `proofs/results.json`: what was run, on which sources, with what outcome.

use std::{collections::BTreeMap, fs, path::Path, process::Command, thread};

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use super::kani::{Run, Verdict};

const RESULTS: &str = "proofs/results.json";

/// The whole file.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct Results {
    /// The last run of everything, without mutants.
    pub(crate) full_run: Option<FullRun>,
    /// By function name.
    pub(crate) harnesses: BTreeMap<String, Proof>,
    /// By name of the mutant.
    pub(crate) mutants: BTreeMap<String, Trial>,
}

/// A run of every harness.
#[derive(Serialize, Deserialize)]
pub(crate) struct FullRun {
    pub(crate) date: String,
    pub(crate) seconds: f64,
    pub(crate) jobs: usize,
    pub(crate) cores: usize,
}

/// The last run of a harness.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct Proof {
    pub(crate) verdict: Verdict,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) reason: Option<String>,
    pub(crate) checks: usize,
    pub(crate) covers_satisfied: usize,
    pub(crate) covers: usize,
    pub(crate) stubs: Vec<String>,
    pub(crate) solver: String,
    /// The solver's part, as Kani measures it.
    pub(crate) seconds: Option<f64>,
    /// All of it, compilation included.
    pub(crate) seconds_in_all: f64,
    pub(crate) memory_mb: Option<u64>,
    pub(crate) conditions: Conditions,
    /// Hash of what was proved.
    pub(crate) sources: String,
}

/// With what a harness was run.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(crate) struct Conditions {
    pub(crate) kani: String,
    pub(crate) cbmc: Option<String>,
    pub(crate) rustc: Option<String>,
    pub(crate) cores: usize,
    pub(crate) date: String,
}

/// What became of a mutant. A change of a property test makes what the harnesses noticed no less true.
#[derive(Clone, Default, Serialize, Deserialize)]
pub(crate) struct Trial {
    /// By function name.
    pub(crate) harnesses: Fates,
    /// By beginning of their names.
    pub(crate) twins: Fates,
}

/// Whether harnesses or property tests noticed a mutant.
#[derive(Clone, Default, Serialize, Deserialize)]
pub(crate) struct Fates {
    pub(crate) date: String,
    pub(crate) fates: BTreeMap<String, Outcome>,
    /// Hash of what was changed, how, and of what should notice.
    pub(crate) sources: String,
}

/// What a harness or the property tests made of a mutant.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Outcome {
    Killed,
    Survived,
    /// Neither: it does not compile, takes too long, or Kani does not get to its end.
    Error(String),
}

impl Results {
    /// The committed results; empty if there are none.
    pub(crate) fn load(root: &Path) -> Result<Self> {
        let path = root.join(RESULTS);
        if !path.is_file() {
            return Ok(Self::default());
        }
        serde_json::from_str(&fs::read_to_string(path)?).context(RESULTS)
    }

    pub(crate) fn save(&self, root: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)? + "\n";
        fs::write(root.join(RESULTS), text).context(RESULTS)
    }
}

impl Proof {
    pub(crate) fn new(run: Run, kani: &str, solver: &str, sources: &str) -> Result<Self> {
        let report = run.report;
        Ok(Self {
            verdict: run.verdict,
            reason: run.reason,
            checks: report.checks,
            covers_satisfied: report.covers_satisfied,
            covers: report.covers,
            stubs: report.stubs,
            solver: solver.to_owned(),
            seconds: report.seconds.map(tenths),
            seconds_in_all: tenths(run.seconds),
            memory_mb: run.memory_mb,
            conditions: Conditions {
                kani: kani.to_owned(),
                cbmc: report.cbmc,
                rustc: report.rustc,
                cores: cores(),
                date: today()?,
            },
            sources: sources.to_owned(),
        })
    }
}

impl Trial {
    /// Whether all that belongs to the property `id` noticed; `None` if something was not tried.
    pub(crate) fn killed(&self) -> bool {
        self.fates().all(|(_, fate)| *fate == Outcome::Killed)
    }

    /// What each harness and each group of property tests made of it.
    pub(crate) fn fates(&self) -> impl Iterator<Item = (&String, &Outcome)> {
        self.harnesses.fates.iter().chain(&self.twins.fates)
    }
}

impl Fates {
    /// Of what is about to be tried.
    pub(crate) fn new(sources: String) -> Result<Self> {
        Ok(Self {
            date: today()?,
            fates: BTreeMap::new(),
            sources,
        })
    }

    /// Adds what was tried since; what is known stays if it is of the same sources.
    pub(crate) fn merge(&mut self, newer: Self) {
        if newer.fates.is_empty() {
            return;
        }
        if self.sources == newer.sources {
            self.fates.extend(newer.fates);
            self.date = newer.date;
        } else {
            *self = newer;
        }
    }
}

/// Cores of this machine.
pub(crate) fn cores() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// Today in UTC, as in 2026-01-31.
pub(crate) fn today() -> Result<String> {
    let output = Command::new("date").args(["-u", "+%F"]).output();
    let output = output.context("date")?.stdout;
    Ok(String::from_utf8(output)?.trim().to_owned())
}

/// Rounded to tenths.
pub(crate) fn tenths(seconds: f64) -> f64 {
    (seconds * 10.0).round() / 10.0
}
