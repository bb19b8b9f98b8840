//! The compiler, its sources and the linker, as Debian and Ubuntu package them.
//!
//! Their core library is there for the host alone, so core is built from source. Several
//! families of packages hold a compiler: `rustc`, `rustc-web` (Debian's for browsers, kept
//! recent in stable releases) and `rustc-1.89` (Ubuntu).

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use xshell::Shell;

use super::{Route, Rustc, Toolchain, Version, apt};

/// Finds the distribution's compiler with its sources, or installs the newest.
pub(super) fn toolchain(sh: &Shell, target: &str) -> Result<Toolchain> {
    let compiler = match Compiler::find() {
        Some(compiler) => compiler,
        None => {
            let packages = newest_packages(sh)?;
            let packages: Vec<_> = packages.iter().map(String::as_str).collect();
            apt::install(sh, &packages)?;
            Compiler::find()
                .with_context(|| format!("{} are installed, yet not in /usr", packages.join(" ")))?
        }
    };
    // The linker only joins ready objects, so that of the other compiler will do.
    let other = Rustc::in_use().ok().and_then(|rustc| rustc.rust_lld());
    let linker = match compiler.about.rust_lld().or(other) {
        Some(lld) => lld,
        None => linker(sh, &compiler.about)?,
    };
    Ok(Toolchain {
        route: Route::Distribution,
        target: target.into(),
        description: format!("{}'s {}, core built from source", name(), compiler.about),
        cargo: compiler.cargo,
        rustc: Some(compiler.rustc),
        linker: Some(linker),
    })
}

/// Finds the distribution's linker, or installs it.
pub(super) fn linker(sh: &Shell, rustc: &Rustc) -> Result<PathBuf> {
    let installed = || newest_of(in_usr_bin("ld.lld"));
    if let Some(linker) = installed() {
        return Ok(linker);
    }
    let same_llvm = format!("lld-{}", rustc.llvm);
    let package = if apt::candidates(sh, &[&same_llvm]).is_empty() {
        "lld"
    } else {
        &same_llvm
    };
    apt::install(sh, &[package])?;
    installed().context("lld is installed, yet not in /usr/bin")
}

/// A compiler and a cargo of one package family.
struct Compiler {
    rustc: PathBuf,
    cargo: PathBuf,
    about: Rustc,
}

impl Compiler {
    /// The newest in `/usr/bin` that is no proxy of rustup, is new enough, and has its sources.
    fn find() -> Option<Compiler> {
        let all = in_usr_bin("rustc")
            .into_iter()
            .filter_map(|(suffix, rustc)| {
                let cargo = Path::new("/usr/bin").join(format!("cargo{suffix}"));
                let about = Rustc::at(&rustc).ok()?;
                let usable = cargo.is_file()
                    && about.sysroot.starts_with("/usr")
                    && about.version >= Version::oldest()
                    && about.has_sources();
                usable.then_some(Compiler {
                    rustc,
                    cargo,
                    about,
                })
            });
        all.max_by_key(|compiler| compiler.about.version)
    }
}

/// The three packages of the newest family that can be installed.
fn newest_packages(sh: &Shell) -> Result<[String; 3]> {
    let look = || {
        let families: Vec<_> = apt::names(sh, "rustc")
            .iter()
            .filter_map(|name| family(name))
            .collect();
        let packages: Vec<_> = families.iter().flatten().collect();
        newest(&families, &apt::candidates(sh, &packages))
    };
    look()
        .or_else(|| apt::update(sh).then(look).flatten())
        .with_context(|| {
            format!(
                "{} has no packages of rustc {} or newer with cargo and sources (or apt-get update is due)",
                name(),
                Version::oldest()
            )
        })
}

/// Compiler, cargo and sources of the family that a compiler's package belongs to.
fn family(rustc: &str) -> Option<[String; 3]> {
    let suffix = rustc.strip_prefix("rustc")?;
    let known =
        suffix.is_empty() || suffix == "-web" || suffix.strip_prefix("-1.").is_some_and(is_number);
    known.then(|| {
        [
            rustc.to_owned(),
            format!("cargo{suffix}"),
            format!("rust{suffix}-src"),
        ]
    })
}

