//! A sealed link: one vehicle and two ground stations, air that loses, doubles and reorders, attacks, a reset.

mod air;
mod station;
mod vehicle;

use std::{collections::VecDeque, path::Path};

use anyhow::{Context, Result, ensure};
use mavlink_commsec::{Sealer, SealingKey, SenderId, hx};
use mavseal_chips_host::{Chip, Image};
use mavseal_keys::KeyFile;

use crate::{
    scenario::{
        self, Phase, Sending,
        Side::{Link, Local},
    },
    wire::{self, Frame},
};
use station::Sealed;
use vehicle::{STATUS, Vehicle, frame_of};

/// How many ground stations there are.
const STATIONS: usize = 2;
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

/// Plays with fresh keys, over links that do as `seed` says; prints the firmware's log too if `log`. With
/// `other_keys` the stations have others than the vehicle.
///
/// # Errors
///
/// If the firmware does not compile, or something comes out that must not, or does not that must, or for another
/// reason: with other keys, always.
pub fn sealed(seed: u64, other_keys: bool, log: bool) -> Result<()> {
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
            .after(Vehicle::stations_listen),
        Phase::new("Attacks on the vehicle").step(Vehicle::attacks),
        Phase::new("Attacks on a station").after(Vehicle::attacks_on_station),
        Phase::new("After a reset: what was accepted before")
            .reset()
            .step(Vehicle::replays),
        Phase::new("Telemetry and commands again")
            .step(telemetry_and_commands(after))
            .after(Vehicle::stations_listen),
    ];
    let vehicle = scenario::run(vehicle, elf, phases, log)?;
    let told = vehicle.radio_told_ever;
    ensure!(told > 0, "the vehicle has told nothing of its radio");
    println!(
        "\nEvery packet was sealed, opened or rejected as it must be. Of {} packages of the vehicle none has a \
         counter that was used before; {told} tell of its radio.",
        vehicle.sent.len(),
    );
    Ok(())
}

fn telemetry_and_commands(
    telemetry: Vec<Frame>,
) -> impl FnOnce(&mut Vehicle, &mut Sending) -> Result<()> {
    move |vehicle, sending| vehicle.telemetry_and_commands(sending, &telemetry)
}

impl Vehicle {
    /// Telemetry down and commands up, at once.
    fn telemetry_and_commands(&mut self, sending: &mut Sending, telemetry: &[Frame]) -> Result<()> {
        let row = sending.row(Local, "recorded telemetry", None);
        for frame in telemetry {
            let fits = frame.len() <= PLAINTEXT_SIZE;
            let verdict = fits.then(|| frame.clone()).ok_or("longer than a message");
            sending.frame(row, frame.clone(), verdict);
        }
        let mut ways = Vec::new();
        for station in &mut self.stations {
            let commands = (0..COMMANDS).map(|_| station.command());
            let commands = commands.collect::<Result<Vec<_>>>()?;
            let (arrived, air) = station.up.carry(&commands);
            let row = sending.row(Link, format!("station {}: commands", station.id), Some(air));
            ways.push((row, VecDeque::from(arrived)));
        }
        // Both stations at once: one package of either after the other, as it comes.
        while !ways.is_empty() {
            let at = self.attacker.any(ways.len());
            let (row, way) = &mut ways[at];
            let Some(sealed) = way.pop_front() else {
                ways.remove(at);
                continue;
            };
            let frame = frame_of(hx::FrameKind::AirData, &sealed.package)?;
            let verdict = if self.accepts(&sealed) {
                Ok(sealed.packets)
            } else {
                Err("stale")
            };
            sending.frame(*row, frame, verdict);
        }
        Ok(())
    }

