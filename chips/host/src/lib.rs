//! Builds the programs of `chips/`, for tests and tools on the host.

use std::{
    env, fmt, fs,
    path::{Path, PathBuf},
    process::Command,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, ensure};
use mavseal_keys::KeyFile;

/// Names the key file to an image that seals: `chips/qemu-m7/build.rs`.
pub const KEYS_VARIABLE: &str = "MAVSEAL_KEYS";

/// Flags of the compiler that stand for those in `chips/.cargo/config.toml`.
const UNROLLED: &str = "--cfg=sha2_backend=\"soft\"";

/// Variables that would override what the firmware's workspace says.
const OUTER: [&str; 6] = [
    "CARGO",
    "CARGO_BUILD_RUSTFLAGS",
    "CARGO_BUILD_TARGET",
    "CARGO_ENCODED_RUSTFLAGS",
    "CARGO_MANIFEST_DIR",
    "RUSTFLAGS",
];

/// A microcontroller, each with a crate in `chips/`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chip {
    /// The Cortex-M7 of QEMU's MPS2-AN500 board.
    QemuM7,
    /// The Cortex-M0+ of ST's NUCLEO-C092RC board.
    Stm32c092rc,
}

impl Chip {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::QemuM7, Self::Stm32c092rc];

    /// The name of its folder in `chips/`.
    #[must_use]
    pub const fn folder(self) -> &'static str {
        match self {
            Self::QemuM7 => "qemu-m7",
            Self::Stm32c092rc => "stm32c092rc",
        }
    }

    /// The compiler's name of the target.
    #[must_use]
    pub const fn target(self) -> &'static str {
        match self {
            Self::QemuM7 => "thumbv7em-none-eabihf",
            Self::Stm32c092rc => "thumbv6m-none-eabi",
        }
    }
}

/// One program for a microcontroller, as cargo builds it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Image {
    /// What it runs on.
    pub chip: Chip,
    /// Which program of the chip's crate.
    pub bin: &'static str,
    /// cargo's profile.
    pub profile: &'static str,
    /// cargo's features, with commas between them.
    pub features: &'static str,
    /// Whether the default features are on too: a dialect, and a log.
    pub default_features: bool,
    /// Whether the rounds of SHA-256 are written out. Otherwise they are a loop, as
    /// `chips/.cargo/config.toml` has it.
    pub unrolled: bool,
}

impl Image {
    /// An image as it is shipped: without a log.
    #[must_use]
    pub const fn shipped(chip: Chip, bin: &'static str, features: &'static str) -> Self {
        Self {
            chip,
            bin,
            profile: "release-deploy",
            features,
            default_features: false,
            unrolled: false,
        }
    }

    /// An image that logs.
    #[must_use]
    pub const fn logging(chip: Chip, bin: &'static str, features: &'static str) -> Self {
        Self {
            profile: "release",
            default_features: true,
            ..Self::shipped(chip, bin, features)
        }
    }

    /// Builds it; gives the path of an ELF file that no other build overwrites, except one of the same image.
    /// If it seals, it gets keys that were made once for this folder.
    ///
    /// # Errors
    ///
    /// If it does not compile.
    pub fn build(&self) -> Result<PathBuf> {
        let folder = target_folder()?.join("images");
        fs::create_dir_all(&folder)?;
        let elf = folder.join(self.to_string().replace(['/', ',', ' '], "-") + ".elf");
        self.build_to(&elf, &keys()?)?;
        Ok(elf)
    }

    /// Builds it, with the keys in the file `keys` if it seals, and copies the ELF file to `elf`.
    ///
    /// # Errors
    ///
    /// If it does not compile.
    pub fn build_to(&self, elf: &Path, keys: &Path) -> Result<()> {
        // Images with other features have the same name where cargo puts them. No other process may
        // build one before this one is copied.
        let _lock = lock()?;
        eprintln!("building {self}");
        let mut target_folder = target_folder()?;
        // From within its folder, so that the configurations of `chips/` are found.
        let mut cargo = Command::new("cargo");
        cargo.current_dir(chips().join(self.chip.folder()));
        for variable in OUTER {
            cargo.env_remove(variable);
        }
        if self.unrolled {
            // Where the other flags are, each change of them would build everything again.
            target_folder.push("unrolled");
            cargo.env("CARGO_ENCODED_RUSTFLAGS", UNROLLED);
        }
        cargo
            .env(KEYS_VARIABLE, std::path::absolute(keys)?)
            .args(["build", "--locked", "--quiet", "--bin", self.bin])
            .args(["--profile", self.profile, "--features", self.features])
            .args(["--target", self.chip.target(), "--target-dir"])
            .arg(&target_folder);
        if !self.default_features {
            cargo.arg("--no-default-features");
        }
        let begun = Instant::now();
        let status = cargo.status().context("cargo cannot be run")?;
        let took = begun.elapsed();
        if took > Duration::from_secs(3) {
            eprintln!("  {:.0} s", took.as_secs_f32());
        }
        ensure!(status.success(), "{self} does not build");
        let built = target_folder
            .join(self.chip.target())
            .join(self.profile)
            .join(self.bin);
        // Who reads the file that was there before reads it to its end.
        let copy = elf.with_extension("new");
        fs::copy(&built, &copy).with_context(|| built.display().to_string())?;
        fs::rename(copy, elf).with_context(|| elf.display().to_string())
    }
}

impl fmt::Display for Image {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{} {}", self.chip.folder(), self.bin, self.profile)?;
        if !self.features.is_empty() {
            write!(f, " {}", self.features)?;
        }
        f.write_str(if self.unrolled { " unrolled" } else { "" })
    }
}

/// The file with the keys of images that are only looked at.
///
/// # Errors
///
/// If there is none and none can be made.
pub fn keys() -> Result<PathBuf> {
    let _lock = lock()?;
    let path = target_folder()?.join("keys.toml");
    if !path.exists() {
        KeyFile::generate(2)?.write_new(&path)?;
    }
    Ok(path)
}

/// Held by one process at a time, until it is dropped.
fn lock() -> Result<fs::File> {
    let folder = target_folder()?;
    fs::create_dir_all(&folder)?;
    let file = fs::File::create(folder.join("images.lock"))?;
    file.lock()?;
    Ok(file)
}

/// The folder `chips/` of the project.
fn chips() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Where firmware is built.
fn target_folder() -> Result<PathBuf> {
    Ok(match env::var_os("CARGO_TARGET_DIR") {
        Some(shared) => std::path::absolute(shared)?.join("chips"),
        None => chips().join("target"),
    })
}
