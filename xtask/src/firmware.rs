//! `cargo xtask firmware`: builds the images of `chips/` and holds them to their budgets.

use std::{
    env, fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, ensure};
use clap::Args;
use comfy_table::{CellAlignment, Table, presets};
use object::{
    Object, ObjectSection, ObjectSymbol,
    elf::{SHF_ALLOC, SHF_WRITE, SHT_NOBITS},
    read::elf::{ElfFile32, SectionHeader},
};

use crate::setup;

/// One program for a microcontroller, as cargo builds it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Image {
    /// `mavseal-` and the name of the directory in `chips/`
    pub(crate) package: &'static str,
    pub(crate) bin: &'static str,
    pub(crate) profile: &'static str,
    pub(crate) features: &'static [&'static str],
    pub(crate) default_features: bool,
    pub(crate) target: &'static str,
}

/// The most that an image may take, in bytes.
struct Budget {
    image: Image,
    flash: u64,
    ram: u64,
}

/// A shipped image: no log, no way to panic.
const fn deployed(bin: &'static str, features: &'static [&'static str]) -> Image {
    Image {
        package: "mavseal-qemu-m7",
        bin,
        profile: "release-deploy",
        features,
        default_features: false,
        target: "thumbv7em-none-eabihf",
    }
}

/// Images that are shipped, and the most that they may take.
const BUDGETS: &[Budget] = &[
    Budget {
        image: deployed("demo", &["common"]),
        flash: 6000,
        ram: 64,
    },
    Budget {
        image: deployed("relay", &["ardupilotmega"]),
        flash: 13_000,
        ram: 64,
    },
];

/// Options of `cargo xtask firmware`.
#[derive(Args, Default)]
pub(crate) struct Options {
    /// Also list the sections of each image
    #[arg(long)]
    sections: bool,
}

/// Builds every image that has a budget and prints what it takes.
///
/// # Errors
/// If an image does not build, is above its budget, can panic, or logs.
pub(crate) fn run(options: &Options) -> Result<()> {
    let mut table = new_table(&[
        "image",
        "profile",
        "flash",
        "budget",
        ".data + .bss",
        "budget",
    ]);
    let mut sections = new_table(&["image", "section", "size"]);
    let mut complaints = Vec::new();
    for Budget { image, flash, ram } in BUDGETS {
        // Stripping takes away no loaded byte, and the symbols say whether the image can panic.
        let unstripped = format!("profile.{}.strip=false", image.profile);
        let elf = build_with(image, &["--config", &unstripped])?;
        let sizes = sizes(&elf)?;
        let name = image.name();
        table.add_row([
            name.clone(),
            image.profile.to_owned(),
            sizes.flash.to_string(),
            flash.to_string(),
            sizes.ram_static.to_string(),
            ram.to_string(),
        ]);
        for section in &sizes.sections {
            sections.add_row([name.clone(), section.name.clone(), section.size.to_string()]);
        }
        if sizes.flash > *flash {
            complaints.push(format!(
                "{name} takes {} bytes of flash, of {flash}",
                sizes.flash
            ));
        }
        if sizes.ram_static > *ram {
            complaints.push(format!(
                "{name} takes {} bytes of RAM, of {ram}",
                sizes.ram_static
            ));
        }
        complaints.extend(
            Symbols::read(&elf)?
                .complaints()
                .map(|complaint| format!("{name} {complaint}")),
        );
    }
    println!("{table}");
    if options.sections {
        println!("{sections}");
    }
    ensure!(complaints.is_empty(), "{}", complaints.join("\n"));
    Ok(())
}

/// Shows that the checks can fail: an image with a log is found to log, and to panic.
///
/// # Errors
/// If it is not.
pub(crate) fn checks_can_fail() -> Result<()> {
    let image = deployed("relay", &["ardupilotmega", "logging"]);
    let unstripped = format!("profile.{}.strip=false", image.profile);
    let found = Symbols::read(&build_with(&image, &["--config", &unstripped])?)?;
    ensure!(!found.logging.is_empty(), "its log was not found");
    ensure!(!found.panicking.is_empty(), "its panics were not found");
    println!(
        "refused, as it must be: {}",
        found.complaints().next().unwrap_or_default()
    );
    Ok(())
}

/// Builds an image; gives the path of the ELF file.
///
/// # Errors
/// If there is no compiler for it, or it does not compile.
pub(crate) fn build(image: &Image) -> Result<PathBuf> {
    build_with(image, &[])
}

fn build_with(image: &Image, arguments: &[&str]) -> Result<PathBuf> {
    let chips = Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name("chips");
    let directory = chips.join(image.directory());
    let toolchain = setup::toolchain(image.target)?;
    let target_dir = match env::var_os("CARGO_TARGET_DIR") {
        Some(shared) => std::path::absolute(shared)?.join("chips"),
        None => chips.join("target"),
    };
    let target_dir = toolchain.target_dir(&target_dir);

    eprintln!(
        "building {} for {} by {toolchain}",
        image.name(),
        image.target
    );
    // From within its directory, so that the configuration in `chips/.cargo` is found.
    let mut cargo = toolchain.cargo("build");
    cargo
        .current_dir(&directory)
        .arg("--manifest-path")
        .arg(directory.join("Cargo.toml"));
    cargo.args([
        "--locked",
        "--quiet",
        "--bin",
        image.bin,
        "--profile",
        image.profile,
    ]);
    cargo.arg("--target-dir").arg(&target_dir).args(arguments);
    if !image.default_features {
        cargo.arg("--no-default-features");
    }
    if !image.features.is_empty() {
        cargo.arg("--features").arg(image.features.join(","));
    }
    let status = cargo
        .status()
        .with_context(|| format!("{toolchain} cannot be run"))?;
    ensure!(
        status.success(),
        "{} does not build by {toolchain}",
        image.name()
    );
    let profile = if image.profile == "dev" {
        "debug"
    } else {
        image.profile
    };
    Ok(target_dir.join(image.target).join(profile).join(image.bin))
}

impl Image {
    fn directory(&self) -> &'static str {
        self.package
            .strip_prefix("mavseal-")
            .unwrap_or(self.package)
    }

    fn name(&self) -> String {
        format!("{}/{}", self.directory(), self.bin)
    }
}

