//! Python with the packages that a command names, in an environment of its own.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use xshell::{Shell, cmd};

use super::{apt, find_program};

/// Finds or makes an environment in `folder` with exactly the packages of `requirements`, a file with
/// the version of each; gives its Python.
///
/// # Errors
/// If there is no Python 3 with `venv` and it cannot be installed, or the packages cannot be had.
pub(crate) fn python(folder: &Path, requirements: &Path) -> Result<PathBuf> {
    let python = folder.join("bin/python");
    let installed = folder.join("requirements.txt");
    let wanted = fs::read(requirements).with_context(|| requirements.display().to_string())?;
    // Written last, so that what was interrupted is begun anew.
    if fs::read(&installed).is_ok_and(|text| text == wanted) && python.is_file() {
        return Ok(python);
    }
    let sh = Shell::new()?;
    let system = with_venv(&sh)?;
    eprintln!("installing {} (pip)", requirements.display());
    cmd!(sh, "{system} -m venv --clear {folder}")
        .quiet()
        .run()?;
    let install = cmd!(
        sh,
        "{python} -m pip install --quiet --disable-pip-version-check --no-deps --requirement {requirements}"
    );
    install.quiet().run().with_context(|| {
        format!(
            "the peers in Python are missing: pip install --no-deps --requirement {}",
            requirements.display()
        )
    })?;
    fs::write(installed, wanted)?;
    Ok(python)
}

/// A Python 3 that can make environments.
fn with_venv(sh: &Shell) -> Result<PathBuf> {
    if let Some(python) = find_program("python3")
        && cmd!(sh, "{python} -c 'import ensurepip, venv'")
            .quiet()
            .ignore_stderr()
            .run()
            .is_ok()
    {
        return Ok(python);
    }
    apt::install("python3-venv")
        .context("Python cannot make environments: apt-get install python3-venv")?;
    // The one that the package is for, whatever stands before it on PATH.
    let python = PathBuf::from("/usr/bin/python3");
    python
        .is_file()
        .then_some(python)
        .context("python3-venv was installed, yet there is no /usr/bin/python3")
}