    /// What an attacker sends to the vehicle.
    fn attacks(&mut self, sending: &mut Sending) -> Result<()> {
        let replayed = self.last_accepted()?;
        let mut fresh = Vec::new();
        for at in 0..4 * EACH {
            fresh.push(self.stations[at % STATIONS].command()?.package);
        }
        let mut fresh = fresh.into_iter();
        let mut forged = |change: fn(&mut Vec<u8>)| changed(fresh.by_ref().take(EACH), change);
        let other_key = strange(self.stations[0].id, self.attacker.strange_key())?;
        let unknown = strange(9, self.attacker.strange_key())?;
        let reflected = self
            .sent
            .iter()
            .take(EACH)
            .map(|sealed| sealed.package.clone());
        let packages = [
            (
                "message changed",
                "bad tag",
                forged(|package| package[MESSAGE] ^= 1),
            ),
            (
                "tag changed",
                "bad tag",
                forged(|package| package[PACKAGE_SIZE - 1] ^= 1),
            ),
            (
                "sender changed",
                "bad tag",
                forged(|package| package[COUNTER - 1] ^= 3),
            ),
            (
                "cut short",
                "wrong length",
                forged(|package| package.truncate(PACKAGE_SIZE - 1)),
            ),
            (
                "counter raised",
                "bad tag",
                changed(replayed.clone(), |package| raise(package)),
            ),
            ("replayed", "stale", replayed),
            ("another key", "bad tag", other_key),
            ("unknown sender", "unknown sender", unknown),
            (
                "the vehicle's own, reflected",
                "unknown sender",
                reflected.collect(),
            ),
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
            sending.rejected(Link, name, because, frames.collect::<Result<Vec<_>>>()?);
        }
        // 101 bytes, one more than there may be.
        let mut too_long = vec![1; 104];
        (too_long[0], too_long[1], too_long[103]) = (hx::FLAG, 0, hx::FLAG);
        let status = frame_of(hx::FrameKind::Radio, &STATUS.to_wire())?;
        let frames = [
            ("empty frames", "empty frame", vec![hx::FLAG, 0, hx::FLAG]),
            (
                "frames of an unknown kind",
                "unknown tag",
                vec![hx::FLAG, 7, 1, hx::FLAG],
            ),
            ("frames that are too long", "frame too long", too_long),
            ("radio status, not asked for", "not asked", status),
        ];
        for (name, because, frame) in frames {
            sending.rejected(Link, name, because, vec![frame; EACH]);
        }
        Ok(())
    }

    /// What an attacker sends to a station.
    fn attacks_on_station(&mut self) -> Result<Vec<scenario::Row>> {
        let sent = self
            .sent
            .iter()
            .take(EACH)
            .map(|sealed| sealed.package.clone());
        let sent: Vec<_> = sent.collect();
        let other_key = strange(self.id, self.attacker.strange_key())?;
        let station = &mut self.stations[0];
        let own = (0..EACH).map(|_| Ok(station.command()?.package));
        let own = own.collect::<Result<Vec<_>>>()?;
        // Newer than anything.
        let tampered = changed(changed(sent.clone(), |package| raise(package)), |package| {
            package[MESSAGE] ^= 1
        });
        Ok(vec![
            station.reject("replayed", &sent, "stale")?,
            station.reject("message changed", &tampered, "bad tag")?,
            station.reject("another key", &other_key, "bad tag")?,
            station.reject("its own, reflected", &own, "unknown sender")?,
        ])
    }

    /// Packages that were accepted before.
    fn replays(&mut self, sending: &mut Sending) -> Result<()> {
        let replayed = self.last_accepted()?.into_iter();
        let frames = replayed.map(|package| frame_of(hx::FrameKind::AirData, &package));
        let frames = frames.collect::<Result<Vec<_>>>()?;
        sending.rejected(Link, "accepted before the reset", "stale", frames);
        Ok(())
    }

    /// The packages that were accepted last.
    fn last_accepted(&self) -> Result<Vec<Vec<u8>>> {
        let last = self
            .accepted
            .len()
            .checked_sub(EACH)
            .context("enough were accepted")?;
        Ok(self.accepted[last..]
            .iter()
            .map(|sealed| sealed.package.clone())
            .collect())
    }

    /// The stations open what has come out since they did before.
    fn stations_listen(&mut self) -> Result<Vec<scenario::Row>> {
        let sent: &[Sealed] = &self.sent[std::mem::replace(&mut self.listened, self.sent.len())..];
        let stations = self.stations.iter_mut();
        stations
            .map(|station| station.listen("telemetry", sent))
            .collect()
    }
}

fn changed(packages: impl IntoIterator<Item = Vec<u8>>, change: fn(&mut Vec<u8>)) -> Vec<Vec<u8>> {
    let packages = packages.into_iter();
    packages
        .map(|mut package| {
            change(&mut package);
            package
        })
        .collect()
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
