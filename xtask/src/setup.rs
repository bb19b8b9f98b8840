//! What the commands need on this machine: found, installed, or named in one line.
//!
//! Nothing here asks a question. Root, and whoever has `sudo` without a password, gets what is
//! missing from the distribution; everybody else gets an error that says what to install.

mod apt;
mod distribution;
mod fuzz;
mod python;

use std::{
    env, fmt,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{Mutex, PoisonError},
};

use anyhow::{Context, Result, bail, ensure};
use xshell::{Shell, cmd};

pub(crate) use fuzz::{CargoFuzz, cargo_fuzz, llvm_tools, rustc_in_use};
pub(crate) use python::python;

/// The machine all firmware for QEMU is built for: MPS2 with the AN500 image, a Cortex-M7.
pub(crate) const MACHINE: &str = "mps2-an500";

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

/// Finds `qemu-system-arm`, or installs it, and checks that it can be [`MACHINE`].
///
/// # Errors
/// If it is missing and may not be installed, or is too old to know the machine.
pub(crate) fn qemu(sh: &Shell) -> Result<PathBuf> {
    let qemu = match find_program("qemu-system-arm") {
        Some(qemu) => qemu,
        None => {
            apt::install(sh, &["qemu-system-arm"])?;
            find_program("qemu-system-arm")
                .context("qemu-system-arm was installed, yet is not on PATH")?
        }
    };
    let machines = cmd!(sh, "{qemu} -machine help").quiet().read()?;
    ensure!(
        machines
            .lines()
            .any(|line| line.split_whitespace().next() == Some(MACHINE)),
        "{} does not know the machine {MACHINE}; a newer QEMU does",
        qemu.display(),
    );
    Ok(qemu)
}

/// A way to compile firmware. [`toolchain`] tries them in the order in which they stand here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Route {
    /// The compiler in use, with the target's core library as rustup installs it.
    Rustup,
    /// The compiler in use, with core built from rustup's component `rust-src`.
    BuildStd,
    /// The distribution's compiler, with core built from the distribution's sources.
    Distribution,
}

impl Route {
    const ALL: [Route; 3] = [Route::Rustup, Route::BuildStd, Route::Distribution];

    fn name(self) -> &'static str {
        match self {
            Route::Rustup => "rustup",
            Route::BuildStd => "build-std",
            Route::Distribution => "distribution",
        }
    }

    /// Which routes to try, given the value of `MAVSEAL_TOOLCHAIN`.
    fn choices(forced: Option<&str>) -> Result<Vec<Route>> {
        let Some(name) = forced.filter(|name| !name.is_empty()) else {
            return Ok(Self::ALL.to_vec());
        };
        let route = Self::ALL.into_iter().find(|route| route.name() == name);
        let route = route.with_context(|| {
            format!("MAVSEAL_TOOLCHAIN is {name:?}; it can be rustup, build-std or distribution")
        })?;
        Ok(vec![route])
    }
}

/// A compiler that makes firmware for one target, and how to call it.
#[derive(Clone, Debug)]
pub(crate) struct Toolchain {
    route: Route,
    target: String,
    description: String,
    cargo: PathBuf,
    /// Given only where `cargo` alone would call another compiler.
    rustc: Option<PathBuf>,
    /// Given only where the target's own default, rustup's `rust-lld`, is missing.
    linker: Option<PathBuf>,
}

/// Finds or installs a compiler for `target`, such as `thumbv7em-none-eabihf`.
///
/// `MAVSEAL_TOOLCHAIN`, one of `rustup`, `build-std` and `distribution`, allows only that way.
///
/// # Errors
/// If none of the ways is open; the message has one reason for each.
pub(crate) fn toolchain(target: &str) -> Result<Toolchain> {
    // Asked for each image; what failed once, such as a download, need not fail again.
    static FOUND: Mutex<Vec<Toolchain>> = Mutex::new(Vec::new());
    let mut found = FOUND.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(toolchain) = found.iter().find(|toolchain| toolchain.target == target) {
        return Ok(toolchain.clone());
    }
    let toolchain = find_toolchain(target)?;
    found.push(toolchain.clone());
    Ok(toolchain)
}

fn find_toolchain(target: &str) -> Result<Toolchain> {
    let forced = env::var("MAVSEAL_TOOLCHAIN").ok();
    let mut reasons = Vec::new();
    for route in Route::choices(forced.as_deref())? {
        let found = match route {
            Route::Rustup => rustup(target),
            Route::BuildStd => build_std(target),
            Route::Distribution => distribution::toolchain(&Shell::new()?, target),
        };
        match found {
            Ok(toolchain) => return Ok(toolchain),
            Err(reason) => reasons.push(format!("{}: {reason:#}", route.name())),
        }
    }
    bail!("no compiler for {target}; {}", reasons.join("; "))
}

