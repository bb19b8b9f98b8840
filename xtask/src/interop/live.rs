//! pymavlink and MAVProxy at the emulated signer, with a vehicle behind it that cannot sign.

mod bench;
mod bridge;

use std::{collections::BTreeMap, fs, process::Command};

use anyhow::{Context, Result};
use serde::Deserialize;

use super::{Peers, Report, Row};
use mavseal_chips_host::{Chip, Image};

use crate::setup::{self, root};
use bench::{Bench, Process, script};

/// The link id that the firmware signs for: `chips/qemu-m7/src/bin/relay.rs`.
const LINK_OUT: u8 = 1;
/// Another.
const LINK_IN: u8 = 2;
/// MAV_CMD_REQUEST_MESSAGE, as in `interop/python/ground.py`.
const COMMAND: u16 = 512;

/// Heartbeats of MAVProxy that are to come.
const HEARTBEATS: usize = 8;

/// One that takes part, from its beginning to its end.
type Play = fn(&mut Bench, &Peers, &str, &mut Report) -> Result<()>;

const PLAYS: [(&str, Play); 2] = [("pymavlink", pymavlink), ("MAVProxy", mavproxy)];

/// Both, each at a signer that has just started.
pub(super) fn run(peers: &Peers, report: &mut Report) -> Result<()> {
    setup::qemu()?;
    let features = "ardupilotmega,standard-signature";
    let elf = Image::logging(Chip::QemuM7, "relay", features).build()?;
    let passphrase = root().join("chips/demo/demo.passphrase");
    let passphrase = fs::read_to_string(&passphrase).context("demo.passphrase")?;
    for (name, play) in PLAYS {
        println!("live: {name}, a signer in QEMU, a vehicle");
        let mut bench = Bench::boot(&peers.python, &elf)?;
        let failed = report.failures.len();
        play(&mut bench, peers, &passphrase, report)
            .with_context(|| format!("{name}, live; the firmware's log:{}", bench.log()))?;
        if report.failures.len() > failed {
            println!("  the firmware's log:{}", bench.log());
        }
    }
    Ok(())
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

fn pymavlink(
    bench: &mut Bench,
    peers: &Peers,
    passphrase: &str,
    report: &mut Report,
) -> Result<()> {
    let python = &peers.python;
    let digest = hmac_sha256::Hash::hash(passphrase.as_bytes());
    let key: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
    let mut ground = script(python, "ground.py");
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
    report.fail_unless("pymavlink", checks);
    let version = bench::version(python, "pymavlink")?;
    let peer = ("pymavlink", version.as_str());
    let both_ways = [(frames, ground.signed), (passed, verified.0)];
    report.rows.extend(rows(peer, &vehicle, both_ways));
    Ok(())
}

fn mavproxy(bench: &mut Bench, peers: &Peers, passphrase: &str, report: &mut Report) -> Result<()> {
    let python = &peers.python;
    let home = peers.folder.join("mavproxy");
    fs::create_dir_all(&home)?;
    let mut station = Command::new(python);
    station
        .arg("-u")
        .arg(python.with_file_name("mavproxy.py"))
        .arg(format!("--master=tcp:127.0.0.1:{}", bench.link))
        .arg(format!("--cmd=signing key {passphrase}"))
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
    report.fail_unless("MAVProxy", checks);
    let packets = packets(&link)?;
    let version = bench::version(python, "MAVProxy")?;
    let peer = ("MAVProxy", version.as_str());
    let both_ways = [(packets, packets), (came, verified.0)];
    report.rows.extend(rows(peer, &vehicle, both_ways));
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
    (peer, version): (&str, &str),
    vehicle: &Vehicle,
    [down, up]: [(usize, usize); 2],
) -> [Row; 2] {
    let row = |direction: &str, kinds: &BTreeMap<_, _>, (frames, agreed)| Row {
        peer: peer.into(),
        version: version.into(),
        direction: direction.into(),
        messages: kinds.len(),
        frames,
        agreed,
        differences: Vec::new(),
    };
    [
        row("live, vehicle to ground", &vehicle.sent, down),
        row("live, ground to vehicle", &vehicle.came, up),
    ]
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
