//! `cargo xtask demo --seal`: a vehicle that seals, and two ground stations behind links that lose.

mod air;
mod station;
mod vehicle;

use std::{
    collections::BTreeMap,
    fs,
    time::{Instant, SystemTime, UNIX_EPOCH},
};

use anyhow::{Result, ensure};
use mavlink_commsec::{Opener, Sealer, SealingKey, SenderId, hx};
use mavseal_chips_host::{Chip, Image};
use mavseal_keys::KeyFile;

use super::{EACH, Row, print_log, summed, wire, wire::Frame};
use crate::setup;
use air::Air;
use station::{Sealed, Station, key};
use vehicle::{Counted, STATUS, Vehicle, frame_of};

/// Commands of each station before the restart, and again after it.
const COMMANDS: usize = 100;
/// Most bytes of a packet that fits into a package.
const PLAINTEXT_SIZE: usize = 80;
/// How far the firmware's marks are ahead at most: `relay/src/sealed.rs`.
const SENT_RESERVATION: u32 = 256;
const ACCEPTED_RESERVATION: u32 = 8;

/// CRC_EXTRA of VEHICLE_RADIO.
const CRC_EXTRA: u8 = 238;
/// The columns of what goes through the air.
const AIR: [&str; 6] = [
    "packages", "lost", "doubled", "arrived", "accepted", "rejected",
];

/// Runs the demonstration.
///
/// # Errors
/// If anything came out that should not have, or did not come out that should have.
pub(super) fn run(seed: Option<u64>, other_keys: bool) -> Result<()> {
    let seed = match seed {
        Some(seed) => seed,
        None => SystemTime::now().duration_since(UNIX_EPOCH)?.as_secs(),
    };
    let keys = KeyFile::generate(2)?;
    let elf = build(&keys)?;
    let telemetry = wire::telemetry()?;
    println!("Links by seed {seed}; fresh keys for one vehicle and two stations");
    let keys = if other_keys {
        KeyFile::generate(2)?
    } else {
        keys
    };
    let mut demo = Demo::boot(&elf, &keys, seed)?;
    let (before, after) = telemetry.split_at(telemetry.len() / 2);
    let steps: [Step<'_>; 4] = [
        &|demo| demo.play(before, ""),
        &Demo::attack,
        &Demo::restart,
        &|demo| demo.play(after, ", after the restart"),
    ];
    for step in steps {
        // What follows a failure only fails for its sake.
        if demo.failures.is_empty() {
            step(&mut demo)?;
        }
    }
    demo.finish()
}

/// The vehicle with these keys.
fn build(keys: &KeyFile) -> Result<std::path::PathBuf> {
    let path = setup::target_dir()?.join("demo-keys.toml");
    if path.exists() {
        fs::remove_file(&path)?;
    }
    keys.write_new(&path)?;
    let image = Image::logging(Chip::QemuM7, "vehicle", "ardupilotmega,sealing");
    let elf = path.with_extension("elf");
    image.build_to(&elf, &path)?;
    Ok(elf)
}

/// A part of the play.
type Step<'a> = &'a dyn Fn(&mut Demo) -> Result<()>;

/// A frame for the vehicle's radio, and what must become of it.
struct Delivery {
    frame: Vec<u8>,
    /// The row that it belongs to
    row: usize,
    /// The packets that must reach the autopilot, or why none may
    expected: Result<Vec<u8>, &'static str>,
}

/// Everybody, and what was seen.
struct Demo {
    vehicle: Vehicle,
    vehicle_id: u32,
    stations: Vec<Station>,
    /// Opens every package as it leaves the vehicle
    witness: Opener<1>,
    /// What the vehicle must have accepted last of each sender
    last: BTreeMap<u32, u32>,
    /// The counter of the vehicle's last package
    sent: u32,
    attacker: Air,
    /// Packages that were accepted, to be replayed
    accepted: Vec<Sealed>,
    /// How many of them before the last start
    accepted_before: usize,
    from_vehicle: Vec<Sealed>,
    local: Vec<Row<3>>,
    up: Vec<Row<6>>,
    down: Vec<Row<6>>,
    /// VEHICLE_RADIO since the start, and before it
    radio_told: usize,
    radio_told_before: usize,
    failures: Vec<String>,
    started: Instant,
}

