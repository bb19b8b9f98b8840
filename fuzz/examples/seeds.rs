//! Writes every seed: `cargo xtask fuzz seeds` gives it recorded telemetry and the folder to write to.

use std::{collections::BTreeSet, env, error::Error, fs, path::PathBuf};

use mavseal_fuzz::seeds;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = env::args_os().skip(1).map(PathBuf::from);
    let (Some(log), Some(folder)) = (arguments.next(), arguments.next()) else {
        return Err("usage: seeds LOG.tlog FOLDER".into());
    };
    let telemetry = telemetry(&fs::read(log)?).ok_or("the log ends within a frame")?;
    let mut written = BTreeSet::new();
    for seed in seeds::all(&telemetry) {
        let path = folder.join(seed.target).join(&seed.name);
        fs::create_dir_all(folder.join(seed.target))?;
        fs::write(&path, &seed.bytes)?;
        if !written.insert(path) {
            return Err(format!("two seeds of {} are called {}", seed.target, seed.name).into());
        }
    }
    for target in fs::read_dir(&folder)? {
        for file in fs::read_dir(target?.path())? {
            let path = file?.path();
            if !written.contains(&path) {
                fs::remove_file(path)?;
            }
        }
    }
    println!("{} seeds", written.len());
    Ok(())
}

/// The frames of a telemetry log: 8 bytes of time before each; none of them is signed.
fn telemetry(mut log: &[u8]) -> Option<Vec<Vec<u8>>> {
    let mut frames = Vec::new();
    while !log.is_empty() {
        let length = 12 + usize::from(*log.get(9)?);
        frames.push(log.get(8..8 + length)?.to_vec());
        log = log.get(8 + length..)?;
    }
    Some(frames)
}