fn rustup(target: &str) -> Result<Toolchain> {
    let rustc = Rustc::in_use()?;
    if !rustc.has_target(target) {
        let rustup = find_program("rustup")
            .with_context(|| format!("{rustc} has no {target}, and there is no rustup"))?;
        eprintln!("installing {target} (rustup target add)");
        let mut add = Command::new(rustup);
        add.args(["target", "add", target]);
        let output = add
            .env("RUST_BACKTRACE", "0")
            .stdin(Stdio::null())
            .output()?;
        let said = String::from_utf8_lossy(&output.stderr);
        let error = said.lines().find_map(|line| line.strip_prefix("error: "));
        ensure!(
            output.status.success() && rustc.has_target(target),
            "`rustup target add {target}` failed ({})",
            error.unwrap_or("it gave no reason"),
        );
    }
    Ok(Toolchain {
        route: Route::Rustup,
        target: target.into(),
        description: format!("{rustc} with {target}"),
        cargo: cargo_in_use(),
        rustc: None,
        linker: None,
    })
}

fn build_std(target: &str) -> Result<Toolchain> {
    let rustc = Rustc::in_use()?;
    ensure!(
        rustc.has_sources(),
        "{rustc} has no sources (rustup component add rust-src)"
    );
    let linker = match rustc.rust_lld() {
        Some(_) => None,
        None => Some(distribution::linker(&Shell::new()?, &rustc)?),
    };
    Ok(Toolchain {
        route: Route::BuildStd,
        target: target.into(),
        description: format!("{rustc}, core built from source"),
        cargo: cargo_in_use(),
        rustc: None,
        linker,
    })
}

impl Toolchain {
    /// A call of `cargo <command> --target …`, to which the caller adds what to build.
    ///
    /// Flags stay in the configuration of the firmware's workspace, so the variables that would
    /// override them, and those of an outer cargo, are taken out of the environment.
    pub(crate) fn cargo(&self, verb: &str) -> Command {
        let mut command = Command::new(&self.cargo);
        command.args([verb, "--target", &self.target]);
        for name in [
            "CARGO",
            "RUSTFLAGS",
            "CARGO_ENCODED_RUSTFLAGS",
            "CARGO_BUILD_RUSTFLAGS",
            "CARGO_BUILD_TARGET",
        ] {
            command.env_remove(name);
        }
        command.env_remove(self.target_variable("RUSTFLAGS"));
        if self.route != Route::Rustup {
            // `-Zbuild-std` is unstable; what it does here, build core, has not changed in years.
            command.arg("-Zbuild-std=core").env("RUSTC_BOOTSTRAP", "1");
        }
        if let Some(rustc) = &self.rustc {
            command.env("RUSTC", rustc);
            // What rustup's cargo sets would have this compiler load the libraries of the other.
            command
                .env_remove("LD_LIBRARY_PATH")
                .env_remove("RUSTUP_TOOLCHAIN")
                .env_remove("RUSTDOC");
        }
        if let Some(linker) = &self.linker {
            command.env(self.target_variable("LINKER"), linker);
        }
        command
    }

    /// The directory for what this compiler makes, in the `target` directory of a workspace:
    /// two compilers that share one would build everything anew at each change.
    pub(crate) fn target_dir(&self, target: &Path) -> PathBuf {
        match self.route {
            Route::Rustup | Route::BuildStd => target.to_owned(),
            Route::Distribution => target.join(self.route.name()),
        }
    }

    fn target_variable(&self, key: &str) -> String {
        format!(
            "CARGO_TARGET_{}_{key}",
            self.target.to_uppercase().replace('-', "_")
        )
    }
}

impl fmt::Display for Toolchain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.description)
    }
}

/// A compiler on this machine: what it says of itself, and where its libraries are.
struct Rustc {
    version: Version,
    host: String,
    llvm: u32,
    sysroot: PathBuf,
}

impl Rustc {
    /// The compiler that called this program, or would.
    fn in_use() -> Result<Rustc> {
        let rustc = env::var_os("RUSTC").map_or_else(|| PathBuf::from("rustc"), PathBuf::from);
        Rustc::at(&rustc)
    }

