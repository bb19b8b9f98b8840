//! Whether every claim has a harness, a property test and a mutant, and whatever is written has a claim.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use anyhow::{Context, Result};
use cargo_metadata::{Metadata, MetadataCommand};

use super::{
    fingerprint::{Depth, fingerprint, hash_of, of_harnesses},
    plan::{Canary, Mutant, Plan, Property, id_of},
    scan::{Found, Harness},
};

/// Developer tools: nothing is claimed about them.
const TOOLS: &str = "xtask";

/// What is claimed, and what there is to show it.
pub(crate) struct Project {
    pub(crate) plan: Plan,
    pub(crate) mutants: Vec<Mutant>,
    pub(crate) found: Found,
    pub(crate) metadata: Metadata,
    /// For each package with property tests: what they depend on.
    tests: BTreeMap<String, String>,
    /// The same for each package and module with harnesses.
    proofs: BTreeMap<(String, String), String>,
}

/// Property tests that one call of `cargo test` runs.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Twins<'a> {
    pub(crate) package: &'a str,
    /// The documentation tests of this file; without it, the tests that are functions.
    pub(crate) doctests: Option<&'a str>,
}

impl Project {
    /// Reads the project in `root`, sources and claims.
    ///
    /// # Errors
    /// If something cannot be read.
    pub(crate) fn load(root: &Path) -> Result<Self> {
        let metadata = MetadataCommand::new()
            .manifest_path(root.join("Cargo.toml"))
            .exec()
            .context("cargo metadata")?;
        let mut found = Found::default();
        for package in metadata.workspace_packages() {
            let folder = package.manifest_path.parent();
            let folder = folder.context("a manifest lies in a folder")?;
            if package.name.as_str() != TOOLS {
                found.scan(&package.name, folder.as_std_path())?;
            }
        }
        let mut tests = BTreeMap::new();
        for package in found.twins.iter().map(|twin| &twin.package) {
            if !tests.contains_key(package) {
                let print = fingerprint(&metadata, package, Depth::Tests)?;
                tests.insert(package.clone(), print);
            }
        }
        let mut proofs = BTreeMap::new();
        for (package, module) in found.harnesses.iter().map(place).collect::<BTreeSet<_>>() {
            let print = of_harnesses(&metadata, &package, &module)?;
            proofs.insert((package, module), print);
        }
        Ok(Self {
            plan: Plan::load(root)?,
            mutants: Mutant::load_all(root)?,
            found,
            metadata,
            tests,
            proofs,
        })
    }

    /// Hash of what a result of `harness` depends on.
    pub(crate) fn sources(&self, harness: &Harness) -> &str {
        self.proofs.get(&place(harness)).map_or("", String::as_str)
    }

    /// Hashes of what decides whether the harnesses, and whether the property tests, notice `mutant`.
    pub(crate) fn sources_of_mutant(&self, mutant: &Mutant) -> Result<[String; 2]> {
        let change = serde_json::to_string(mutant)?;
        let [mut harnesses, mut twins] = [change.clone(), change];
        let kills = mutant.kills.iter();
        let proving = kills.filter_map(|name| self.found.harness(name));
        let places: BTreeSet<_> = proving.map(place).collect();
        for proof in places.iter().filter_map(|place| self.proofs.get(place)) {
            harnesses += proof;
        }
        let mut packages = BTreeSet::new();
        let prefixes = mutant.twins();
        for found in prefixes.iter().flat_map(|prefix| self.twins(prefix)) {
            packages.insert(found.package);
            if let Some(file) = found.doctests {
                twins += &fs::read_to_string(self.metadata.workspace_root.join(file))?;
            }
        }
        for tests in packages.iter().filter_map(|&name| self.tests.get(name)) {
            twins += tests;
        }
        Ok([hash_of(&harnesses), hash_of(&twins)])
    }

