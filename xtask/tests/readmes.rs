//! The examples of every README, each built and run as a crate outside the workspace, as copied.
//!
//! A README with an example names its dependencies, in a block of TOML. They are paths into a clone in the
//! folder `mavseal` beside the crate. A block of Rust is a program, or the file that its first line names.

use std::{
    env, fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::Command,
};

use mavseal_keys::KeyFile;

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// The text of each fenced block, and what is said behind its fence.
fn blocks(markdown: &str) -> Vec<(&str, &str)> {
    let fenced = markdown.split("\n```").skip(1).step_by(2);
    fenced.filter_map(|block| block.split_once('\n')).collect()
}

/// Every README of the project, and the name of its folder.
fn readmes() -> Vec<(String, String)> {
    let folder = |path: PathBuf| fs::read_dir(path).expect("a folder").flatten();
    let folders = folder(root().into()).chain(folder(root().join("chips")));
    let named = folders.filter_map(|entry| {
        let text = fs::read_to_string(entry.path().join("README.md")).ok()?;
        Some((entry.file_name().into_string().ok()?, text))
    });
    let project = fs::read_to_string(root().join("README.md")).expect("the project's README");
    named.chain([("project".into(), project)]).collect()
}

/// Writes the crate that a README describes. Gives its folder and how many programs it has.
fn write_crate(name: &str, blocks: &[(&str, &str)]) -> (PathBuf, usize) {
    let parent = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("readmes")
        .join(name);
    if parent.exists() {
        fs::remove_dir_all(&parent).expect("the crate of the last run");
    }
    let folder = parent.join("example");
    fs::create_dir_all(folder.join("src/bin")).expect("a folder");
    symlink(root(), parent.join("mavseal")).expect("a link to the workspace");
    fs::copy(root().join("Cargo.lock"), folder.join("Cargo.lock")).expect("the versions in use");

    let manifests = blocks.iter().filter(|(kind, _)| *kind == "toml");
    let dependencies = manifests.map(|(_, text)| *text);
    let dependencies: String = dependencies
        .filter(|text| text.contains("dependencies]"))
        .collect();
    assert!(!dependencies.is_empty(), "{name}: no [dependencies]");
    let manifest = format!(
        "[package]\nname = \"readme-{name}\"\nedition = \"2024\"\n\n{dependencies}\n\n[workspace]\n"
    );
    fs::write(folder.join("Cargo.toml"), manifest).expect("a manifest");
    if dependencies.contains("mavseal-keys") {
        let keys = KeyFile::generate(2).expect("keys");
        keys.write_new(&folder.join("keys.toml"))
            .expect("a key file");
    }

    let mut programs = 0;
    for (kind, text) in blocks {
        if !kind.starts_with("rust") {
            continue;
        }
        let file = match text
            .lines()
            .next()
            .and_then(|line| line.strip_prefix("// "))
        {
            Some(file) if file.ends_with(".rs") => file.to_owned(),
            _ => format!("src/bin/example-{programs}.rs"),
        };
        programs += usize::from(file != "build.rs");
        fs::write(folder.join(file), text).expect("a source file");
    }
    (folder, programs)
}

#[test]
fn examples_of_the_readmes_run_as_copied() {
    let mut ran = Vec::new();
    for (name, text) in readmes() {
        let blocks = blocks(&text);
        if !blocks.iter().any(|(kind, _)| kind.starts_with("rust")) {
            continue;
        }
        let (folder, programs) = write_crate(&name, &blocks);
        let mut bins: Vec<_> = (0..programs).map(|n| format!("example-{n}")).collect();
        if folder.join("src/main.rs").exists() {
            bins = vec![format!("readme-{name}")];
        }
        for bin in bins {
            let status = Command::new(env!("CARGO"))
                .args(["run", "--quiet", "--offline", "--bin", &bin])
                .env(
                    "CARGO_TARGET_DIR",
                    concat!(env!("CARGO_TARGET_TMPDIR"), "/readmes-target"),
                )
                .current_dir(&folder)
                .status();
            assert!(status.expect("cargo").success(), "{name}: {bin}");
            ran.push(name.clone());
        }
    }
    for library in ["project", "mavlink", "commsec", "keys", "store"] {
        assert!(ran.iter().any(|name| name == library), "{library}: none");
    }
}
