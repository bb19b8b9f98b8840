//! `proofs/mutants.toml`: broken code that proofs, property tests and fuzz targets must notice.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};

use crate::{
    proofs::id_of,
    sources::{Sources, share, text},
};

/// A change that breaks the code.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Mutant {
    pub(crate) name: String,
    /// What is broken, in plain words.
    #[serde(rename = "breaks")]
    _breaks: String,
    /// Path in the project.
    file: String,
    /// Occurs exactly once in the file.
    find: String,
    replace: String,
    /// Harnesses that must fail.
    #[serde(default)]
    pub(crate) kills: Vec<String>,
    /// Property tests that must fail, by the beginning of their names, or documentation tests, by their file.
    /// Without it, `v1_` for a harness `v1_*`.
    #[serde(default)]
    tests: Vec<String>,
    /// Fuzz targets that must fail. None where only the compiler can notice, or none has been looked for yet.
    #[serde(default)]
    pub(crate) fuzz: Vec<String>,
    /// Not a mutant, but a check of the checks.
    #[serde(default)]
    control: Option<Outcome>,
}

/// What became of a mutant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Outcome {
    Caught,
    Missed,
    KaniNotRun,
    /// It does not compile, takes too long, or Kani does not get to its end.
    Error(String),
}

impl Mutant {
    /// All of `proofs/mutants.toml`, or those named in `only` and the controls.
    ///
    /// # Errors
    /// If there are none of such a name.
    pub(crate) fn load(tree: &Path, only: &[String]) -> Result<Vec<Self>> {
        #[derive(Deserialize)]
        struct File {
            mutant: Vec<Mutant>,
        }
        let File { mutant: mut all } = toml::from_str(&text(tree, "proofs/mutants.toml")?)?;
        for name in only {
            let known = all.iter().any(|mutant| mutant.name == *name);
            ensure!(known, "proofs/mutants.toml has no mutant {name}");
        }
        all.retain(|m| only.is_empty() || only.contains(&m.name) || m.control.is_some());
        Ok(all)
    }

    /// The beginnings of the names of the property tests that must fail.
    pub(crate) fn tests(&self) -> BTreeSet<String> {
        let ids = self.kills.iter().map(|name| id_of(name));
        match &self.tests[..] {
            [] => ids.map(|id| id.to_lowercase() + "_").collect(),
            tests => tests.iter().cloned().collect(),
        }
    }

    /// The file `before`, broken.
    fn apply(&self, before: &str) -> Result<String> {
        let Self { name, file, .. } = self;
        ensure!(self.find != self.replace, "mutant {name} changes nothing");
        match before.matches(&self.find).count() {
            1 => Ok(before.replacen(&self.find, &self.replace, 1)),
            n => bail!("mutant {name}: its text occurs {n} times in {file}, not once"),
        }
    }
}

