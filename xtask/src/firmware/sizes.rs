//! What an ELF file takes of a microcontroller, and what its symbols say that it can do.

use std::{fs, path::Path};

use anyhow::{Context, Result, ensure};
use object::{
    Object, ObjectSection, ObjectSymbol,
    elf::{SHF_ALLOC, SHF_WRITE, SHT_NOBITS},
    read::elf::{ElfFile32, SectionHeader},
};

/// Functions that a crate for a chip brings in and that nothing of ours can reach. None does: the
/// register access of stm32-metapac and of volatile-register leaves no check to run time.
const ALLOWED_PANICS: [&str; 0] = [];

/// Where QEMU's board models its flash, in RAM that it has and other boards need not.
const FLASH_MODEL: &str = ".uninit";

/// What an image takes of a microcontroller, in bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Sizes {
    /// Everything that is written to flash: vectors, code, constants, initial values of `.data`
    pub(crate) flash: u64,
    /// What the linker gives an address in RAM: `.data` and `.bss`; neither the stack, nor `.uninit`, which
    /// stands for another flash
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
        let name = section.name()?.to_owned();
        if flags.contains(SHF_WRITE) && name != FLASH_MODEL {
            sizes.ram_static += size;
        }
        sizes.sections.push(Section { name, size });
    }
    Ok(sizes)
}

/// The names in an ELF file that tell what an image can do.
#[derive(Clone, Debug, Default)]
pub(crate) struct Symbols {
    /// Functions of `core::panicking` and the panic handler, in plain writing
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
            let local = format!("{:#}", rustc_demangle::demangle(name));
            let panics = ["core::panicking", "rust_begin_unwind"];
            if panics.iter().any(|name| local.contains(name)) {
                found.panicking.push(local);
            } else if name == "_SEGGER_RTT" {
                found.logging.push(local);
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

    /// What a shipped image must not have.
    pub(crate) fn complaints(&self) -> impl Iterator<Item = String> {
        let panicking = self
            .panicking
            .iter()
            .filter(|name| !ALLOWED_PANICS.contains(&name.as_str()))
            .map(|name| format!("can panic: {name}"));
        panicking.chain(self.logging.iter().map(|name| format!("logs: {name}")))
    }
}

fn parse<'data>(data: &'data [u8], elf: &Path) -> Result<ElfFile32<'data, object::LittleEndian>> {
    ElfFile32::parse(data).with_context(|| format!("{} is no 32-bit ELF file", elf.display()))
}
