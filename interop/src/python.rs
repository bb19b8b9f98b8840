//! Python with the packages of a list.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use anyhow::{Context, Result, ensure};

/// The folder of the scripts and lists.
const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/python");

/// A Python with exactly the packages of `list`; they are installed where they are not.
pub(crate) fn environment(list: &str) -> Result<PathBuf> {
    let mut command = Command::new(Path::new(FOLDER).join("environment"));
    let output = command.arg(list).stderr(Stdio::inherit()).output()?;
    ensure!(
        output.status.success(),
        "the packages of {list} are missing"
    );
    Ok(String::from_utf8(output.stdout)?.trim_end().into())
}

/// The folder of an environment, for what else belongs to it.
pub(crate) fn folder(python: &Path) -> Result<&Path> {
    let folder = python.ancestors().nth(2);
    folder.context("a Python of an environment")
}

/// A call of a script of the project.
pub(crate) fn script(python: &Path, name: &str) -> Command {
    let mut command = Command::new(python);
    command.arg(Path::new(FOLDER).join(name));
    command
}

/// The installed version of a package.
pub(crate) fn version(python: &Path, package: &str) -> Result<String> {
    let ask = format!("import importlib.metadata as m; print(m.version('{package}'))");
    let version = Command::new(python).args(["-c", &ask]).output()?;
    ensure!(
        version.status.success(),
        "{} has no {package}",
        python.display()
    );
    Ok(String::from_utf8(version.stdout)?.trim().to_owned())
}
