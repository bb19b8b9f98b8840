//! `cargo xtask test`: everything that must hold, each step to its end, one verdict.

use std::{process::Command, time::Instant};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use xshell::{Shell, cmd};

use mavseal_chips_host::{Chip, KEYS_VARIABLE, keys};

use crate::{
    fuzz, mutants, proofs,
    setup::{self, root},
};

/// Targets that the cores alone are built for: those of the chips, and one that no chip has.
const CORE_TARGETS: [&str; 3] = [
    "thumbv7em-none-eabihf",
    "thumbv6m-none-eabi",
    "riscv32imc-unknown-none-elf",
];

/// Options of `cargo xtask test`.
#[derive(Args)]
pub(crate) struct Options {
    /// Also what takes long or installs much: every wrong tag, 100,000 histories of a
    /// link, the mutants of the cores, and unmodified peers
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
    checks.step("documentation", documentation);
    checks.step("host and doc tests", host_tests);
    checks.step("cores alone for microcontrollers", cores_alone);
    checks.step("firmware lints", firmware_lints);
    checks.step("properties and their table", proofs::check);
    checks.step_unless("fast proofs", proofs::fast);
    checks.step("inputs of the fuzz targets, and their table", inputs);
    checks.step_unless("fuzz targets, some seconds each", fuzz::smoke);
    if options.all {
        checks.step("every wrong tag rejected in constant time", every_wrong_tag);
        checks.step("100,000 histories of a link", histories);
        checks.step("mutants of the cores", mutants::all);
        checks.step("interoperation with unmodified peers", interoperation);
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
        let result = check();
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
        let failed = self.failed.len();
        println!(
            "\n{} passed, {failed} failed, {} skipped",
            self.passed, self.skipped
        );
        if failed == 0 {
            return Ok(());
        }
        bail!("failed: {}", self.failed.join(", "))
    }
}

/// A shell in `folder` of the project.
fn shell(folder: &str) -> Result<Shell> {
    let sh = Shell::new()?;
    sh.change_dir(root().join(folder));
    Ok(sh)
}

/// A shell for the host workspace that has cargo's `component`.
fn shell_with(component: &str) -> Result<Shell> {
    let sh = shell(".")?;
    let found = cmd!(sh, "cargo {component} --version")
        .quiet()
        .ignore_stdout();
    if found.ignore_stderr().run().is_err() {
        let package = if component == "fmt" {
            "rustfmt"
        } else {
            component
        };
        cmd!(sh, "rustup component add {package}")
            .run()
            .with_context(|| {
                format!("cargo {component} is missing: rustup component add {package}")
            })?;
    }
    Ok(sh)
}

fn formatting() -> Result<()> {
    let sh = shell_with("fmt")?;
    cmd!(sh, "cargo fmt --all --check").run()?;
    for workspace in ["chips", "fuzz", "interop"] {
        sh.change_dir(root().join(workspace));
        cmd!(sh, "cargo fmt --all --check").run()?;
    }
    Ok(())
}

fn lints() -> Result<()> {
    let sh = shell_with("clippy")?;
    cmd!(
        sh,
        "cargo clippy --quiet --locked --workspace --all-targets --features mavseal-keys/cli -- -D warnings"
    )
    .run()?;
    let cores = mutants::CORES.map(|core| format!("--package={core}"));
    cmd!(
        sh,
        "cargo clippy --quiet --locked {cores...} --features defmt -- -D warnings"
    )
    .run()?;
    let without_engine = fuzz::without_engine()?;
    cmd!(
        sh,
        "cargo clippy --quiet {without_engine...} --all-targets -- -D warnings"
    )
    .run()?;
    Ok(())
}

fn documentation() -> Result<()> {
    let sh = shell(".")?;
    sh.set_var("RUSTDOCFLAGS", "-D warnings");
    cmd!(sh, "cargo doc --quiet --locked --workspace --no-deps").run()?;
    Ok(())
}

fn host_tests() -> Result<()> {
    let sh = shell(".")?;
    let program = "--features=mavseal-keys/cli";
    cmd!(sh, "cargo test --quiet --locked --workspace {program}").run()?;
    let cores = ["--package=mavlink-signing", "--package=mavseal-proofs"];
    let tables = "--features=mavlink-signing/fast-checksum";
    cmd!(sh, "cargo test --quiet --locked {cores...} {tables}").run()?;
    Ok(())
}

/// Every committed input of the fuzz targets, on this compiler and without an engine.
fn inputs() -> Result<()> {
    let sh = shell(".")?;
    let without_engine = fuzz::without_engine()?;
    cmd!(sh, "cargo test --quiet {without_engine...}").run()?;
    fuzz::check()
}

/// A new chip needs no change to the cores: they build for one that no crate of `chips/` is for.
fn cores_alone() -> Result<()> {
    for target in CORE_TARGETS {
        println!("{target}");
        let mut cargo = Command::new("cargo");
        cargo.current_dir(root());
        cargo
            .args(["build", "--quiet", "--locked", "--target", target])
            .args(mutants::CORES.iter().flat_map(|core| ["-p", core]));
        succeed(&mut cargo)?;
    }
    Ok(())
}

fn firmware_lints() -> Result<()> {
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
            let mut cargo = Command::new("cargo");
            cargo.env(KEYS_VARIABLE, keys()?);
            cargo.current_dir(root().join("chips").join(chip.folder()));
            cargo.args(["clippy", "--quiet", "--locked", "--no-default-features"]);
            cargo.args(["--target", chip.target()]);
            cargo.args(["--features", features, "--", "-D", "warnings"]);
            succeed(&mut cargo)?;
        }
    }
    Ok(())
}

/// What the host tests have some thousands of.
fn histories() -> Result<()> {
    let sh = shell(".")?;
    let test = ["--test", "simulation", "--", "--ignored", "--nocapture"];
    cmd!(
        sh,
        "cargo test --quiet --locked --release -p mavseal-relay {test...}"
    )
    .run()?;
    Ok(())
}

/// What the host tests have some of.
fn every_wrong_tag() -> Result<()> {
    let sh = shell(".")?;
    let test = ["every_wrong_tag", "--", "--ignored", "--nocapture"];
    cmd!(
        sh,
        "cargo test --quiet --locked -p mavseal-chips-host {test...}"
    )
    .run()?;
    Ok(())
}

fn interoperation() -> Result<()> {
    let sh = shell("interop")?;
    let all = ["--quiet", "--locked", "--workspace"];
    cmd!(sh, "cargo clippy {all...} --all-targets -- -D warnings").run()?;
    // The benchmark is no test: `cargo xtask bench`.
    cmd!(sh, "cargo test {all...} --lib --bins").run()?;
    setup::venv()?;
    cmd!(sh, "cargo run --quiet --locked").run()?;
    Ok(())
}

fn succeed(command: &mut Command) -> Result<()> {
    let status = command.status()?;
    ensure!(status.success(), "{command:?} ended with {status}");
    Ok(())
}
