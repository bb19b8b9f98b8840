//! The core against unmodified peers: frame by frame, and live at the signer in QEMU.

mod differences;
mod exchange;
mod forge;
mod here;
mod hex;
mod live;
mod messages;
mod payloads;
mod peers;
mod python;
mod report;
mod scenarios;
mod script;
mod sealed;
mod vectors;
mod verdicts;

use std::{
    path::Path,
    process::{Command, Stdio},
    time::{SystemTime, UNIX_EPOCH},
};

use anyhow::{Result, ensure};
use clap::{Parser, ValueEnum};
use rand::{SeedableRng, rngs::SmallRng};
use sha2::{Digest, Sha256};

use here::Here;
use messages::Message;
use peers::Pymavlink;
use report::Judge;

/// The key of all frames is SHA-256 of this; the vectors' too.
const PASSPHRASE: &str = "correct horse battery staple";
/// Where frames of the peers are kept; the tests of the signing core read them.
const VECTORS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../mavlink/tests/vectors");

/// Holds the cores against other implementations of the standard's signature, and of AES-GCM
#[derive(Parser)]
struct Options {
    /// What the random payloads come from; one that the clock gives if not said
    #[arg(long)]
    seed: Option<u64>,
    /// Write frames that the peers sign to `mavlink/tests/vectors`, and do nothing else
    #[arg(long)]
    vectors: bool,
    /// Do one part of it
    #[arg(long, value_enum)]
    only: Option<Part>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Part {
    /// Every message, both ways, and frames that must not pass; sealed packages too
    Frames,
    /// pymavlink and MAVProxy at the signer in QEMU
    Live,
}

fn main() -> Result<()> {
    let options = Options::parse();
    let seed = match options.seed {
        Some(seed) => seed,
        None => SystemTime::now().duration_since(UNIX_EPOCH)?.as_secs(),
    };
    let python = python::environment("requirements.txt")?;
    let mut judge = Judge::default();
    if options.vectors || options.only != Some(Part::Live) {
        println!("seed {seed}");
        judge = Judge::new();
        frames(&python, seed, options.vectors, &mut judge)?;
    }
    if options.vectors {
        return Ok(());
    }
    if options.only != Some(Part::Frames) {
        live::run(&python, &mut judge)?;
    }
    let report = judge.finish();
    report.print();
    ensure!(
        report.failures.is_empty(),
        "not as it has to be, seed {seed}:\n  {}",
        report.failures.join("\n  ")
    );
    println!("Every frame was as it had to be.");
    Ok(())
}

/// Every message with every peer, or with `vectors` some messages that are written down.
fn frames(python: &Path, seed: u64, vectors: bool, judge: &mut Judge) -> Result<()> {
    let key: [u8; 32] = Sha256::digest(PASSPHRASE).into();
    let definition = messages::definition()?;
    let messages = messages::read(&definition)?;
    let dialect = python::folder(python)?.join("dialect.py");
    generate(python, &definition, &dialect)?;
    same_sizes(python, &dialect, &key, &messages)?;
    let mut peers = peers::all(python, &dialect, &key)?;
    if vectors {
        return vectors::write(Path::new(VECTORS), &mut peers, &messages, PASSPHRASE, seed);
    }

    let mut here = Here::new(&key)?;
    for peer in &mut peers {
        eprintln!("{} {}", peer.name(), peer.version());
        // Each peer gets the same payloads.
        let mut random = SmallRng::seed_from_u64(seed);
        exchange::run(peer.as_mut(), &messages, &mut here, &mut random, judge)?;
        if peer.receives() {
            verdicts::run(
                peer.as_mut(),
                &messages,
                &mut here,
                &key,
                &mut random,
                judge,
            )?;
        }
    }
    let mut random = SmallRng::seed_from_u64(seed);
    sealed::run(&python::environment("sealed.txt")?, &mut random, judge)
}

/// Has pymavlink's own generator make the module of the dialect, since the one that it ships lacks some
/// messages of these definitions.
fn generate(python: &Path, definition: &Path, module: &Path) -> Result<()> {
    let mut generate = Command::new(python);
    generate.args(["-m", "pymavlink.tools.mavgen", "--lang", "Python3"]);
    // The schema that it would check them with takes one more package.
    generate.args(["--wire-protocol", "2.0", "--no-validate", "--output"]);
    generate.args([module, definition]).stdout(Stdio::null());
    let status = generate.status()?;
    ensure!(status.success(), "pymavlink does not generate the dialect");
    Ok(())
}

/// Another generator reads the same lengths out of the definitions.
fn same_sizes(python: &Path, dialect: &Path, key: &[u8; 32], messages: &[Message]) -> Result<()> {
    let theirs = Pymavlink::start(python, dialect, key)?.sizes()?;
    let ours = messages.iter().map(|message| (message.id, message.size));
    ensure!(
        ours.eq(theirs),
        "pymavlink has payloads of other lengths than the definitions"
    );
    Ok(())
}