impl Demo {
    fn boot(elf: &std::path::Path, keys: &KeyFile, seed: u64) -> Result<Self> {
        let own = keys.vehicle();
        let stations = keys.stations().iter();
        let stations = stations.map(|station| Station::new(station, own, seed));
        let stations = stations.collect::<Result<Vec<_>>>()?;
        let mut witness = Opener::new();
        witness.permit(key(own)?, &[SenderId(own.id)])?;
        let (vehicle, start) = Vehicle::boot(elf, stations.len())?;
        ensure!(
            start.next == 1,
            "a fresh key, yet it goes on at {}",
            start.next
        );
        let mut demo = Self {
            vehicle,
            vehicle_id: own.id,
            stations,
            witness,
            last: BTreeMap::new(),
            sent: 0,
            attacker: Air::new(seed, 0),
            accepted: Vec::new(),
            accepted_before: 0,
            from_vehicle: Vec::new(),
            local: Vec::new(),
            up: Vec::new(),
            down: Vec::new(),
            radio_told: 0,
            radio_told_before: 0,
            failures: Vec::new(),
            started: Instant::now(),
        };
        demo.last = start.above;
        Ok(demo)
    }

    /// Telemetry down and commands up, at once.
    fn play(&mut self, telemetry: &[Frame], when: &str) -> Result<()> {
        let mut ways = Vec::new();
        for station in &mut self.stations {
            let sealed = station.commands(COMMANDS)?;
            let arrived = station.up.carry(&sealed);
            self.up.push(Row {
                name: format!("station {}: commands{when}", station.id),
                counts: [
                    sealed.len(),
                    arrived.lost,
                    arrived.doubled,
                    arrived.packages.len(),
                    0,
                    0,
                ],
                because: String::new(),
            });
            ways.push(
                arrived
                    .packages
                    .into_iter()
                    .collect::<std::collections::VecDeque<_>>(),
            );
        }
        // Both stations at once: one package of either after the other, as it comes.
        let first_row = self.up.len() - ways.len();
        let mut deliveries = Vec::new();
        while ways.iter().any(|way| !way.is_empty()) {
            let at = self.attacker.any(ways.len());
            let Some(sealed) = ways[at].pop_front() else {
                continue;
            };
            let last = self.last.entry(sealed.sender).or_default();
            let expected = if sealed.counter > *last {
                *last = sealed.counter;
                self.accepted.push(sealed.clone());
                Ok(sealed.packets)
            } else {
                Err("stale")
            };
            deliveries.push(Delivery {
                frame: frame_of(hx::FrameKind::AirData, &sealed.package)?,
                row: first_row + at,
                expected,
            });
        }
        let sent = self.from_vehicle.len();
        self.exchange(telemetry, deliveries, when)?;
        for station in &mut self.stations {
            let name = format!("station {}: telemetry{when}", station.id);
            let sent = &self.from_vehicle[sent..];
            let row = station.listen(&name, sent, &mut self.failures);
            self.down.push(row);
        }
        Ok(())
    }

