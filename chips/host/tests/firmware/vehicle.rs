//! The vehicle of a sealed link between an autopilot and a radio, which let it do all that it can.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use mavlink_commsec::{
    Opener, Package, Packer, Sealer, SealingKey, SenderId,
    hx::{self, FrameKind},
    radio::Status,
};
use mavseal_chips_host::{Image, keys};
use mavseal_keys::{Exceptions, KeyFile, SenderKeys};

use crate::{
    elf::Elf,
    emulator::Machine,
    lines::{LOCAL, Lines, RADIO},
    wire,
};

/// PLAY_TUNE_V2, of which 80 bytes are a message as long as they can be, and its `CRC_EXTRA`.
const PACKET: ([u8; 3], u8) = ([0x90, 0x01, 0], 110);
/// Bytes of payload with which a packet fills a message.
const FULL: usize = 80 - 12;
/// More marks than a page of flash holds: 128.
const MARKS: u32 = 140;
/// Counters beyond which a mark is stored anew, and time after which it is not further ahead.
const RESERVED: u32 = 8;
const SECONDS: u64 = 11;

/// The vehicle, and what both sides have in mind.
struct Play {
    lines: Lines,
    opener: Opener<1>,
    stations: Vec<Station>,
}

/// A station, and the counter that it seals with next.
struct Station {
    keys: SenderKeys,
    next: u32,
}

fn key(sender: &SenderKeys) -> Result<SealingKey> {
    Ok(SealingKey::new(&*sender.key, sender.salt)?)
}

/// Plays with the vehicle; gives the machine as it is then.
///
/// # Errors
/// If something comes out that must not, or does not that must.
pub(crate) fn play(image: &Image, elf: &Elf) -> Result<Machine> {
    let keys = KeyFile::read(&keys()?, Exceptions::default())?;
    let mut opener = Opener::new();
    opener.permit(key(keys.vehicle())?, &[SenderId(keys.vehicle().id)])?;
    let stations = keys.stations().iter().cloned();
    let stations = stations.map(|keys| Station { keys, next: 1 });
    let mut play = Play {
        lines: Lines::start(image, elf)?,
        opener,
        stations: stations.collect(),
    };
    // The power fails in the first write of all.
    let machine = &mut play.lines.machine;
    machine.run_to(elf.find("mavseal_store::pages::Pages<F>::append")?.start)?;
    machine.run_to_change(&elf.find("mavseal_qemu_m7::flash::MEMORY")?)?;
    machine.restart();
    for marks in [MARKS, 1] {
        play.lines.rejected(LOCAL, &packet(1))?;
        play.lines.silence()?;
        for length in [0, 20, FULL] {
            play.down(&packet(length))?;
            play.up(0, &packet(length))?;
            play.up(1, &packet(length))?;
        }
        play.lines.rejected(LOCAL, &packet(FULL + 1))?;
        play.lines.rejected(LOCAL, &packet(255))?;
        play.rejects()?;
        play.lines.noise()?;
        play.lines.loses_a_byte(LOCAL, &packet(FULL))?;
        let lost = play.sealed(0, &packet(FULL))?;
        play.lines.loses_a_byte(RADIO, &framed(&lost))?;
        play.radio_answers()?;
        for _ in 0..marks {
            play.lines.passes(SECONDS);
            play.stations[0].next += RESERVED;
            play.up(0, &packet(1))?;
        }
        play.lines.machine.restart();
        for station in &mut play.stations {
            // A mark is at most as far ahead of what was accepted as that is of the first.
            station.next = 2 * station.next + RESERVED;
        }
    }
    Ok(play.lines.machine)
}

fn packet(length: usize) -> Vec<u8> {
    let ([a, b, c], crc_extra) = PACKET;
    wire::frame([0, 1, 1, a, b, c], &vec![0x7E; length], crc_extra)
}

fn framed(package: &Package) -> Vec<u8> {
    hx::Frame::from(package).encode().collect()
}

