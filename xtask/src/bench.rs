//! `cargo xtask bench`: what signing and verifying cost, beside peers and the least that they can.
//!
//! The measuring is in `interop/bench/`, by criterion, and for pymavlink in `interop/python/bench.py`. Here
//! the times are put beside each other and held to their bars.

mod table;
mod times;

use std::{
    fs,
    io::Write as _,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use anyhow::{Context, Result, ensure};
use clap::Args;
use serde::Deserialize;
use xshell::{Shell, cmd};

use crate::setup::{self, root};
use table::Table;
use times::{Mode, Times};

/// What verifying may take, times the floor of its profile.
const MOST: f64 = 1.3;
/// The payloads for which that holds.
const SHORT: [usize; 2] = [9, 32];
const PROFILES: [&str; 2] = ["Hmac", "Standard"];
const PEERS: [&str; 3] = ["mavlink", "mavio", "pymavlink"];

/// Options of `cargo xtask bench`.
#[derive(Args)]
pub(crate) struct Options {
    /// Measure shortly: for a look, not for numbers to publish
    #[arg(long)]
    quick: bool,
}

/// How long is measured.
struct Effort {
    /// Everything is measured this often, as another process may disturb one round.
    rounds: usize,
    /// Seconds for each time in a round.
    measure: &'static str,
    /// Seconds before it.
    warm_up: &'static str,
}

impl Effort {
    const QUICK: Self = Self {
        rounds: 1,
        measure: "0.2",
        warm_up: "0.05",
    };
    const FULL: Self = Self {
        rounds: 3,
        measure: "0.4",
        warm_up: "0.1",
    };
}

/// What `interop/bench/` says about itself.
#[derive(Deserialize)]
struct Given {
    /// What compresses.
    sha2: String,
    messages: Vec<Message>,
}

#[derive(Deserialize)]
struct Message {
    name: String,
    size: usize,
    /// Compressions with each of [`PROFILES`].
    compressions: [usize; 2],
}

/// Measures all of it.
///
/// # Errors
/// If a bar is missed, which is named, or something does not run.
pub(crate) fn run(options: &Options) -> Result<()> {
    let effort = if options.quick {
        Effort::QUICK
    } else {
        Effort::FULL
    };
    let target = setup::target_dir()?;
    let environment = target.join("interop/python");
    let requirements = root().join("interop/python/requirements.txt");
    fs::create_dir_all(&environment)?;
    let python = setup::python(&environment, &requirements)?;
    let folder = target.join("bench");
    if folder.exists() {
        fs::remove_dir_all(&folder)?;
    }

    let output = cargo("run").output()?;
    ensure!(output.status.success(), "interop/bench: {}", output.status);
    let given: Given = serde_json::from_slice(&output.stdout).context("interop/bench")?;
    let mut asked = Vec::new();
    for round in 1..=effort.rounds {
        eprintln!("round {round} of {}", effort.rounds);
        measure(&folder, round, &effort)?;
        asked.push(ask(&python, &output.stdout, effort.measure)?);
    }

    let times = Times::read(&folder, &asked)?;
    conditions(&given, &times, &asked)?;
    for mode in Mode::ALL {
        if times.has(mode) {
            println!(
                "\n{}\n{}",
                mode.describe(),
                Table::of(&given, &times, mode)?
            );
        }
    }
    let missed = missed(&times)?;
    ensure!(missed.is_empty(), "missed:\n  {}", missed.join("\n  "));
    println!("\nEvery bar is kept.");
    Ok(())
}

/// A call of cargo for `interop/bench/`, optimised.
fn cargo(verb: &str) -> Command {
    let mut command = Command::new("cargo");
    command.current_dir(root().join("interop/bench"));
    command.args([verb, "--quiet", "--locked"]);
    if verb == "run" {
        command.arg("--release");
    }
    command.stderr(Stdio::inherit());
    command
}

fn measure(folder: &Path, round: usize, effort: &Effort) -> Result<()> {
    let mut command = cargo("bench");
    command.env("CRITERION_HOME", folder);
    command.args(["--bench", "signing", "--", "--quiet", "--noplot"]);
    command.args(["--warm-up-time", effort.warm_up]);
    command.args(["--measurement-time", effort.measure]);
    // Its own statistics are not looked at; the fewest that it does without a warning.
    command.args(["--nresamples", "1001"]);
    command.args(["--save-baseline", &format!("{}{round}", times::ROUND)]);
    let output = command
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .output()?;
    ensure!(
        output.status.success(),
        "interop/bench: {}\n{}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    Ok(())
}

/// Has pymavlink sign and verify the same frames.
fn ask(python: &Path, given: &[u8], seconds: &str) -> Result<times::Pymavlink> {
    let script: PathBuf = root().join("interop/python/bench.py");
    let mut child = Command::new(python)
        .arg(script)
        .arg(seconds)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    child.stdin.take().context("its input")?.write_all(given)?;
    let output = child.wait_with_output()?;
    ensure!(output.status.success(), "bench.py: {}", output.status);
    serde_json::from_slice(&output.stdout).context("bench.py")
}

/// With what was measured.
fn conditions(given: &Given, times: &Times, asked: &[times::Pymavlink]) -> Result<()> {
    let sh = Shell::new()?;
    let cpu = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let cpu = cpu.lines().find_map(|line| line.strip_prefix("model name"));
    let cpu = cpu.map_or("unknown", |line| line.trim_start_matches([' ', '\t', ':']));
    println!("processor   {cpu}");
    println!(
        "compiler    {}",
        cmd!(sh, "rustc --version").quiet().read()?
    );
    println!("SHA-256     sha2 {}, {}", versions("sha2")?, given.sha2);
    let names = ["mavlink", "mavio"].map(|name| Ok(format!("{name} {}", versions(name)?)));
    let names = names.into_iter().collect::<Result<Vec<_>>>()?;
    if let Some(asked) = asked.first() {
        let (version, python) = (&asked.pymavlink, &asked.python);
        println!(
            "peers       {}, pymavlink {version} (Python {python})",
            names.join(", ")
        );
    }
    let clock = times.get(times.strictest(), "clock", 0)?;
    println!("clock       {clock:.0} ns, which is in the times of mavlink alone");
    for message in &given.messages {
        let Message {
            name,
            size,
            compressions: [hmac, standard],
        } = message;
        let (fastest, _) = times.fastest_checksum(times.strictest(), *size)?;
        println!(
            "floor       {name}, {size} bytes: {hmac} compressions (Hmac), {standard} (Standard), and {fastest}"
        );
    }
    Ok(())
}

/// The versions of a package in the lock file, in ascending order.
fn versions(package: &str) -> Result<String> {
    let mut metadata = cargo_metadata::MetadataCommand::new();
    metadata.manifest_path(root().join("interop/bench/Cargo.toml"));
    metadata.other_options(["--locked".to_owned()]);
    let packages = metadata.exec()?.packages;
    let versions = packages.iter().filter(|one| *one.name == *package);
    let versions: Vec<_> = versions.map(|one| one.version.to_string()).collect();
    Ok(versions.join(" and "))
}

/// The bars that are missed, each in words.
fn missed(times: &Times) -> Result<Vec<String>> {
    let mode = times.strictest();
    let mut missed = Vec::new();
    for size in SHORT {
        for profile in PROFILES {
            let floor = times.floor(mode, profile, size)?;
            let ours = times.get(mode, &format!("{profile} verify"), size)?;
            let what = format!("verify, {profile}, {size} bytes: {ours:.0} ns");
            if ours > MOST * floor {
                let ratio = ours / floor;
                missed.push(format!(
                    "{what} is {ratio:.2} times the floor of {floor:.0} ns; {MOST} is the most"
                ));
            }
            for peer in PEERS {
                let theirs = times.get(mode, &format!("{peer} verify"), size)?;
                if ours >= theirs {
                    missed.push(format!("{what} is not faster than {peer}, {theirs:.0} ns"));
                }
            }
        }
    }
    Ok(missed)
}
