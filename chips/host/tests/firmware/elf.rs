//! What an ELF file would write to flash, what it takes, and where its functions and variables are.

use std::{fs, ops::Range, path::Path};

use anyhow::{Context, Result, ensure};
use object::{
    LittleEndian, Object, ObjectSection, ObjectSymbol, SymbolKind,
    elf::{PT_LOAD, SHF_ALLOC, SHF_WRITE, SHT_NOBITS},
    read::elf::{ElfFile32, ProgramHeader, SectionHeader},
};

/// Where QEMU's board models its flash, in RAM that it has and other boards need not.
const FLASH_MODEL: &str = ".uninit";

/// A firmware image as it lies in flash; it can be changed before it is run.
#[derive(Clone)]
pub(crate) struct Elf {
    /// Bytes that are written to flash: vectors, code, constants, initial values of `.data`.
    pub(crate) flash: u64,
    /// Bytes that the linker gives an address in RAM: `.data` and `.bss`; neither the stack nor `.uninit`.
    pub(crate) ram: u64,
    /// What a shipped image must not have: ways to panic, and a log.
    pub(crate) complaints: Vec<String>,
    /// Where in flash it begins, and what is written there.
    pub(crate) start: u32,
    pub(crate) image: Vec<u8>,
    symbols: Vec<Symbol>,
}

/// A function or a variable.
#[derive(Clone)]
pub(crate) struct Symbol {
    /// The path as in the source, without hash.
    pub(crate) path: String,
    pub(crate) address: u32,
    size: u32,
    is_function: bool,
}

impl Elf {
    /// Reads an ELF file with symbols.
    ///
    /// # Errors
    /// If it cannot be read as a 32-bit little endian ELF file, or is stripped.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let data = fs::read(path).with_context(|| path.display().to_string())?;
        let file = ElfFile32::<LittleEndian>::parse(&*data)?;
        let mut elf = Self {
            flash: 0,
            ram: 0,
            complaints: Vec::new(),
            start: 0,
            image: Vec::new(),
            symbols: Vec::new(),
        };
        let parts = file.elf_program_headers().iter();
        let parts = parts.filter(|part| part.p_type(LittleEndian) == PT_LOAD);
        let in_flash = parts.filter(|part| part.p_filesz(LittleEndian) > 0);
        for part in in_flash {
            let (address, bytes) = (part.p_paddr(LittleEndian), part.data(LittleEndian, &*data));
            if elf.image.is_empty() {
                elf.start = address;
            }
            let offset = address.checked_sub(elf.start).context("parts in order")? as usize;
            elf.image.resize(offset, 0xFF);
            elf.image
                .extend(bytes.ok().context("a part outside of the file")?);
        }
        for section in file.sections() {
            let (name, header) = (section.name()?, section.elf_section_header());
            let flags = header.sh_flags(LittleEndian);
            if flags.contains(SHF_ALLOC) && header.sh_type(LittleEndian) != SHT_NOBITS {
                elf.flash += section.size();
            }
            if flags.contains(SHF_ALLOC | SHF_WRITE) && name != FLASH_MODEL {
                elf.ram += section.size();
            }
            if name.starts_with(".defmt") || name.contains("rtt") {
                elf.complaints.push(format!("logs: {name}"));
            }
        }
        for symbol in file.symbols().filter(|symbol| symbol.name() != Ok("")) {
            let path = format!("{:#}", rustc_demangle::demangle(symbol.name()?));
            if path.contains("core::panicking") || path.contains("rust_begin_unwind") {
                elf.complaints.push(format!("can panic: {path}"));
            } else if path == "_SEGGER_RTT" {
                elf.complaints.push(format!("logs: {path}"));
            }
            let is_function = symbol.kind() == SymbolKind::Text;
            elf.symbols.push(Symbol {
                path,
                // A function's lowest bit says that it is Thumb code.
                address: u32::try_from(symbol.address())? & !u32::from(is_function),
                size: u32::try_from(symbol.size())?,
                is_function,
            });
        }
        ensure!(!elf.symbols.is_empty(), "{} is stripped", path.display());
        Ok(elf)
    }

    /// Its functions, those without a size too.
    pub(crate) fn functions(&self) -> impl Iterator<Item = &Symbol> {
        self.symbols.iter().filter(|symbol| symbol.is_function)
    }

    /// The addresses of the only function or variable whose path ends so.
    ///
    /// # Errors
    /// If there is none, or more than one.
    pub(crate) fn find(&self, path: &str) -> Result<Range<u32>> {
        let mut found = self.symbols.iter().filter(|symbol| {
            let before = symbol.path.strip_suffix(path);
            before.is_some_and(|before| before.is_empty() || before.ends_with("::"))
        });
        let symbol = found
            .next()
            .with_context(|| format!("the image has no {path}"))?;
        ensure!(found.next().is_none(), "the image has several {path}");
        Ok(symbol.address..symbol.address + symbol.size)
    }

    /// The bytes of the function or variable at `path`, which lies in flash.
    ///
    /// # Errors
    /// As [`Self::find`]; also if it lies elsewhere.
    pub(crate) fn flash_mut(&mut self, path: &str) -> Result<&mut [u8]> {
        let Range { start, end } = self.find(path)?;
        let offset = |address: u32| address.wrapping_sub(self.start) as usize;
        let bytes = self.image.get_mut(offset(start)..offset(end));
        bytes.with_context(|| format!("{path} is not in flash"))
    }
}
