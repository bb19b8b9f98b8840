//! `cargo xtask fuzz`: loops over `cargo fuzz`.

use std::{collections::BTreeMap, fs, path::Path, process::Command, sync::Mutex};

use anyhow::{Result, bail, ensure};
use clap::{Args, ValueEnum};
use regex::Regex;
use serde::{Deserialize, Serialize};
use xshell::{Shell, cmd};

use crate::{
    mutants::{Mutant, Outcome, each},
    setup::{root, target_dir},
    sources::{Sources, lock, share},
};

/// What is installed where there is no cargo-fuzz.
const CARGO_FUZZ: &str = "cargo-fuzz@0.13.2";
/// Folders of `fuzz/` with committed inputs, each with a folder for each target.
const INPUTS: [&str; 3] = ["corpus", "seeds", "found"];
/// No sanitizer: the cores forbid `unsafe`, it halves the speed, and needs a nightly compiler; ClusterFuzzLite runs
/// with it. No traces of comparisons, which halve the speed too: inputs and dictionary know what to compare with.
const FLAGS: [&str; 3] = ["--sanitizer=none", "--release", "--no-trace-compares"];
/// For the engine. The longest input has this many bytes, and may take this many seconds.
const ENGINE: &str = "-max_len=2000 -timeout=10 -dict=fuzz/mavlink.dict -print_final_stats=1";
/// Sources of the cores, and the least part of their lines that committed inputs must reach, in percent.
const CORES: [&str; 4] = ["mavlink/src", "commsec/src", "store/src", "relay/src"];
const COVERAGE: f64 = 90.0;

/// Options of `cargo xtask fuzz`.
#[derive(Args)]
pub(crate) struct Options {
    /// What to do
    command: Action,
    /// Only this target, with `mutants` only this mutant; may be repeated
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// How long a campaign takes
    #[arg(long, default_value_t = 60)]
    minutes: u64,
    /// Targets or mutants at a time
    #[arg(long, value_name = "N", default_value_t = 2)]
    jobs: usize,
}

#[derive(Clone, ValueEnum)]
enum Action {
    /// Every target for four seconds
    Smoke,
    /// All targets together for some minutes; new inputs go to target/fuzz/corpus
    Campaign,
    /// Which part of the cores' lines the committed inputs reach
    Coverage,
    /// Break the code in known ways: the targets named in proofs/mutants.toml must find each within a minute
    Mutants,
}

/// A target that was run.
#[derive(Serialize, Deserialize)]
pub(crate) struct Run {
    pub(crate) executions: u64,
    pub(crate) edges: u64,
    pub(crate) seconds: u64,
    /// What it failed on.
    pub(crate) finding: Option<String>,
}

/// Runs what the options say.
///
/// # Errors
/// If something is missing, a target fails, a mutant is not found, or too little is reached.
pub(crate) fn run(options: &Options) -> Result<()> {
    if let Some(missing) = missing()? {
        bail!(missing);
    }
    match options.command {
        Action::Smoke => all(&root().canonicalize()?, options, 4, None),
        Action::Coverage => coverage(&target_dir()?.join("fuzz/coverage"), &options.only),
        Action::Campaign => {
            let sources = Sources::now()?;
            let tree = sources.worktree(0)?;
            let targets = targets(&tree, &options.only)?.len();
            let seconds = options.minutes * 60 * options.jobs as u64 / targets as u64;
            all(&tree, options, seconds.max(1), Some(&sources))
        }
        Action::Mutants => {
            let sources = Sources::now()?;
            let mut mutants = Mutant::load(&sources.worktree(0)?, &options.only)?;
            // Where there is none, only the compiler notices.
            mutants.retain(|mutant| !mutant.fuzz.is_empty());
            each(
                &sources,
                "fuzz-mutants",
                mutants,
                options.jobs,
                |mutant, tree| {
                    let mut outcomes = BTreeMap::new();
                    for target in &mutant.fuzz {
                        let outcome = match one(tree, target, "mutants", 60)?.finding {
                            Some(_) => Outcome::Caught,
                            None => Outcome::Missed,
                        };
                        outcomes.insert(target.clone(), outcome);
                    }
                    Ok(outcomes)
                },
            )
        }
    }
}

/// For `cargo xtask test`: every target for some seconds, or why not.
///
/// # Errors
/// If a target fails.
pub(crate) fn smoke() -> Result<Option<String>> {
    let missing = missing()?;
    if missing.is_none() {
        let (command, only) = (Action::Smoke, Vec::new());
        run(&Options {
            command,
            only,
            minutes: 0,
            jobs: 2,
        })?;
    }
    Ok(missing)
}

/// What is missing and cannot be installed.
fn missing() -> Result<Option<String>> {
    let sh = Shell::new()?;
    let has = |program: &str| cmd!(sh, "{program} --version").quiet().read().is_ok();
    if !["c++", "g++", "clang++"].into_iter().any(has) {
        return Ok(Some("no C++ compiler: sudo apt-get install g++".to_owned()));
    }
    if !has("cargo-fuzz") {
        println!("cargo-fuzz is missing; installing it takes a minute");
        if cmd!(sh, "cargo install --locked {CARGO_FUZZ}")
            .run()
            .is_err()
        {
            return Ok(Some(format!(
                "no cargo-fuzz: cargo install --locked {CARGO_FUZZ}"
            )));
        }
    }
    Ok(None)
}

/// `cargo fuzz` in a copy of the sources, with these words.
fn cargo_fuzz(tree: &Path, words: &[&str]) -> Command {
    let mut cargo = Command::new("cargo");
    cargo.current_dir(tree).arg("fuzz").args(words);
    cargo
}

