//! What is fuzzed: `fuzz/targets.toml`.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use anyhow::{Context, Result, ensure};
use serde::Deserialize;

const TARGETS: &str = "fuzz/targets.toml";
/// The target that does nothing, to measure the engine with.
pub(super) const EMPTY: &str = "empty";

/// A fuzz target.
#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Target {
    /// Its file in `fuzz/fuzz_targets`, without extension.
    pub(super) name: String,
    /// What with what.
    pub(super) compares: String,
    /// Ids of `proofs/properties.toml`.
    pub(super) properties: Vec<String>,
    /// Bytes of the longest input.
    pub(super) max_len: usize,
}

/// `fuzz/targets.toml`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Plan {
    #[serde(rename = "target")]
    targets: Vec<Target>,
    /// Why no target can find a mutant, by the mutant's name.
    exempt: BTreeMap<String, String>,
}

impl Plan {
    fn load(root: &Path) -> Result<Self> {
        let text = fs::read_to_string(root.join(TARGETS)).context(TARGETS)?;
        toml::from_str(&text).context(TARGETS)
    }
}

/// Every target.
///
/// # Errors
/// If one is without entry, or an entry without target.
pub(super) fn targets(root: &Path) -> Result<Vec<Target>> {
    let targets = Plan::load(root)?.targets;
    let mut listed: BTreeSet<_> = targets.iter().map(|target| target.name.clone()).collect();
    listed.insert(EMPTY.to_owned());
    let mut written = BTreeSet::new();
    for entry in fs::read_dir(root.join("fuzz/fuzz_targets"))? {
        let path = entry?.path();
        written.extend(
            path.file_stem()
                .map(|name| name.to_string_lossy().into_owned()),
        );
    }
    let differ: Vec<_> = listed.symmetric_difference(&written).cloned().collect();
    let differ = differ.join(", ");
    ensure!(
        differ.is_empty(),
        "{TARGETS} and fuzz/fuzz_targets differ in {differ}"
    );
    Ok(targets)
}

/// Mutants of `proofs/mutants.toml` that no target can find, each with the reason.
///
/// # Errors
/// If the file cannot be read.
pub(super) fn exempt(root: &Path) -> Result<BTreeMap<String, String>> {
    Ok(Plan::load(root)?.exempt)
}
