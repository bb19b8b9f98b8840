//! Packages of Debian and Ubuntu: what there is, and installing without a question.

use std::sync::Once;

use anyhow::{Context, Result, bail};
use xshell::{Shell, cmd};

use super::find_program;

/// Installs `packages`, after one `apt-get update` if the lists do not have them all.
///
/// Nothing is ever removed: where a package would displace another, this fails.
///
/// # Errors
/// If this user may not install, with the command to give to somebody who may.
pub(super) fn install(sh: &Shell, packages: &[&str]) -> Result<()> {
    let list = packages.join(" ");
    let advice = format!("{list} is missing: sudo apt-get install {list}");
    let Some(rights) = Rights::of_this_user(sh) else {
        bail!(advice)
    };
    if packages
        .iter()
        .any(|package| candidates(sh, &[package]).is_empty())
    {
        update(sh);
    }
    eprintln!("installing {list} (apt-get)");
    // The lock may be held by the updates that a fresh machine makes by itself.
    let mut command = vec![
        "apt-get",
        "install",
        "--yes",
        "--no-install-recommends",
        "--no-remove",
    ];
    command.extend(["-o", "DPkg::Lock::Timeout=300"]);
    command.extend(packages);
    let mut result = rights.run(sh, &command)?;
    if result.is_err() && update(sh) {
        result = rights.run(sh, &command)?;
    }
    result.map_err(anyhow::Error::msg).context(advice)
}

/// The packages of these names that could be installed, each with its version.
pub(super) fn candidates(sh: &Shell, packages: &[impl AsRef<str>]) -> Vec<(String, String)> {
    if packages.is_empty() {
        return Vec::new();
    }
    let packages = packages.iter().map(AsRef::as_ref);
    let policy = cmd!(sh, "apt-cache policy {packages...}")
        .env("LC_ALL", "C")
        .quiet()
        .ignore_stderr()
        .read();
    parse_policy(&policy.unwrap_or_default())
}

/// The names of all packages that begin so.
pub(super) fn names(sh: &Shell, prefix: &str) -> Vec<String> {
    let names = cmd!(sh, "apt-cache pkgnames {prefix}")
        .quiet()
        .ignore_stderr()
        .read();
    names
        .unwrap_or_default()
        .lines()
        .map(str::to_owned)
        .collect()
}

/// Fetches the lists of packages, at most once in the life of this program; true if it did.
pub(super) fn update(sh: &Shell) -> bool {
    static ONCE: Once = Once::new();
    let mut updated = false;
    ONCE.call_once(|| {
        let Some(rights) = Rights::of_this_user(sh) else {
            return;
        };
        eprintln!("fetching the lists of packages (apt-get update)");
        updated = matches!(rights.run(sh, &["apt-get", "update"]), Ok(Ok(())));
    });
    updated
}

/// How this user installs packages.
#[derive(Clone, Copy)]
enum Rights {
    Root,
    Sudo,
}

impl Rights {
    fn of_this_user(sh: &Shell) -> Option<Rights> {
        find_program("apt-get")?;
        if cmd!(sh, "id -u").quiet().read().is_ok_and(|id| id == "0") {
            return Some(Rights::Root);
        }
        find_program("sudo")?;
        let sudo = cmd!(sh, "sudo -n true")
            .quiet()
            .ignore_stdout()
            .ignore_stderr();
        sudo.run().is_ok().then_some(Rights::Sudo)
    }

    /// Runs a command without questions; the inner error is the last line of its complaint.
    fn run(self, sh: &Shell, command: &[&str]) -> Result<Result<(), String>> {
        let env = "DEBIAN_FRONTEND=noninteractive";
        let command = match self {
            Rights::Root => cmd!(sh, "env {env} {command...}"),
            Rights::Sudo => cmd!(sh, "sudo -n env {env} {command...}"),
        };
        let output = command.quiet().ignore_status().output()?;
        if output.status.success() {
            return Ok(Ok(()));
        }
        let said = String::from_utf8_lossy(&output.stderr);
        let last = said.lines().rfind(|line| !line.trim().is_empty());
        Ok(Err(last.unwrap_or("apt-get failed").to_owned()))
    }
}

/// Parses what `apt-cache policy` says.
fn parse_policy(policy: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut package = None;
    for line in policy.lines() {
        if !line.starts_with(' ') {
            package = line.strip_suffix(':');
        } else if let (Some(package), Some(version)) = (package, line.strip_prefix("  Candidate: "))
            && version != "(none)"
        {
            found.push((package.to_owned(), version.to_owned()));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_can_be_installed_is_a_candidate() {
        let policy = "rustc:\n  Installed: (none)\n  Candidate: 1.63.0+dfsg1-2\n  Version table:\n     \
            1.63.0+dfsg1-2 500\n        500 http://deb.example bookworm/main amd64 Packages\n\
            rustc-mozilla:\n  Installed: (none)\n  Candidate: (none)\n  Version table:\n\
            lld-22:\n  Installed: (none)\n  Candidate: 1:22.1.8-1~deb12u1\n";
        let found = parse_policy(policy);
        let expected = [
            ("rustc", "1.63.0+dfsg1-2"),
            ("lld-22", "1:22.1.8-1~deb12u1"),
        ];
        assert_eq!(
            found,
            expected.map(|(name, version)| (name.to_owned(), version.to_owned()))
        );
    }
}
