//! The in-line signer between a vehicle and a ground station, which let it do all that it can.

use anyhow::{Result, ensure};
use mavseal_chips_host::Image;

use crate::{
    elf::Elf,
    emulator::Machine,
    lines::{LOCAL, Lines, RADIO},
    wire::{self, Tag},
};

const LINK_OUT: u8 = 1;
const LINK_IN: u8 = 2;

/// Message ids, and the `CRC_EXTRA` of each.
const ENCAPSULATED_DATA: (u32, u8) = (131, 223);
const SETUP_SIGNING: (u32, u8) = (256, 71);

/// A HEARTBEAT of MAVLink 1.
const MAVLINK_1: [u8; 17] = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];
/// More marks than a page of flash holds: 128.
const MARKS: u32 = 140;
/// As many systems as the receiver has streams for, beside that of its own frames.
const SYSTEMS: u8 = 15;

/// The signer, and what both sides have in mind.
struct Play {
    lines: Lines,
    tag: Tag,
    key: [u8; 32],
    /// The station's clock: it goes on from what it hears.
    ticks: u64,
}

/// Plays with the signer; gives the machine as it is then.
///
/// # Errors
/// If something comes out that must not, or does not that must.
pub(crate) fn play(image: &Image, elf: &Elf) -> Result<Machine> {
    let key = match image.features.contains("standard-signature") {
        true => hmac_sha256::Hash::hash(include_bytes!("../../../demo/demo.passphrase")),
        false => *include_bytes!("../../../demo/demo.key"),
    };
    let mut play = Play {
        lines: Lines::start(image, elf)?,
        tag: wire::tag(image),
        key,
        ticks: 0,
    };
    for (round, marks) in [(1, MARKS), (2, 1)] {
        play.starts([round; 32])?;
        play.down(1, &[])?;
        play.down(1, &[round; 255])?;
        for system in 1..=SYSTEMS {
            play.up(system, &[round; 255])?;
        }
        // Whether one more takes the place of another is not looked at here.
        let [one_more, _] = play.signed(SYSTEMS + 1, &[round; 255]);
        play.lines.pass(RADIO, &one_more)?;
        play.rejects()?;
        let [signed, unsigned] = play.signed(1, &[7; 255]);
        play.lines.loses_a_byte(LOCAL, &unsigned)?;
        play.lines.loses_a_byte(RADIO, &signed)?;
        for _ in 0..marks {
            play.lines.passes(20);
            play.down(1, &[round])?;
            play.up(1, &[round])?;
        }
        // It asks for the time of day each hour. Its timer comes round every 171 seconds.
        for _ in 0..40 {
            play.lines.passes(100);
            play.lines.pass(LOCAL, &[])?;
        }
        play.lines.machine.restart();
    }
    Ok(play.lines.machine)
}

fn frame(system: u8, (id, crc_extra): (u32, u8), payload: &[u8]) -> Vec<u8> {
    let [a, b, c, _] = id.to_le_bytes();
    wire::frame([0, system, 1, a, b, c], payload, crc_extra)
}

impl Play {
    /// A frame of the vehicle, which comes out signed.
    fn down(&mut self, system: u8, payload: &[u8]) -> Result<()> {
        let unsigned = frame(system, ENCAPSULATED_DATA, payload);
        let signed = self.lines.pass(LOCAL, &unsigned)?;
        ensure!(
            signed.len() == unsigned.len() + 13,
            "it signs nothing: {signed:02x?}"
        );
        let mut stamp = [0; 8];
        stamp[..6].copy_from_slice(&signed[signed.len() - 12..signed.len() - 6]);
        let ticks = u64::from_le_bytes(stamp);
        self.ticks = ticks;
        let expected = wire::sign(
            &unsigned,
            ENCAPSULATED_DATA.1,
            (self.tag, &self.key),
            LINK_OUT,
            ticks,
        );
        ensure!(
            signed == expected,
            "signed: {signed:02x?}, expected: {expected:02x?}"
        );
        Ok(())
    }

