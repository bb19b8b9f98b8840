//! Runs a target on files, without an engine: `cargo run --no-default-features --example replay -- TARGET
//! FILE...`. Folders stand for all files in them; then it prints which errors came out. A file that is too short
//! to be an input is named instead of run.

use std::{env, error::Error, fs, path::PathBuf};

use mavseal_fuzz::{TARGETS, reached};

/// Before the name of such a file.
const NO_INPUT: &str = "no input: ";

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = env::args_os().skip(1);
    let name = arguments.next().ok_or("usage: replay TARGET FILE...")?;
    let target = TARGETS.iter().find(|target| name == *target.name);
    let target = target.ok_or("no such target")?;
    reached::watch();
    for path in arguments.map(PathBuf::from) {
        let files = if path.is_dir() {
            let entries = fs::read_dir(path)?.map(|entry| entry.map(|entry| entry.path()));
            entries.collect::<Result<_, _>>()?
        } else {
            vec![path]
        };
        for file in files {
            if !(target.run)(&fs::read(&file)?) {
                eprintln!("{NO_INPUT}{}", file.display());
            }
        }
    }
    for error in reached::errors() {
        println!("{error}");
    }
    Ok(())
}
