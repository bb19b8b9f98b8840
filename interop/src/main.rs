//! The core against unmodified peers, frame by frame; `cargo xtask interop` builds and runs this.

mod differences;
mod exchange;
mod forge;
mod here;
mod hex;
mod messages;
mod payloads;
mod peers;
mod report;
mod scenarios;
mod script;
mod sealed;
mod vectors;
mod verdicts;

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::Parser;
use rand::{SeedableRng, rngs::SmallRng};
use sha2::{Digest, Sha256};

use here::Here;
use messages::Message;
use peers::Pymavlink;
use report::Judge;

/// The key of all frames is SHA-256 of this; the vectors' too.
const PASSPHRASE: &str = "correct horse battery staple";

/// What `cargo xtask interop` says.
#[derive(Parser)]
struct Options {
    /// A Python that has pymavlink
    #[arg(long)]
    python: PathBuf,
    /// A Python that has cryptography
    #[arg(long)]
    sealing_python: PathBuf,
    /// The dialect `all` as pymavlink generated it, a Python module
    #[arg(long)]
    dialect: PathBuf,
    /// The messages of the dialect `all`, one a line
    #[arg(long)]
    messages: PathBuf,
    /// What the random payloads come from
    #[arg(long)]
    seed: u64,
    /// Write frames of the peers to this folder, and do nothing else
    #[arg(long)]
    vectors: Option<PathBuf>,
}

fn main() -> Result<()> {
    let options = Options::parse();
    let key: [u8; 32] = Sha256::digest(PASSPHRASE).into();
    let messages = messages::read(&options.messages)?;
    same_sizes(&options, &key, &messages)?;
    let mut peers = peers::all(&options.python, &options.dialect, &key)?;
    if let Some(folder) = &options.vectors {
        return vectors::write(folder, &mut peers, &messages, PASSPHRASE, options.seed);
    }

    let mut judge = Judge::new();
    let mut here = Here::new(&key)?;
    for peer in &mut peers {
        eprintln!("{} {}", peer.name(), peer.version());
        // Each peer gets the same payloads.
        let mut random = SmallRng::seed_from_u64(options.seed);
        exchange::run(peer.as_mut(), &messages, &mut here, &mut random, &mut judge)?;
        if peer.receives() {
            verdicts::run(
                peer.as_mut(),
                &messages,
                &mut here,
                &key,
                &mut random,
                &mut judge,
            )?;
        }
    }
    let mut random = SmallRng::seed_from_u64(options.seed);
    sealed::run(&options.sealing_python, &mut random, &mut judge)?;
    println!("{}", serde_json::to_string(&judge.finish(options.seed))?);
    Ok(())
}

/// Another generator reads the same lengths out of the definitions.
fn same_sizes(options: &Options, key: &[u8; 32], messages: &[Message]) -> Result<()> {
    let theirs = Pymavlink::start(&options.python, &options.dialect, key)?.sizes()?;
    let ours = messages.iter().map(|message| (message.id, message.size));
    ensure!(
        ours.eq(theirs),
        "pymavlink has payloads of other lengths than the list of messages"
    );
    Ok(())
}
