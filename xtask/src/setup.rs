//! What the commands need on this machine: found, or got without a question.

mod apt;
mod python;
mod qemu;

use std::{
    env,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail};
use xshell::{Shell, cmd};

pub(crate) use python::venv;
pub(crate) use qemu::qemu;

/// The project's folder.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Where cargo puts what it makes.
///
/// # Errors
/// If cargo does not say.
pub(crate) fn target_dir() -> Result<PathBuf> {
    let mut metadata = cargo_metadata::MetadataCommand::new();
    metadata.manifest_path(root().join("Cargo.toml")).no_deps();
    Ok(metadata.exec()?.target_directory.into())
}

/// Finds the core library of a target such as `thumbv7em-none-eabihf`, or installs it.
///
/// # Errors
/// If rustup cannot.
pub(crate) fn target(target: &str) -> Result<()> {
    let sysroot = run("rustc", &["--print", "sysroot"], root())?;
    let library = Path::new(sysroot.trim()).join("lib/rustlib").join(target);
    if library.is_dir() {
        return Ok(());
    }
    step(&format!("installing {target} (rustup)"), || {
        let installed = run("rustup", &["target", "add", target], root());
        installed.with_context(|| format!("firmware needs `rustup target add {target}`"))
    })?;
    Ok(())
}

/// Says what is done, and how long it took if that was long.
fn step<T>(what: &str, action: impl FnOnce() -> Result<T>) -> Result<T> {
    eprintln!("{what}");
    let start = Instant::now();
    let result = action();
    if start.elapsed() > Duration::from_secs(3) {
        eprintln!("  {:.0} s", start.elapsed().as_secs_f32());
    }
    result
}

/// Runs a program in a folder; gives what it prints.
///
/// # Errors
/// If it fails: what it says of that, and what apt would have to remove.
fn run(program: &str, arguments: &[&str], folder: impl AsRef<Path>) -> Result<String> {
    let sh = Shell::new()?;
    sh.change_dir(folder);
    let command = cmd!(sh, "{program} {arguments...}").env("LC_ALL", "C");
    let output = command.quiet().ignore_status().output()?;
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    if output.status.success() {
        return Ok(said);
    }
    let mut removed = said.lines().skip_while(|line| !line.ends_with("REMOVED:"));
    let removed = removed
        .nth(1)
        .map(|names| format!("it would remove {};", names.trim()));
    let errors = String::from_utf8_lossy(&output.stderr);
    let errors = errors.lines().filter(|line| !line.starts_with("W: "));
    let reason: Vec<&str> = removed.as_deref().into_iter().chain(errors).collect();
    bail!("{}", reason.join(" "))
}

/// The program of this name on PATH.
fn find_program(name: &str) -> Option<PathBuf> {
    env::split_paths(&env::var_os("PATH")?)
        .map(|directory| directory.join(name))
        .find(|path| path.is_file())
}
