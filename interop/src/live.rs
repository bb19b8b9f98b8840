//! pymavlink and MAVProxy at the emulated signer, with a vehicle behind it that cannot sign.

mod bench;
mod bridge;

use std::{collections::BTreeMap, fs, path::Path, process::Command};

use anyhow::{Context, Result};
use mavseal_chips_host::{Chip, Image};
use serde::Deserialize;
use sha2::{Digest, Sha256};

use crate::{
    hex, python,
    report::{Judge, Row},
};
use bench::{Bench, Process};

/// Public, as the firmware has it.
const PASSPHRASE: &str = include_str!("../../chips/demo/demo.passphrase");
/// The link id that the firmware signs for: `chips/qemu-m7/src/bin/relay.rs`.
const LINK_OUT: u8 = 1;
/// Another.
const LINK_IN: u8 = 2;
/// MAV_CMD_REQUEST_MESSAGE, as in `interop/python/ground.py`.
const COMMAND: u16 = 512;

/// Heartbeats of MAVProxy that are to come.
const HEARTBEATS: usize = 8;

/// One that takes part, from its beginning to its end.
type Play = fn(&mut Bench, &Path, &mut Judge) -> Result<()>;

const PLAYS: [(&str, Play); 2] = [("pymavlink", pymavlink), ("MAVProxy", mavproxy)];

/// Both, each at a signer that has just started.
pub(crate) fn run(python: &Path, judge: &mut Judge) -> Result<()> {
    let features = "ardupilotmega,standard-signature";
    let elf = Image::logging(Chip::QemuM7, "relay", features).build()?;
    for (name, play) in PLAYS {
        println!("live: {name}, a signer in QEMU, a vehicle");
        let mut bench = Bench::boot(python, &elf)?;
        let failed = judge.failed();
        play(&mut bench, python, judge)
            .with_context(|| format!("{name}, live; the firmware's log:{}", bench.log()))?;
        if judge.failed() > failed {
            println!("  the firmware's log:{}", bench.log());
        }
    }
    Ok(())
}

/// Fails for each check that is not right, in its own words.
fn fail_unless(judge: &mut Judge, peer: &str, checks: impl IntoIterator<Item = (bool, String)>) {
    for (_, what) in checks.into_iter().filter(|(right, _)| !right) {
        judge.fail(format!("{peer}, live: {what}"), || {
            "the firmware's log is above".to_owned()
        });
    }
}

/// A command that was sent or came: system, command, first parameter.
type Sent = (u8, u16, f32);

/// What `interop/python/vehicle.py` says at its end.
#[derive(Deserialize)]
struct Vehicle {
    sent: BTreeMap<String, usize>,
    came: BTreeMap<String, usize>,
    commands: Vec<Sent>,
}

/// What `interop/python/ground.py` says at its end.
#[derive(Deserialize)]
struct Ground {
    frames: usize,
    signed: usize,
    gaps: usize,
    rejected: usize,
    links: Vec<Option<u8>>,
    /// The commands that are to come to the vehicle.
    authentic: Vec<Sent>,
    acknowledged: usize,
    /// All frames that are to.
    passed: usize,
    /// The link id that its last command was signed for: it was given none, and heard the vehicle.
    adopted: u8,
}

fn pymavlink(bench: &mut Bench, python: &Path, judge: &mut Judge) -> Result<()> {
    let key = hex::encode(&Sha256::digest(PASSPHRASE));
    let mut ground = python::script(python, "ground.py");
    ground.args([&bench.link.to_string(), &key, &LINK_IN.to_string()]);
    let ground = Process::start(&mut ground)?.wait_for("{")?;
    let ground: Ground = serde_json::from_str(&ground).context("ground.py")?;
    let vehicle: Vehicle = serde_json::from_str(&bench.end_vehicle()?).context("vehicle.py")?;
    let signed = bench.counters("signed")?;
    let verified = bench.counters("verified")?;

    let sent: usize = vehicle.sent.values().sum();
    let Ground {
        frames,
        gaps,
        rejected,
        links,
        authentic,
        acknowledged,
        passed,
        ..
    } = ground;
    let adopted = ground.adopted;
    let all_authentic = ground.signed == frames && gaps == 0 && rejected == 0;
    let commands = &vehicle.commands;
    let checks = [
        (
            all_authentic,
            format!(
                "{} of {frames} frames are authentic, {gaps} gaps, {rejected} rejected",
                ground.signed
            ),
        ),
        (
            links == [Some(LINK_OUT)],
            format!("frames come of links {links:?}"),
        ),
        (
            adopted == LINK_OUT,
            format!("after link id 0 the station signs for link {adopted}"),
        ),
        (
            *commands == authentic && acknowledged == authentic.len(),
            format!("commands {authentic:?} sent, {acknowledged} acknowledged, {commands:?} came"),
        ),
        (
            signed == (sent, 0),
            format!("the vehicle sent {sent} frames, the signer says {signed:?}"),
        ),
        // One command was signed with another key, one not at all.
        (
            verified == (passed, 2),
            format!("{passed} authentic frames sent, the signer says {verified:?}"),
        ),
    ];
    fail_unless(judge, "pymavlink", checks);
    let version = python::version(python, "pymavlink")?;
    let peer = ("pymavlink", version.as_str());
    let both_ways = [(frames, ground.signed), (passed, verified.0)];
    rows(judge, peer, &vehicle, both_ways);
    Ok(())
}