    /// The property tests `prefix*`, by package: each to be run on its own.
    pub(crate) fn twins(&self, prefix: &str) -> BTreeSet<Twins<'_>> {
        let named = self.found.twins.iter();
        let named = named.filter(|twin| twin.name.starts_with(prefix));
        let named = named.map(|twin| Twins {
            package: &twin.package,
            doctests: None,
        });
        let documented = self.plan.doctests(prefix).and_then(|file| {
            let path = self.metadata.workspace_root.join(file);
            let mut packages = self.metadata.workspace_packages().into_iter();
            let owner = packages.find(|package| {
                let folder = package.manifest_path.parent();
                path.is_file() && folder.is_some_and(|folder| path.starts_with(folder))
            });
            owner.map(|package| Twins {
                package: package.name.as_str(),
                doctests: Some(file),
            })
        });
        named.chain(documented).collect()
    }

    /// Harnesses of the property `id`.
    pub(crate) fn harnesses_of(&self, id: &str) -> Vec<&Harness> {
        let all = self.found.harnesses.iter();
        all.filter(|harness| harness.id().as_deref() == Some(id))
            .collect()
    }

    /// Mutants that the property `id` must notice.
    pub(crate) fn mutants_of(&self, id: &str) -> Vec<&Mutant> {
        let all = self.mutants.iter();
        all.filter(|mutant| mutant.control.is_none() && mutant.ids().contains(id))
            .collect()
    }

    /// What is missing, or belongs to nothing; in plain words, one line each.
    pub(crate) fn census(&self, root: &Path) -> Vec<String> {
        let mut faults = self.found.faults.clone();
        let ids = self.plan.properties.iter().map(|p| p.id.as_str());
        faults.extend(repeated(ids).map(|id| format!("{id} is claimed twice")));
        let names = self.found.harnesses.iter().map(Harness::name);
        faults.extend(repeated(names).map(|name| format!("two harnesses are called {name}")));
        let names = self.mutants.iter().map(|mutant| mutant.name.as_str());
        faults.extend(repeated(names).map(|name| format!("two mutants are called {name}")));
        for harness in &self.found.harnesses {
            let claimed = harness
                .id()
                .is_some_and(|id| self.plan.property(&id).is_some());
            if !claimed {
                let path = &harness.path;
                faults.push(format!("{path} belongs to no id of proofs/properties.toml"));
            }
        }
        for property in &self.plan.properties {
            self.property(property, &mut faults);
        }
        for mutant in &self.mutants {
            self.mutant(mutant, root, &mut faults);
        }
        for (kind, name) in [(Canary::Survives, "survives"), (Canary::Dies, "dies")] {
            if !self
                .mutants
                .iter()
                .any(|mutant| mutant.control == Some(kind))
            {
                faults.push(format!("no control that {name}"));
            }
        }
        faults
    }

    fn property(&self, property: &Property, faults: &mut Vec<String>) {
        let id = &property.id;
        let mut fault = |text: &str| faults.push(format!("{id} {text}"));
        let prefix = id.to_lowercase() + "_";
        if id_of(&prefix).as_ref() != Some(id) {
            fault("is no id: letters, then digits");
        }
        let texts = [&property.statement, &property.section, &property.bound];
        if texts.iter().any(|text| text.trim().is_empty()) {
            fault("has no statement, section or bound");
        }
        let harnesses = self.harnesses_of(id);
        match &property.no_harness {
            None if harnesses.is_empty() => fault("has no harness"),
            Some(reason) if reason.trim().is_empty() => fault("has no harness, for no reason"),
            Some(_) if !harnesses.is_empty() => fault("has a harness, but says it can have none"),
            _ => {}
        }
        if property.models.is_empty() && harnesses.iter().any(|harness| harness.stubbed) {
            fault("names no model, but a harness of it has a stub");
        }
        if self.twins(&prefix).is_empty() {
            fault("has no property test");
        }
        let mutants = self.mutants_of(id);
        let kills = mutants.iter().flat_map(|mutant| &mutant.kills);
        let killed = kills.filter(|name| name.starts_with(&prefix)).count() > 0;
        if mutants.is_empty() || (!harnesses.is_empty() && !killed) {
            fault("has no mutant");
        }
    }

    fn mutant(&self, mutant: &Mutant, root: &Path, faults: &mut Vec<String>) {
        let name = &mutant.name;
        match fs::read_to_string(root.join(&mutant.file)) {
            Ok(text) => faults.extend(mutant.apply(&text).err()),
            Err(error) => faults.push(format!("mutant {name}: {}: {error}", mutant.file)),
        }
        if mutant.ids().is_empty() {
            faults.push(format!("mutant {name}: nothing is said to notice it"));
        }
        for harness in &mutant.kills {
            if self.found.harness(harness).is_none() {
                faults.push(format!("mutant {name}: there is no harness {harness}"));
            }
        }
        for prefix in mutant.twins() {
            if self.twins(&prefix).is_empty() {
                faults.push(format!(
                    "mutant {name}: there is no property test {prefix}*"
                ));
            }
        }
    }
}

/// What occurs more than once.
fn repeated<'a>(names: impl Iterator<Item = &'a str>) -> impl Iterator<Item = &'a str> {
    let mut seen = BTreeSet::new();
    names.filter(move |name| !seen.insert(*name))
}

/// The package and the module that `harness` is in.
fn place(harness: &Harness) -> (String, String) {
    let module = harness.path.split("::").next().unwrap_or_default();
    (harness.package.clone(), module.to_owned())
}
