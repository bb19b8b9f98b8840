//! What a result depends on, as a hash: when it changes, the result is stale.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, anyhow, ensure};
use cargo_metadata::{DependencyKind, Metadata, PackageId};
use hmac_sha256::Hash;
use proc_macro2::{TokenStream, TokenTree};
use serde_json::{Value, json};

/// What a hash is taken over.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Depth {
    /// What a harness runs: no comments, no tests.
    Proof,
    /// What a fuzz target runs: no comments, no tests, no harnesses.
    Fuzz,
    /// What a property test runs: no comments, no harnesses.
    Tests,
}

impl Depth {
    /// The same for what `self` uses: its tests are not run with it.
    const fn of_dependencies(self) -> Self {
        match self {
            Self::Proof => Self::Proof,
            Self::Fuzz | Self::Tests => Self::Fuzz,
        }
    }

    /// Whether an item with this attribute has no influence.
    fn leaves_out(self, attribute: &str) -> bool {
        match attribute {
            "[cfg(test)]" => self != Self::Tests,
            "[cfg(kani)]" => self != Self::Proof,
            _ => false,
        }
    }
}

/// The hash of everything that a result about `package` depends on: its sources and manifest, those
/// of the workspace's packages that it uses, the versions of other packages, and what the workspace
/// says to Kani and to the compiler.
///
/// # Errors
/// If a file cannot be read or is no Rust.
pub(crate) fn fingerprint(metadata: &Metadata, package: &str, depth: Depth) -> Result<String> {
    hash(metadata, package, depth, None)
}

/// The same for the harnesses in one module of `package`: neither harnesses of other modules have an
/// influence on them, nor what the module does not reach.
///
/// # Errors
/// As [`fingerprint`].
pub(crate) fn of_harnesses(metadata: &Metadata, package: &str, module: &str) -> Result<String> {
    hash(metadata, package, Depth::Proof, Some(module))
}

fn hash(metadata: &Metadata, package: &str, depth: Depth, module: Option<&str>) -> Result<String> {
    let root = metadata.workspace_root.as_std_path();
    let reach = module
        .map(|module| Reach::of(metadata, package, module))
        .transpose()?;
    let mut hash = Hash::new();
    let mut add = |name: &str, content: &[u8]| {
        // Lengths first, so that no two lists of files look alike.
        for part in [name.as_bytes(), content] {
            hash.update((part.len() as u64).to_le_bytes());
            hash.update(part);
        }
    };
    add("workspace", workspace(root)?.to_string().as_bytes());
    for id in closure(metadata, package, depth, reach.as_ref())? {
        let ours = metadata[&id].name.as_str() == package;
        let depth = if ours { depth } else { depth.of_dependencies() };
        let package = &metadata[&id];
        if !metadata.workspace_members.contains(&id) {
            add(&package.name, package.version.to_string().as_bytes());
            continue;
        }
        let manifest = package.manifest_path.as_std_path();
        let folder = manifest.parent().context("a manifest lies in a folder")?;
        add(&package.name, declared(package).to_string().as_bytes());
        for part in ["src", "tests"] {
            if part == "tests" && depth != Depth::Tests {
                continue;
            }
            for file in rust_files(&folder.join(part))? {
                let name = file.strip_prefix(root).unwrap_or(&file).to_string_lossy();
                let meaning = match &reach {
                    Some(reach) if ours && !reach.modules.contains(&file) => continue,
                    Some(reach) if !ours || file != reach.start => {
                        meaning_without_harnesses(&file, depth)?
                    }
                    _ => meaning(&file, depth)?,
                };
                add(&name, meaning.as_bytes());
            }
        }
    }
    Ok(hex(&hash.finalize()[..8]))
}

/// What the harnesses in a module can run of their package, and of the workspace's others.
struct Reach {
    /// The module's file.
    start: PathBuf,
    /// The files of the modules.
    modules: BTreeSet<PathBuf>,
    /// The packages that these name.
    packages: BTreeSet<String>,
}

