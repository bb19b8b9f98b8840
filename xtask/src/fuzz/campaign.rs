//! `cargo xtask fuzz campaign` and `smoke`: every target for a time, over the cores.

use std::{
    collections::BTreeMap,
    fs,
    io::{IsTerminal, Write, stderr},
    path::PathBuf,
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    thread,
    time::{Duration, Instant},
};

use anyhow::{Result, ensure};
use comfy_table::{Table, presets};

use super::{
    Fuzzer,
    engine::{Ended, Session, Status},
    plan::Target,
    results::{Campaign, Fuzzed, Results, Run},
    table::grouped,
};
use crate::{proofs::results::tenths, workers};

/// What a smoke test gives each target.
const SMOKE: Duration = Duration::from_secs(4);

/// Fuzzes every target, all together for `minutes`, and keeps what came out of all of them.
///
/// # Errors
/// If a target fails on an input; which, and how to see it again, has been printed.
pub(super) fn campaign(fuzzer: &Fuzzer, minutes: f64, jobs: usize) -> Result<()> {
    ensure!(minutes > 0.0, "a campaign takes time");
    let share = minutes * 60.0 / fuzzer.targets.len() as f64;
    let corpus = fuzzer.root.join("fuzz/corpus");
    let targets = Rounds {
        fuzzer,
        corpus,
        share: Duration::from_secs_f64(share.max(1.0)),
        jobs,
    }
    .run()?;
    print(fuzzer, &targets);
    let found = failed(&targets);
    if fuzzer.all {
        let outcome = Campaign {
            minutes,
            jobs,
            targets,
        };
        let run = Run::new(&fuzzer.root, fuzzer.cargo_fuzz.rustc()?, outcome)?;
        Results::change(&fuzzer.root, |results| results.campaign = Some(run))?;
        super::table::write(&fuzzer.root)?;
    }
    ensure!(found.is_empty(), "found something: {found}");
    Ok(())
}

/// Fuzzes every target for some seconds, from its seeds, and keeps nothing.
///
/// # Errors
/// As [`campaign`].
pub(super) fn smoke(fuzzer: &Fuzzer, jobs: usize) -> Result<()> {
    let corpus = fuzzer.target_dir.join("smoke");
    if corpus.is_dir() {
        fs::remove_dir_all(&corpus)?;
    }
    let targets = Rounds {
        fuzzer,
        corpus,
        share: SMOKE / jobs as u32,
        jobs,
    }
    .run()?;
    print(fuzzer, &targets);
    let found = failed(&targets);
    ensure!(found.is_empty(), "found something: {found}");
    Ok(())
}

/// The targets that failed on something.
fn failed(targets: &BTreeMap<String, Fuzzed>) -> String {
    let failed = targets
        .iter()
        .filter(|(_, fuzzed)| !fuzzed.findings.is_empty());
    let failed: Vec<_> = failed.map(|(name, _)| name.as_str()).collect();
    failed.join(", ")
}

/// Every worker goes round all targets, each from another place on, so that all of them end together
/// and no two are with one target for long. What one finds, the next begins with.
struct Rounds<'a> {
    fuzzer: &'a Fuzzer,
    corpus: PathBuf,
    /// What each worker gives each target.
    share: Duration,
    jobs: usize,
}

impl Rounds<'_> {
    fn run(&self) -> Result<BTreeMap<String, Fuzzed>> {
        let progress = Progress::new(self.share * self.fuzzer.targets.len() as u32);
        let targets = &self.fuzzer.targets;
        let worker = |number| {
            let first = number * targets.len() / self.jobs;
            for target in targets.iter().cycle().skip(first).take(targets.len()) {
                if !progress.has_failed(&target.name) {
                    self.session(target, number, &progress)?;
                }
            }
            Ok(())
        };
        thread::scope(|scope| {
            let ticker = scope.spawn(|| progress.show());
            let outcome = workers::run(self.jobs, worker);
            progress.done.store(true, Relaxed);
            ticker.thread().unpark();
            outcome
        })?;
        Ok(progress.into_targets())
    }

    fn session(&self, target: &Target, number: usize, progress: &Progress) -> Result<()> {
        let engine = &self.fuzzer.engine;
        let mut corpus = vec![self.corpus.join(&target.name)];
        corpus.extend(engine.seeds(target));
        let session = Session {
            corpus,
            time: self.share,
            options: vec![],
        };
        let ended = engine.run(&target.name, target.max_len, &session, |status| {
            progress.running(number, status);
        })?;
        let mut finding = None;
        if let Some(found) = &ended.finding {
            finding = Some(found.said.clone());
            progress.say(&format!("{} FAILED: {}", target.name, found.said));
            if let Some(input) = &found.input {
                let smaller = engine.minimise(&target.name, input)?;
                progress.say(&engine.reproduction(&target.name, &smaller));
            }
        }
        progress.ended(number, &target.name, &ended, finding);
        Ok(())
    }
}