/// The targets, or those named in `only`.
fn targets(tree: &Path, only: &[String]) -> Result<Vec<String>> {
    let listed = String::from_utf8(cargo_fuzz(tree, &["list"]).output()?.stdout)?;
    let mut targets: Vec<_> = listed.lines().map(str::to_owned).collect();
    targets.retain(|target| only.is_empty() || only.contains(target));
    ensure!(!targets.is_empty(), "cargo fuzz list has no {only:?}");
    Ok(targets)
}

/// Adds the committed inputs of a target to a command.
fn add_inputs(cargo: &mut Command, tree: &Path, target: &str) {
    let folders = INPUTS.map(|folder| tree.join("fuzz").join(folder).join(target));
    cargo.args(folders.iter().filter(|folder| folder.is_dir()));
}

/// Builds all targets, runs each that is asked for, and keeps what comes out as results of `sources`.
fn all(tree: &Path, options: &Options, seconds: u64, sources: Option<&Sources>) -> Result<()> {
    let targets = targets(tree, &options.only)?;
    println!(
        "{} targets: building, then {seconds} s for each",
        targets.len()
    );
    let status = cargo_fuzz(tree, &["build"]).args(FLAGS).status()?;
    ensure!(status.success(), "the targets were not built");
    let failed = Mutex::new(Vec::new());
    share(options.jobs, targets, |_, target| {
        let run = one(tree, &target, "corpus", seconds)?;
        println!(
            "{target}: {} executions, {} edges",
            run.executions, run.edges
        );
        if let Some(sources) = sources {
            sources.record("campaign", &target, &run)?;
        }
        if let Some(finding) = run.finding {
            println!("{target} FAILED: {finding}");
            lock(&failed).push(target);
        }
        Ok(())
    })?;
    ensure!(
        lock(&failed).is_empty(),
        "found something: {:?}",
        lock(&failed)
    );
    Ok(())
}

/// Runs a target until it fails or the time is over; what is new to it goes to `target/fuzz/NEW`.
fn one(tree: &Path, target: &str, new: &str, seconds: u64) -> Result<Run> {
    let new = target_dir()?.join("fuzz").join(new).join(target);
    let artifacts = root().canonicalize()?.join("fuzz/artifacts").join(target);
    fs::create_dir_all(&new)?;
    fs::create_dir_all(&artifacts)?;
    let mut cargo = cargo_fuzz(tree, &["run"]);
    cargo.args(FLAGS).arg(target).arg(new);
    add_inputs(&mut cargo, tree, target);
    cargo.arg("--").args(ENGINE.split(' '));
    cargo.arg(format!("-max_total_time={seconds}"));
    cargo.arg(format!("-artifact_prefix={}/", artifacts.display()));
    let output = cargo.output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    let last = |pattern: &str| {
        let found = Regex::new(pattern)
            .expect("a pattern")
            .captures_iter(&said)
            .last();
        found.map(|found| found[1].to_owned())
    };
    let number = |pattern: &str| last(pattern).and_then(|n| n.parse().ok()).unwrap_or(0);
    let mut finding = last(r"panicked at (.*\n.*)").or_else(|| last("ERROR: libFuzzer: (.*)"));
    ensure!(
        output.status.success() || finding.is_some(),
        "{target}: {said}"
    );
    if output.status.success() {
        finding = None;
    } else if let Some(input) = last("Test unit written to (.*)") {
        println!("again: cargo fuzz run --sanitizer none {target} {input}");
    }
    Ok(Run {
        executions: number(r"stat::number_of_executed_units: (\d+)"),
        edges: number(r"cov: (\d+)"),
        seconds,
        finding,
    })
}

/// Runs targets over committed inputs, with counters in the code, and says which lines of the cores they reach.
fn coverage(folder: &Path, only: &[String]) -> Result<()> {
    let sh = Shell::new()?;
    let libraries = cmd!(sh, "rustc --print target-libdir").quiet().read()?;
    let tools = Path::new(&libraries).with_file_name("bin");
    let (profdata, cov) = (tools.join("llvm-profdata"), tools.join("llvm-cov"));
    ensure!(
        cov.is_file(),
        "no llvm-cov: rustup component add llvm-tools"
    );
    let root = root().canonicalize()?;
    let (mut objects, mut profiles) = (Vec::new(), Vec::new());
    for target in targets(&root, only)? {
        println!("{target}");
        let mut cargo = cargo_fuzz(&root, &["coverage", FLAGS[0], "--target-dir"]);
        add_inputs(cargo.arg(folder).arg(&target), &root, &target);
        let output = cargo.output()?;
        ensure!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let host = tools.with_file_name("");
        let host = folder.join(host.file_name().unwrap_or_default());
        objects.extend(["-object".into(), host.join("release").join(&target)]);
        profiles.push(
            root.join("fuzz/coverage")
                .join(target)
                .join("coverage.profdata"),
        );
    }
    let all = folder.join("all.profdata");
    cmd!(sh, "{profdata} merge -sparse {profiles...} -o {all}")
        .quiet()
        .run()?;
    let cores = CORES.map(|core| root.join(core));
    let report = cmd!(
        sh,
        "{cov} report -instr-profile {all} {objects...} {cores...}"
    );
    let report = report.quiet().read()?;
    println!("{report}");
    // The last line: TOTAL, then for regions, functions and lines: all, missed, percent.
    let percent = report
        .lines()
        .last()
        .and_then(|total| total.split_whitespace().nth(9));
    let percent = percent.and_then(|lines| lines.trim_end_matches('%').parse().ok());
    ensure!(
        percent >= Some(COVERAGE),
        "fewer lines than {COVERAGE} % are reached"
    );
    Ok(())
}
