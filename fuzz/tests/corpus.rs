//! Every committed input through its target.

use std::{collections::BTreeSet, fs, path::Path};

use mavseal_fuzz::TARGETS;

/// What the folder `name` holds, by name.
fn names(name: &str) -> BTreeSet<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(name);
    let entries = fs::read_dir(folder).expect(name);
    let name = |entry: fs::DirEntry| entry.file_name().into_string().expect("a name");
    entries.map(|entry| name(entry.expect("a file"))).collect()
}

#[test]
fn every_input() {
    for (target, run) in TARGETS {
        let inputs = names(&format!("corpus/{target}"));
        assert!(
            (1..=200).contains(&inputs.len()),
            "{target}: {}",
            inputs.len()
        );
        for name in inputs {
            let path = format!("{}/corpus/{target}/{name}", env!("CARGO_MANIFEST_DIR"));
            println!("{path}");
            assert!(run(&fs::read(&path).expect("a file")), "{path} is no input");
        }
    }
}

#[test]
fn every_target_has_inputs_and_a_program() {
    let known: BTreeSet<_> = TARGETS.iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(names("corpus"), known);
    let programs = known.iter().map(|name| format!("{name}.rs")).collect();
    assert_eq!(names("fuzz_targets"), programs);
}
