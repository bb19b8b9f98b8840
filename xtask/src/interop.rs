//! `cargo xtask interop`: the standard's signature against unmodified peers, frame by frame and live;
//! sealed packages against another AES-GCM.
//!
//! The frame-by-frame part is the crate in `interop/`, which builds the peers written in Rust and asks
//! those in Python over a pipe. The live part is here: pymavlink and MAVProxy at an emulated signer.

mod live;

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{SystemTime, UNIX_EPOCH},
};

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use comfy_table::{CellAlignment, Table, presets};
use serde::Deserialize;
use xshell::{Shell, cmd};

use crate::{
    setup::{self, root},
    tables,
};

/// Where frames of the peers are kept; the tests of the signing core read them.
const VECTORS: &str = "mavlink/tests/vectors";

/// Options of `cargo xtask interop`.
#[derive(Args, Default)]
pub(crate) struct Options {
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

/// A row of the table.
#[derive(Debug, Default, Deserialize)]
struct Row {
    peer: String,
    version: String,
    direction: String,
    messages: usize,
    frames: usize,
    agreed: usize,
    differences: Vec<String>,
}

/// What the frame-by-frame part has seen.
#[derive(Default, Deserialize)]
struct Report {
    rows: Vec<Row>,
    reasons: Vec<Reason>,
    failures: Vec<String>,
}

impl Report {
    /// What fails of the live part with `peer`: each check that is not right, in its own words.
    fn fail_unless(&mut self, peer: &str, checks: impl IntoIterator<Item = (bool, String)>) {
        let wrong = checks.into_iter().filter(|(right, _)| !right);
        self.failures
            .extend(wrong.map(|(_, what)| format!("{peer}, live: {what}")));
    }
}

/// Why a peer does something else.
#[derive(Deserialize)]
struct Reason {
    peer: String,
    scenario: String,
    reason: String,
}

/// Runs all of it.
///
/// # Errors
/// If a frame of a peer is not understood here, or the reverse, if a verdict differs in a way that is
/// not listed, or if one that is listed does not differ any more.
pub(crate) fn run(options: &Options) -> Result<()> {
    let seed = match options.seed {
        Some(seed) => seed,
        None => SystemTime::now().duration_since(UNIX_EPOCH)?.as_secs(),
    };
    let peers = Peers::prepare()?;
    if options.vectors {
        let mut command = peers.frames(seed);
        command.arg("--vectors").arg(root().join(VECTORS));
        let status = command.status()?;
        ensure!(status.success(), "the peers' frames: {status}");
        return Ok(());
    }
    let mut report = Report::default();
    if options.only != Some(Part::Live) {
        println!("seed {seed}");
        report = peers.compare(seed)?;
    }
    if options.only != Some(Part::Frames) {
        live::run(&peers, &mut report)?;
    }
    print(&report);
    ensure!(
        report.failures.is_empty(),
        "not as it has to be, seed {seed}:\n  {}",
        report.failures.join("\n  ")
    );
    println!("Every frame was as it had to be.");
    Ok(())
}

/// The peers, and what they are given.
struct Peers {
    /// Where they are, below the target directory.
    folder: PathBuf,
    python: PathBuf,
    /// One that has `cryptography`.
    sealing_python: PathBuf,
    dialect: PathBuf,
    messages: PathBuf,
}

impl Peers {
    /// Finds or installs them, below `target/`.
    fn prepare() -> Result<Self> {
        let folder = setup::target_dir()?.join("interop");
        fs::create_dir_all(&folder)?;
        // A process in another folder is given it too.
        let folder = folder.canonicalize()?;
        let requirements = root().join("interop/python/requirements.txt");
        let python = setup::python(&folder.join("python"), &requirements)?;
        let requirements = root().join("interop/python/sealed.txt");
        let sealing_python = setup::python(&folder.join("sealed"), &requirements)?;

        let (definition, messages) = tables::largest()?;
        let mut list = String::new();
        for (id, message) in messages {
            let [base, all] = message.sizes;
            let (crc_extra, name) = (message.crc_extra, message.name);
            writeln!(list, "{id} {crc_extra} {base} {all} {name}")?;
        }
        let messages = folder.join("messages.txt");
        fs::write(&messages, list)?;

        let dialect = folder.join("dialect.py");
        generate(&python, &definition, &dialect)?;
        Ok(Self {
            folder,
            python,
            sealing_python,
            dialect,
            messages,
        })
    }

    /// A call of the frame-by-frame part.
    fn frames(&self, seed: u64) -> Command {
        let mut command = Command::new("cargo");
        command.current_dir(root().join("interop"));
        command.args(["run", "--quiet", "--locked", "--"]);
        command.arg("--python").arg(&self.python);
        command.arg("--sealing-python").arg(&self.sealing_python);
        command.arg("--dialect").arg(&self.dialect);
        command.arg("--messages").arg(&self.messages);
        command.args(["--seed", &seed.to_string()]);
        command
    }

    fn compare(&self, seed: u64) -> Result<Report> {
        let output = self.frames(seed).stderr(Stdio::inherit()).output()?;
        ensure!(output.status.success(), "frame by frame: {}", output.status);
        serde_json::from_slice(&output.stdout).context("the report of interop/")
    }
}

/// Has pymavlink's own generator make the module of a dialect, since the one that it ships lacks some
/// messages of these definitions.
fn generate(python: &Path, definition: &Path, module: &Path) -> Result<()> {
    let sh = Shell::new()?;
    // The schema that it would check them with takes one more package.
    let generate = cmd!(
        sh,
        "{python} -m pymavlink.tools.mavgen --lang Python3 --wire-protocol 2.0 --no-validate --output {module} {definition}"
    );
    generate
        .quiet()
        .ignore_stdout()
        .run()
        .context("pymavlink does not generate the dialect")
}

fn print(report: &Report) {
    let mut table = Table::new();
    table.load_preset(presets::NOTHING);
    table.set_header([
        "peer",
        "version",
        "direction",
        "messages",
        "frames",
        "agreed",
        "differences",
    ]);
    for row in &report.rows {
        table.add_row([
            row.peer.clone(),
            row.version.clone(),
            row.direction.clone(),
            row.messages.to_string(),
            row.frames.to_string(),
            row.agreed.to_string(),
            row.differences.len().to_string(),
        ]);
    }
    for column in 3..=6 {
        if let Some(column) = table.column_mut(column) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    println!("\nWhat the peers do in another way, in every run:");
    let mut scenarios: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for Reason {
        peer,
        scenario,
        reason,
    } in &report.reasons
    {
        let same = scenarios.entry((peer, reason)).or_default();
        same.push(scenario.as_str());
    }
    for ((peer, reason), scenarios) in scenarios {
        println!("  {peer}: {}\n    {reason}", scenarios.join("; "));
    }
    println!("\n{table}");
}