    /// What an attacker sends to the vehicle.
    fn attack(&mut self) -> Result<()> {
        let mut deliveries = Vec::new();
        let count = self.accepted.len();
        let replayed: Vec<Sealed> = self.accepted[count - EACH..].to_vec();
        let mut fresh: Vec<Vec<u8>> = Vec::new();
        for at in 0..4 * EACH {
            let station = &mut self.stations[at % 2];
            fresh.extend(
                station
                    .commands(1)?
                    .into_iter()
                    .map(|sealed| sealed.package),
            );
        }
        let mut fresh = fresh.into_iter();
        let mut forge = |change: &dyn Fn(&mut Vec<u8>)| -> Vec<Vec<u8>> {
            let packages = fresh.by_ref().take(EACH);
            packages
                .map(|mut package| {
                    change(&mut package);
                    package
                })
                .collect()
        };
        let message = forge(&|package| package[40] ^= 1);
        let tag = forge(&|package| package[95] ^= 1);
        let sender = forge(&|package| package[3] ^= 3);
        let cut = forge(&|package| package.truncate(95));
        let raised = replayed.iter().map(|sealed| {
            let mut package = sealed.package.clone();
            package[4] = 0x70;
            package
        });
        let strange = |id, key: [u8; 16]| -> Result<Vec<Vec<u8>>> {
            let mut sealer: Sealer =
                Sealer::resume(SealingKey::new(&key, 0)?, SenderId(id), 1 << 30);
            (0..EACH)
                .map(|_| Ok(sealer.seal(&[0; PLAINTEXT_SIZE])?.as_bytes().to_vec()))
                .collect()
        };
        let raised: Vec<Vec<u8>> = raised.collect();
        let other_key = strange(self.stations[0].id, self.attacker.strange_key())?;
        let unknown = strange(9, self.attacker.strange_key())?;
        let reflected = self.from_vehicle.iter().take(EACH);
        let reflected: Vec<Vec<u8>> = reflected.map(|sealed| sealed.package.clone()).collect();
        let replays = replayed
            .iter()
            .map(|sealed| sealed.package.clone())
            .collect();

        let packages: [(&str, &'static str, Vec<Vec<u8>>); 9] = [
            ("replayed", "stale", replays),
            ("message changed", "bad tag", message),
            ("tag changed", "bad tag", tag),
            ("sender changed", "bad tag", sender),
            ("counter raised", "bad tag", raised),
            ("another key", "bad tag", other_key),
            ("unknown sender", "unknown sender", unknown),
            ("the vehicle's own, reflected", "unknown sender", reflected),
            ("cut short", "wrong length", cut),
        ];
        for (name, because, packages) in packages {
            ensure!(
                packages.len() == EACH,
                "{name}: {} packages",
                packages.len()
            );
            let frames = packages
                .iter()
                .map(|package| frame_of(hx::FrameKind::AirData, package));
            self.rejected(
                name,
                because,
                frames.collect::<Result<_>>()?,
                &mut deliveries,
            );
        }
        let frames: [(&str, &'static str, Vec<u8>); 4] = [
            ("empty frames", "empty frame", vec![hx::FLAG, 0, hx::FLAG]),
            (
                "frames of an unknown kind",
                "unknown tag",
                vec![hx::FLAG, 7, 1, hx::FLAG],
            ),
            (
                "frames that are too long",
                "frame too long",
                frame_too_long(),
            ),
            (
                "radio status, not asked for",
                "not asked",
                frame_of(hx::FrameKind::Radio, &STATUS.to_wire())?,
            ),
        ];
        for (name, because, frame) in frames {
            self.rejected(name, because, vec![frame; EACH], &mut deliveries);
        }
        self.exchange(&[], deliveries, "")?;

        // The same against a station.
        let sent = self.from_vehicle.clone();
        let tampered = |at: usize| {
            let packages = sent.iter().take(EACH).map(|sealed| {
                let mut package = sealed.package.clone();
                // Newer than anything.
                package[4] = 0x70;
                package[at] ^= 1;
                package
            });
            packages.collect::<Vec<_>>()
        };
        let replayed = sent.iter().take(EACH).map(|sealed| sealed.package.clone());
        let replayed: Vec<_> = replayed.collect();
        let own = self.stations[0].commands(EACH)?;
        let own: Vec<_> = own.into_iter().map(|sealed| sealed.package).collect();
        let other_key = strange(self.vehicle_id, self.attacker.strange_key())?;
        let station = &mut self.stations[0];
        for (name, packages, because) in [
            ("station 1: replayed", replayed, "stale"),
            ("station 1: message changed", tampered(40), "bad tag"),
            ("station 1: another key", other_key, "bad tag"),
            ("station 1: its own, reflected", own, "unknown sender"),
        ] {
            let row = station.reject(name, &packages, because, &mut self.failures);
            self.down.push(row);
        }
        Ok(())
    }

    /// Adds a row of what must be rejected for one reason.
    fn rejected(
        &mut self,
        name: &str,
        because: &'static str,
        frames: Vec<Vec<u8>>,
        deliveries: &mut Vec<Delivery>,
    ) {
        let count = frames.len();
        self.up.push(Row {
            name: name.to_owned(),
            counts: [count, 0, 0, count, 0, 0],
            because: because.to_owned(),
        });
        let row = self.up.len() - 1;
        deliveries.extend(frames.into_iter().map(|frame| Delivery {
            frame,
            row,
            expected: Err(because),
        }));
    }

    /// Sends both ways at once and judges what came of it.
    fn exchange(&mut self, telemetry: &[Frame], up: Vec<Delivery>, when: &str) -> Result<()> {
        let long = telemetry
            .iter()
            .filter(|frame| frame.len() > PLAINTEXT_SIZE);
        let long = long.count();
        let short: Vec<&Frame> = telemetry
            .iter()
            .filter(|frame| frame.len() <= PLAINTEXT_SIZE)
            .collect();
        let vehicle = &mut self.vehicle;
        let (packages_before, handed_before) = (vehicle.packages.len(), vehicle.handed.len());
        let rejected_before = vehicle.rejected.each_ref().map(Vec::len);
        let counted_before = vehicle.counted;
        let told_before = self.radio_told;
        let handed: Vec<&[u8]> = up
            .iter()
            .filter_map(|one| one.expected.as_deref().ok())
            .collect();
        let opened = handed.len();
        let rejected = up.len() - opened;
        let handed = handed.concat();

        vehicle.autopilot.send(telemetry.concat())?;
        for delivery in &up {
            vehicle.radio.send(delivery.frame.clone())?;
        }
        vehicle.until(|vehicle| {
            let [sealing, opening] = vehicle.counted;
            vehicle.handed.len() - handed_before >= handed.len()
                && sealing.packages == vehicle.packages.len()
                && sealing.packets >= counted_before[0].packets + short.len()
                && sealing.rejected >= counted_before[0].rejected + long
                && opening.packages >= counted_before[1].packages + opened
                && opening.rejected >= counted_before[1].rejected + rejected
        })?;

        // Down: what the witness reads is the telemetry, whole and in order, and the radio's status.
        let mut came = Vec::new();
        for package in &self.vehicle.packages[packages_before..] {
            let opened = match self.witness.open(package) {
                Ok(opened) => opened,
                Err(error) => {
                    self.failures.push(format!("from the vehicle: {error}"));
                    break;
                }
            };
            self.sent = opened.counter();
            let mut packets = Vec::new();
            for packet in opened.packets() {
                let packet = packet?;
                if packet[0] == 0xFD {
                    came.push(packet.to_vec());
                } else if packet == vehicle_radio(self.radio_told as u8) {
                    self.radio_told += 1;
                } else {
                    self.failures
                        .push(format!("a strange packet: {packet:02X?}"));
                }
                packets.extend_from_slice(packet);
            }
            self.from_vehicle.push(Sealed {
                sender: self.vehicle_id,
                counter: opened.counter(),
                package: package.clone(),
                packets,
            });
        }
        let right = came.iter().zip(&short).filter(|(a, b)| a == *b).count();
        if came.len() != short.len() || right != came.len() {
            self.failures.push(format!(
                "{right} of {} packets are the telemetry's, {} came",
                short.len(),
                came.len()
            ));
        }
        if !telemetry.is_empty() {
            self.local.push(Row {
                name: format!("recorded telemetry{when}"),
                counts: [
                    telemetry.len(),
                    right,
                    self.vehicle.rejected[0].len() - rejected_before[0],
                ],
                because: "longer than a message".to_owned(),
            });
        }
        let reasons = &self.vehicle.rejected[0][rejected_before[0]..];
        if reasons.len() != long
            || reasons
                .iter()
                .any(|reason| reason != "longer than a message")
        {
            self.failures.push(format!(
                "{long} packets are too long, rejected: {reasons:?}"
            ));
        }

        // Up: each frame by itself.
        if self.vehicle.handed[handed_before..] != handed {
            self.failures.push(format!(
                "{} bytes reached the autopilot, or others, not {}",
                self.vehicle.handed.len() - handed_before,
                handed.len()
            ));
        }
        let mut reasons = self.vehicle.rejected[1][rejected_before[1]..].iter();
        let mut bytes = &self.vehicle.handed[handed_before..];
        for delivery in &up {
            let [.., accepted, rejected] = &mut self.up[delivery.row].counts;
            match &delivery.expected {
                Ok(packets) => {
                    if let Some(rest) = bytes.strip_prefix(&packets[..]) {
                        bytes = rest;
                        *accepted += 1;
                    }
                }
                Err(because) => {
                    *rejected +=
                        usize::from(reasons.next().is_some_and(|reason| reason == because));
                    (*because).clone_into(&mut self.up[delivery.row].because);
                }
            }
        }
        let left = reasons.len();
        if let Some(first) = reasons.next() {
            self.failures
                .push(format!("{left} rejections too many, the first: {first}"));
        }
        for row in self
            .up
            .iter()
            .filter(|row| row.counts[3] != row.counts[4] + row.counts[5])
        {
            let [.., arrived, accepted, rejected] = row.counts;
            self.failures.push(format!(
                "{}: {arrived} arrived, {accepted} accepted, {rejected} rejected",
                row.name
            ));
        }

        // The firmware's own counters.
        let counted = self.vehicle.counted;
        let expected = [
            Counted {
                packages: self.vehicle.packages.len(),
                packets: counted_before[0].packets + short.len() + self.radio_told - told_before,
                rejected: counted_before[0].rejected + long,
                dropped: 0,
            },
            Counted {
                packages: counted_before[1].packages + opened,
                packets: counted_before[1].packets + 2 * opened,
                rejected: counted_before[1].rejected + rejected,
                dropped: 0,
            },
        ];
        if counted != expected {
            self.failures
                .push(format!("counted: {counted:?}, not {expected:?}"));
        }
        let accepted = self.accepted_of();
        if self.vehicle.opened_of != accepted {
            let counted = &self.vehicle.opened_of;
            self.failures.push(format!(
                "counted of each sender: {counted:?}, not {accepted:?}"
            ));
        }
        Ok(())
    }

    /// How many packages of each station were accepted since the start.
    fn accepted_of(&self) -> BTreeMap<u32, usize> {
        let since = self.accepted[self.accepted_before..].iter();
        let none = self.stations.iter().map(|station| (station.id, 0));
        let mut accepted = BTreeMap::from_iter(none);
        for sealed in since {
            *accepted.entry(sealed.sender).or_default() += 1;
        }
        accepted
    }

    /// Presses the reset button, and sends again what was accepted before.
    fn restart(&mut self) -> Result<()> {
        let start = self.vehicle.restart(self.stations.len())?;
        self.accepted_before = self.accepted.len();
        self.radio_told_before += std::mem::take(&mut self.radio_told);
        let ahead = start.next.checked_sub(self.sent + 1);
        if ahead.is_none_or(|ahead| ahead >= SENT_RESERVATION) {
            self.failures.push(format!(
                "after {} the vehicle goes on at {}",
                self.sent, start.next
            ));
        }
        for (sender, last) in &self.last {
            let above = start.above.get(sender).copied().unwrap_or_default();
            let ahead = above.checked_sub(*last);
            if ahead.is_none_or(|ahead| ahead > ACCEPTED_RESERVATION) {
                self.failures.push(format!(
                    "sender {sender} was heard up to {last}, and is heard above {above}"
                ));
            }
        }
        self.last = start.above;
        let mut deliveries = Vec::new();
        let mut frames = Vec::new();
        for sealed in self.accepted.iter().rev().take(EACH) {
            frames.push(frame_of(hx::FrameKind::AirData, &sealed.package)?);
        }
        self.rejected("from before the restart", "stale", frames, &mut deliveries);
        self.exchange(&[], deliveries, "")
    }

    /// Prints the log and the tables; fails if anything was not as it must be.
    fn finish(mut self) -> Result<()> {
        let took = self.started.elapsed();
        self.vehicle.stop()?;
        self.failures.append(&mut self.vehicle.faults);
        println!("\nThe firmware's log:");
        print_log(&self.vehicle.lines);
        let names = ["packets", "sealed", "rejected"];
        println!(
            "\nFrom the autopilot into the vehicle:\n{}",
            summed(names, self.local)
        );
        println!(
            "\nThrough the air to the vehicle:\n{}",
            summed(AIR, self.up)
        );
        println!(
            "\nThrough the air from the vehicle:\n{}",
            summed(AIR, self.down)
        );
        let told = self.radio_told_before + self.radio_told;
        if told == 0 {
            self.failures.push("no VEHICLE_RADIO came".to_owned());
        }
        println!("\ntime: {:.1} s", took.as_secs_f32());
        ensure!(
            self.failures.is_empty(),
            "the demonstration failed:\n  {}",
            self.failures.join("\n  ")
        );
        println!(
            "{} packages of the vehicle, none under a counter that was used before; {told} of them tell of its radio.\n\
             Everything was as it had to be.",
            self.from_vehicle.len(),
        );
        Ok(())
    }
}

/// A frame with 101 bytes, one more than there may be.
fn frame_too_long() -> Vec<u8> {
    let mut frame = vec![1; 104];
    frame[0] = hx::FLAG;
    frame[1] = 0;
    frame[103] = hx::FLAG;
    frame
}

/// VEHICLE_RADIO of SMACCMPilot's dialect, message 174 of MAVLink 1, as [`STATUS`] makes it.
fn vehicle_radio(sequence: u8) -> Vec<u8> {
    let mut packet = vec![0xFE, 9, sequence, 1, 68, 174];
    packet.extend(STATUS.tx_errors.to_le_bytes());
    packet.extend(STATUS.ecc_errors.to_le_bytes());
    packet.extend([
        STATUS.rssi,
        STATUS.remote_rssi,
        STATUS.serial_rx_overflow as u8,
    ]);
    packet.extend([STATUS.noise, STATUS.remote_noise]);
    packet.extend(wire::checksum_with(&packet, CRC_EXTRA));
    packet
}
