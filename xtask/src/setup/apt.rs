//! Packages of Debian and Ubuntu: installed, or unpacked below `target/` where they cannot be.

use std::{fs, path::Path};

use anyhow::{Result, ensure};

use super::{run, step};

/// Installs a package. Nothing is removed for it, and nothing is asked.
///
/// # Errors
/// If this user may not, or apt fails; the error has apt's reason.
pub(super) fn install(package: &str) -> Result<()> {
    let may = is_root() || run("sudo", &["-n", "true"], ".").is_ok();
    ensure!(may, "this user may not install packages");
    let apt = |command: &str| {
        let sudo = if is_root() { "" } else { "sudo -n " };
        let command =
            format!("{sudo}env LC_ALL=C DEBIAN_FRONTEND=noninteractive apt-get {command}");
        let command: Vec<&str> = command.split(' ').collect();
        run(command[0], &command[1..], ".")
    };
    // The lock may be held by the updates that a new machine makes by itself.
    let options = "--yes --no-remove --no-install-recommends -o DPkg::Lock::Timeout=300";
    let install = || apt(&format!("install {options} {package}"));
    step(&format!("installing {package} (apt-get install)"), || {
        // The lists of packages may be missing or old.
        install().or_else(|_| apt("update").and_then(|_| install()))
    })?;
    Ok(())
}

/// Whether this is the user who may do everything.
pub(super) fn is_root() -> bool {
    run("id", &["-u"], ".").is_ok_and(|id| id.trim() == "0")
}

/// Unpacks a package, and what it needs that is not installed, into `folder`.
///
/// # Errors
/// If apt cannot get them; the error has its reason.
pub(super) fn unpack(package: &str, folder: &Path) -> Result<()> {
    let parts = folder.with_extension("parts");
    fs::create_dir_all(parts.join("lists/partial"))?;
    fs::create_dir_all(parts.join("cache/archives/partial"))?;
    // Lists of its own: those of the system may be missing or old, and only root can write them.
    let lists = format!("Dir::State::Lists={}", parts.join("lists").display());
    let cache = format!("Dir::Cache={}", parts.join("cache").display());
    // The user that apt has for downloads may have no access to this folder.
    let own = ["-o", &lists, "-o", &cache, "-o", "APT::Sandbox::User=root"];
    let apt = |arguments: &[&str]| run("apt-get", &[&own[..], arguments].concat(), &parts);
    let what = format!("unpacking {package} below {}", folder.display());
    step(&what, || {
        let updated = apt(&["update"]);
        let plan = ["install", "--simulate", "--no-install-recommends", package];
        // One of several sources that fails does not matter if the others have the package.
        let plan = apt(&plan).or_else(|why| updated.and(Err(why)))?;
        let inst = plan.lines().filter_map(|line| line.strip_prefix("Inst "));
        let packages = inst.filter_map(|rest| rest.split(' ').next());
        apt(&["download"].into_iter().chain(packages).collect::<Vec<_>>())?;
        let script = "for deb in *.deb; do dpkg-deb --extract $deb \"$0\" || exit; done";
        run("sh", &["-c", script, &folder.display().to_string()], &parts)?;
        Ok(fs::remove_dir_all(&parts)?)
    })
}
