//! `fuzz/results.json`: what was run, on which sources, with what outcome.

use std::{collections::BTreeMap, fmt, fs, ops::Add, path::Path};

use anyhow::{Context, Result};
use cargo_metadata::MetadataCommand;
use serde::{Deserialize, Serialize};

use crate::proofs::{
    fingerprint::{Depth, fingerprint, hash_of, meaning, rust_files},
    results::{cores, today},
};

const RESULTS: &str = "fuzz/results.json";

/// The whole file: the last run of each kind.
#[derive(Default, Serialize, Deserialize)]
pub(super) struct Results {
    pub(super) campaign: Option<Run<Campaign>>,
    pub(super) coverage: Option<Run<Coverage>>,
    pub(super) speed: Option<Run<Speed>>,
    pub(super) mutants: Option<Run<Mutants>>,
}

/// A run, and the conditions that it was made under.
#[derive(Serialize, Deserialize)]
pub(super) struct Run<T> {
    pub(super) date: String,
    pub(super) rustc: String,
    pub(super) cores: usize,
    /// Hash of what was run.
    pub(super) sources: String,
    pub(super) outcome: T,
}

/// A campaign over all targets.
#[derive(Serialize, Deserialize)]
pub(super) struct Campaign {
    pub(super) minutes: f64,
    /// Targets at a time.
    pub(super) jobs: usize,
    pub(super) targets: BTreeMap<String, Fuzzed>,
}

/// What became of a target in a campaign.
#[derive(Clone, Default, Serialize, Deserialize)]
pub(super) struct Fuzzed {
    pub(super) executions: u64,
    /// Of one process after another.
    pub(super) seconds: f64,
    pub(super) edges: u64,
    pub(super) features: u64,
    /// What it failed on, each as the target said it.
    pub(super) findings: Vec<String>,
}

/// What seeds and corpora reach.
#[derive(Default, Serialize, Deserialize)]
pub(super) struct Coverage {
    /// By folder of the project, all targets together.
    pub(super) folders: BTreeMap<String, Lines>,
    /// By target, all folders together.
    pub(super) targets: BTreeMap<String, Lines>,
    /// Lines that no target reaches, as `file:line`.
    pub(super) missed: Vec<String>,
    /// Variants of errors, all and those that no target reaches.
    pub(super) errors: usize,
    pub(super) errors_missed: Vec<String>,
}

/// How many of some lines are reached.
#[derive(Clone, Copy, Default, Serialize, Deserialize)]
pub(super) struct Lines {
    pub(super) reached: usize,
    pub(super) of: usize,
}

/// A target against one that does nothing.
#[derive(Serialize, Deserialize)]
pub(super) struct Speed {
    pub(super) target: String,
    pub(super) per_second: u64,
    pub(super) empty_per_second: u64,
}

/// What became of the mutants of `proofs/mutants.toml`.
#[derive(Default, Serialize, Deserialize)]
pub(super) struct Mutants {
    pub(super) mutants: BTreeMap<String, Fate>,
}

/// What became of a mutant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Fate {
    /// By which target, after how long.
    Found { target: String, seconds: f64 },
    /// By none.
    Survived,
    /// Why no target can find it.
    Exempt(String),
}

impl Results {
    /// The committed results; empty if there are none.
    pub(super) fn load(root: &Path) -> Result<Self> {
        let path = root.join(RESULTS);
        if !path.is_file() {
            return Ok(Self::default());
        }
        serde_json::from_str(&fs::read_to_string(path)?).context(RESULTS)
    }

    /// Changes the committed results.
    pub(super) fn change(root: &Path, change: impl FnOnce(&mut Self)) -> Result<()> {
        let mut results = Self::load(root)?;
        change(&mut results);
        let text = serde_json::to_string_pretty(&results)? + "\n";
        fs::write(root.join(RESULTS), text).context(RESULTS)
    }
}

impl Speed {
    /// The part of the empty target's speed.
    pub(super) fn ratio(&self) -> f64 {
        self.per_second as f64 / self.empty_per_second.max(1) as f64
    }
}

impl Lines {
    /// The part that is reached.
    pub(super) fn share(self) -> f64 {
        self.reached as f64 / self.of.max(1) as f64
    }
}

impl Add for Lines {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            reached: self.reached + other.reached,
            of: self.of + other.of,
        }
    }
}

impl fmt::Display for Lines {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { reached, of } = self;
        write!(f, "{reached} of {of} lines ({:.1} %)", 100.0 * self.share())
    }
}

impl<T> Run<T> {
    /// A run that has just ended, with a compiler of this version.
    pub(super) fn new(root: &Path, rustc: String, outcome: T) -> Result<Self> {
        Ok(Self {
            date: today()?,
            rustc,
            cores: cores(),
            sources: sources(root)?,
            outcome,
        })
    }
}

/// The hash of what the targets run: the properties with all that they use, and the targets.
pub(super) fn sources(root: &Path) -> Result<String> {
    let mut metadata = MetadataCommand::new();
    let metadata = metadata.manifest_path(root.join("Cargo.toml")).exec()?;
    let mut text = fingerprint(&metadata, "mavseal-proofs", Depth::Fuzz)?;
    for file in rust_files(&root.join("fuzz/src"))? {
        text += &meaning(&file, Depth::Fuzz)?;
    }
    Ok(hash_of(&text))
}
