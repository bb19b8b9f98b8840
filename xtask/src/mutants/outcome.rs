//! What became of each mutant, and why some may survive.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;

const RESULTS: &str = "xtask/src/mutants/results.json";
const SURVIVORS: &str = "xtask/src/mutants/survivors.toml";

/// The last run of all mutants.
#[derive(Serialize, Deserialize)]
pub(super) struct Results {
    pub(super) date: String,
    pub(super) minutes: f64,
    pub(super) cores: usize,
    pub(super) jobs: usize,
    pub(super) cargo_mutants: String,
    pub(super) rustc: String,
    pub(super) hashes: Hashes,
    /// When those that had survived were tried again, with tests that came since.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) survivors_again: Option<String>,
    /// By name and place.
    pub(super) mutants: BTreeMap<String, Mutant>,
}

/// What a run depends on.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Hashes {
    /// Of the code that is changed.
    pub(super) code: String,
    /// Of that and of the tests.
    pub(super) all: String,
}

/// A mutant that was tried.
#[derive(Serialize, Deserialize)]
pub(super) struct Mutant {
    pub(super) package: String,
    /// The first line that it changes, as changed; empty if it deletes one.
    pub(super) line: String,
    pub(super) fate: Fate,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Fate {
    /// A test failed.
    Killed,
    /// No test did.
    Survived,
    /// The tests did not end.
    Timeout,
    /// It does not compile.
    Unviable,
}

impl Mutant {
    /// Whether nobody noticed: all tests passed.
    pub(super) const fn survived(&self) -> bool {
        matches!(self.fate, Fate::Survived)
    }
}

/// How many mutants met which fate.
#[derive(Default)]
pub(super) struct Count {
    pub(super) killed: usize,
    pub(super) survived: usize,
    pub(super) timeout: usize,
    pub(super) unviable: usize,
}

impl Count {
    pub(super) const fn all(&self) -> usize {
        self.killed + self.survived + self.timeout + self.unviable
    }

    /// Percent noticed of those that compile: tests that do not end are noticed too.
    pub(super) fn score(&self) -> f64 {
        let viable = self.all() - self.unviable;
        100.0 * (self.killed + self.timeout) as f64 / viable.max(1) as f64
    }
}

impl Results {
    /// The committed results, if there are any.
    pub(super) fn load(root: &Path) -> Result<Option<Self>> {
        let path = root.join(RESULTS);
        if !path.is_file() {
            return Ok(None);
        }
        serde_json::from_str(&fs::read_to_string(path)?).context(RESULTS)
    }

    pub(super) fn save(&self, root: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)? + "\n";
        fs::write(root.join(RESULTS), text).context(RESULTS)
    }

    /// Regular expressions for the names of those that survived, wherever they are in their files now.
    pub(super) fn survivors(&self) -> BTreeSet<String> {
        let survived = self.mutants.iter().filter(|(_, mutant)| mutant.survived());
        let names = survived.filter_map(|(name, _)| Name::parse(name));
        let pattern = |name: Name<'_>| {
            let [file, change] = [name.file, name.change].map(regex::escape);
            format!(r"^{file}:\d+:\d+:{change}$")
        };
        names.map(pattern).collect()
    }

    /// Adds what came out of survivors that were tried again, which may have moved in their files.
    pub(super) fn retry(&mut self, tried: &BTreeMap<String, Mutant>) {
        let mut all = in_order(&self.mutants);
        for (key, now) in in_order(tried) {
            let before = all.remove(&key).unwrap_or_default();
            // As many as there were, and so the same ones.
            if before.len() != now.len() {
                continue;
            }
            for (before, now) in before.iter().zip(now) {
                if tried[&now].fate == Fate::Killed
                    && let Some(mutant) = self.mutants.get_mut(before)
                {
                    mutant.fate = Fate::Killed;
                }
            }
        }
    }

    /// Of one package, or of all.
    pub(super) fn count(&self, package: Option<&str>) -> Count {
        let mut count = Count::default();
        for mutant in self.mutants.values() {
            if package.is_none_or(|package| package == mutant.package) {
                *match mutant.fate {
                    Fate::Killed => &mut count.killed,
                    Fate::Survived => &mut count.survived,
                    Fate::Timeout => &mut count.timeout,
                    Fate::Unviable => &mut count.unviable,
                } += 1;
            }
        }
        count
    }
}