/// What all workers have done so far.
struct Progress {
    start: Instant,
    time: Duration,
    done: AtomicBool,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    targets: BTreeMap<String, Fuzzed>,
    running: BTreeMap<usize, Status>,
}

impl Progress {
    fn new(time: Duration) -> Self {
        Self {
            start: Instant::now(),
            time,
            done: AtomicBool::new(false),
            state: Mutex::default(),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn running(&self, worker: usize, status: Status) {
        self.state().running.insert(worker, status);
    }

    fn ended(&self, worker: usize, target: &str, ended: &Ended, finding: Option<String>) {
        let mut state = self.state();
        state.running.remove(&worker);
        let fuzzed = state.targets.entry(target.to_owned()).or_default();
        fuzzed.executions += ended.status.executions;
        fuzzed.seconds = tenths(fuzzed.seconds + ended.seconds);
        fuzzed.edges = fuzzed.edges.max(ended.status.edges);
        fuzzed.features = fuzzed.features.max(ended.status.features);
        fuzzed.findings.extend(finding);
    }

    /// A target that fails on one input fails on it again at once: nothing is left to find with it.
    fn has_failed(&self, target: &str) -> bool {
        let state = self.state();
        let fuzzed = state.targets.get(target);
        fuzzed.is_some_and(|fuzzed| !fuzzed.findings.is_empty())
    }

    fn into_targets(self) -> BTreeMap<String, Fuzzed> {
        self.state
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner)
            .targets
    }

    /// A line of its own, above the line of progress.
    fn say(&self, line: &str) {
        let clear = if stderr().is_terminal() {
            "\r\x1b[K"
        } else {
            ""
        };
        eprintln!("{clear}{line}");
    }

    /// Shows a line of progress until all is done: one that changes, or one a minute in a log.
    fn show(&self) {
        let terminal = stderr().is_terminal();
        let period = Duration::from_secs(if terminal { 1 } else { 60 });
        while !self.done.load(Relaxed) {
            thread::park_timeout(period);
            let line = self.line();
            if terminal {
                eprint!("\r\x1b[K{line}");
                // Progress that is not seen is no reason to stop.
                let _ = stderr().flush();
            } else {
                eprintln!("{line}");
            }
        }
        if terminal {
            eprintln!();
        }
    }

    fn line(&self) -> String {
        let state = self.state();
        let ended = state.targets.values().map(|fuzzed| fuzzed.executions);
        let running = state.running.values().map(|status| status.executions);
        let executions = grouped(ended.chain(running).sum());
        let edges: u64 = state.targets.values().map(|fuzzed| fuzzed.edges).sum();
        let findings: usize = state
            .targets
            .values()
            .map(|fuzzed| fuzzed.findings.len())
            .sum();
        let (at, end) = (self.start.elapsed().as_secs(), self.time.as_secs());
        format!("{at} of {end} s, {executions} executions, {edges} edges, {findings} findings")
    }
}

/// Prints what came out.
fn print(fuzzer: &Fuzzer, targets: &BTreeMap<String, Fuzzed>) {
    let mut table = Table::new();
    table.load_preset(presets::NOTHING);
    table.set_header([
        "target",
        "executions",
        "time",
        "edges",
        "features",
        "findings",
    ]);
    for Target { name, .. } in &fuzzer.targets {
        let Some(fuzzed) = targets.get(name) else {
            continue;
        };
        table.add_row([
            name.clone(),
            grouped(fuzzed.executions),
            format!("{:.0} s", fuzzed.seconds),
            fuzzed.edges.to_string(),
            fuzzed.features.to_string(),
            fuzzed.findings.len().to_string(),
        ]);
    }
    println!("{table}");
}
