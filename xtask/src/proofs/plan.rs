//! What is to be proved: `proofs/properties.toml` and `proofs/mutants.toml`.

use std::{collections::BTreeSet, fs, path::Path};

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

const PROPERTIES: &str = "proofs/properties.toml";
const MUTANTS: &str = "proofs/mutants.toml";

/// `proofs/properties.toml`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Plan {
    /// The only version of Kani whose results count.
    pub(crate) kani: String,
    /// What one harness, or the property tests of one mutant, may take.
    pub(crate) timeout_minutes: u64,
    /// What one harness may take, all its processes together.
    pub(crate) memory_gb: u64,
    #[serde(rename = "property")]
    pub(crate) properties: Vec<Property>,
}

/// A claim: one row of the tables of verification.md.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Property {
    /// `W1`: its harnesses and property tests are the functions `w1_*`.
    pub(crate) id: String,
    pub(crate) statement: String,
    /// The section of the MAVLink guide, or the RFC, that it is about.
    pub(crate) section: String,
    pub(crate) bound: String,
    /// What stands in for the real thing, and to which side it errs.
    #[serde(default)]
    pub(crate) models: Vec<String>,
    /// Part of `--fast`.
    #[serde(default)]
    pub(crate) fast: bool,
    /// Why there can be no harness, for example because it is about what does not compile.
    #[serde(default)]
    pub(crate) no_harness: Option<String>,
    /// A file whose documentation tests are property tests as well.
    #[serde(default)]
    pub(crate) doctests: Option<String>,
}

/// A change that breaks the code and must be noticed by proofs and property tests.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Mutant {
    pub(crate) name: String,
    /// What is broken, in plain words.
    pub(crate) breaks: String,
    /// Path in the project.
    pub(crate) file: String,
    /// Occurs exactly once in the file.
    pub(crate) find: String,
    pub(crate) replace: String,
    /// Harnesses that must fail, by function name.
    #[serde(default)]
    pub(crate) kills: Vec<String>,
    /// Property tests that must fail, by the beginning of their names; without it, `v1_` for a harness `v1_*`.
    #[serde(default)]
    pub(crate) twins: Vec<String>,
    /// Not a mutant, but a check of the checks: tried first, and the run is void if it misbehaves.
    #[serde(default)]
    pub(crate) control: Option<Canary>,
}

/// What a control must do.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Canary {
    Survives,
    Dies,
}

impl Plan {
    pub(crate) fn load(root: &Path) -> Result<Self> {
        load(root, PROPERTIES)
    }

    pub(crate) fn property(&self, id: &str) -> Option<&Property> {
        self.properties.iter().find(|property| property.id == id)
    }

    /// The file with documentation tests among the property tests `prefix*`.
    pub(crate) fn doctests(&self, prefix: &str) -> Option<&str> {
        self.property(&id_of(prefix)?)?.doctests.as_deref()
    }
}

impl Mutant {
    pub(crate) fn load_all(root: &Path) -> Result<Vec<Self>> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Mutants {
            mutant: Vec<Mutant>,
        }
        Ok(load::<Mutants>(root, MUTANTS)?.mutant)
    }

    /// The property tests that must fail.
    pub(crate) fn twins(&self) -> BTreeSet<String> {
        if !self.twins.is_empty() {
            return self.twins.iter().cloned().collect();
        }
        let ids = self.kills.iter().filter_map(|name| id_of(name));
        ids.map(|id| id.to_lowercase() + "_").collect()
    }

    /// The properties that must notice it.
    pub(crate) fn ids(&self) -> BTreeSet<String> {
        let twins = self.twins();
        let names = self.kills.iter().chain(&twins);
        names.filter_map(|name| id_of(name)).collect()
    }

    /// The text of the file `before` with the change made.
    ///
    /// # Errors
    /// If what is to be changed does not occur exactly once.
    pub(crate) fn apply(&self, before: &str) -> Result<String, String> {
        let Self { name, file, .. } = self;
        match before.matches(&self.find).count() {
            _ if self.find == self.replace => Err(format!("mutant {name} changes nothing")),
            1 => Ok(before.replacen(&self.find, &self.replace, 1)),
            n => Err(format!(
                "mutant {name}: its text occurs {n} times in {file}, not once"
            )),
        }
    }
}

/// The property that a function belongs to: `w1_parse_any` to `W1`.
pub(crate) fn id_of(name: &str) -> Option<String> {
    let (id, _) = name.split_once('_')?;
    let letters = id.trim_end_matches(|c: char| c.is_ascii_digit());
    let is_id = !letters.is_empty()
        && letters.len() < id.len()
        && letters.chars().all(|c| c.is_ascii_lowercase());
    is_id.then(|| id.to_uppercase())
}

fn load<T: DeserializeOwned>(root: &Path, path: &str) -> Result<T> {
    let text = fs::read_to_string(root.join(path)).context(path.to_owned())?;
    toml::from_str(&text).context(path.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_of_functions() {
        assert_eq!(id_of("w1_parse_any").as_deref(), Some("W1"));
        assert_eq!(id_of("v12_").as_deref(), Some("V12"));
        for name in ["step", "w_1", "1w_x", "W1_x", "any_timestamp", "w1"] {
            assert_eq!(id_of(name), None, "{name}");
        }
    }

    #[test]
    fn a_mutant_fits_exactly_once() {
        let mutant = |find: &str| Mutant {
            name: "m".into(),
            breaks: String::new(),
            file: "f".into(),
            find: find.into(),
            replace: "<".into(),
            kills: vec!["v1_a".into(), "r1_b".into(), "v1_c".into()],
            twins: vec![],
            control: None,
        };
        assert_eq!(mutant("<=").apply("a <= b").as_deref(), Ok("a < b"));
        assert!(mutant("<=").apply("a <= b <= c").is_err());
        assert!(mutant("<=").apply("a == b").is_err());
        assert!(mutant("<").apply("a < b").is_err());
        assert_eq!(Vec::from_iter(mutant("<=").twins()), ["r1_", "v1_"]);
        assert_eq!(Vec::from_iter(mutant("<=").ids()), ["R1", "V1"]);
    }
}