impl Reach {
    /// Modules are found by the paths that begin with `crate`, in them and in the package's root.
    fn of(metadata: &Metadata, package: &str, module: &str) -> Result<Self> {
        let members = metadata.workspace_packages();
        let named = members.iter().find(|member| member.name == package);
        let named = named.with_context(|| format!("no package {package}"))?;
        let manifest = named.manifest_path.as_std_path();
        let folder = manifest.parent().context("a manifest lies in a folder")?;
        let folder = folder.join("src");
        let file_of = |module: &str| folder.join(format!("{module}.rs"));
        let start = file_of(module);
        let mut reach = Self {
            start: start.clone(),
            modules: BTreeSet::new(),
            packages: BTreeSet::new(),
        };
        let mut open = vec![start, file_of("lib")];
        while let Some(file) = open.pop() {
            if !reach.modules.insert(file.clone()) {
                continue;
            }
            let text = if file == reach.start {
                meaning(&file, Depth::Proof)?
            } else {
                meaning_without_harnesses(&file, Depth::Proof)?
            };
            let words: Vec<_> = text.split(' ').collect();
            for path in words.windows(4) {
                if let ["crate", ":", ":", next] = path {
                    // Several at once would have to be told apart.
                    ensure!(!next.ends_with('('), "{}: crate::{{", file.display());
                    open.extend(Some(file_of(next)).filter(|file| file.is_file()));
                }
            }
            let libraries = members.iter().filter(|member| {
                let library = member.name.replace('-', "_");
                words.contains(&library.as_str())
            });
            reach
                .packages
                .extend(libraries.map(|member| member.name.to_string()));
        }
        Ok(reach)
    }
}

/// The hash of `text`.
pub(crate) fn hash_of(text: &str) -> String {
    hex(&Hash::hash(text.as_bytes())[..8])
}

