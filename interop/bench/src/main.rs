//! What signing and verifying cost, beside peers and the least that they can, held to bars.
//!
//! Criterion measures, in `benches/signing.rs`, and `interop/python/bench.py` measures pymavlink. Here the times
//! are put beside each other.

mod times;

use std::{
    fs,
    io::Write as _,
    path::Path,
    process::{Command, Stdio},
};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use mavlink_signing::Standard;
use mavseal_bench::{
    floor::{Profile, backend},
    messages::{KEY, MESSAGES},
};
use serde_json::{Value, json};
use times::{MODES, ROUND, Times};

/// What verifying may take, times the floor of its profile.
const MOST: f64 = 1.3;
/// The payloads for which that holds.
const SHORT: [usize; 2] = [9, 32];
const PEERS: [&str; 3] = ["mavlink", "mavio", "pymavlink"];

const FOLDER: &str = env!("CARGO_MANIFEST_DIR");

/// Measures signing and verifying beside peers and the floor, and holds them to their bars
#[derive(Parser)]
struct Options {
    /// Measure shortly: for a look, not for numbers to publish
    #[arg(long)]
    quick: bool,
}

fn main() -> Result<()> {
    // Everything is measured so often, as another process may disturb one round; seconds for each time.
    let (rounds, measure, warm_up) = match Options::parse().quick {
        true => (1, "0.2", "0.05"),
        false => (3, "0.4", "0.1"),
    };
    let python = Command::new(Path::new(FOLDER).join("../python/environment"))
        .arg("requirements.txt")
        .stderr(Stdio::inherit())
        .output()?;
    ensure!(python.status.success(), "pymavlink is missing");
    let python = String::from_utf8(python.stdout)?;
    let folder = Path::new(FOLDER).join("../target/signing");
    if folder.exists() {
        fs::remove_dir_all(&folder)?;
    }
    let mut asked = Vec::new();
    for round in 1..=rounds {
        eprintln!("round {round} of {rounds}");
        criterion(&folder, round, measure, warm_up)?;
        asked.push(pymavlink(python.trim_end(), measure)?);
    }

    let times = Times::read(&folder, &asked)?;
    conditions(&times, &asked[0])?;
    for mode in MODES {
        if times.has(mode) {
            println!("\nFrames {mode}; nanoseconds (times the floor):\n");
            print(&times, mode)?;
        }
    }
    let missed = missed(&times)?;
    ensure!(missed.is_empty(), "missed:\n  {}", missed.join("\n  "));
    println!("\nEvery bar is kept.");
    Ok(())
}

/// Measures all but pymavlink.
fn criterion(folder: &Path, round: usize, measure: &str, warm_up: &str) -> Result<()> {
    let output = Command::new("cargo")
        .current_dir(FOLDER)
        .env("CRITERION_HOME", folder)
        .args(["bench", "--quiet", "--locked", "--bench", "signing", "--"])
        .args(["--quiet", "--noplot", "--warm-up-time", warm_up])
        .args(["--measurement-time", measure])
        // Its own statistics are not looked at; the fewest that it does without a warning.
        .args(["--nresamples", "1001"])
        .args(["--save-baseline", &format!("{ROUND}{round}")])
        .stdout(Stdio::null())
        .output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{}\n{said}", output.status);
    Ok(())
}

/// Has pymavlink sign and verify the same frames.
fn pymavlink(python: &str, seconds: &str) -> Result<Value> {
    let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    let messages = MESSAGES.map(|message| {
        let frames = message.frames::<Standard>();
        let frames: Vec<String> = frames.iter().map(|frame| hex(frame)).collect();
        json!({ "name": message.name, "size": message.size, "frames": frames })
    });
    let key: String = hex(&KEY);
    let given = json!({ "key": key, "messages": messages });
    let mut child = Command::new(python)
        .arg(Path::new(FOLDER).join("../python/bench.py"))
        .arg(seconds)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut input = child.stdin.take().context("its input")?;
    input.write_all(given.to_string().as_bytes())?;
    drop(input);
    let output = child.wait_with_output()?;
    ensure!(output.status.success(), "bench.py: {}", output.status);
    serde_json::from_slice(&output.stdout).context("bench.py")
}

