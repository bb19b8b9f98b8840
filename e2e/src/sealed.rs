//! A sealed link: one vehicle and two ground stations, air that loses, doubles and reorders, attacks, a reset.

mod air;
mod station;
mod vehicle;

use std::{
    collections::VecDeque,
    path::Path,
    time::{SystemTime, UNIX_EPOCH},
};

use anyhow::{Result, ensure};
use mavlink_commsec::{Sealer, SealingKey, SenderId, hx};
use mavseal_chips_host::{Chip, Image};
use mavseal_keys::KeyFile;

use crate::{
    run,
    scenario::{
        Phase, Row, Sending,
        Side::{Link, Local},
    },
    wire::{self, Frame},
};
use station::Sealed;
use vehicle::{STATUS, Vehicle, frame_of};

/// How many ground stations there are.
const STATIONS: usize = 2;
/// The id of a sender that the vehicle does not know.
const UNKNOWN: u32 = 9;
/// Frames of each kind that must be rejected.
const EACH: usize = 25;
/// Commands of each station before the reset, and again after it.
const COMMANDS: usize = 100;
/// Most bytes of a packet that fits into a package.
const PLAINTEXT_SIZE: usize = 80;
/// Bytes of a package, the first of its message, and the first of its counter.
const PACKAGE_SIZE: usize = 96;
const COUNTER: usize = 4;
const MESSAGE: usize = 40;

/// Plays with fresh keys. The air does as `seed` says, otherwise as the time of day does. The firmware's log is
/// printed too if `log`. With `other_keys` the stations have others than the vehicle.
///
/// # Errors
///
/// If the firmware does not compile, or if something comes out that must not, or does not that must, or for
/// another reason. With other keys this is always so.
pub fn sealed(seed: Option<u64>, other_keys: bool, log: bool) -> Result<()> {
    let time = SystemTime::now().duration_since(UNIX_EPOCH)?;
    let seed = seed.unwrap_or(time.as_micros() as u64);
    let folder = tempfile::tempdir()?;
    let [path, elf] = ["keys.toml", "vehicle.elf"].map(|name| folder.path().join(name));
    let mut keys = KeyFile::generate(STATIONS)?;
    keys.write_new(&path)?;
    Image::logging(Chip::QemuM7, "vehicle", "ardupilotmega,sealing").build_to(&elf, &path)?;
    if other_keys {
        keys = KeyFile::generate(STATIONS)?;
    }
    println!(
        "Fresh keys for one vehicle and {STATIONS} stations; the air does as --seed {seed} says"
    );
    play(&elf, Vehicle::new(&keys, seed)?, log)
}

fn play(elf: &Path, vehicle: Vehicle, log: bool) -> Result<()> {
    let mut before = wire::telemetry()?;
    let after = before.split_off(before.len() / 2);
    let phases = vec![
        Phase::new("Telemetry for both stations, and their commands, through the air")
            .step(telemetry_and_commands(before))
            .step(Vehicle::stations_listen),
        Phase::new("Attacks on the vehicle")
            .step(Vehicle::attacks)
            .step(Vehicle::radio_answers)
            .step(Vehicle::radio_attacks),
        Phase::new("Attacks on a station").step(Vehicle::attacks_on_station),
        Phase::new("After a reset: what was accepted before")
            .reset()
            .step(Vehicle::replays),
        Phase::new("Telemetry and commands again")
            .step(telemetry_and_commands(after))
            .step(Vehicle::stations_listen),
    ];
    let vehicle = run(vehicle, elf, phases, log)?;
    let told = vehicle.radio_told_ever;
    ensure!(told > 0, "the vehicle has told nothing of its radio");
    println!(
        "\nEvery packet was sealed, opened or rejected as it must be. Of {} packages of the vehicle none has a \
         counter that was used before; {told} tell of its radio.",
        vehicle.sent.len(),
    );
    Ok(())
}

/// Telemetry down and commands up, at once.
fn telemetry_and_commands(
    telemetry: Vec<Frame>,
) -> impl FnOnce(&mut Vehicle, &mut Sending) -> Result<()> {
    move |vehicle, sending| {
        let row = sending.row(Row::new("recorded telemetry"));
        for frame in telemetry {
            let fits = frame.len() <= PLAINTEXT_SIZE;
            let verdict = fits.then(|| frame.clone()).ok_or("longer than a message");
            sending.frame(Local, row, frame, verdict);
        }
        let mut ways = Vec::new();
        for station in &mut vehicle.stations {
            let commands = station.commands(COMMANDS)?;
            let (arrived, air) = station.up.carry(&commands);
            let mut row = Row::new(format!("station {}: commands", station.id));
            row.air = Some(air);
            ways.push((sending.row(row), VecDeque::from(arrived)));
        }
        // Both stations at once: one package of either after the other, as it comes.
        while !ways.is_empty() {
            let at = vehicle.attacker.any(ways.len());
            let (row, way) = &mut ways[at];
            if let Some(sealed) = way.pop_front() {
                let accepts = vehicle.accepts(&sealed);
                let verdict = accepts.then_some(sealed.packets).ok_or("stale");
                sending.frame(Link, *row, air_frame(&sealed.package)?, verdict);
            } else {
                ways.remove(at);
            }
        }
        Ok(())
    }
}

