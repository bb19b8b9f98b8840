//! `cargo xtask fuzz mutants`: a target must find each mutant of `proofs/mutants.toml`.

use std::{
    fs,
    sync::{Mutex, PoisonError},
    time::Duration,
};

use anyhow::{Context, Result, bail, ensure};

use super::{
    Fuzzer,
    engine::{Engine, Session},
    plan::{self, Target},
    results::{Fate, Mutants, Results, Run},
    table,
};
use crate::{
    proofs::{
        plan::{Canary, Mutant},
        results::tenths,
        workshop::{Snapshot, Workshop},
    },
    workers,
};

/// How long targets may look for one mutant, all together.
const TIME: Duration = Duration::from_secs(60);

/// Puts back every mutant in a copy of the sources; with `only`, those.
///
/// # Errors
/// If one is not found, or something is found where nothing is broken.
pub(super) fn mutants(fuzzer: &Fuzzer, only: &[String], jobs: usize) -> Result<()> {
    let mut mutants = Mutant::load_all(&fuzzer.root)?;
    for name in only {
        let known = mutants.iter().any(|mutant| mutant.name == *name);
        ensure!(known, "{name} is no mutant of proofs/mutants.toml");
    }
    mutants.retain(|mutant| only.is_empty() || only.contains(&mutant.name));
    let exempt = plan::exempt(&fuzzer.root)?;
    for name in exempt.keys().filter(|_| only.is_empty()) {
        let known = mutants.iter().any(|mutant| mutant.name == *name);
        ensure!(
            known,
            "{name} is exempt, and no mutant of proofs/mutants.toml"
        );
    }

    let snapshot = Snapshot::take(&fuzzer.root, &fuzzer.target_dir)?;
    let trials = Trials {
        fuzzer,
        snapshot: &snapshot,
    };
    trials.baseline()?;
    let mut fates = Mutants::default();
    let mut faults = Vec::new();
    let todo = mutants
        .iter()
        .filter(|mutant| !exempt.contains_key(&mutant.name));
    for (mutant, fate) in trials.in_parallel(todo.collect(), jobs)? {
        let found = matches!(fate, Fate::Found { .. });
        if found == (mutant.control == Some(Canary::Survives)) {
            faults.push(mutant.name.as_str());
        }
        if mutant.control.is_none() {
            fates.mutants.insert(mutant.name.clone(), fate);
        }
    }
    let known = |name: &String| mutants.iter().any(|mutant| mutant.name == *name);
    let exempt = exempt.into_iter().filter(|(name, _)| known(name));
    fates
        .mutants
        .extend(exempt.map(|(name, reason)| (name, Fate::Exempt(reason))));
    if only.is_empty() {
        let run = Run::new(&fuzzer.root, fuzzer.cargo_fuzz.rustc()?, fates)?;
        Results::change(&fuzzer.root, |results| results.mutants = Some(run))?;
        table::write(&fuzzer.root)?;
    }
    ensure!(
        faults.is_empty(),
        "not as it must be: {}",
        faults.join(", ")
    );
    Ok(())
}

struct Trials<'a> {
    fuzzer: &'a Fuzzer,
    snapshot: &'a Snapshot,
}

impl Trials<'_> {
    /// No seed finds anything in the code as it is.
    fn baseline(&self) -> Result<()> {
        let targets: Vec<_> = self.fuzzer.targets.iter().collect();
        let found = self.look(&self.fuzzer.engine, &targets, "baseline", Duration::ZERO)?;
        if let Some((target, _)) = found {
            bail!("the run is void: {target} fails without mutant");
        }
        Ok(())
    }

    /// Has workers, each with a copy of the sources, try `mutants`.
    fn in_parallel<'m>(
        &self,
        mutants: Vec<&'m Mutant>,
        jobs: usize,
    ) -> Result<Vec<(&'m Mutant, Fate)>> {
        let fates = Mutex::new(Vec::new());
        let place = |number| self.snapshot.workshop(number);
        workers::share(jobs, mutants, place, |workshop, mutant| {
            let fate = self.attempt(workshop, mutant)?;
            println!("{}: {}", mutant.name, said(&fate));
            let mut fates = fates.lock().unwrap_or_else(PoisonError::into_inner);
            fates.push((mutant, fate));
            Ok(())
        })?;
        Ok(fates.into_inner().unwrap_or_else(PoisonError::into_inner))
    }

    /// Looks for one mutant with the targets of the properties that it breaks: their seeds first.
    fn attempt(&self, workshop: &Workshop, mutant: &Mutant) -> Result<Fate> {
        self.snapshot.restore(workshop)?;
        let path = workshop.tree.join(&mutant.file);
        let before = fs::read_to_string(&path).with_context(|| mutant.file.clone())?;
        fs::write(&path, mutant.apply(&before).map_err(anyhow::Error::msg)?)?;
        let engine = Engine::new(&self.fuzzer.cargo_fuzz, &workshop.tree, &workshop.test);

        let ids = mutant.ids();
        let concerns = |target: &&Target| target.properties.iter().any(|id| ids.contains(id));
        let targets: Vec<_> = self.fuzzer.targets.iter().filter(concerns).collect();
        ensure!(!targets.is_empty(), "no target is about {ids:?}");
        let mut found = self.look(&engine, &targets, &mutant.name, Duration::ZERO)?;
        if found.is_none() {
            let share = TIME / targets.len() as u32;
            found = self.look(&engine, &targets, &mutant.name, share)?;
        }
        Ok(
            found.map_or(Fate::Survived, |(target, seconds)| Fate::Found {
                target,
                seconds,
            }),
        )
    }

    /// Builds one of `targets` after the other; the first that fails when each has `time`, and after how long;
    /// without time, each looks at its seeds.
    fn look(
        &self,
        engine: &Engine,
        targets: &[&Target],
        mutant: &str,
        time: Duration,
    ) -> Result<Option<(String, f64)>> {
        let scratch = self.fuzzer.target_dir.join("mutants").join(mutant);
        if scratch.is_dir() {
            fs::remove_dir_all(&scratch)?;
        }
        let mut seconds = 0.0;
        for target in targets {
            let built = engine.build(Some(&target.name));
            built.with_context(|| mutant.to_owned())?;
            let mut corpus = vec![scratch.join(&target.name)];
            corpus.extend(engine.seeds(target));
            let session = Session {
                corpus,
                time,
                options: vec![],
            };
            let ended = engine.run(&target.name, target.max_len, &session, |_| {})?;
            seconds += ended.seconds;
            if ended.finding.is_some() {
                return Ok(Some((target.name.clone(), tenths(seconds))));
            }
        }
        Ok(None)
    }
}

fn said(fate: &Fate) -> String {
    match fate {
        Fate::Found { target, seconds } => format!("found by {target} after {seconds:.1} s"),
        Fate::Survived => "NOT FOUND".to_owned(),
        Fate::Exempt(reason) => reason.clone(),
    }
}