fn mavproxy(bench: &mut Bench, python: &Path, judge: &mut Judge) -> Result<()> {
    let home = python::folder(python)?.join("mavproxy");
    fs::create_dir_all(&home)?;
    let mut station = Command::new(python);
    station
        .arg("-u")
        .arg(python.with_file_name("mavproxy.py"))
        .arg(format!("--master=tcp:127.0.0.1:{}", bench.link))
        .arg(format!("--cmd=signing key {PASSPHRASE}"))
        .args([
            "--default-modules=signing,link,cmdlong",
            "--state-basedir=.",
        ])
        .current_dir(&home)
        .env("HOME", &home);
    let mut station = Process::start(&mut station)?;
    station.wait_for("Detected vehicle 1:1 on link 0")?;
    station.say(&format!("long {COMMAND} 148"))?;
    bench.vehicle.wait_for("COMMAND_LONG")?;
    // One a second: for longer than any message is on its way.
    for _ in 0..HEARTBEATS {
        bench.vehicle.wait_for("HEARTBEAT")?;
    }
    station.say("link")?;
    let link = station.wait_for(" packets, ")?;
    station.end()?;
    let vehicle: Vehicle = serde_json::from_str(&bench.end_vehicle()?).context("vehicle.py")?;
    let signed = bench.counters("signed")?;
    let verified = bench.counters("verified")?;

    let sent: usize = vehicle.sent.values().sum();
    let came: usize = vehicle.came.values().sum();
    let commands = &vehicle.commands;
    let ours = |(_, command, parameter): &Sent| (*command, *parameter) == (COMMAND, 148.0);
    let checks = [
        (
            link.contains(" OK ") && link.contains("unsigned 0 reject 0"),
            format!("it says of its link: {link}"),
        ),
        (
            commands.iter().any(ours),
            format!("its command is not among {commands:?}"),
        ),
        (
            signed == (sent, 0),
            format!("the vehicle sent {sent} frames, the signer says {signed:?}"),
        ),
        (
            verified == (came, 0),
            format!("{came} frames came to the vehicle, the signer says {verified:?}"),
        ),
    ];
    fail_unless(judge, "MAVProxy", checks);
    let packets = packets(&link)?;
    let version = python::version(python, "MAVProxy")?;
    let peer = ("MAVProxy", version.as_str());
    let both_ways = [(packets, packets), (came, verified.0)];
    rows(judge, peer, &vehicle, both_ways);
    Ok(())
}

/// How many packets MAVProxy says it has accepted: `link 1 OK (25 packets, …`.
fn packets(link: &str) -> Result<usize> {
    let (before, _) = link.split_once(" packets, ").context("packets")?;
    let (_, count) = before.rsplit_once('(').context("a count")?;
    Ok(count.parse()?)
}

/// What a peer and the vehicle said to each other: downwards, then upwards, frames and how many agreed.
fn rows(
    judge: &mut Judge,
    (peer, version): (&str, &str),
    vehicle: &Vehicle,
    [down, up]: [(usize, usize); 2],
) {
    let mut row = |direction, kinds: &BTreeMap<_, _>, (frames, agreed)| {
        judge.row(Row {
            peer: peer.into(),
            version: version.into(),
            direction,
            messages: kinds.len(),
            frames,
            agreed,
            ..Row::default()
        });
    };
    row("live, vehicle to ground", &vehicle.sent, down);
    row("live, ground to vehicle", &vehicle.came, up);
}

#[cfg(test)]
mod tests {
    use super::packets;

    #[test]
    fn mavproxy_tells_how_many_packets() {
        let said = "STABILIZE> link 1 OK (25 packets, 893 bytes, 0.00s delay, 0 lost)";
        assert_eq!(packets(said).unwrap(), 25);
        assert!(packets("link 1 DOWN").is_err());
    }
}
