//! What the sources of the cores say about themselves: kinds of errors, and code that is not counted.

use std::{collections::BTreeSet, fs, path::Path};

use anyhow::Result;

use crate::proofs::fingerprint::rust_files;

/// How things look when printed is not counted.
const PRINTING: [&str; 2] = ["fmt::Display for ", "fmt::Debug for "];
/// Nor are the private `const fn` of this file: the compiler runs them, for each choice of features, and
/// no program can.
const AT_COMPILE_TIME: &str = "mavlink/src/dialect/mod.rs";

/// Every variant of every error in `folders`, such as `VerifyError::BadTag`: of enumerations called
/// so, and of the relay's `RejectReason`.
///
/// # Errors
/// If a source cannot be read.
pub(super) fn error_variants(root: &Path, folders: &[&str]) -> Result<BTreeSet<String>> {
    let mut variants = BTreeSet::new();
    for folder in folders {
        for file in rust_files(&root.join(folder))? {
            variants.extend(variants_in(&fs::read_to_string(file)?));
        }
    }
    Ok(variants)
}

fn variants_in(text: &str) -> Vec<String> {
    let mut variants = Vec::new();
    let mut open = None;
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("pub enum ") {
            let name = word(rest);
            open = (name.ends_with("Error") || name == "Rejection").then_some(name);
        } else if line == "}" {
            open = None;
        } else if let (Some(name), Some(variant)) = (open, line.strip_prefix("    "))
            && variant.starts_with(|c: char| c.is_ascii_uppercase())
        {
            variants.push(format!("{name}::{}", word(variant)));
        }
    }
    variants
}

/// The name at the front of `text`.
fn word(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_alphanumeric());
    &text[..end.unwrap_or(text.len())]
}

/// The lines of `file` that coverage does not count, from 1.
pub(super) fn not_counted(file: &str, text: &str) -> BTreeSet<usize> {
    let begins = |line: &str| {
        let printing = PRINTING.iter().any(|of| line.contains(of));
        line.starts_with("impl") && printing
            || line.starts_with("const fn") && file == AT_COMPILE_TIME
    };
    let mut lines = BTreeSet::new();
    let mut inside = false;
    for (number, line) in (1..).zip(text.lines()) {
        inside |= begins(line);
        if inside {
            lines.insert(number);
        }
        inside &= line != "}";
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_and_how_they_look() {
        let text = "/// Why.\npub enum SomeError<T> {\n    /// So.\n    One(T),\n    Two,\n}\n\
            pub enum Other {\n    Three,\n}\n\
            impl<T> fmt::Display for SomeError<T> {\n    fn fmt() {}\n}\nfn counted() {}\n";
        assert_eq!(variants_in(text), ["SomeError::One", "SomeError::Two"]);
        assert_eq!(Vec::from_iter(not_counted("a.rs", text)), [10, 11, 12]);
        let text = "const fn a() {\n}\npub const fn b() {\n}\n";
        assert!(not_counted("a.rs", text).is_empty());
        assert_eq!(Vec::from_iter(not_counted(AT_COMPILE_TIME, text)), [1, 2]);
    }
}
