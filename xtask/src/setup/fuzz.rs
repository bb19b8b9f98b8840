//! What fuzzing needs: a compiler, cargo-fuzz, and a C++ compiler for the engine.

use std::{env, path::PathBuf, process::Command};

use anyhow::{Context, Result, ensure};
use xshell::{Shell, cmd};

use super::{apt, find_program, root, run};

/// The compilers that will do, by the name that `c++` has there.
const CXX: [&str; 3] = ["c++", "g++", "clang++"];

/// How cargo-fuzz is called.
#[derive(Clone, Debug)]
pub(crate) struct CargoFuzz {
    /// A nightly of rustup's; without it the compiler in use, told to allow what is unstable.
    nightly: Option<String>,
    /// What is built for: the machine that it runs on.
    pub(crate) host: String,
}

/// Finds what fuzzing needs, or installs it; with `stable`, for the compiler in use.
///
/// # Errors
/// If something is missing and cannot be installed, with the command that would.
pub(crate) fn cargo_fuzz(stable: bool) -> Result<CargoFuzz> {
    let sh = Shell::new()?;
    let cargo_fuzz = CargoFuzz {
        nightly: if stable { None } else { nightly(&sh) },
        host: host()?,
    };
    if env::var_os("CXX").is_none() && !CXX.iter().any(|name| find_program(name).is_some()) {
        apt::install("g++").context("a C++ compiler is missing: apt-get install g++")?;
    }
    if !cargo_fuzz.is_there() {
        eprintln!("installing cargo-fuzz (cargo install)");
        let install = cmd!(sh, "cargo install --quiet --locked cargo-fuzz").quiet();
        let advice = "cargo-fuzz is missing: cargo install --locked cargo-fuzz";
        install.run().context(advice)?;
        ensure!(
            cargo_fuzz.is_there(),
            "cargo-fuzz was installed, yet cargo does not find it"
        );
    }
    Ok(cargo_fuzz)
}

/// The nightly that rustup has, if it has one.
fn nightly(sh: &Shell) -> Option<String> {
    let list = cmd!(sh, "rustup toolchain list").quiet().ignore_stderr();
    let list = list.read().ok()?;
    let names = list
        .lines()
        .filter_map(|line| line.split_whitespace().next());
    // A name with a date sorts before the one without, which is the newest.
    let nightly = names.filter(|name| name.starts_with("nightly-")).max();
    nightly.map(str::to_owned)
}

impl CargoFuzz {
    /// A call of `cargo fuzz`, to which the caller adds what to do.
    pub(crate) fn command(&self) -> Command {
        let mut command = match &self.nightly {
            Some(nightly) => {
                let mut rustup = Command::new("rustup");
                rustup.args(["run", nightly, "cargo"]);
                rustup
            }
            None => {
                let mut cargo = Command::new("cargo");
                cargo.env("RUSTC_BOOTSTRAP", "1");
                cargo
            }
        };
        // What an outer cargo says would override what cargo-fuzz says.
        for name in ["CARGO", "CARGO_ENCODED_RUSTFLAGS", "RUSTFLAGS"] {
            command.env_remove(name);
        }
        command.arg("fuzz");
        command
    }

    /// What a developer types for the same.
    pub(crate) fn typed(&self) -> &'static str {
        match self.nightly {
            Some(_) => "cargo +nightly fuzz",
            None => "RUSTC_BOOTSTRAP=1 cargo fuzz",
        }
    }

    /// The compiler, by its version.
    ///
    /// # Errors
    /// If it cannot be asked.
    pub(crate) fn rustc(&self) -> Result<String> {
        let Some(nightly) = &self.nightly else {
            return rustc_in_use();
        };
        let sh = Shell::new()?;
        let version = cmd!(sh, "rustup run {nightly} rustc --version").quiet();
        Ok(version.read()?)
    }

    fn is_there(&self) -> bool {
        let output = self.command().arg("--version").output();
        output.is_ok_and(|output| output.status.success())
    }
}

/// The compiler in use, by its version.
///
/// # Errors
/// If it cannot be asked.
pub(crate) fn rustc_in_use() -> Result<String> {
    let version = run("rustc", &["--version"], root())?;
    Ok(version.split(' ').take(2).collect::<Vec<_>>().join(" "))
}

/// What the compiler in use builds for unless it is told otherwise.
fn host() -> Result<String> {
    let about = run("rustc", &["--version", "--verbose"], root())?;
    let host = about.lines().find_map(|line| line.strip_prefix("host: "));
    Ok(host.context("rustc names no host")?.to_owned())
}

/// The folder of `llvm-profdata` and `llvm-cov`, of the version that the compiler in use has.
///
/// # Errors
/// If rustup's component is missing and cannot be installed.
pub(crate) fn llvm_tools() -> Result<PathBuf> {
    let sysroot = run("rustc", &["--print", "sysroot"], root())?;
    let library = PathBuf::from(sysroot.trim()).join("lib/rustlib");
    let folder = library.join(host()?).join("bin");
    if !folder.join("llvm-cov").is_file() {
        let sh = Shell::new()?;
        let add = cmd!(sh, "rustup component add llvm-tools").run();
        add.context("llvm-cov is missing: rustup component add llvm-tools")?;
    }
    Ok(folder)
}