/// The family with the newest compiler of which every package is a candidate.
fn newest(families: &[[String; 3]], candidates: &[(String, String)]) -> Option<[String; 3]> {
    let version = |package: &String| {
        let (_, version) = candidates.iter().find(|(name, _)| name == package)?;
        Version::parse(version)
    };
    let complete = families
        .iter()
        .filter(|family| family[1..].iter().all(|package| version(package).is_some()));
    let versions = complete.filter_map(|family| Some((version(&family[0])?, family)));
    let (_, family) = versions
        .filter(|(version, _)| *version >= Version::oldest())
        .max()?;
    Some(family.clone())
}

/// Programs of this name in `/usr/bin`, also `name-22` and `name-1.89`, each with its suffix.
fn in_usr_bin(name: &str) -> Vec<(String, PathBuf)> {
    let Ok(entries) = fs::read_dir("/usr/bin") else {
        return Vec::new();
    };
    let found = entries.flatten().filter_map(|entry| {
        let file = entry.file_name().into_string().ok()?;
        let suffix = file.strip_prefix(name)?;
        let number = |text: &str| text.split('.').all(is_number);
        let known = suffix.is_empty() || suffix.strip_prefix('-').is_some_and(number);
        known.then(|| (suffix.to_owned(), entry.path()))
    });
    found.collect()
}

/// The program with the highest number in its suffix.
fn newest_of(programs: Vec<(String, PathBuf)>) -> Option<PathBuf> {
    let number = |suffix: &str| suffix.trim_start_matches('-').parse().unwrap_or(0);
    let newest = programs
        .into_iter()
        .max_by_key(|(suffix, _)| number(suffix));
    newest.map(|(_, program): (String, PathBuf)| program)
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// The first word of the distribution's name, such as `Debian`.
fn name() -> String {
    let text = fs::read_to_string("/etc/os-release").unwrap_or_default();
    let name = text.lines().find_map(|line| line.strip_prefix("NAME="));
    let word = name.and_then(|name| name.trim_matches('"').split(' ').next());
    word.unwrap_or("the distribution").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choose(candidates: &[(&str, &str)]) -> Option<String> {
        let families: Vec<_> = candidates
            .iter()
            .filter_map(|(name, _)| family(name))
            .collect();
        let candidates: Vec<_> = candidates
            .iter()
            .map(|(name, version)| (name.to_string(), version.to_string()))
            .collect();
        newest(&families, &candidates).map(|family| family.join(" "))
    }

    #[test]
    fn the_newest_complete_family_is_chosen() {
        let debian = [
            ("rustc", "1.63.0+dfsg1-2"),
            ("cargo", "0.66.0+ds1-1"),
            ("rust-src", "1.63.0+dfsg1-2"),
            ("rustc-web", "1.96.0+dfsg1-1~deb12u2"),
            ("cargo-web", "1.96.0+dfsg1-1~deb12u2"),
            ("rust-web-src", "1.96.0+dfsg1-1~deb12u2"),
        ];
        assert_eq!(
            choose(&debian).as_deref(),
            Some("rustc-web cargo-web rust-web-src")
        );
        assert_eq!(choose(&debian[..5]), None, "no sources");
        assert_eq!(choose(&debian[..3]), None, "too old");

        let ubuntu = [
            ("rustc-1.89", "1.89.0+dfsg-0ubuntu1"),
            ("cargo-1.89", "1.89.0+dfsg-0ubuntu1"),
            ("rust-1.89-src", "1.89.0+dfsg-0ubuntu1"),
            ("rustc-1.100", "1.100.0+dfsg-0ubuntu1"),
            ("cargo-1.100", "1.100.0+dfsg-0ubuntu1"),
            ("rust-1.100-src", "1.100.0+dfsg-0ubuntu1"),
            ("rustc-1.101-doc", "1.101.0"),
        ];
        assert_eq!(
            choose(&ubuntu).as_deref(),
            Some("rustc-1.100 cargo-1.100 rust-1.100-src")
        );
    }

    #[test]
    fn the_newest_linker_is_chosen() {
        let programs =
            ["", "-9", "-22"].map(|suffix| (suffix.to_owned(), format!("ld.lld{suffix}").into()));
        assert_eq!(
            newest_of(programs.to_vec()),
            Some(PathBuf::from("ld.lld-22"))
        );
    }
}
