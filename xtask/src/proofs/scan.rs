//! Harnesses and property tests in a package's sources, with their paths; no compiler needed.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, anyhow};
use proc_macro2::{Delimiter, TokenStream, TokenTree};

use super::{fingerprint::rust_files, plan::id_of};

/// A function with `#[kani::proof]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Harness {
    pub(crate) package: String,
    /// `verify::verification::v1_accepted_iff`, as `cargo kani --exact --harness` wants it.
    pub(crate) path: String,
    /// The solver it asks for, or Kani's default.
    pub(crate) solver: String,
    /// Whether something stands in for the real thing.
    pub(crate) stubbed: bool,
}

/// A function with `#[test]` and the name of a property test.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Twin {
    pub(crate) package: String,
    pub(crate) name: String,
}

/// What the sources of some packages hold.
#[derive(Default)]
pub(crate) struct Found {
    pub(crate) harnesses: Vec<Harness>,
    pub(crate) twins: Vec<Twin>,
    /// What cannot be what was meant.
    pub(crate) faults: Vec<String>,
}

impl Harness {
    /// `v1_accepted_iff`
    pub(crate) fn name(&self) -> &str {
        self.path.rsplit("::").next().unwrap_or(&self.path)
    }

    /// The property it belongs to; none if its name does not say.
    pub(crate) fn id(&self) -> Option<String> {
        id_of(self.name())
    }
}

impl Found {
    /// Reads the library of `package` in `folder`, and the tests beside it.
    ///
    /// # Errors
    /// If a file cannot be read or is no Rust.
    pub(crate) fn scan(&mut self, package: &str, folder: &Path) -> Result<()> {
        let source = folder.join("src");
        let root = source.join("lib.rs");
        if !root.is_file() {
            return Ok(());
        }
        let mut scan = Scan {
            package,
            found: self,
            seen: BTreeSet::new(),
            macros: BTreeMap::new(),
        };
        // A macro may be used in a file that is read before the one it is defined in.
        for file in rust_files(&source)? {
            scan.find_macros(read(&file)?);
        }
        scan.file(&root, &source, &[])?;
        let tests = folder.join("tests");
        for file in rust_files(&tests)? {
            // Which of them is a root does not matter: only names of property tests are wanted.
            scan.tokens(read(&file)?, &tests, None)?;
        }
        for file in rust_files(&source)? {
            let text = fs::read_to_string(&file)?;
            if !scan.seen.contains(&file) && text.contains("kani::proof") {
                let orphan = file.strip_prefix(folder).unwrap_or(&file).display();
                let fault = format!("{package}: {orphan} has a harness, but is no module");
                scan.found.faults.push(fault);
            }
        }
        Ok(())
    }

    /// The harness function `name`.
    pub(crate) fn harness(&self, name: &str) -> Option<&Harness> {
        self.harnesses.iter().find(|harness| harness.name() == name)
    }
}

struct Scan<'a> {
    package: &'a str,
    found: &'a mut Found,
    seen: BTreeSet<PathBuf>,
    /// Macros that make harnesses or property tests of names they are given.
    macros: BTreeMap<String, HighWaterMarks>,
}

/// What the attributes in front of a function say.
#[derive(Clone, Default)]
struct HighWaterMarks {
    proof: bool,
    test: bool,
    solver: Option<String>,
    stubbed: bool,
}

impl HighWaterMarks {
    fn note(&mut self, attribute: &TokenStream) {
        let text: String = attribute.to_string().split_whitespace().collect();
        self.proof |= text.contains("kani::proof");
        self.test |= text == "test";
        self.stubbed |= text.contains("kani::stub");
        if let Some((_, rest)) = text.split_once("kani::solver(") {
            self.solver = rest.split(')').next().map(str::to_owned);
        }
    }
}

