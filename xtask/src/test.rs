//! `cargo xtask test`: everything that must hold, each step to its end, one verdict.

use std::{
    process::{Command, exit},
    sync::mpsc,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Result, ensure};
use clap::Args;
use mavseal_chips_host::{KEYS_VARIABLE, keys};

use crate::{
    setup::{self, root},
    sources::Sources,
};

/// Targets that the cores alone are built for: those of the chips, and one that no chip has.
const CORE_TARGETS: [&str; 3] = [
    "thumbv7em-none-eabihf",
    "thumbv6m-none-eabi",
    "riscv32imc-unknown-none-elf",
];
const CORES: &str = "-p mavlink-signing -p mavlink-commsec -p mavseal-store -p mavseal-relay";
/// The folders of all workspaces.
const FOLDERS: &str = ". chips chips/examples/embassy fuzz interop";
/// The status of a command for which something is missing, as automake's tests have it.
pub(crate) const NOT_RUN: i32 = 77;
/// How often a step that is still running says so.
const HEARTBEAT: Duration = Duration::from_secs(20);

/// Steps, each a name and what a shell in the project's folder runs. Where that ends with [`NOT_RUN`], something is
/// missing.
const STEPS: &str = r#"
formatting
cargo fmt --version || rustup component add rustfmt
for folder in $FOLDERS; do (cd $folder && cargo fmt --all --check); done

lints
cargo clippy --version || rustup component add clippy
cargo clippy --quiet --locked --workspace --all-targets --features mavseal-keys/cli,mavseal-relay/std -- -D warnings
cargo clippy --quiet --locked $CORES --features defmt -- -D warnings
(cd fuzz && cargo clippy --quiet --locked --no-default-features --all-targets -- -D warnings)

licences, versions and origins of dependencies
cargo deny --version || exit 77
for folder in $FOLDERS; do
    cargo deny --locked --manifest-path $folder/Cargo.toml --config $PWD/deny.toml check bans licenses sources
done

known weaknesses of dependencies
# The list of them is on GitHub.
cargo deny --version && cargo deny fetch db || exit 77
for folder in $FOLDERS; do
    cargo deny --locked --manifest-path $folder/Cargo.toml --config $PWD/deny.toml check --disable-fetch advisories
done

documentation
RUSTDOCFLAGS='-D warnings' cargo doc --quiet --locked --workspace --no-deps

cores alone for microcontrollers
for target in $TARGETS; do cargo build --quiet --locked --target $target $CORES; done

firmware lints
clippy() { cargo clippy --quiet --locked --no-default-features --features $1 -- -D warnings; }
signing='common common,logging common,logging,standard-signature minimal,leaky'
(cd chips/stm32c092rc && for features in $signing; do clippy $features; done)
sealing='common,sealing common,logging,sealing'
(cd chips/qemu-m7 && for features in $signing $sealing; do clippy $features; done)
(cd chips/examples/embassy && cargo clippy --quiet --locked -- -D warnings)

host and doc tests
others='--exclude mavseal-e2e --exclude mavseal-chips-host'
cargo test --quiet --locked --workspace $others --features mavseal-keys/cli,mavseal-relay/std
cargo test --quiet --locked -p mavlink-signing -p mavseal-proofs --features mavlink-signing/fast-checksum

shipped images on emulated chips
cargo test --quiet --locked -p mavseal-chips-host

plays over the emulated machine
cargo test --quiet --locked -p mavseal-e2e

fast proofs
cargo xtask proofs --fast

committed inputs of the fuzz targets
(cd fuzz && cargo test --quiet --locked --no-default-features)

fuzz targets, four seconds each
cargo xtask fuzz smoke
"#;

/// What takes long or installs much.
const ALL: &str = r#"
every wrong tag rejected in constant time
cargo test --quiet --locked -p mavseal-chips-host every_wrong_tag -- --ignored --nocapture

100,000 histories of three devices and an adversary
cargo test --quiet --locked --release -p mavseal-proofs --lib d_100_000 -- --ignored