/// With what was measured.
fn conditions(times: &Times, asked: &Value) -> Result<()> {
    let cpu = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let cpu = cpu.lines().find_map(|line| line.strip_prefix("model name"));
    let cpu = cpu.map_or("unknown", |line| line.trim_start_matches([' ', '\t', ':']));
    println!("processor   {cpu}");
    let rustc = Command::new("rustc").arg("--version").output()?;
    print!("compiler    {}", String::from_utf8(rustc.stdout)?);
    println!("SHA-256     sha2 {}, {}", versions("sha2"), backend());
    let [mavlink, mavio] = ["mavlink", "mavio"].map(versions);
    let [pymavlink, python] = ["pymavlink", "python"].map(|what| asked[what].as_str());
    println!(
        "peers       mavlink {mavlink}, mavio {mavio}, pymavlink {} (Python {})",
        pymavlink.unwrap_or_default(),
        python.unwrap_or_default()
    );
    let mode = times.strictest();
    let clock = times.get(mode, "clock")?;
    println!("clock       {clock:.0} ns, which is in the times of mavlink alone");
    for message in MESSAGES {
        let [hmac, standard] = Profile::ALL.map(|profile| profile.compressions(message.size));
        let (fastest, _) = times.fastest_checksum(mode, message.size)?;
        println!(
            "floor       {}, {} bytes: {hmac} compressions (Hmac), {standard} (Standard), and {fastest}",
            message.name, message.size
        );
    }
    Ok(())
}

/// The versions of a package in the lock file, in ascending order.
fn versions(package: &str) -> String {
    let name = format!("name = \"{package}\"\nversion = \"");
    let found = include_str!("../../Cargo.lock").split(&name).skip(1);
    let versions = found.filter_map(|rest| rest.split('"').next());
    Vec::from_iter(versions).join(" and ")
}

/// The table: a line for each payload and operation, a column for each who does it.
fn print(times: &Times, mode: &str) -> Result<()> {
    let [hmac, standard] = Profile::ALL.map(Profile::name);
    println!(
        "| payload | operation | floor, {hmac} | floor, {standard} | here, {hmac} | here, {standard} | {} |",
        PEERS.join(" | ")
    );
    println!("|---|---{}|", "|---:".repeat(7));
    for size in MESSAGES.map(|message| message.size) {
        let floors = [
            times.floor(mode, hmac, size)?,
            times.floor(mode, standard, size)?,
        ];
        for operation in ["sign", "verify", "verify, streams"] {
            let cell = |(who, floor): (&str, f64)| {
                // Only the core can be told to remember one stream or several.
                if PEERS.contains(&who) && operation == "verify, streams" {
                    return Ok(String::new());
                }
                let time = times.get(mode, &format!("{who} {operation}/{size}"))?;
                anyhow::Ok(format!("{time:.0} ({:.2})", time / floor))
            };
            let here = [(hmac, floors[0]), (standard, floors[1])].into_iter();
            let all = here.chain(PEERS.map(|peer| (peer, floors[1])));
            let cells = all.map(cell).collect::<Result<Vec<_>>>()?;
            let [a, b] = floors;
            println!(
                "| {size} | {operation} | {a:.0} | {b:.0} | {} |",
                cells.join(" | ")
            );
        }
    }
    Ok(())
}

/// The bars that are missed, each in words.
fn missed(times: &Times) -> Result<Vec<String>> {
    let mode = times.strictest();
    let mut missed = Vec::new();
    for size in SHORT {
        for profile in Profile::ALL.map(Profile::name) {
            let floor = times.floor(mode, profile, size)?;
            let ours = times.get(mode, &format!("{profile} verify/{size}"))?;
            let what = format!("verify, {profile}, {size} bytes: {ours:.0} ns");
            if ours > MOST * floor {
                let ratio = ours / floor;
                missed.push(format!(
                    "{what} is {ratio:.2} times the floor of {floor:.0} ns; {MOST} is the most"
                ));
            }
            for peer in PEERS {
                let theirs = times.get(mode, &format!("{peer} verify/{size}"))?;
                if ours >= theirs {
                    missed.push(format!("{what} is not faster than {peer}, {theirs:.0} ns"));
                }
            }
        }
    }
    Ok(missed)
}
