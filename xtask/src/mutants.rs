//! `cargo xtask mutants`: small changes of the cores, each of which a test must notice.
//!
//! The proofs have mutants too, few and made by hand for each property. These are all that
//! cargo-mutants can think of, tried with the tests of the cores and the property tests of the properties.

mod outcome;
mod table;

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use xshell::{Shell, cmd};

use crate::proofs::{
    fingerprint::{Depth, fingerprint, hash_of},
    results::{cores, tenths, today},
    workshop::Snapshot,
};
use crate::setup::root;
use outcome::{Hashes, Results, Survivors};

/// The cores, which are changed, and the packages that have the tests.
pub(crate) const CORES: [&str; 4] = [
    "mavlink-signing",
    "mavlink-commsec",
    "mavseal-store",
    "mavseal-relay",
];
const TESTS: [&str; 5] = [
    "mavlink-signing",
    "mavlink-commsec",
    "mavseal-store",
    "mavseal-relay",
    "mavseal-proofs",
];

/// What is compiled with a feature alone: the feature, and which mutants are tried once more with it.
const FEATURE: (&str, &str) = ("mavlink-signing/fast-checksum", "by_tables|low::");

/// The least score, in percent.
const BAR: f64 = 95.0;

/// Options of `cargo xtask mutants`.
#[derive(Args)]
pub(crate) struct Options {
    /// Only mutants whose name matches this regular expression; what comes out is not kept
    #[arg(long, value_name = "REGEX", conflicts_with_all = ["table", "check"])]
    only: Option<String>,
    /// Only what survived the last run, for tests that came since; what was killed then is not tried again
    #[arg(long, conflicts_with_all = ["only", "table", "check"])]
    survivors: bool,
    /// Run nothing; write the table of verification.md
    #[arg(long, conflicts_with = "check")]
    table: bool,
    /// Run nothing; fail if verification.md does not say what the results say
    #[arg(long)]
    check: bool,
    /// Mutants at a time
    #[arg(long, value_name = "N", default_value_t = 2)]
    jobs: usize,
}

/// Runs what the options say.
///
/// # Errors
/// If a mutant survives that nobody has explained, or one that somebody has does not, or the score is
/// below [`BAR`].
pub(crate) fn run(options: &Options) -> Result<()> {
    let root = root();
    if options.table {
        return table::write(&root, &Hashes::of(&root)?);
    }
    if options.check {
        return table::check(&root, &Hashes::of(&root)?);
    }
    let start = Instant::now();
    let version = cargo_mutants()?;
    let metadata = cargo_metadata::MetadataCommand::new()
        .manifest_path(root.join("Cargo.toml"))
        .no_deps()
        .exec()?;
    let folder = metadata
        .target_directory
        .join("mutants")
        .into_std_path_buf();
    let tree = Snapshot::take(&root, &folder)?.tree();
    let hashes = Hashes::of(&tree)?;
    let before = options.survivors.then(|| survived(&root, &hashes));
    let before = before.transpose()?;
    let patterns: Vec<_> = match &before {
        Some(results) => results.survivors().into_iter().collect(),
        None => options.only.iter().cloned().collect(),
    };
    let limit = baseline(&tree, &folder)?;
    let tries = Tries {
        tree: &tree,
        limit,
        jobs: options.jobs,
    };
    let mut tried = outcome::read(&tries.run(&folder, &patterns, None)?)?;
    if patterns.is_empty() {
        let (feature, names) = FEATURE;
        let again = tries.run(&folder.join("feature"), &[names.to_owned()], Some(feature))?;
        outcome::merge(&mut tried, outcome::read(&again)?);
    }
    let results = match before {
        Some(mut results) => {
            results.retry(&tried);
            results.hashes = hashes;
            results.survivors_again = Some(today()?);
            results
        }
        None => Results {
            date: today()?,
            minutes: tenths(start.elapsed().as_secs_f64() / 60.0),
            cores: cores(),
            jobs: options.jobs,
            cargo_mutants: version,
            rustc: rustc()?,
            hashes,
            survivors_again: None,
            mutants: tried,
        },
    };
    let survivors = Survivors::load(&tree)?;
    let faults = survivors.faults(&results.mutants, options.only.is_none());
    print!("\n{}", table::rows(&results));
    if options.only.is_none() {
        results.save(&root)?;
        table::write(&root, &results.hashes)?;
    }
    ensure!(faults.is_empty(), "{}", faults.join("\n"));
    let score = results.count(None).score();
    ensure!(score >= BAR, "the score is {score:.1} %, less than {BAR} %");
    Ok(())
}

/// The last run, if it was of this code and something survived it.
fn survived(root: &Path, now: &Hashes) -> Result<Results> {
    let results = Results::load(root)?.context("nothing has been tried yet")?;
    ensure!(
        results.hashes.code == now.code,
        "the code has changed since"
    );
    ensure!(!results.survivors().is_empty(), "nothing has survived");
    Ok(results)
}

/// For `cargo xtask test --all`: every mutant.
///
/// # Errors
/// As [`run`].
pub(crate) fn all() -> Result<()> {
    run(&Options {
        only: None,
        survivors: false,
        table: false,
        check: false,
        jobs: 2,
    })
}