/// What an image takes of a microcontroller, in bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Sizes {
    /// Everything that is written to flash: vectors, code, constants, initial values of `.data`
    pub(crate) flash: u64,
    /// What the linker gives an address in RAM: `.data`, `.bss`, `.uninit`; the stack is not in it
    pub(crate) ram_static: u64,
    pub(crate) sections: Vec<Section>,
}

/// A section that takes flash, RAM or both.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Section {
    pub(crate) name: String,
    pub(crate) size: u64,
}

/// Measures an ELF file.
///
/// # Errors
/// If it cannot be read as a 32-bit little endian ELF file.
pub(crate) fn sizes(elf: &Path) -> Result<Sizes> {
    let data = fs::read(elf).with_context(|| elf.display().to_string())?;
    let mut sizes = Sizes {
        flash: 0,
        ram_static: 0,
        sections: Vec::new(),
    };
    for section in parse(&data, elf)?.sections() {
        let header = section.elf_section_header();
        let endian = object::LittleEndian;
        let flags = header.sh_flags(endian);
        let size = section.size();
        if !flags.contains(SHF_ALLOC) || size == 0 {
            continue;
        }
        if header.sh_type(endian) != SHT_NOBITS {
            sizes.flash += size;
        }
        if flags.contains(SHF_WRITE) {
            sizes.ram_static += size;
        }
        sizes.sections.push(Section {
            name: section.name()?.to_owned(),
            size,
        });
    }
    Ok(sizes)
}

/// The names in an ELF file that tell what an image can do.
#[derive(Clone, Debug, Default)]
pub(crate) struct Symbols {
    /// Functions of `core::panicking`, in plain writing
    pub(crate) panicking: Vec<String>,
    /// Sections of defmt's strings, and the control block of RTT
    pub(crate) logging: Vec<String>,
}

impl Symbols {
    /// Reads the names from an ELF file that is not stripped.
    ///
    /// # Errors
    /// If it cannot be read, or has no symbols.
    pub(crate) fn read(elf: &Path) -> Result<Symbols> {
        let data = fs::read(elf).with_context(|| elf.display().to_string())?;
        let file = parse(&data, elf)?;
        let mut found = Symbols::default();
        let mut count = 0;
        for symbol in file.symbols() {
            let name = symbol.name()?;
            count += usize::from(!name.is_empty());
            let plain = format!("{:#}", rustc_demangle::demangle(name));
            if plain.contains("core::panicking") {
                found.panicking.push(plain);
            } else if name == "_SEGGER_RTT" {
                found.logging.push(plain);
            }
        }
        ensure!(count > 0, "{} is stripped", elf.display());
        for section in file.sections() {
            let name = section.name()?;
            if name.starts_with(".defmt") || name.contains("rtt") {
                found.logging.push(name.to_owned());
            }
        }
        Ok(found)
    }

    fn complaints(&self) -> impl Iterator<Item = String> {
        let panicking = self
            .panicking
            .iter()
            .map(|name| format!("can panic: {name}"));
        panicking.chain(self.logging.iter().map(|name| format!("logs: {name}")))
    }
}

fn parse<'data>(data: &'data [u8], elf: &Path) -> Result<ElfFile32<'data, object::LittleEndian>> {
    ElfFile32::parse(data).with_context(|| format!("{} is no 32-bit ELF file", elf.display()))
}

fn new_table(header: &[&str]) -> Table {
    let mut table = Table::new();
    table
        .load_preset(presets::ASCII_MARKDOWN)
        .set_header(header);
    for (index, name) in header.iter().enumerate() {
        if !["image", "profile", "section"].contains(name)
            && let Some(column) = table.column_mut(index)
        {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}