/// Every Rust file below `folder`, sorted; none if there is no such folder.
///
/// # Errors
/// If a folder cannot be read.
pub(crate) fn rust_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    if !folder.is_dir() {
        return Ok(files);
    }
    for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        if path.is_dir() {
            files.extend(rust_files(&path)?);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The parts of the workspace's files that change what is compiled.
fn workspace(root: &Path) -> Result<Value> {
    let mut manifest: Value = toml::from_str(&fs::read_to_string(root.join("Cargo.toml"))?)?;
    if let Some(profiles) = manifest["profile"].as_object_mut() {
        // How single packages are optimised changes no result, nor does what a debugger is told.
        for profile in profiles.values_mut().filter_map(Value::as_object_mut) {
            profile.retain(|key, _| !["package", "debug"].contains(&key.as_str()));
        }
        profiles.retain(|_, profile| profile.as_object().is_none_or(|keys| !keys.is_empty()));
    }
    let config = fs::read_to_string(root.join(".cargo/config.toml")).unwrap_or_default();
    let mut config: Value = toml::from_str(&config)?;
    if let Some(config) = config.as_object_mut() {
        config.remove("alias");
    }
    Ok(json!([
        manifest["workspace"]["metadata"],
        manifest["profile"],
        manifest["patch"],
        config,
    ]))
}

/// `package` and all that it is built from, in a fixed order; of the workspace's packages those that
/// `reach` names, and what they are built from.
fn closure(
    metadata: &Metadata,
    package: &str,
    depth: Depth,
    reach: Option<&Reach>,
) -> Result<Vec<PackageId>> {
    let resolve = metadata.resolve.as_ref().context("cargo metadata")?;
    let start = metadata
        .workspace_packages()
        .into_iter()
        .find(|candidate| candidate.name.as_str() == package)
        .with_context(|| format!("no package {package}"))?;
    let mut open = vec![&start.id];
    let mut closure = BTreeSet::new();
    while let Some(id) = open.pop() {
        if !closure.insert(id.clone()) {
            continue;
        }
        for dependency in &resolve[id].deps {
            let used = dependency.dep_kinds.iter().any(|kind| match kind.kind {
                DependencyKind::Development => id == &start.id && depth == Depth::Tests,
                _ => true,
            });
            let reached = id != &start.id
                || !metadata.workspace_members.contains(&dependency.pkg)
                || reach.is_none_or(|reach| {
                    let name = metadata[&dependency.pkg].name.as_str();
                    reach.packages.contains(name)
                });
            if used && reached {
                open.push(&dependency.pkg);
            }
        }
    }
    let mut closure: Vec<_> = closure.into_iter().collect();
    // Ids hold the path of the workspace.
    closure.sort_by_key(|id| (metadata[id].name.clone(), metadata[id].version.clone()));
    Ok(closure)
}

/// What a manifest of the workspace asks for.
fn declared(package: &cargo_metadata::Package) -> Value {
    let dependencies: Vec<_> = package
        .dependencies
        .iter()
        .filter(|dependency| dependency.kind != DependencyKind::Development)
        .map(|d| json!([d.name, d.req, d.features, d.uses_default_features]))
        .collect();
    json!([dependencies, package.features, package.metadata])
}

/// A source file without what has no influence: layout, comments, tests and harnesses that are not run.
///
/// # Errors
/// If it cannot be read or is no Rust.
pub(crate) fn meaning(file: &Path, depth: Depth) -> Result<String> {
    let mut meaning = String::new();
    write(tokens(file)?, depth, true, &mut meaning);
    Ok(meaning)
}

/// The same without its module `harness`, which nothing else can reach.
fn meaning_without_harnesses(file: &Path, depth: Depth) -> Result<String> {
    let mut meaning = String::new();
    write(tokens(file)?, depth, false, &mut meaning);
    Ok(meaning)
}

fn tokens(file: &Path) -> Result<TokenStream> {
    let text = fs::read_to_string(file).with_context(|| file.display().to_string())?;
    text.parse()
        .map_err(|error| anyhow!("{}: {error}", file.display()))
}

/// Appends `tokens`, with the attributes left out that are documentation or mark what is not run, and
/// then what they mark.
fn write(tokens: TokenStream, depth: Depth, harnesses: bool, out: &mut String) {
    let mut tokens = tokens.into_iter().peekable();
    while let Some(token) = tokens.next() {
        if token.to_string() == "#" {
            let inner = tokens.next_if(|token| token.to_string() == "!");
            if let Some(TokenTree::Group(group)) = tokens.peek() {
                let text: String = group.to_string().split_whitespace().collect();
                if text.starts_with("[doc=") {
                    tokens.next();
                    continue;
                }
                let of_harnesses = || {
                    let words = tokens.clone().skip(1).take(2);
                    words.map(|word| word.to_string()).eq(["mod", "harness"])
                };
                let left_out = depth.leaves_out(&text)
                    || (!harnesses && text == "[cfg(kani)]" && of_harnesses());
                if left_out && inner.is_none() {
                    skip_item(&mut tokens);
                    continue;
                }
            }
        }
        match token {
            TokenTree::Group(group) => {
                let text = format!("{:?}(", group.delimiter());
                out.push_str(&text);
                write(group.stream(), depth, harnesses, out);
                out.push(')');
            }
            other => out.push_str(&other.to_string()),
        }
        out.push(' ');
    }
}

/// Skips to the end of an item: its body, or its semicolon.
fn skip_item(tokens: &mut impl Iterator<Item = TokenTree>) {
    for token in tokens {
        let text = token.to_string();
        if text == ";" || (matches!(token, TokenTree::Group(_)) && text.starts_with('{')) {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn meaning(text: &str, depth: Depth) -> String {
        let mut out = String::new();
        write(text.parse().expect("Rust"), depth, true, &mut out);
        out
    }

    #[test]
    fn harnesses_of_other_modules_have_no_influence() {
        let other = |text: &str| {
            let mut out = String::new();
            write(text.parse().expect("Rust"), Depth::Proof, false, &mut out);
            out
        };
        let text = "fn a() {} #[cfg(kani)] mod harness { fn k() {} } #[cfg(kani)] fn any() {}";
        assert_eq!(other(text), other("fn a() {} #[cfg(kani)] fn any() {}"));
        assert_ne!(other(text), other("fn a() {}"));
        assert_ne!(other(text), meaning(text, Depth::Proof));
    }

    #[test]
    fn a_harness_reaches_what_its_module_names() {
        let metadata = cargo_metadata::MetadataCommand::new()
            .exec()
            .expect("cargo metadata");
        let reach = |module| Reach::of(&metadata, "mavseal-proofs", module).expect("a module");
        let opening = reach("opening");
        let has = |name| opening.modules.iter().any(|file| file.ends_with(name));
        assert!(["lib.rs", "opening.rs", "cipher.rs"].into_iter().all(has));
        assert!(!has("relay.rs"));
        assert!(opening.packages.contains("mavlink-commsec"));
        assert!(!opening.packages.contains("mavseal-relay"));
        assert!(reach("relay").packages.contains("mavseal-relay"));
    }

    #[test]
    fn only_what_has_influence_counts() {
        let text = "//! Doc.\nfn a() { b(1) }\n#[cfg(test)]\nmod t { fn c() {} }\nfn d() {}";
        let same = "/// Other.\nfn a() {\n  // why\n  b(1)\n}\nfn d() {}";
        let proof = |text| meaning(text, Depth::Proof);
        assert_eq!(proof(text), proof(same));
        assert_eq!(meaning(text, Depth::Fuzz), meaning(same, Depth::Fuzz));
        assert_ne!(meaning(text, Depth::Tests), meaning(same, Depth::Tests));
        let text = "fn a() {}\n#[cfg(kani)]\n#[must_use]\npub fn k(x: u8) -> u8 { x }\nfn d() {}";
        let same = "fn a() {} fn d() {}";
        assert_eq!(meaning(text, Depth::Tests), meaning(same, Depth::Tests));
        assert_eq!(meaning(text, Depth::Fuzz), meaning(same, Depth::Fuzz));
        assert_ne!(proof(text), proof(same));
        for other in [
            "fn a() { b(2) } fn d() {}",
            "fn a() { b[1] } fn d() {}",
            "fn a() { b(1) } #[inline] fn d() {}",
            "fn a() { b(1) }",
        ] {
            assert_ne!(proof(text), proof(other), "{other}");
        }
    }
}
