//! `cargo xtask test`: everything that must hold, each step to its end, one verdict.

use std::{
    fs,
    path::Path,
    process::Command,
    sync::mpsc,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use mavseal_chips_host::{Chip, KEYS_VARIABLE, keys};

use crate::{
    fuzz, proofs,
    setup::{self, root},
    sources::Sources,
};

/// The cores, which are built for every chip.
const CORES: &str = "-p mavlink-signing -p mavlink-commsec -p mavseal-store -p mavseal-relay";
/// Targets that the cores alone are built for: those of the chips, and one that no chip has.
const CORE_TARGETS: [&str; 3] = [
    "thumbv7em-none-eabihf",
    "thumbv6m-none-eabi",
    "riscv32imc-unknown-none-elf",
];
/// How often a step that is still running says so.
const HEARTBEAT: Duration = Duration::from_secs(20);

/// Options of `cargo xtask test`.
#[derive(Args)]
pub(crate) struct Options {
    /// Also what takes long or installs much: every wrong tag, 100,000
    /// histories of a link, the mutants of the cores, and unmodified peers
    #[arg(long)]
    all: bool,
}

/// Runs every check; those after a failed one too.
///
/// # Errors
/// If a check failed; which and why has been printed.
pub(crate) fn run(options: &Options) -> Result<()> {
    let mut checks = Checks::default();
    checks.step("what the tests need", || {
        setup::qemu()?;
        CORE_TARGETS.into_iter().try_for_each(setup::target)
    });
    checks.step("formatting", formatting);
    checks.step("lints", lints);
    checks.step("documentation", || {
        let doc = "cargo doc --quiet --locked --workspace --no-deps";
        call(".", doc, &[("RUSTDOCFLAGS", "-D warnings")])
    });
    checks.step("cores alone for microcontrollers", cores_alone);
    checks.step("firmware lints", firmware_lints);
    checks.step("host and doc tests", || {
        cargo(".", "test --workspace --exclude mavseal-e2e --exclude mavseal-chips-host --features mavseal-keys/cli,mavseal-relay/std")?;
        let tables = "--features mavlink-signing/fast-checksum";
        cargo(".", &format!("test -p mavlink-signing -p mavseal-proofs {tables}"))
    });
    checks.step("shipped images on emulated chips", || {
        cargo(".", "test -p mavseal-chips-host")
    });
    checks.step("plays over the emulated machine", || {
        cargo(".", "test -p mavseal-e2e")
    });
    checks.step_unless("fast proofs", proofs::fast);
    checks.step("committed inputs of the fuzz targets", || {
        cargo("fuzz", "test --no-default-features")
    });
    checks.step_unless("fuzz targets, four seconds each", fuzz::smoke);
    if options.all {
        checks.step("every wrong tag rejected in constant time", || {
            cargo(
                ".",
                "test -p mavseal-chips-host every_wrong_tag -- --ignored --nocapture",
            )
        });
        checks.step("100,000 histories of a link", || {
            cargo(
                ".",
                "test --release -p mavseal-relay --test simulation -- --ignored --nocapture",
            )
        });
        checks.step("mutants of the cores", mutants);
        checks.step("interoperation with unmodified peers", || {
            cargo("interop", "clippy --workspace --all-targets -- -D warnings")?;
            // The benchmark is no test: `cargo xtask bench`.
            cargo("interop", "test --workspace --lib --bins")?;
            call(".", "cargo xtask interop", &[])
        });
    }
    checks.finish()
}

#[derive(Default)]
struct Checks {
    passed: usize,
    skipped: usize,
    failed: Vec<&'static str>,
}

impl Checks {
    fn step(&mut self, name: &'static str, check: impl FnOnce() -> Result<()>) {
        self.step_unless(name, || check().map(|()| None));
    }

    /// A check that may say why it could not be made.
    fn step_unless(&mut self, name: &'static str, check: impl FnOnce() -> Result<Option<String>>) {
        println!("\n== {name}");
        let start = Instant::now();
        let result = thread::scope(|scope| {
            let (end, ended) = mpsc::channel::<()>();
            scope.spawn(move || {
                while ended.recv_timeout(HEARTBEAT) == Err(mpsc::RecvTimeoutError::Timeout) {
                    println!("== {name}: still running, {} s", start.elapsed().as_secs());
                }
            });
            let result = check();
            drop(end);
            result
        });
        let seconds = start.elapsed().as_secs_f32();
        match result {
            Ok(None) => {
                self.passed += 1;
                println!("== {name}: ok, {seconds:.1} s");
            }
            Ok(Some(reason)) => {
                self.skipped += 1;
                println!("== {name}: NOT RUN, {reason}");
            }
            Err(error) => {
                self.failed.push(name);
                println!("== {name}: FAILED, {seconds:.1} s\n{error:#}");
            }
        }
    }

    fn finish(self) -> Result<()> {
        let Self {
            passed,
            skipped,
            failed,
        } = self;
        println!(
            "\n{passed} passed, {} failed, {skipped} skipped",
            failed.len()
        );
        ensure!(failed.is_empty(), "failed: {}", failed.join(", "));
        Ok(())
    }
}

/// Says `line` and runs it, in `folder` of the project.
fn call(folder: &str, line: &str, variables: &[(&str, &str)]) -> Result<()> {
    println!("$ {line}");
    let mut words = line.split(' ');
    let mut command = Command::new(words.next().unwrap_or_default());
    command.current_dir(root().join(folder)).args(words);
    succeed(command.envs(variables.iter().copied()))
}

/// Runs cargo with these words, in `folder` of the project.
fn cargo(folder: &str, words: &str) -> Result<()> {
    let (command, rest) = words
        .split_once(' ')
        .context("a command and its arguments")?;
    call(
        folder,
        &format!("cargo {command} --quiet --locked {rest}"),
        &[],
    )
}

/// Whether cargo has this command.
fn has(command: &str) -> bool {
    let output = Command::new("cargo").args([command, "--version"]).output();
    output.is_ok_and(|output| output.status.success())
}

fn formatting() -> Result<()> {
    if !has("fmt") {
        call(".", "rustup component add rustfmt", &[])?;
    }
    let workspaces = [".", "chips", "chips/examples/embassy", "fuzz", "interop"];
    workspaces
        .iter()
        .try_for_each(|folder| call(folder, "cargo fmt --all --check", &[]))
}

fn lints() -> Result<()> {
    if !has("clippy") {
        call(".", "rustup component add clippy", &[])?;
    }
    cargo(
        ".",
        "clippy --workspace --all-targets --features mavseal-keys/cli,mavseal-relay/std -- -D warnings",
    )?;
    cargo(
        ".",
        &format!("clippy {CORES} --features defmt -- -D warnings"),
    )?;
    cargo(
        "fuzz",
        "clippy --no-default-features --all-targets -- -D warnings",
    )
}

/// Every small change of the cores that cargo-mutants can make, but those that its configuration leaves out.
fn mutants() -> Result<()> {
    if !has("mutants") {
        println!("cargo-mutants is missing and takes some minutes to install");
        call(".", "cargo install --locked cargo-mutants", &[])?;
    }
    let results = Sources::now()?.results;
    for (name, config) in [("cores", "mutants.toml"), ("tables", "mutants-tables.toml")] {
        let mut cargo = Command::new("cargo");
        cargo
            .current_dir(root())
            .args(["mutants", "--config"])
            .arg(Path::new(".cargo").join(config));
        fs::create_dir_all(results.join(name))?;
        let status = cargo.arg("--output").arg(results.join(name)).status()?;
        // 3: tests did not end, which is noticed too.
        ensure!(
            matches!(status.code(), Some(0 | 3)),
            "cargo mutants: {status}"
        );
    }
    Ok(())
}

/// A new chip needs no change to the cores: they build for one that no crate of `chips/` is for.
fn cores_alone() -> Result<()> {
    CORE_TARGETS
        .iter()
        .try_for_each(|target| cargo(".", &format!("build --target {target} {CORES}")))
}

fn firmware_lints() -> Result<()> {
    let keys = keys()?.display().to_string();
    for chip in Chip::ALL {
        let sealing = match chip {
            Chip::QemuM7 => &["common,sealing", "common,logging,sealing"][..],
            Chip::Stm32c092rc => &[],
        };
        let signing = [
            "common",
            "common,logging",
            "common,logging,standard-signature",
            "minimal,leaky",
        ];
        for features in signing.iter().chain(sealing) {
            let line = format!(
                "cargo clippy --quiet --locked --no-default-features --target {} --features {features} -- -D warnings",
                chip.target()
            );
            call(
                &format!("chips/{}", chip.folder()),
                &line,
                &[(KEYS_VARIABLE, &keys)],
            )?;
        }
    }
    let example = "cargo clippy --quiet --locked -- -D warnings";
    call("chips/examples/embassy", example, &[])
}

fn succeed(command: &mut Command) -> Result<()> {
    let status = command.status()?;
    if !status.success() {
        bail!("{command:?} ended with {status}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_step_is_told_at_the_end() {
        let mut checks = Checks::default();
        checks.step("good", || Ok(()));
        checks.step("bad", || bail!("x"));
        checks.step_unless("missing", || Ok(Some("no tool".to_owned())));
        assert_eq!((checks.passed, checks.skipped), (1, 1));
        let said = checks.finish().expect_err("one failed").to_string();
        assert_eq!(said, "failed: bad");
    }
}