/// Reads what cargo-mutants left in `folder`.
pub(super) fn read(folder: &Path) -> Result<BTreeMap<String, Mutant>> {
    let text = fs::read_to_string(folder.join("outcomes.json")).context("outcomes.json")?;
    let outcomes: Value = serde_json::from_str(&text)?;
    let mut mutants = BTreeMap::new();
    for outcome in outcomes["outcomes"].as_array().context("no outcomes")? {
        let mutant = &outcome["scenario"]["Mutant"];
        let (Some(name), Some(package)) = (mutant["name"].as_str(), mutant["package"].as_str())
        else {
            continue;
        };
        let summary = outcome["summary"].as_str().unwrap_or_default();
        let fate = match summary {
            "CaughtMutant" => Fate::Killed,
            "MissedMutant" => Fate::Survived,
            "Timeout" => Fate::Timeout,
            "Unviable" => Fate::Unviable,
            other => anyhow::bail!("{name}: {other}"),
        };
        let diff = outcome["diff_path"].as_str().context("no diff")?;
        let diff = fs::read_to_string(folder.join(diff)).with_context(|| diff.to_owned())?;
        let mutant = Mutant {
            package: package.to_owned(),
            line: changed_line(&diff),
            fate,
        };
        mutants.insert(name.to_owned(), mutant);
    }
    Ok(mutants)
}

/// Adds what came out of mutants that were tried once more: killed once is killed.
pub(super) fn merge(tried: &mut BTreeMap<String, Mutant>, again: BTreeMap<String, Mutant>) {
    for (name, mutant) in again {
        if mutant.fate == Fate::Killed {
            tried.insert(name, mutant);
        }
    }
}

/// The first line that a diff adds, without the mark that cargo-mutants leaves in it.
fn changed_line(diff: &str) -> String {
    let mut added = diff
        .lines()
        .skip(2)
        .filter_map(|line| line.strip_prefix('+'));
    let line = added.next().unwrap_or_default();
    let line = line.replace("/* ~ changed by cargo-mutants ~ */", "");
    line.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A mutant's name, as cargo-mutants writes it.
struct Name<'a> {
    file: &'a str,
    /// Line and column, which other changes move.
    place: (usize, usize),
    change: &'a str,
}

impl<'a> Name<'a> {
    fn parse(name: &'a str) -> Option<Self> {
        let mut parts = name.splitn(4, ':');
        Some(Self {
            file: parts.next()?,
            place: (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?),
            change: parts.next()?,
        })
    }

    fn without_place(&self) -> String {
        format!("{}:{}", self.file, self.change)
    }
}

/// The names of mutants that differ in nothing but their place, in its order.
fn in_order(mutants: &BTreeMap<String, Mutant>) -> BTreeMap<(String, String), Vec<String>> {
    let mut alike: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for (full, mutant) in mutants {
        if let Some(name) = Name::parse(full) {
            let key = (name.without_place(), mutant.line.clone());
            alike
                .entry(key)
                .or_default()
                .push((name.place, full.clone()));
        }
    }
    let sorted = alike.into_iter().map(|(key, mut names)| {
        names.sort();
        (key, names.into_iter().map(|(_, name)| name).collect())
    });
    sorted.collect()
}

/// The mutants that may survive, and why.
#[derive(Deserialize)]
pub(super) struct Survivors {
    #[serde(default, rename = "survivor")]
    survivors: Vec<Survivor>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Survivor {
    /// As cargo-mutants calls it, without its place in the file.
    mutant: String,
    /// As in [`Mutant`].
    line: String,
    reason: String,
}

impl Survivors {
    pub(super) fn load(root: &Path) -> Result<Self> {
        let text = fs::read_to_string(root.join(SURVIVORS)).context(SURVIVORS)?;
        toml::from_str(&text).context(SURVIVORS)
    }

    /// Why `mutant` may survive, if somebody has said so.
    pub(super) fn reason(&self, name: &str, mutant: &Mutant) -> Option<&str> {
        let is = |survivor: &&Survivor| survivor.names(name, mutant);
        let survivor = self.survivors.iter().find(is)?;
        Some(&survivor.reason)
    }