    /// A frame of the station, signed, and the same unsigned.
    fn signed(&mut self, system: u8, payload: &[u8]) -> [Vec<u8>; 2] {
        self.ticks += 1;
        let unsigned = frame(system, ENCAPSULATED_DATA, payload);
        let key = (self.tag, &self.key[..]);
        [
            wire::sign(&unsigned, ENCAPSULATED_DATA.1, key, LINK_IN, self.ticks),
            unsigned,
        ]
    }

    /// A frame of the station, which comes out without its signature.
    fn up(&mut self, system: u8, payload: &[u8]) -> Result<()> {
        let [signed, unsigned] = self.signed(system, payload);
        let came = self.lines.pass(RADIO, &signed)?;
        ensure!(
            came == unsigned,
            "accepted: {came:02x?}, expected: {unsigned:02x?}"
        );
        self.lines.rejected(RADIO, &signed)
    }

    /// Frames that must not pass.
    fn rejects(&mut self) -> Result<()> {
        for change in [2, 12, 100, 200, 266, 270, 279] {
            let [mut signed, _] = self.signed(1, &[7; 255]);
            signed[change] ^= 0x40;
            self.lines.rejected(RADIO, &signed)?;
            self.lines.silence()?;
        }
        let [_, unsigned] = self.signed(1, &[7; 255]);
        self.lines.rejected(RADIO, &unsigned)?;
        self.lines.noise()?;
        for side in [LOCAL, RADIO] {
            self.lines.rejected(side, &MAVLINK_1)?;
        }
        // Signed already, in another's name, for a message that nobody knows, damaged.
        let [signed, mut damaged] = self.signed(1, &[7; 255]);
        self.lines.rejected(LOCAL, &signed)?;
        let foreign = frame(2, ENCAPSULATED_DATA, &[7; 255]);
        self.lines.rejected(LOCAL, &foreign)?;
        damaged[20] ^= 1;
        for no_packet in [damaged, frame(1, (0x00FF_FFFF, 0), &[7; 255])] {
            self.lines.rejected(LOCAL, &no_packet)?;
            // The place in the stream is lost.
            let good = frame(1, ENCAPSULATED_DATA, &[7]);
            self.lines.rejected(LOCAL, &good)?;
            self.lines.silence()?;
        }
        Ok(())
    }

    /// It hears its vehicle after a silence. First comes SETUP_SIGNING, which gives it `key`: it is taken over, heard, and
    /// settled by another that is signed with it. Later, without a signature, none is taken.
    fn starts(&mut self, key: [u8; 32]) -> Result<()> {
        let good = frame(1, ENCAPSULATED_DATA, &[7]);
        self.lines.rejected(LOCAL, &good)?;
        self.lines.silence()?;
        self.lines.machine.restart();
        self.lines.pass(LOCAL, &[])?;
        self.lines.silence()?;

        self.ticks = self.lines.machine.mps2.borrow().now();
        let setup = |ticks: u64, key: &[u8; 32]| {
            let payload = [&ticks.to_le_bytes()[..], &[1, 25], key].concat();
            frame(1, SETUP_SIGNING, &payload)
        };
        self.lines.rejected(LOCAL, &setup(self.ticks, &key))?;
        self.up(1, &[1; 255])?;
        let old = std::mem::replace(&mut self.key, key);
        self.down(1, &[1; 255])?;
        self.up(1, &[1; 255])?;
        self.lines
            .rejected(LOCAL, &setup(self.ticks, &[0x33; 32]))?;
        self.down(1, &[1; 255])?;
        let again = setup(self.ticks, &key);
        let with = (self.tag, &self.key[..]);
        let again = wire::sign(&again, SETUP_SIGNING.1, with, LINK_IN, self.ticks);
        self.lines.rejected(LOCAL, &again)?;
        self.key = old;
        let [signed, _] = self.signed(1, &[1; 255]);
        self.lines.rejected(RADIO, &signed)?;
        self.key = key;
        self.up(1, &[1; 255])
    }
}
