//! `cargo xtask proofs`: runs the harnesses and the mutants, and says so in verification.md.

mod census;
pub(crate) mod fingerprint;
mod kani;
mod mutants;
pub(crate) mod plan;
pub(crate) mod process;
pub(crate) mod results;
mod scan;
mod table;
pub(crate) mod workshop;

use std::{
    collections::BTreeSet,
    path::PathBuf,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;

use crate::{setup::root, workers};
use census::Project;
use process::Limits;
use results::{FullRun, Proof, Results, cores, today};
use scan::Harness;
use workshop::{Snapshot, Workshop};

/// Options of `cargo xtask proofs`.
#[derive(Args, Default)]
pub(crate) struct Options {
    /// Only the properties that are proved fast
    #[arg(long, conflicts_with = "only")]
    fast: bool,
    /// Only this property, for example V1; may be repeated
    #[arg(long, value_name = "ID")]
    only: Vec<String>,
    /// Only harnesses that are not verified, or mutants that are not noticed, yet on these sources
    #[arg(long)]
    stale: bool,
    /// Run nothing; fail if something is missing or verification.md does not say what the results say
    #[arg(long, conflicts_with_all = ["fast", "only", "stale", "mutants"])]
    check: bool,
    /// Run nothing; write the tables of verification.md
    #[arg(long, conflicts_with_all = ["fast", "only", "stale", "mutants", "check"])]
    table: bool,
    /// Break the code in known ways, which proofs and property tests must notice
    #[arg(long)]
    mutants: bool,
    /// Also with another version of Kani than the pinned one; the tables will not take the results
    #[arg(long)]
    any_kani: bool,
    /// Harnesses or mutants at a time
    #[arg(long, value_name = "N", default_value_t = 2)]
    jobs: usize,
}

/// Runs what the options say.
///
/// # Errors
/// If a proof does not hold, is missing or could not be run; which has been printed.
pub(crate) fn run(options: &Options) -> Result<()> {
    let root = root();
    if options.check || options.table {
        let project = Project::load(&root)?;
        let results = Results::load(&root)?;
        if options.table {
            return table::write(&root, &project, &results);
        }
        complete(&project.census(&root))?;
        return table::check(&root, &project, &results);
    }
    let run = Run::new(options, true)?;
    let census = run.project.census(&run.snapshot.tree());
    let outcome = if options.mutants {
        mutants::run(&run, options.stale)
    } else {
        run.all(options)
    };
    table::write(&root, &Project::load(&root)?, &Results::load(&root)?)?;
    match (complete(&census), outcome) {
        (Err(incomplete), Err(failed)) => bail!("{failed:#}\n{incomplete}"),
        (complete, outcome) => complete.and(outcome),
    }
}

/// The census of the properties, and whether the table says what the results say; runs nothing.
///
/// # Errors
/// As [`run`].
pub(crate) fn check() -> Result<()> {
    run(&Options {
        check: true,
        ..Options::default()
    })
}

/// The fast proofs, writing nothing; or why they were not run.
///
/// # Errors
/// As [`run`].
pub(crate) fn fast() -> Result<Option<String>> {
    let pinned = plan::Plan::load(&root())?.kani;
    match kani::installed() {
        None => Ok(Some(not_installed(&pinned))),
        Some(other) if other != pinned => Ok(Some(format!(
            "this is Kani {other}, the pinned one is {pinned}"
        ))),
        Some(_) => {
            let options = Options {
                fast: true,
                jobs: 2,
                ..Options::default()
            };
            Run::new(&options, false)?.all(&options)?;
            Ok(None)
        }
    }
}

/// One run of proofs or mutants, on a snapshot of the sources.
struct Run {
    root: PathBuf,
    project: Project,
    snapshot: Snapshot,
    /// The installed version, if there is one.
    kani: Option<String>,
    /// The properties that are asked for.
    ids: BTreeSet<String>,
    jobs: usize,
    /// Whether results are kept.
    keep: bool,
    /// Held while `proofs/results.json` is changed.
    results: Mutex<()>,
}

impl Run {
    fn new(options: &Options, keep: bool) -> Result<Self> {
        let root = root();
        let target = cargo_metadata::MetadataCommand::new()
            .manifest_path(root.join("Cargo.toml"))
            .no_deps()
            .exec()?
            .target_directory;
        let snapshot = Snapshot::take(&root, target.as_std_path())?;
        let project = Project::load(&snapshot.tree())?;
        let only: BTreeSet<_> = options.only.iter().map(|id| id.to_uppercase()).collect();
        for id in &only {
            let known = project.plan.property(id).is_some();
            ensure!(known, "{id} is no id of proofs/properties.toml");
        }
        let ids = project.plan.properties.iter();
        let ids = ids.filter(|property| property.fast || !options.fast);
        let ids = ids.map(|property| property.id.clone());
        let ids = ids.filter(|id| only.is_empty() || only.contains(id));
        let kani = kani::installed();
        if let Some(version) = kani
            .as_ref()
            .filter(|version| **version != project.plan.kani)
        {
            let pinned = &project.plan.kani;
            println!("this is Kani {version}, not the pinned {pinned}");
            ensure!(
                options.any_kani,
                "only with --any-kani: Kani is not {pinned}"
            );
        }
        Ok(Self {
            root,
            ids: ids.collect(),
            project,
            snapshot,
            kani,
            jobs: options.jobs.max(1),
            keep,
            results: Mutex::new(()),
        })
    }

    /// Whether the property `id` is asked for.
    fn wanted(&self, id: &str) -> bool {
        self.ids.contains(id)
    }

    fn limits(&self) -> Limits {
        Limits {
            time: Duration::from_secs(self.project.plan.timeout_minutes * 60),
            memory_mb: self.project.plan.memory_gb * 1000,
        }
    }

    /// Every harness that is asked for; all of them, if no option chooses.
    fn all(&self, options: &Options) -> Result<()> {
        ensure!(
            self.kani.is_some(),
            "the proofs were not run: {}",
            not_installed(&self.project.plan.kani)
        );
        let start = Instant::now();
        let all = !options.fast && options.only.is_empty();
        let full = all && !options.stale;
        let known = Results::load(&self.root)?;
        let harnesses = self.project.found.harnesses.iter();
        // A harness that belongs to nothing is run too when everything is.
        let verified = |harness: &Harness| {
            let proof = table::fresh(&self.project, &known, harness);
            proof.is_ok_and(|proof| proof.verdict == kani::Verdict::Verified)
        };
        let wanted = |h: &&Harness| {
            let chosen = all || h.id().is_some_and(|id| self.wanted(&id));
            chosen && !(options.stale && verified(h))
        };
        let harnesses: Vec<_> = harnesses.filter(wanted).collect();
        ensure!(!harnesses.is_empty(), "there is no harness to run");
        let listed = if full { self.listed() } else { Ok(()) };
        let proved = self.prove(harnesses);
        let seconds = start.elapsed().as_secs_f64();
        println!("{:.1} minutes in all", seconds / 60.0);
        if full {
            let (jobs, cores, date) = (self.jobs, cores(), today()?);
            self.record(|results| {
                results.full_run = Some(FullRun {
                    date,
                    seconds: results::tenths(seconds),
                    jobs,
                    cores,
                });
                let found = &self.project.found;
                results
                    .harnesses
                    .retain(|name, _| found.harness(name).is_some());
                let known = |name: &String| self.project.mutants.iter().any(|m| m.name == *name);
                results.mutants.retain(|name, _| known(name));
            })?;
        } else {
            self.record(|results| results.full_run = None)?;
        }
        let failed = Vec::from_iter(proved?).join(", ");
        ensure!(failed.is_empty(), "not proved: {failed}");
        listed
    }

    /// Kani sees the same harnesses as the sources show.
    fn listed(&self) -> Result<()> {
        let workshop = self.snapshot.workshop(0)?;
        let harnesses = &self.project.found.harnesses;
        let packages: BTreeSet<_> = harnesses.iter().map(|h| h.package.as_str()).collect();
        let unstable = &self.project.metadata.workspace_metadata["kani"]["unstable"];
        let unstable = unstable.as_object().into_iter().flatten();
        let unstable = unstable.filter(|(_, on)| **on == serde_json::Value::Bool(true));
        let unstable: Vec<_> = unstable.map(|(feature, _)| feature.clone()).collect();
        let (mut listed, mut found) = (BTreeSet::new(), BTreeSet::new());
        found.extend(harnesses.iter().map(|harness| harness.path.clone()));
        for package in self.project.metadata.workspace_packages() {
            let root = &self.project.metadata.workspace_root;
            let folder = package.manifest_path.strip_prefix(root)?.parent();
            let folder = workshop.tree.join(folder.context("no folder")?);
            if packages.contains(package.name.as_str()) {
                listed.extend(kani::list(&folder, &workshop.kani, &unstable)?);
            }
        }
        self.snapshot.restore(&workshop)?;
        let differ: Vec<_> = listed.symmetric_difference(&found).cloned().collect();
        let differ = differ.join(", ");
        ensure!(
            differ.is_empty(),
            "Kani sees other harnesses than the sources show: {differ}"
        );
        Ok(())
    }

    /// Runs `harnesses`, and says which of them are not verified.
    fn prove(&self, mut harnesses: Vec<&Harness>) -> Result<BTreeSet<String>> {
        let kani = self
            .kani
            .as_deref()
            .context("cargo kani is not installed")?;
        // The longest first, as far as is known, so that it does not run alone at the end.
        let known = Results::load(&self.root)?.harnesses;
        let seconds = |harness: &Harness| {
            let proof = known.get(harness.name());
            proof.map_or(f64::MAX, |proof| proof.seconds_in_all)
        };
        harnesses.sort_by(|a, b| seconds(b).total_cmp(&seconds(a)));
        let failed = Mutex::new(BTreeSet::new());
        self.in_parallel(harnesses, |workshop, harness| {
            let run = kani::run(&workshop.tree, &workshop.kani, harness, self.limits())?;
            let sources = self.project.sources(harness);
            let proof = Proof::new(run, kani, &harness.solver, sources)?;
            println!("{}: {}", harness.name(), one_line(&proof));
            if proof.verdict != kani::Verdict::Verified {
                lock(&failed).insert(harness.name().to_owned());
            }
            self.record(|results| {
                results.harnesses.insert(harness.name().to_owned(), proof);
            })
        })?;
        Ok(failed.into_inner().unwrap_or_else(PoisonError::into_inner))
    }

    /// Changes the results at once, so that what has been run is kept if the rest is not.
    fn record(&self, change: impl FnOnce(&mut Results)) -> Result<()> {
        if !self.keep {
            return Ok(());
        }
        let _held = lock(&self.results);
        let mut results = Results::load(&self.root)?;
        change(&mut results);
        results.save(&self.root)
    }

    /// Has workers, each with a copy of the sources, do `work` on `items` in order; all of them,
    /// also after an error.
    fn in_parallel<T: Send>(
        &self,
        items: Vec<T>,
        work: impl Fn(&Workshop, T) -> Result<()> + Sync,
    ) -> Result<()> {
        let place = |number| self.snapshot.workshop(number);
        workers::share(self.jobs, items, place, work)
    }
}

fn one_line(proof: &Proof) -> String {
    let verdict = format!("{:?}", proof.verdict).to_lowercase();
    let reason = proof.reason.as_ref().map(|reason| format!(": {reason}"));
    let memory = proof.memory_mb.map(|megabytes| format!(", {megabytes} MB"));
    format!(
        "{verdict}{}, {} checks, {}/{} covers, {:.1} s of {:.1} s in the solver{}",
        reason.unwrap_or_default(),
        proof.checks,
        proof.covers_satisfied,
        proof.covers,
        proof.seconds.unwrap_or_default(),
        proof.seconds_in_all,
        memory.unwrap_or_default(),
    )
}

fn complete(faults: &[String]) -> Result<()> {
    ensure!(faults.is_empty(), "incomplete:\n  {}", faults.join("\n  "));
    Ok(())
}

fn not_installed(version: &str) -> String {
    format!(
        "cargo kani is not installed \
         (cargo install --locked kani-verifier@{version} && cargo kani setup)"
    )
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
