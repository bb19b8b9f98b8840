//! QEMU: on PATH, installed, or unpacked below `target/`.

use std::{
    fs::{self, Permissions},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, ensure};

use super::{apt, find_program, run, target_dir};

const PROGRAM: &str = "qemu-system-arm";
/// Runs the QEMU of the folder `root` beside it, with the libraries that are there.
const SCRIPT: &str = r#"#!/bin/sh
root=$(dirname "$(realpath "$0")")/root
LD_LIBRARY_PATH=$(find "$root" -name '*.so*' -printf '%h\n' | sort -u | paste -sd:)
export LD_LIBRARY_PATH
exec "$root/usr/bin/qemu-system-arm" -L "$root/usr/share/qemu" "$@"
"#;

/// Finds QEMU where `e2e` looks for it, or gets it: on PATH, or as `target/qemu/qemu-system-arm`.
///
/// # Errors
/// If it cannot be had, or does not know the machine that the firmware is for.
pub(crate) fn qemu() -> Result<()> {
    let unpacked = target_dir()?.join("qemu").join(PROGRAM);
    let known = match find_program(PROGRAM) {
        Some(qemu) => knows_machine(&qemu),
        None if knows_machine(&unpacked).is_ok() => Ok(()),
        None => knows_machine(&get(&unpacked)?),
    };
    known.context("QEMU cannot be used")
}

/// Installs QEMU, or unpacks it with the script `unpacked` beside it; gives what runs it.
fn get(unpacked: &Path) -> Result<PathBuf> {
    let missing = format!("{PROGRAM} is missing");
    let has_apt = find_program("apt-get").is_some();
    ensure!(has_apt, "{missing}: install QEMU for Arm");
    eprintln!("{missing}");
    let reason = match apt::install(PROGRAM) {
        Ok(()) => return find_program(PROGRAM).context("it is installed, yet not on PATH"),
        Err(reason) => reason,
    };
    eprintln!("not installed: {reason:#}");
    let root = unpacked.with_file_name("root");
    let sudo = if apt::is_root() { "" } else { "sudo " };
    let advice = format!("{missing}: {sudo}apt-get install {PROGRAM}");
    apt::unpack(PROGRAM, &root).context(advice)?;
    fs::write(unpacked, SCRIPT)?;
    fs::set_permissions(unpacked, Permissions::from_mode(0o755))?;
    Ok(unpacked.to_owned())
}

/// Whether this QEMU starts, and has the machine.
fn knows_machine(qemu: &Path) -> Result<()> {
    let machines = run(&qemu.display().to_string(), &["-machine", "help"], ".")?;
    let known = machines.lines().any(|line| line.starts_with("mps2-an500 "));
    ensure!(
        known,
        "{} does not know the machine mps2-an500; a newer one does",
        qemu.display()
    );
    Ok(())
}
