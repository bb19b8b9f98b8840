//! Every committed input, seeds and what campaigns found beside them, through its target.

use std::{
    collections::BTreeSet,
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
};

use mavseal_fuzz::TARGETS;

fn entries(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut entries: Vec<_> = match fs::read_dir(folder) {
        Ok(entries) => entries.map(|entry| entry.expect("a file").path()).collect(),
        Err(_) => Vec::new(),
    };
    entries.sort();
    entries
}

#[test]
fn every_input() {
    for target in TARGETS {
        let seeds = entries(&format!("seeds/{}", target.name));
        assert!(!seeds.is_empty(), "{} has no seed", target.name);
        let found = entries(&format!("found/{}", target.name));
        for path in seeds.iter().chain(&found) {
            println!("{}", path.display());
            let ran = (target.run)(&fs::read(path).expect("a file"));
            assert!(ran, "{} is no input", path.display());
        }
    }
}

#[test]
fn every_input_has_a_target() {
    let known: BTreeSet<_> = TARGETS.iter().map(|target| target.name.into()).collect();
    for folder in ["seeds", "found"] {
        for path in entries(folder) {
            let name = path.file_name().expect("a name");
            assert!(
                known.contains(name),
                "{} belongs to no target",
                path.display()
            );
        }
    }
    let mut written: BTreeSet<_> = entries("fuzz_targets")
        .iter()
        .map(|path| path.file_stem().expect("a name").to_owned())
        .collect();
    assert!(written.remove(OsStr::new("empty")));
    assert_eq!(written, known);
}
