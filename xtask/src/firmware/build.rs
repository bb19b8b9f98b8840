//! Builds the programs of `chips/`.

use std::{
    env, fmt, fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, ensure};
use mavseal_keys::KeyFile;

use crate::setup::{self, root};

/// Names the key file to images that seal: `chips/qemu-m7/build.rs`.
pub(crate) const KEYS_VARIABLE: &str = "MAVSEAL_KEYS";

/// A microcontroller, each with a crate in `chips/`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Chip {
    QemuM7,
    Stm32c092rc,
}

impl Chip {
    pub(crate) const ALL: [Chip; 2] = [Chip::QemuM7, Chip::Stm32c092rc];

    /// Its directory in `chips/`.
    pub(crate) fn directory(self) -> &'static str {
        match self {
            Chip::QemuM7 => "qemu-m7",
            Chip::Stm32c092rc => "stm32c092rc",
        }
    }

    pub(crate) fn target(self) -> &'static str {
        match self {
            Chip::QemuM7 => "thumbv7em-none-eabihf",
            Chip::Stm32c092rc => "thumbv6m-none-eabi",
        }
    }
}

/// How SHA-256 is compiled: sha2's software backend with its rounds in a loop, or written out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rounds {
    /// As `chips/.cargo/config.toml` has it.
    Looped,
    Unrolled,
}

impl Rounds {
    /// Flags of the compiler that stand for those of the configuration.
    const UNROLLED_FLAGS: &str = "--cfg=sha2_backend=\"soft\"";
}

impl fmt::Display for Rounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Rounds::Looped => "compact",
            Rounds::Unrolled => "unrolled",
        })
    }
}

/// How an image signs, or seals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Profile {
    Hmac,
    Standard,
    AesGcm,
}

impl fmt::Display for Profile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Profile::Hmac => "Hmac",
            Profile::Standard => "Standard",
            Profile::AesGcm => "AES-GCM",
        })
    }
}

/// One program for a microcontroller, as cargo builds it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Image {
    pub(crate) chip: Chip,
    pub(crate) bin: &'static str,
    pub(crate) profile: &'static str,
    pub(crate) rounds: Rounds,
    pub(crate) features: &'static [&'static str],
    pub(crate) default_features: bool,
}

impl Image {
    pub(crate) fn tags(&self) -> Profile {
        if self.features.contains(&"sealing") {
            Profile::AesGcm
        } else if self.features.contains(&"standard-signature") {
            Profile::Standard
        } else {
            Profile::Hmac
        }
    }
}

impl fmt::Display for Image {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.chip.directory(), self.bin)
    }
}

/// Builds an image; gives the path of the ELF file. One that seals gets keys that were made once for
/// this machine.
///
/// # Errors
/// If there is no compiler for it, or it does not compile.
pub(crate) fn build(image: &Image) -> Result<PathBuf> {
    build_with(image, &keys()?)
}

/// The file with the keys of images that are only looked at.
///
/// # Errors
/// If there is none and none can be made.
pub(crate) fn keys() -> Result<PathBuf> {
    let path = setup::target_dir()?.join("keys.toml");
    if !path.exists() {
        fs::create_dir_all(setup::target_dir()?)?;
        KeyFile::generate(2)?.write_new(&path)?;
    }
    Ok(path)
}

/// Builds an image as [`build`] does, with the keys in the file `keys` if it seals.
///
/// # Errors
/// As [`build`].
pub(crate) fn build_with(image: &Image, keys: &Path) -> Result<PathBuf> {
    let chips = root().join("chips");
    let directory = chips.join(image.chip.directory());
    let mut target_dir = match env::var_os("CARGO_TARGET_DIR") {
        Some(shared) => std::path::absolute(shared)?.join("chips"),
        None => chips.join("target"),
    };
    eprintln!("building {image} for {}", image.chip.target());
    // From within its directory, so that the configuration in `chips/.cargo` is found.
    let mut cargo = setup::cargo_for(image.chip.target(), "build")?;
    cargo
        .current_dir(&directory)
        .env(KEYS_VARIABLE, keys)
        .arg("--manifest-path")
        .arg(directory.join("Cargo.toml"));
    if image.rounds == Rounds::Unrolled {
        target_dir = target_dir.join("unrolled");
        cargo.env("CARGO_ENCODED_RUSTFLAGS", Rounds::UNROLLED_FLAGS);
    }
    cargo.args(["--locked", "--quiet", "--bin", image.bin]);
    cargo.args(["--profile", image.profile]);
    cargo.arg("--target-dir").arg(&target_dir);
    if !image.default_features {
        cargo.arg("--no-default-features");
    }
    if !image.features.is_empty() {
        cargo.arg("--features").arg(image.features.join(","));
    }
    let status = cargo.status().context("cargo cannot be run")?;
    ensure!(status.success(), "{image} does not build");
    let profile = if image.profile == "dev" {
        "debug"
    } else {
        image.profile
    };
    let folder = target_dir.join(image.chip.target()).join(profile);
    Ok(folder.join(image.bin))
}
