//! What an ELF file would write to flash, and where its functions and variables are.

use std::{fs, ops::Range, path::Path};

use anyhow::{Context, Result, bail, ensure};
use object::{
    Object, ObjectSymbol,
    elf::PT_LOAD,
    read::elf::{ElfFile32, ProgramHeader},
};

/// A firmware image as it lies in flash; it can be changed before it is run.
#[derive(Clone)]
pub(super) struct Program {
    /// Address in flash and bytes of each loaded part.
    parts: Vec<(u32, Vec<u8>)>,
    symbols: Vec<Symbol>,
}

/// A function or a variable.
#[derive(Clone)]
struct Symbol {
    /// The path as in the source, without hash.
    path: String,
    address: u32,
    size: u32,
}

impl Program {
    /// Reads an ELF file with symbols.
    ///
    /// # Errors
    /// If it cannot be read as a 32-bit little endian ELF file.
    pub(super) fn read(elf: &Path) -> Result<Program> {
        let data = fs::read(elf).with_context(|| elf.display().to_string())?;
        let file = ElfFile32::<object::LittleEndian>::parse(&*data)
            .with_context(|| format!("{} is no 32-bit ELF file", elf.display()))?;
        let endian = object::LittleEndian;
        let mut parts = Vec::new();
        for header in file.elf_program_headers() {
            if header.p_type(endian) == PT_LOAD && header.p_filesz(endian) > 0 {
                let bytes = header.data(endian, &*data);
                let bytes = bytes.ok().context("a part lies outside of the file")?;
                parts.push((header.p_paddr(endian), bytes.to_vec()));
            }
        }
        let mut symbols = Vec::new();
        for symbol in file.symbols() {
            symbols.push(Symbol {
                path: format!("{:#}", rustc_demangle::demangle(symbol.name()?)),
                // A function's lowest bit says that it is Thumb code.
                address: u32::try_from(symbol.address())?
                    & !u32::from(symbol.kind() == object::SymbolKind::Text),
                size: u32::try_from(symbol.size())?,
            });
        }
        Ok(Program { parts, symbols })
    }

    /// The addresses of the only function or variable whose path ends so.
    ///
    /// # Errors
    /// If there is none, or more than one.
    pub(super) fn find(&self, path: &str) -> Result<Range<u32>> {
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

    /// The bytes at these addresses of flash.
    ///
    /// # Errors
    /// If they are not all in the image.
    pub(super) fn flash_mut(&mut self, addresses: Range<u32>) -> Result<&mut [u8]> {
        for (start, bytes) in &mut self.parts {
            if let Some(offset) = addresses.start.checked_sub(*start)
                && let Some(bytes) = bytes.get_mut(offset as usize..)
                && let Some(bytes) = bytes.get_mut(..addresses.len())
            {
                return Ok(bytes);
            }
        }
        bail!("the image has nothing at {addresses:#010x?}")
    }

    /// The contents of the flash at `addresses`; it is all ones where nothing is written.
    ///
    /// # Errors
    /// If a part of the image lies elsewhere.
    pub(super) fn flash(&self, addresses: &Range<u32>) -> Result<Vec<u8>> {
        let mut flash = vec![0xFF; addresses.len()];
        for (start, bytes) in &self.parts {
            let offset = start
                .checked_sub(addresses.start)
                .map(|offset| offset as usize);
            let place = offset.and_then(|offset| flash.get_mut(offset..)?.get_mut(..bytes.len()));
            place
                .with_context(|| format!("{start:#010x} is not in flash"))?
                .copy_from_slice(bytes);
        }
        Ok(flash)
    }
}
