//! `cargo xtask fuzz`: loops over `cargo fuzz`.

use std::{collections::BTreeMap, fs, path::Path, process::Command};

use anyhow::{Result, ensure};
use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};

use crate::{
    mutants::{Mutant, Outcome, each},
    setup::{root, target_dir},
    sources::{Sources, find, find_all, share},
    test::{NOT_RUN, not_run},
};

/// No sanitizer: the cores forbid `unsafe`, it halves the speed, and needs a nightly compiler; ClusterFuzzLite runs
/// with it. No traces of comparisons, which halve the speed too: inputs and dictionary know what to compare with.
const FLAGS: &str = "--sanitizer=none --release --no-trace-compares";
/// For the engine. The longest input has this many bytes, and may take this many seconds.
const ENGINE: &str = "-max_len=2000 -timeout=10 -dict=fuzz/mavlink.dict -print_final_stats=1";
/// Gets what is needed, where there is none. `cargo fuzz` knows no `--locked`: where Cargo.lock does not fit, this fails.
const NEEDS: &str = r#"
cargo tree --locked --manifest-path fuzz/Cargo.toml > /dev/null
c++ --version > /dev/null || { echo 'no C++ compiler: sudo apt-get install g++'; exit 77; }
install='cargo install --locked cargo-fuzz@0.13.2'
cargo-fuzz --version > /dev/null || { echo "$install takes a minute"; $install; } || exit 77
"#;
/// Runs $TARGETS over committed inputs, with counters in the code; nine tenths of the cores' lines must be reached.
/// The programs that read the counters come with the compiler.
const COVERAGE: &str = r#"
libraries=$(dirname $(rustc --print target-libdir))
ls $libraries/bin/llvm-cov > /dev/null || rustup component add llvm-tools || exit 77
mkdir -p target/coverage
for target in $TARGETS; do
    echo $target
    cargo fuzz coverage --sanitizer none --target-dir $PWD/target/coverage $target > target/coverage.log 2>&1
    profiles="$profiles fuzz/coverage/$target/coverage.profdata"
    objects="$objects -object target/coverage/$(basename $libraries)/release/$target"
done
$libraries/bin/llvm-profdata merge -sparse $profiles -o target/coverage/profdata
cores='mavlink/src commsec/src store/src relay/src'
$libraries/bin/llvm-cov report -instr-profile target/coverage/profdata $objects -sources $cores > target/coverage.txt
awk '{ print } /^TOTAL/ { lines = $10 } END { print lines " of the lines; 90% are wanted"; exit lines + 0 < 90 }' target/coverage.txt
"#;

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
    /// What it failed on; empty if on nothing.
    pub(crate) finding: String,
}

/// Runs what the options say.
///
/// # Errors
/// If something is missing, a target fails, or a mutant is not found.
pub(crate) fn run(options: &Options) -> Result<()> {
    shell(NEEDS, "")?;
    let (only, jobs) = (&options.only, options.jobs);
    match options.command {
        Action::Smoke => all(&root().canonicalize()?, options, 4, None),
        Action::Coverage => shell(COVERAGE, &targets(&root(), only)?.join(" ")),
        Action::Campaign => {
            let sources = Sources::now()?;
            let tree = sources.worktree(0)?;
            let of = targets(&tree, only)?.len() as u64;
            let seconds = options.minutes * 60 * jobs as u64 / of;
            all(&tree, options, seconds.max(1), Some(&sources))
        }
        Action::Mutants => {
            let sources = Sources::now()?;
            let mut mutants = Mutant::load(&sources.worktree(0)?, only)?;
            // Where there is none, only the compiler notices.
            mutants.retain(|mutant| !mutant.fuzz.is_empty());
            let attempt = |mutant: &Mutant, tree: &Path| {
                let mut outcomes = BTreeMap::new();
                for target in &mutant.fuzz {
                    let found = !one(tree, target, "mutants", 60)?.finding.is_empty();
                    let outcome = [Outcome::Missed, Outcome::Caught][usize::from(found)].clone();
                    outcomes.insert(target.clone(), outcome);
                }
                Ok(outcomes)
            };
            each(&sources, "fuzz-mutants", mutants, jobs, attempt)
        }
    }
}

