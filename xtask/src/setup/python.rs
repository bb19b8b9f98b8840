//! A Python that can make environments.

use anyhow::Result;

use super::{apt, run};

/// Finds a Python 3 with `venv`, as `interop/python/environment` does, or installs it.
///
/// # Errors
/// If there is none and it cannot be installed.
pub(crate) fn venv() -> Result<()> {
    let can = |python| run(python, &["-c", "import ensurepip, venv"], ".").is_ok();
    if can("python3") || can("/usr/bin/python3") {
        return Ok(());
    }
    apt::install("python3-venv")
}
