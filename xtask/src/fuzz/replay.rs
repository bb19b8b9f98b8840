//! Targets over their files, without an engine: the example `replay` of `fuzz/`.

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

use anyhow::{Context, Result, ensure};

/// The example, built from one copy of the sources.
pub(super) struct ReplayGuard {
    tree: PathBuf,
    pub(super) program: PathBuf,
}

impl ReplayGuard {
    /// Builds it in `target_dir`, with more `flags` for the compiler.
    ///
    /// # Errors
    /// If it does not compile.
    pub(super) fn build(tree: &Path, target_dir: &Path, flags: &str) -> Result<Self> {
        let mut cargo = Command::new("cargo");
        cargo.current_dir(tree.join("fuzz"));
        cargo.args([
            "build",
            "--quiet",
            "--locked",
            "--release",
            "--no-default-features",
        ]);
        cargo
            .args(["--example", "replay", "--target-dir"])
            .arg(target_dir);
        cargo.env_remove("CARGO_ENCODED_RUSTFLAGS");
        cargo.env("RUSTFLAGS", flags);
        // What build scripts and macros say of themselves is not asked for.
        cargo.env("LLVM_PROFILE_FILE", target_dir.join("build.profraw"));
        succeed(&mut cargo)?;
        Ok(Self {
            tree: tree.to_owned(),
            program: target_dir.join("release/examples/replay"),
        })
    }

    /// A run of a target over those of `folders` of `fuzz/` that it has: prints an error that came out in
    /// each line.
    pub(super) fn command(&self, target: &str, folders: &[&str]) -> Command {
        let mut replay = Command::new(&self.program);
        let folders = folders
            .iter()
            .map(|folder| self.tree.join("fuzz").join(folder).join(target));
        replay
            .arg(target)
            .args(folders.filter(|folder| folder.is_dir()));
        replay
    }

    /// Which files in a folder of `fuzz/` are too short to be inputs of the target.
    ///
    /// # Errors
    /// If the target fails on one that is.
    pub(super) fn no_inputs(&self, target: &str, folder: &str) -> Result<Vec<PathBuf>> {
        let output = run(&mut self.command(target, &[folder]))?;
        let said = String::from_utf8(output.stderr)?;
        let names = said.lines().filter_map(|line| line.strip_prefix(NO_INPUT));
        Ok(names.map(PathBuf::from).collect())
    }
}

/// What the example says before the name of such a file.
const NO_INPUT: &str = "no input: ";

/// What `command` printed, if it succeeded.
///
/// # Errors
/// If it did not.
pub(super) fn succeed(command: &mut Command) -> Result<String> {
    Ok(String::from_utf8(run(command)?.stdout)?)
}

fn run(command: &mut Command) -> Result<Output> {
    let output = command.output().with_context(|| format!("{command:?}"))?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{command:?}: {said}");
    Ok(output)
}