impl Play {
    /// A packet of the autopilot, which comes out sealed.
    fn down(&mut self, packet: &[u8]) -> Result<()> {
        let mut sealed = self.lines.pass(LOCAL, packet)?;
        // It has waited for others.
        self.lines.passes(1);
        sealed.extend(self.lines.pass(LOCAL, &[])?);
        let opened = self.opened(&sealed)?;
        ensure!(opened == packet, "{opened:02x?} came out for {packet:02x?}");
        Ok(())
    }

    /// The packets in a package on the radio's line.
    fn opened(&mut self, sealed: &[u8]) -> Result<Vec<u8>> {
        let mut decoder = hx::Decoder::new();
        let end = sealed.len().checked_sub(1).context("nothing came out")?;
        let begun = sealed[..end]
            .iter()
            .all(|byte| decoder.push(*byte).is_none());
        ensure!(begun, "more than a package: {sealed:02x?}");
        let frame = decoder.push(sealed[end]).context("half a package")??;
        ensure!(
            frame.kind() == FrameKind::AirData,
            "no package: {sealed:02x?}"
        );
        let opened = self.opener.open(frame.payload())?;
        let packets = opened.packets().collect::<Result<Vec<_>, _>>()?;
        Ok(packets.concat())
    }

    /// A package of a station.
    fn sealed(&mut self, station: usize, packet: &[u8]) -> Result<Package> {
        let mut packer = Packer::new(Duration::ZERO);
        let full = packer.push(packet, Duration::ZERO)?;
        let message = full.or_else(|| packer.flush()).context("a packet")?;
        let Station { keys, next } = &mut self.stations[station];
        let sealed = Sealer::resume(key(keys)?, SenderId(keys.id), *next).seal(&message)?;
        *next += 1;
        Ok(sealed)
    }

    /// A packet of a station, which comes out as it was.
    fn up(&mut self, station: usize, packet: &[u8]) -> Result<()> {
        let package = framed(&self.sealed(station, packet)?);
        let came = self.lines.pass(RADIO, &package)?;
        ensure!(came == packet, "{came:02x?} came out for {packet:02x?}");
        self.lines.rejected(RADIO, &package)
    }

    /// Packages and frames that must not pass.
    fn rejects(&mut self) -> Result<()> {
        for at in [3, 7, 40, 87, 95] {
            let mut package = self.sealed(1, &packet(FULL))?.as_bytes().to_vec();
            package[at] ^= 1;
            self.frame(FrameKind::AirData, &package)?;
        }
        let strange: SealingKey = SealingKey::new(&[7; 16], 7)?;
        let package = Sealer::new(strange, SenderId(99)).seal(&[1; 80])?;
        self.frame(FrameKind::AirData, package.as_bytes())?;
        self.frame(FrameKind::AirData, &[1; 95])?;
        self.frame(FrameKind::Radio, b"no status")?;
        for frame in [
            &[0x7E, 0, 0x7E][..],
            &[0x7E, 9, 9, 0x7E],
            &[0x7E, 0, 0x7C, 0x7E],
            &[1; 400],
        ] {
            self.lines.rejected(RADIO, frame)?;
        }
        self.lines.rejected(RADIO, &[0x7E])
    }

    fn frame(&mut self, kind: FrameKind, payload: &[u8]) -> Result<()> {
        let frame = hx::Frame::new(kind, payload)?;
        self.lines.rejected(RADIO, &Vec::from_iter(frame.encode()))
    }

    /// The radio says how it does, and the stations are told.
    fn radio_answers(&mut self) -> Result<()> {
        self.lines.passes(2);
        self.lines.rejected(LOCAL, &[])?;
        self.frame(FrameKind::Radio, &Status::default().to_wire())?;
        self.lines.passes(1);
        let sealed = self.lines.pass(LOCAL, &[])?;
        let told = self.opened(&sealed)?;
        ensure!(told.starts_with(&[0xFE]), "no VEHICLE_RADIO: {told:02x?}");
        Ok(())
    }
}