    fn at(program: &Path) -> Result<Rustc> {
        let ask = |arguments: &[&str]| {
            let output = Command::new(program)
                .args(arguments)
                .stdin(Stdio::null())
                .output();
            let output = output.with_context(|| format!("{} cannot be run", program.display()))?;
            anyhow::Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
        };
        let sysroot = ask(&["--print", "sysroot"])?;
        Rustc::parse(&ask(&["--version", "--verbose"])?, sysroot.into())
            .with_context(|| format!("{} does not tell its version", program.display()))
    }

    /// Parses what `rustc --version --verbose` says.
    fn parse(text: &str, sysroot: PathBuf) -> Option<Rustc> {
        let field = |name| text.lines().find_map(|line| line.strip_prefix(name));
        Some(Rustc {
            version: Version::parse(field("release: ")?)?,
            host: field("host: ")?.to_owned(),
            llvm: field("LLVM version: ")?.split('.').next()?.parse().ok()?,
            sysroot,
        })
    }

    fn has_target(&self, target: &str) -> bool {
        self.rustlib().join(target).join("lib").is_dir()
    }

    fn has_sources(&self) -> bool {
        self.rustlib().join("src/rust/library/core").is_dir()
    }

    fn rust_lld(&self) -> Option<PathBuf> {
        let lld = self.rustlib().join(&self.host).join("bin/rust-lld");
        lld.is_file().then_some(lld)
    }

    fn rustlib(&self) -> PathBuf {
        self.sysroot.join("lib/rustlib")
    }
}

impl fmt::Display for Rustc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "rustc {}", self.version)
    }
}

/// A version of three numbers, with whatever else a package's version has left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Version(u32, u32, u32);

impl Version {
    /// Parses `1.88`, `1.95.0`, `1.97.0-nightly` and `1:1.96.0+dfsg1-1~deb12u2`.
    fn parse(text: &str) -> Option<Version> {
        let text = text
            .split_once(':')
            .map_or(text, |(_epoch, version)| version);
        let end = text
            .find(|c: char| !c.is_ascii_digit() && c != '.')
            .unwrap_or(text.len());
        let mut numbers = text[..end]
            .split('.')
            .filter(|part| !part.is_empty())
            .map(str::parse);
        let mut next = || numbers.next().transpose().ok();
        Some(Version(next()??, next()??, next()?.unwrap_or(0)))
    }

    /// The oldest compiler that the workspace allows.
    fn oldest() -> Version {
        Version::parse(env!("CARGO_PKG_RUST_VERSION")).expect("the manifest has a rust-version")
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}.{}", self.0, self.1, self.2)
    }
}

/// The cargo that called this program, or would.
fn cargo_in_use() -> PathBuf {
    env::var_os("CARGO").map_or_else(|| PathBuf::from("cargo"), PathBuf::from)
}

fn find_program(name: &str) -> Option<PathBuf> {
    env::split_paths(&env::var_os("PATH")?)
        .map(|directory| directory.join(name))
        .find(|path| path.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_of_compilers_and_packages() {
        assert_eq!(Version::parse("1.88"), Some(Version(1, 88, 0)));
        assert_eq!(Version::parse("1.97.0-nightly"), Some(Version(1, 97, 0)));
        assert_eq!(
            Version::parse("1:1.96.1+dfsg1-1~deb12u2"),
            Some(Version(1, 96, 1))
        );
        assert_eq!(Version::parse("(none)"), None);
        assert_eq!(Version::parse("2"), None);
        assert!(Version(1, 100, 0) > Version(1, 96, 3));
        assert!(Version::oldest() >= Version(1, 85, 0), "edition 2024");
    }

    #[test]
    fn a_compiler_describes_itself() {
        let text = "rustc 1.96.0 (ac68faa20 2026-05-25) (built from a source tarball)\nbinary: rustc\n\
            commit-hash: ac68faa20\nhost: x86_64-unknown-linux-gnu\nrelease: 1.96.0\nLLVM version: 22.1.8\n";
        let rustc = Rustc::parse(text, "/usr".into()).unwrap();
        assert_eq!(rustc.to_string(), "rustc 1.96.0");
        assert_eq!(rustc.llvm, 22);
        assert_eq!(rustc.rustlib(), Path::new("/usr/lib/rustlib"));
    }

    #[test]
    fn one_way_can_be_forced() {
        assert_eq!(Route::choices(None).unwrap(), Route::ALL);
        assert_eq!(Route::choices(Some("")).unwrap(), Route::ALL);
        assert_eq!(
            Route::choices(Some("distribution")).unwrap(),
            [Route::Distribution]
        );
        assert!(Route::choices(Some("debian")).is_err());
    }
}