any two power cuts while the marks of a sealed link are provisioned
cargo test --quiet --locked --release -p mavseal-relay --test sealed_marks -- --ignored

packed crates by their own tests
cargo test --quiet --locked -p xtask --test packages -- --ignored

mutants of the cores
cargo mutants --version || cargo install --locked cargo-mutants@27.1.0
mkdir -p $RESULTS/cores $RESULTS/tables
# 3: the tests did not end, which is noticed too.
cargo mutants --output $RESULTS/cores || [ $? -eq 3 ]
cargo mutants --config .cargo/mutants-tables.toml --output $RESULTS/tables || [ $? -eq 3 ]

interoperation with unmodified peers
(cd interop && cargo clippy --quiet --locked --workspace --all-targets -- -D warnings)
# The benchmark is no test: `cargo xtask bench`.
(cd interop && cargo test --quiet --locked --workspace --lib --bins)
cargo xtask interop
"#;

/// Options of `cargo xtask test`.
#[derive(Args)]
pub(crate) struct Options {
    /// Also what takes long or installs much: every wrong tag, 100,000 histories of whole devices, any two power
    /// cuts, packed crates, the mutants of the cores, and unmodified peers
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
        CORE_TARGETS.into_iter().try_for_each(setup::target)?;
        Ok(true)
    });
    checks.shell(STEPS)?;
    if options.all {
        checks.shell(ALL)?;
    }
    let Checks {
        passed,
        skipped,
        failed,
    } = checks;
    println!(
        "\n{passed} passed, {} failed, {skipped} skipped",
        failed.len()
    );
    ensure!(failed.is_empty(), "failed: {}", failed.join(", "));
    Ok(())
}

/// Ends this program, as something is missing.
pub(crate) fn not_run(missing: &str) -> ! {
    eprintln!("not run: {missing}");
    exit(NOT_RUN)
}

#[derive(Default)]
struct Checks {
    passed: usize,
    skipped: usize,
    failed: Vec<String>,
}

impl Checks {
    /// Takes steps from a text like [`STEPS`].
    fn shell(&mut self, steps: &str) -> Result<()> {
        let (keys, results) = (keys()?, Sources::now()?.results);
        for step in steps.trim().split("\n\n") {
            let (name, script) = step.split_once('\n').unwrap_or((step, ""));
            self.step(name, || {
                let mut shell = Command::new("sh");
                shell.current_dir(root()).args(["-exc", script]);
                shell
                    .env("CORES", CORES)
                    .env("FOLDERS", FOLDERS)
                    .env("TARGETS", CORE_TARGETS.join(" "));
                shell.env("RESULTS", &results).env(KEYS_VARIABLE, &keys);
                let status = shell.status()?;
                let not_run = status.code() == Some(NOT_RUN);
                ensure!(not_run || status.success(), "{status}");
                Ok(!not_run)
            });
        }
        Ok(())
    }

    /// Runs a check, which gives false where it could not be made.
    fn step(&mut self, name: &str, check: impl FnOnce() -> Result<bool>) {
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
        let verdict = match result {
            Ok(true) => "ok".to_owned(),
            Ok(false) => "NOT RUN, something is missing".to_owned(),
            Err(ref error) => format!("FAILED, {error:#}"),
        };
        println!(
            "== {name}: {verdict}, {:.1} s",
            start.elapsed().as_secs_f32()
        );
        match result {
            Ok(true) => self.passed += 1,
            Ok(false) => self.skipped += 1,
            Err(_) => self.failed.push(name.to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fails_is_told_and_does_not_keep_others_from_running() -> Result<()> {
        let mut checks = Checks::default();
        let steps = "bad\nfalse\ntrue\n\ngood\ntest -n \"$CORES\"\n\nmissing\nexit 77";
        checks.shell(steps)?;
        assert_eq!((checks.passed, checks.skipped), (1, 1));
        assert_eq!(checks.failed, ["bad"]);
        Ok(())
    }
}