/// Finds cargo-mutants, or installs it, and says which version it is.
fn cargo_mutants() -> Result<String> {
    let sh = Shell::new()?;
    let version = || {
        cmd!(sh, "cargo mutants --version")
            .quiet()
            .ignore_stderr()
            .read()
    };
    if version().is_err() {
        eprintln!("installing cargo-mutants (cargo install)");
        let install = cmd!(sh, "cargo install --quiet --locked cargo-mutants").quiet();
        let advice = "cargo-mutants is missing: cargo install --locked cargo-mutants";
        install.run().context(advice)?;
    }
    let said = version().context("cargo-mutants was installed, yet cargo does not find it")?;
    let version = said.split_whitespace().last();
    Ok(version
        .context("cargo-mutants does not tell its version")?
        .to_owned())
}

fn rustc() -> Result<String> {
    let sh = Shell::new()?;
    let said = cmd!(sh, "rustc --version").quiet().read()?;
    let version = said.split_whitespace().nth(1);
    Ok(version
        .context("rustc does not tell its version")?
        .to_owned())
}

impl Hashes {
    fn of(tree: &Path) -> Result<Self> {
        let metadata = cargo_metadata::MetadataCommand::new()
            .manifest_path(tree.join("Cargo.toml"))
            .exec()?;
        let hash = |packages: &[&str], depth| {
            let hashes = packages
                .iter()
                .map(|package| fingerprint(&metadata, package, depth));
            anyhow::Ok(hash_of(&hashes.collect::<Result<Vec<_>>>()?.concat()))
        };
        Ok(Self {
            code: hash(&CORES, Depth::Fuzz)?,
            all: hash(&TESTS, Depth::Tests)?,
        })
    }
}

/// The same for every test: values by chance that are the same each time, and of a failure only that
/// there is one.
fn calm(cargo: &mut Command) -> &mut Command {
    // Each of the copies is built in a folder of its own.
    cargo.env_remove("CARGO_TARGET_DIR");
    cargo.env("PROPTEST_RNG_SEED", "0");
    cargo.env("PROPTEST_MAX_SHRINK_ITERS", "0");
    cargo.env("PROPTEST_DISABLE_FAILURE_PERSISTENCE", "1")
}

/// Runs the tests without any mutant, as otherwise their failures mean nothing, and says how long
/// they may take with one.
fn baseline(tree: &Path, folder: &Path) -> Result<Duration> {
    let config: toml::Table =
        toml::from_str(&fs::read_to_string(tree.join(".cargo/mutants.toml"))?)?;
    let arguments = |key: &str| {
        let values = config.get(key).and_then(toml::Value::as_array);
        let values = values.into_iter().flatten().filter_map(toml::Value::as_str);
        values.map(str::to_owned).collect::<Vec<_>>()
    };
    let test = |more: &[&str]| {
        let mut cargo = Command::new("cargo");
        calm(&mut cargo).current_dir(tree).arg("test");
        cargo.arg("--target-dir").arg(folder.join("baseline"));
        cargo.args(TESTS.iter().flat_map(|package| ["-p", package]));
        cargo.args(arguments("additional_cargo_args"));
        cargo.args(arguments("additional_cargo_test_args"));
        let status = cargo.arg("--quiet").args(more).status()?;
        ensure!(status.success(), "the tests fail without any mutant");
        anyhow::Ok(())
    };
    test(&["--no-run"])?;
    let start = Instant::now();
    test(&[])?;
    Ok(start.elapsed() * 10 + Duration::from_secs(20))
}

/// How mutants are tried.
struct Tries<'a> {
    tree: &'a Path,
    limit: Duration,
    jobs: usize,
}

impl Tries<'_> {
    /// Has cargo-mutants try those that one of `patterns` matches, or all if there is none; gives the folder
    /// with what came out.
    fn run(&self, folder: &Path, patterns: &[String], feature: Option<&str>) -> Result<PathBuf> {
        // It copies the tree to where temporary files are, and builds there.
        let copies = folder.join("copies");
        fs::create_dir_all(&copies)?;
        let mut cargo = Command::new("cargo");
        calm(&mut cargo).env("TMPDIR", copies).arg("mutants");
        cargo
            .arg("--dir")
            .arg(self.tree)
            .arg("--output")
            .arg(folder);
        cargo.args(CORES.iter().flat_map(|package| ["--package", package]));
        let limit = self.limit.as_secs().to_string();
        cargo.args(["--baseline=skip", "--timeout", &limit]);
        cargo.args(["--jobs", &self.jobs.to_string()]);
        cargo.args(patterns.iter().flat_map(|pattern| ["--re", pattern]));
        cargo.args(feature.iter().flat_map(|feature| ["--features", feature]));
        // 2 and 3 tell of mutants that survived or took too long.
        match cargo.status()?.code() {
            Some(0 | 2 | 3) => Ok(folder.join("mutants.out")),
            _ => bail!("cargo mutants did not get to its end"),
        }
    }
}