impl Vehicle {
    /// What an attacker sends to the vehicle.
    fn attacks(&mut self, sending: &mut Sending) -> Result<()> {
        let replayed = packages(self.last_accepted());
        let mut fresh = self.stations[0].commands(2 * EACH)?;
        fresh.extend(self.stations[1].commands(2 * EACH)?);
        let other_key = strange(self.stations[0].id, self.attacker.strange_key())?;
        let unknown = strange(UNKNOWN, self.attacker.strange_key())?;
        let own = packages(&self.sent[..EACH]);
        let raised = changed(&replayed, |package| raise(package));
        let mut fresh = fresh.chunks(EACH).map(packages);
        let mut forged = |change| changed(&fresh.next().unwrap_or_default(), change);

        let mut reject = |name, because, packages: Vec<Vec<u8>>| {
            ensure!(packages.len() == EACH, "{name}: {}", packages.len());
            let frames = packages.iter().map(|package| air_frame(package));
            sending.rejected(Link, name, because, frames.collect::<Result<Vec<_>>>()?);
            Ok(())
        };
        reject(
            "message changed",
            "bad tag",
            forged(|package| package[MESSAGE] ^= 1),
        )?;
        reject(
            "tag changed",
            "bad tag",
            forged(|package| package[PACKAGE_SIZE - 1] ^= 1),
        )?;
        reject(
            "sender changed",
            "bad tag",
            forged(|package| package[COUNTER - 1] ^= 3),
        )?;
        let cut = forged(|package| package.truncate(PACKAGE_SIZE - 1));
        reject("cut short", "wrong length", cut)?;
        reject("counter raised", "bad tag", raised)?;
        reject("another key", "bad tag", other_key)?;
        reject("unknown sender", "unknown sender", unknown)?;
        reject("the vehicle's own, reflected", "unknown sender", own)?;
        reject("replayed", "stale", replayed)?;

        // 101 bytes, one more than there may be.
        let too_long = [&[hx::FLAG, 0], &[1; 101][..], &[hx::FLAG]].concat();
        let empty = vec![hx::FLAG, 0, hx::FLAG];
        let unknown = vec![hx::FLAG, 7, 1, hx::FLAG];
        let mut reject =
            |name, because, frame| sending.rejected(Link, name, because, vec![frame; EACH]);
        reject("empty frames", "empty frame", empty);
        reject("frames of an unknown kind", "unknown tag", unknown);
        reject("frames that are too long", "frame too long", too_long);
        Ok(())
    }

    /// What everybody on its radio's line can send.
    fn radio_attacks(&mut self, sending: &mut Sending) -> Result<()> {
        let status = frame_of(hx::FrameKind::Radio, &STATUS.to_wire())?;
        let name = "radio status, not asked for";
        sending.rejected(Link, name, "not asked", vec![status; EACH]);
        Ok(())
    }

    /// What an attacker sends to a station.
    fn attacks_on_station(&mut self, sending: &mut Sending) -> Result<()> {
        let sent = packages(&self.sent[..EACH]);
        // Newer than anything.
        let tampered = changed(&sent, |package| {
            raise(package);
            package[MESSAGE] ^= 1;
        });
        let other_key = strange(self.id, self.attacker.strange_key())?;
        let station = &mut self.stations[0];
        let own = packages(&station.commands(EACH)?);
        sending.row(station.reject("replayed", &sent, "stale")?);
        sending.row(station.reject("message changed", &tampered, "bad tag")?);
        sending.row(station.reject("another key", &other_key, "bad tag")?);
        sending.row(station.reject("its own, reflected", &own, "unknown sender")?);
        Ok(())
    }

    /// Packages that were accepted before.
    fn replays(&mut self, sending: &mut Sending) -> Result<()> {
        let replayed = self.last_accepted().iter();
        let frames = replayed.map(|sealed| air_frame(&sealed.package));
        let frames = frames.collect::<Result<Vec<_>>>()?;
        sending.rejected(Link, "accepted before the reset", "stale", frames);
        Ok(())
    }

    fn last_accepted(&self) -> &[Sealed] {
        &self.accepted[self.accepted.len().saturating_sub(EACH)..]
    }

    /// The stations open what has come out since they did before.
    fn stations_listen(&mut self, sending: &mut Sending) -> Result<()> {
        let heard = std::mem::replace(&mut self.heard, self.sent.len());
        for station in &mut self.stations {
            sending.row(station.listen("telemetry", &self.sent[heard..])?);
        }
        Ok(())
    }
}

/// A package on the line.
fn air_frame(package: &[u8]) -> Result<Vec<u8>> {
    frame_of(hx::FrameKind::AirData, package)
}

fn packages(sealed: &[Sealed]) -> Vec<Vec<u8>> {
    sealed.iter().map(|sealed| sealed.package.clone()).collect()
}

fn changed(packages: &[Vec<u8>], change: fn(&mut Vec<u8>)) -> Vec<Vec<u8>> {
    let mut packages = packages.to_vec();
    packages.iter_mut().for_each(change);
    packages
}

/// Gives a package a counter beyond any in use.
fn raise(package: &mut [u8]) {
    package[COUNTER] = 0x70;
}

/// Packages under a key that nobody has.
fn strange(id: u32, key: [u8; 16]) -> Result<Vec<Vec<u8>>> {
    let mut sealer: Sealer = Sealer::resume(SealingKey::new(&key, 0)?, SenderId(id), 1 << 30);
    let seal = |_| Ok(sealer.seal(&[0; PLAINTEXT_SIZE])?.as_bytes().to_vec());
    (0..EACH).map(seal).collect()
}
