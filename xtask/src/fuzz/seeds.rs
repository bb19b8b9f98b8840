//! `cargo xtask fuzz seeds`: inputs named by what they are, from vectors and recorded telemetry.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, ensure};

use super::{Fuzzer, replay::ReplayGuard, without_engine};
use mavseal_e2e::wire::telemetry_path;

use crate::proofs::workshop::files;
use crate::setup::{root, target_dir};

const SEEDS: &str = "fuzz/seeds";
const FOUND: &str = "fuzz/found";

/// Writes every seed; with `check`, fails if that would change something.
///
/// # Errors
/// If a seed cannot be made.
pub(super) fn seeds(check: bool) -> Result<()> {
    let root = root();
    let folder = if check {
        target_dir()?.join("fuzz/seeds")
    } else {
        root.join(SEEDS)
    };
    fs::create_dir_all(&folder)?;
    let mut cargo = Command::new("cargo");
    cargo.args(["run", "--quiet"]).args(without_engine()?);
    cargo.args(["--example", "seeds", "--"]);
    let status = cargo.arg(telemetry_path()?).arg(&folder).status()?;
    ensure!(status.success(), "the seeds were not made");
    if check {
        let (made, committed) = (contents(&folder)?, contents(&root.join(SEEDS))?);
        let differ = |name: &&PathBuf| made.get(*name) != committed.get(*name);
        let names = made.keys().chain(committed.keys());
        let different: Vec<_> = names.filter(differ).map(|name| name.display()).collect();
        ensure!(
            different.is_empty(),
            "run `cargo xtask fuzz seeds`: {different:?} are not what is committed"
        );
    }
    Ok(())
}

/// The files below `folder`, by their paths from there.
fn contents(folder: &Path) -> Result<BTreeMap<PathBuf, Vec<u8>>> {
    let names = files(folder)?.into_iter();
    let contents = names.map(|name| Ok((name.clone(), fs::read(folder.join(name))?)));
    contents.collect()
}

/// Keeps of what campaigns left in `fuzz/corpus` what reaches edges that no seed does, and has targets
/// read it beside their seeds.
///
/// # Errors
/// If the engine fails.
pub(super) fn minimise(fuzzer: &Fuzzer) -> Result<()> {
    let replay = ReplayGuard::build(&fuzzer.root, &fuzzer.target_dir.join("replay"), "")?;
    for target in &fuzzer.targets {
        let name = &target.name;
        let corpus = fuzzer.root.join("fuzz/corpus").join(name);
        let found = fuzzer.root.join(FOUND).join(name);
        // Seeds come first, as what is there already; then only what was added is kept.
        let merged = fuzzer.target_dir.join("merged").join(name);
        if merged.is_dir() {
            fs::remove_dir_all(&merged)?;
        }
        fs::create_dir_all(&merged)?;
        let seeds = fuzzer.root.join(SEEDS).join(name);
        for seed in files(&seeds)? {
            fs::copy(seeds.join(&seed), merged.join(&seed))?;
        }
        let from = [found.clone(), corpus]
            .into_iter()
            .filter(|folder| folder.is_dir());
        fuzzer
            .engine
            .merge(target, &merged, &from.collect::<Vec<_>>())?;
        let mut kept = Vec::new();
        for name in files(&merged)? {
            if !seeds.join(&name).is_file() {
                kept.push(name);
            }
        }
        if found.is_dir() {
            fs::remove_dir_all(&found)?;
        }
        for file in &kept {
            // The engine names a file by the hash of what it holds; the first of it are enough.
            let hash = file.to_str().and_then(|name| name.get(..12));
            fs::create_dir_all(&found)?;
            fs::copy(merged.join(file), found.join(hash.context("a hash")?))?;
        }
        // To be none is an edge too.
        let none = replay.no_inputs(name, "found")?;
        none.iter().try_for_each(fs::remove_file)?;
        println!("{name}: {} beside the seeds", kept.len() - none.len());
    }
    Ok(())
}
