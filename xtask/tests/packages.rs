//! The packages of the libraries: what is in them, and whether they work without the workspace.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// The name and the folder of every library that can be published.
fn libraries() -> Vec<(String, PathBuf)> {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let folders = fs::read_dir(root).expect("the workspace").flatten();
    let library = |folder: PathBuf| {
        let manifest = fs::read_to_string(folder.join("Cargo.toml")).ok()?;
        let name = manifest.split_once("name = \"")?.1.split_once('"')?.0;
        let published = !manifest.contains("\npublish = false") && folder.join("src").exists();
        published.then(|| (name.to_owned(), folder))
    };
    let libraries: Vec<_> = folders.filter_map(|entry| library(entry.path())).collect();
    assert!(libraries.len() >= 5, "{libraries:?}");
    libraries
}

fn cargo(folder: &Path, arguments: &[&str]) -> Command {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(arguments).current_dir(folder);
    cargo
}

fn run(command: &mut Command) {
    let status = command.status().expect("a program");
    assert!(status.success(), "{command:?}");
}

#[test]
fn packages_have_licences_and_a_readme() {
    for (name, folder) in libraries() {
        let list = cargo(&folder, &["package", "--list", "--allow-dirty"]).output();
        let list = String::from_utf8(list.expect("cargo").stdout).expect("text");
        for file in ["LICENSE-APACHE", "LICENSE-MIT", "README.md"] {
            assert!(list.lines().any(|line| line == file), "{name}: {file}");
        }
    }
}

#[test]
#[ignore = "two minutes; `cargo xtask test --all` runs it"]
fn packed_crates_pass_their_own_tests() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("packages");
    let packed = folder.join("packed");
    if packed.exists() {
        fs::remove_dir_all(&packed).expect("what was packed before");
    }
    fs::create_dir_all(&packed).expect("a folder");

    let libraries = libraries();
    let root = libraries[0].1.join("..");
    let mut package = cargo(
        &root,
        &["package", "--allow-dirty", "--no-verify", "--offline"],
    );
    package.arg("--target-dir").arg(&folder);
    for (name, _) in &libraries {
        package.args(["-p", name]);
    }
    run(&mut package);

    let mut workspace = "[workspace]\nresolver = \"3\"\nmembers = [\"*\"]\n\n".to_owned();
    workspace += "[profile.dev]\nopt-level = 2\ndebug = false\n\n[patch.crates-io]\n";
    for (name, _) in &libraries {
        let file = format!("{name}-{}", env!("CARGO_PKG_VERSION"));
        let archive = folder.join("package").join(format!("{file}.crate"));
        run(Command::new("tar")
            .arg("xzf")
            .arg(archive)
            .current_dir(&packed));
        workspace += &format!("{name} = {{ path = \"{file}\" }}\n");
    }
    fs::write(packed.join("Cargo.toml"), workspace).expect("a manifest");
    fs::copy(root.join("Cargo.lock"), packed.join("Cargo.lock")).expect("the versions in use");
    let mut test = cargo(&packed, &["test", "--quiet", "--workspace", "--offline"]);
    test.args([
        "--features",
        "mavseal-store/model,mavseal-keys/cli",
        "--target-dir",
    ]);
    run(test.arg(folder.join("target")));
}