    /// What survived without a reason; and if `all` mutants were tried, the reasons without a
    /// survivor.
    pub(super) fn faults(&self, tried: &BTreeMap<String, Mutant>, all: bool) -> Vec<String> {
        let mut faults = Vec::new();
        for (name, mutant) in tried {
            if mutant.survived() && self.reason(name, mutant).is_none() {
                let fate = format!("{:?}", mutant.fate).to_lowercase();
                faults.push(format!("{fate}, unexplained: {name}: {}", mutant.line));
            }
        }
        for survivor in &self.survivors {
            let named = tried
                .iter()
                .filter(|(name, mutant)| survivor.names(name, mutant));
            let survived: Vec<_> = named.map(|(_, mutant)| mutant.survived()).collect();
            // Another of the same name may have been noticed: one that is compiled otherwise.
            let fault = match survived.iter().filter(|survived| **survived).count() {
                0 if !survived.is_empty() => "survives no longer",
                0 if all => "exists no longer",
                0 | 1 => continue,
                _ => "is not one mutant",
            };
            faults.push(format!("{SURVIVORS}: {fault}: {}", survivor.mutant));
        }
        faults
    }
}

impl Survivor {
    fn names(&self, name: &str, mutant: &Mutant) -> bool {
        let name = Name::parse(name).map(|name| name.without_place());
        name.as_ref() == Some(&self.mutant) && mutant.line == self.line
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAME: &str = "core/src/a.rs: replace > with < in A::b";

    fn tried(fate: Fate) -> BTreeMap<String, Mutant> {
        let mutant = Mutant {
            package: "core".into(),
            line: "if a < b {".into(),
            fate,
        };
        [(
            "core/src/a.rs:7:11: replace > with < in A::b".into(),
            mutant,
        )]
        .into()
    }

    fn survivors(names: &[&str]) -> Survivors {
        let survivor = |name: &&str| Survivor {
            mutant: (*name).into(),
            line: "if a < b {".into(),
            reason: "both are the same".into(),
        };
        Survivors {
            survivors: names.iter().map(survivor).collect(),
        }
    }

    #[test]
    fn a_survivor_needs_a_reason_and_a_reason_a_survivor() {
        let faults = |names: &[&str], fate| survivors(names).faults(&tried(fate), true).len();
        assert_eq!(faults(&[], Fate::Killed), 0);
        assert_eq!(faults(&[], Fate::Unviable), 0);
        assert_eq!(faults(&[], Fate::Survived), 1);
        assert_eq!(faults(&[], Fate::Timeout), 0);
        assert_eq!(faults(&[NAME], Fate::Survived), 0);
        assert_eq!(faults(&[NAME], Fate::Killed), 1);
        assert_eq!(faults(&["another"], Fate::Killed), 1);
        let some = survivors(&["another"]).faults(&tried(Fate::Killed), false);
        assert!(some.is_empty(), "{some:?}");
    }

    #[test]
    fn a_survivor_is_found_again_where_it_has_moved_to() {
        let mutant = |fate| Mutant {
            package: "core".into(),
            line: "0".into(),
            fate,
        };
        let named = |name: &str| format!("core/src/a.rs:{name}: replace sum -> u32 with 0");
        let mut results = Results {
            date: String::new(),
            minutes: 0.0,
            cores: 2,
            jobs: 2,
            cargo_mutants: String::new(),
            rustc: String::new(),
            hashes: Hashes {
                code: String::new(),
                all: String::new(),
            },
            survivors_again: None,
            mutants: ["9:5", "10:5"]
                .map(|place| (named(place), mutant(Fate::Survived)))
                .into(),
        };
        let patterns = results.survivors();
        assert_eq!(
            patterns.into_iter().collect::<Vec<_>>(),
            [r"^core/src/a\.rs:\d+:\d+: replace sum \-> u32 with 0$"]
        );
        let first = (named("99:5"), mutant(Fate::Killed));
        let second = (named("100:5"), mutant(Fate::Survived));
        results.retry(&[first, second].into());
        assert_eq!(results.mutants[&named("9:5")].fate, Fate::Killed);
        assert_eq!(results.mutants[&named("10:5")].fate, Fate::Survived);
        // It cannot be told which of both this is.
        results.retry(&[(named("100:5"), mutant(Fate::Killed))].into());
        assert_eq!(results.mutants[&named("10:5")].fate, Fate::Survived);
    }

    #[test]
    fn the_changed_line_is_that_of_the_diff() {
        let diff = "--- a.rs\n+++ replace > with < in A::b\n@@ -1,3 +1,3 @@\n fn b() {\n\
                    -    if a > b {\n+    if a < /* ~ changed by cargo-mutants ~ */ b {\n";
        assert_eq!(changed_line(diff), "if a < b {");
        assert_eq!(changed_line("--- a.rs\n+++ delete\n-    A => 1,\n"), "");
    }

    #[test]
    fn the_score_leaves_out_what_does_not_compile() {
        let count = Count {
            killed: 19,
            survived: 1,
            unviable: 5,
            ..Count::default()
        };
        assert_eq!((count.all(), count.score()), (25, 95.0));
        assert_eq!(Count::default().score(), 0.0);
    }
}