/// Applies one of `mutants` after the other to a copy of the sources, has `attempt` look at it there, and keeps
/// the outcomes as `results`. The controls come first: where one is not as it must be, nothing else counts.
///
/// # Errors
/// If one was not caught by all that should; which has been printed.
pub(crate) fn each(
    sources: &Sources,
    results: &str,
    mutants: Vec<Mutant>,
    jobs: usize,
    attempt: impl Fn(&Mutant, &Path) -> Result<BTreeMap<String, Outcome>> + Sync,
) -> Result<()> {
    let one = |worker, mutant: Mutant| {
        let tree = sources.worktree(worker)?;
        let path = tree.join(&mutant.file);
        let before = text(&tree, &mutant.file)?;
        fs::write(&path, mutant.apply(&before)?)?;
        let outcomes = attempt(&mutant, &tree);
        fs::write(&path, before)?;
        let outcomes = outcomes.with_context(|| mutant.name.clone())?;
        println!("{}: {outcomes:?}", mutant.name);
        sources.record(results, &mutant.name, &outcomes)?;
        let expected = mutant.control.as_ref().unwrap_or(&Outcome::Caught);
        let as_expected = |what: &Outcome| what == expected || *what == Outcome::KaniNotRun;
        let right = !outcomes.is_empty() && outcomes.values().all(as_expected);
        Ok((!right).then_some(mutant.name))
    };
    let (controls, mutants) = mutants.into_iter().partition(|it| it.control.is_some());
    for (mutants, fault) in [
        (controls, "the run is void, these controls are wrong"),
        (mutants, "not caught by all that should"),
    ] {
        let wrong = share(jobs, mutants, one)?;
        let wrong: BTreeSet<_> = wrong.into_iter().flatten().collect();
        ensure!(wrong.is_empty(), "{fault}: {wrong:?}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use regex::Regex;

    use super::*;
    use crate::{proofs::ids, setup::root};

    fn mutants() -> Vec<Mutant> {
        Mutant::load(&root(), &[]).expect("mutants.toml")
    }

    /// All sources of the properties, one after the other.
    fn proofs() -> String {
        fn texts(path: &Path) -> String {
            let Ok(folder) = fs::read_dir(path) else {
                return fs::read_to_string(path).expect("text");
            };
            folder
                .map(|it| texts(&it.expect("a file").path()))
                .collect()
        }
        texts(&root().join("proofs/src"))
    }

    /// The names of the functions behind `#[ATTRIBUTE]`.
    fn functions(attribute: &str, text: &str) -> BTreeSet<String> {
        let function = format!(r"#\[{attribute}\]\s*(?:#\[[^\]]*\]\s*)*fn (\w+)");
        let function = Regex::new(&function).expect("a pattern");
        function
            .captures_iter(text)
            .map(|function| function[1].to_owned())
            .collect()
    }

    #[test]
    fn each_property_has_a_harness_a_test_and_a_mutant() {
        let (mutants, text) = (mutants(), proofs());
        let tests = functions("test", &text);
        for id in ids(&root()).expect("verification.md") {
            let begins = |name: &String| id_of(name) == id;
            assert!(tests.iter().any(begins), "{id} has no property test");
            // Each name in `kills` is one of the sources: see below.
            let mut kills = mutants
                .iter()
                .filter(|m| m.control.is_none())
                .flat_map(|m| &m.kills);
            assert!(kills.any(begins), "{id} has no harness that kills a mutant");
        }
    }

    #[test]
    fn each_harness_belongs_to_a_property() {
        let ids = ids(&root()).expect("verification.md");
        for name in functions("kani::proof", &proofs()) {
            assert!(
                ids.contains(&id_of(&name)),
                "{name} belongs to no property of verification.md"
            );
        }
    }

    #[test]
    fn each_mutant_applies_and_names_who_notices() {
        let text = proofs();
        let tests = functions("test", &text);
        let targets = root().join("fuzz/fuzz_targets");
        let mut names = BTreeSet::new();
        for mutant in mutants() {
            let name = &mutant.name;
            assert!(names.insert(name.clone()), "{name} is there twice");
            let before = fs::read_to_string(root().join(&mutant.file)).expect(name);
            mutant.apply(&before).expect(name);
            for kill in &mutant.kills {
                let word = Regex::new(&format!(r"\b{kill}\b")).expect("a pattern");
                assert!(word.is_match(&text), "{name}: there is no harness {kill}");
            }
            for test in mutant.tests() {
                let found = tests.iter().any(|name| name.starts_with(&test));
                let found = found || test.ends_with(".rs") && root().join(&test).is_file();
                assert!(found, "{name}: there is no test {test}");
            }
            assert!(!mutant.tests().is_empty(), "{name}: nothing notices it");
            for target in &mutant.fuzz {
                let found = targets.join(target).with_extension("rs").is_file();
                assert!(found, "{name}: there is no fuzz target {target}");
            }
        }
    }

    #[test]
    fn there_are_controls_of_both_kinds() {
        let controls: Vec<_> = mutants().into_iter().filter_map(|m| m.control).collect();
        assert!(controls.contains(&Outcome::Caught) && controls.contains(&Outcome::Missed));
    }

    #[test]
    fn functions_by_attribute() {
        let text = "#[test]\n#[x(y)]\nfn v1_a() {}\n#[kani::proof]\nfn v1_b() {}\nfn v1_c() {}";
        assert_eq!(Vec::from_iter(functions("test", text)), ["v1_a"]);
        assert_eq!(Vec::from_iter(functions("kani::proof", text)), ["v1_b"]);
    }

    #[test]
    fn a_mutant_fits_exactly_once() {
        let mutant = |find: &str| -> Mutant {
            let kills = "kills = ['v1_a', 'r1_b', 'v1_c']";
            let text =
                format!("name='m'\nbreaks='x'\nfile='f'\nfind='{find}'\nreplace='<'\n{kills}");
            toml::from_str(&text).expect("a mutant")
        };
        assert_eq!(mutant("<=").apply("a <= b").expect("once"), "a < b");
        for (find, before) in [("<=", "a <= b <= c"), ("<=", "a == b"), ("<", "a < b")] {
            assert!(mutant(find).apply(before).is_err(), "{before}");
        }
        assert_eq!(Vec::from_iter(mutant("<=").tests()), ["r1_", "v1_"]);
    }
}