/// Runs a script in the project's folder, with `targets` as $TARGETS.
fn shell(script: &str, targets: &str) -> Result<()> {
    let mut shell = Command::new("sh");
    shell.current_dir(root()).args(["-ec", script]);
    let status = shell.env("TARGETS", targets).status()?;
    if status.code() == Some(NOT_RUN) {
        not_run("something is missing, see above");
    }
    ensure!(
        status.success(),
        "{status}; builds are told of in target/coverage.log"
    );
    Ok(())
}

/// `cargo fuzz` in a copy of the sources, with these words.
fn cargo_fuzz(tree: &Path, words: &str) -> Command {
    let mut cargo = Command::new("cargo");
    cargo.current_dir(tree).arg("fuzz").args(words.split(' '));
    cargo
}

/// The targets, or those named in `only`.
fn targets(tree: &Path, only: &[String]) -> Result<Vec<String>> {
    let listed = String::from_utf8(cargo_fuzz(tree, "list").output()?.stdout)?;
    let mut targets: Vec<_> = listed.lines().map(str::to_owned).collect();
    targets.retain(|target| only.is_empty() || only.contains(target));
    ensure!(!targets.is_empty(), "cargo fuzz list has no {only:?}");
    Ok(targets)
}

/// Builds all targets, runs each that is asked for, and keeps what comes out as results of `sources`.
fn all(tree: &Path, options: &Options, seconds: u64, sources: Option<&Sources>) -> Result<()> {
    let targets = targets(tree, &options.only)?;
    println!("building targets, then {seconds} s for each");
    let status = cargo_fuzz(tree, &format!("build {FLAGS}")).status()?;
    ensure!(status.success(), "the targets were not built");
    let failed = share(options.jobs, targets, |_, target| {
        let run = one(tree, &target, "corpus", seconds)?;
        let (executions, edges, finding) = (run.executions, run.edges, &run.finding);
        println!("{target}: {executions} executions, {edges} edges {finding}");
        if let Some(sources) = sources {
            sources.record("campaign", &target, &run)?;
        }
        Ok((!finding.is_empty()).then_some(target))
    })?;
    let failed: Vec<_> = failed.into_iter().flatten().collect();
    ensure!(failed.is_empty(), "found something: {failed:?}");
    Ok(())
}

/// Runs a target until it fails or the time is over; what is new to it goes to `target/fuzz/NEW`.
fn one(tree: &Path, target: &str, new: &str, seconds: u64) -> Result<Run> {
    let new = target_dir()?.join("fuzz").join(new).join(target);
    let artifacts = root().canonicalize()?.join("fuzz/artifacts").join(target);
    fs::create_dir_all(&new)?;
    fs::create_dir_all(&artifacts)?;
    let mut cargo = cargo_fuzz(tree, &format!("run {FLAGS} {target}"));
    cargo.arg(new).arg(tree.join("fuzz/corpus").join(target));
    cargo.arg("--").args(ENGINE.split(' '));
    cargo.arg(format!("-max_total_time={seconds}"));
    cargo.arg(format!("-artifact_prefix={}/", artifacts.display()));
    let output = cargo.output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    let mut finding = String::new();
    if !output.status.success() {
        let what = r"(?:panicked at |ERROR: libFuzzer: )(.*\n.*)";
        let input = find("Test unit written to (.*)", &said);
        ensure!(!input.is_empty(), "{target}: {said}");
        let again = format!("cargo fuzz run --sanitizer none {target} {input}");
        finding = format!("FAILED: {}\n{again}", find(what, &said));
    }
    let last = |pattern: &str| find_all(pattern, &said).pop().and_then(|n| n.parse().ok());
    Ok(Run {
        executions: last(r"stat::number_of_executed_units: (\d+)").unwrap_or(0),
        edges: last(r"cov: (\d+)").unwrap_or(0),
        seconds,
        finding,
    })
}