impl Scan<'_> {
    /// A file that is the module `path`; the files of its own modules are in `folder`.
    fn file(&mut self, file: &Path, folder: &Path, path: &[String]) -> Result<()> {
        self.seen.insert(file.to_owned());
        self.tokens(read(file)?, folder, Some(path))
    }

    /// Source text in the module `path`, or in none that matters.
    fn tokens(&mut self, text: TokenStream, folder: &Path, path: Option<&[String]>) -> Result<()> {
        let tokens: Vec<TokenTree> = text.into_iter().collect();
        let mut marks = HighWaterMarks::default();
        for (i, token) in tokens.iter().enumerate() {
            let next = tokens.get(i + 1);
            match token {
                TokenTree::Punct(punct) if punct.as_char() == '#' => {
                    if let Some(TokenTree::Group(group)) = next {
                        marks.note(&group.stream());
                    }
                }
                TokenTree::Punct(punct) if punct.as_char() == ';' => {
                    marks = HighWaterMarks::default()
                }
                TokenTree::Ident(word) if word == "fn" => {
                    if let Some(TokenTree::Ident(name)) = next {
                        self.function(&name.to_string(), &marks, path);
                    }
                }
                TokenTree::Ident(word) if word == "mod" => {
                    if let (Some(TokenTree::Ident(name)), Some(after)) = (next, tokens.get(i + 2)) {
                        self.module(&name.to_string(), after, folder, path)?;
                    }
                }
                TokenTree::Ident(word) => {
                    let bang =
                        matches!(next, Some(TokenTree::Punct(punct)) if punct.as_char() == '!');
                    if !bang {
                        continue;
                    }
                    if let (Some(made), Some(TokenTree::Group(arguments))) =
                        (self.macros.get(&word.to_string()), tokens.get(i + 2))
                    {
                        let made = made.clone();
                        for name in identifiers(arguments.stream()) {
                            self.function(&name, &made, path);
                        }
                    }
                }
                // Attributes have been read, modules and macros are read where they are named.
                TokenTree::Group(group) => {
                    let before = |n: usize| i.checked_sub(n).map(|at| tokens[at].to_string());
                    let word = |n| before(n).unwrap_or_default();
                    let elsewhere = word(1) == "#"
                        || word(2) == "mod"
                        || word(3) == "macro_rules"
                        || (word(1) == "!" && self.macros.contains_key(&word(2)));
                    if !elsewhere {
                        self.tokens(group.stream(), folder, path)?;
                    }
                    if group.delimiter() == Delimiter::Brace {
                        marks = HighWaterMarks::default();
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn function(&mut self, name: &str, marks: &HighWaterMarks, path: Option<&[String]>) {
        let package = self.package.to_owned();
        if marks.test && id_of(name).is_some() {
            self.found.twins.push(Twin {
                package: package.clone(),
                name: name.to_owned(),
            });
        }
        if let (true, Some(path)) = (marks.proof, path) {
            let path = [path, &[name.to_owned()]].concat().join("::");
            let solver = marks.solver.clone().unwrap_or_else(|| "cadical".to_owned());
            self.found.harnesses.push(Harness {
                package,
                path,
                solver,
                stubbed: marks.stubbed,
            });
        }
    }

    fn module(
        &mut self,
        name: &str,
        after: &TokenTree,
        folder: &Path,
        path: Option<&[String]>,
    ) -> Result<()> {
        let inner = path.map(|path| [path, &[name.to_owned()]].concat());
        let inside = folder.join(name);
        match after {
            TokenTree::Group(body) => self.tokens(body.stream(), &inside, inner.as_deref()),
            TokenTree::Punct(punct) if punct.as_char() == ';' => {
                let Some(inner) = inner else { return Ok(()) };
                let files = [inside.with_extension("rs"), inside.join("mod.rs")];
                match files.iter().find(|file| file.is_file()) {
                    Some(file) => self.file(file, &inside, &inner),
                    None => Err(anyhow!("no file for module {}", inner.join("::"))),
                }
            }
            _ => Ok(()),
        }
    }

    /// Remembers every macro in `tokens` that makes harnesses or property tests of the names it is given.
    fn find_macros(&mut self, tokens: TokenStream) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        for (i, token) in tokens.iter().enumerate() {
            match token {
                TokenTree::Ident(word) if word == "macro_rules" => {
                    if let [_, name, body, ..] = &tokens[i + 1..] {
                        let mut marks = HighWaterMarks::default();
                        note_all(TokenStream::from(body.clone()), &mut marks);
                        if marks.proof || marks.test {
                            self.macros.insert(name.to_string(), marks);
                        }
                    }
                }
                TokenTree::Group(group) => self.find_macros(group.stream()),
                _ => {}
            }
        }
    }
}

/// Every attribute anywhere in `tokens`.
fn note_all(tokens: TokenStream, marks: &mut HighWaterMarks) {
    let mut hash = false;
    for token in tokens {
        if let TokenTree::Group(group) = &token {
            if hash {
                marks.note(&group.stream());
            } else {
                note_all(group.stream(), marks);
            }
        }
        hash = matches!(&token, TokenTree::Punct(punct) if punct.as_char() == '#');
    }
}

/// Names of harnesses and property tests anywhere in `tokens`.
fn identifiers(tokens: TokenStream) -> Vec<String> {
    let mut names = Vec::new();
    for token in tokens {
        match token {
            TokenTree::Group(group) => names.extend(identifiers(group.stream())),
            TokenTree::Ident(name) if id_of(&name.to_string()).is_some() => {
                names.push(name.to_string());
            }
            _ => {}
        }
    }
    names
}

fn read(file: &Path) -> Result<TokenStream> {
    let text = fs::read_to_string(file).with_context(|| file.display().to_string())?;
    text.parse()
        .map_err(|error| anyhow!("{}: {error}", file.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scan(text: &str) -> Found {
        let mut found = Found::default();
        let mut scan = Scan {
            package: "p",
            found: &mut found,
            seen: BTreeSet::new(),
            macros: BTreeMap::new(),
        };
        let tokens: TokenStream = text.parse().expect("Rust");
        scan.find_macros(tokens.clone());
        scan.tokens(tokens, Path::new("."), Some(&["verify".to_owned()]))
            .expect("no files");
        found
    }

    #[test]
    fn harnesses_and_twins_as_they_are_written() {
        let found = scan(
            r#"
            //! #[kani::proof] fn c9_in_a_comment() {}
            #[cfg(test)]
            mod tests {
                proptest! { #[test] fn v1_random(x: u8) { let _ = x; } }
                #[test]
                fn v1_edges() { fn v1_helper() {} }
                #[test]
                fn helper() {}
            }
            #[cfg(kani)]
            mod verification {
                fn v1_no_harness() {}
                #[kani::proof]
                #[kani::unwind(33)]
                #[kani::stub(a::b, c)]
                #[kani::solver(kissat)]
                pub(crate) fn v1_accepted_iff() { let x = [0; 3]; }
                #[cfg_attr(kani, kani::proof)]
                fn v2() {}
            }
            "#,
        );
        let harness = |path: &str, solver: &str, stubbed| Harness {
            package: "p".into(),
            path: path.into(),
            solver: solver.into(),
            stubbed,
        };
        assert_eq!(
            found.harnesses,
            [
                harness("verify::harness::v1_accepted_iff", "kissat", true),
                harness("verify::harness::v2", "cadical", false),
            ]
        );
        let twins: Vec<_> = found.twins.iter().map(|twin| twin.name.as_str()).collect();
        assert_eq!(twins, ["v1_random", "v1_edges"]);
    }

    #[test]
    fn harnesses_made_by_a_macro() {
        let found = scan(
            r#"
            mod verification {
                crate::lengths! { signs: s1_length_0 0, s1_length_255 255, }
            }
            macro_rules! lengths {
                ($check:ident: $($name:ident $length:literal,)*) => {
                    $(#[kani::proof] #[kani::solver(minisat)] fn $name() { $check::<$length>(); })*
                };
            }
            "#,
        );
        let paths: Vec<_> = found.harnesses.iter().map(|h| h.path.as_str()).collect();
        let expected = [
            "verify::harness::s1_length_0",
            "verify::harness::s1_length_255",
        ];
        assert_eq!(paths, expected);
        assert_eq!(found.harnesses[0].solver, "minisat");
    }
}
