//! The relay and its peer: telemetry to sign, the peer's frames to verify, attacks.

mod nested;
mod restart;

use std::{
    fs,
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

use anyhow::{Context, Result, ensure};
use mavseal_chips_host::{Chip, Image};

use crate::{
    run,
    scenario::{
        Counts, Device, Phase, Sending,
        Side::{self, Link, Local},
    },
    wire::{self, Frame},
};
use restart::Resets;
pub use restart::restart;

/// The link ids that the firmware signs and verifies with: `chips/qemu-m7/src/bin/relay.rs`.
const LINK_OUT: u8 = 1;
const LINK_IN: u8 = 2;

const TICKS_PER_SECOND: u64 = 100_000;
/// How far the peer's clock is behind this machine's, so that it is never ahead of the firmware's: half a
/// second.
const BEHIND: u64 = TICKS_PER_SECOND / 2;
/// The vehicle, in whose name the firmware signs.
const SYSTEM: u8 = 1;
/// Frames of each kind that must be rejected.
const EACH: usize = 25;
/// The same of those that make the local side deaf until it was silent.
const FEW: usize = 3;
/// Authentic frames from the peer, before the attacks and again after them.
const FROM_PEER: usize = 200;

/// Builds the firmware: the program `relay`, or `echo`, which signs nothing.
///
/// # Errors
///
/// If it does not compile.
pub fn build(program: &'static str) -> Result<PathBuf> {
    Image::logging(Chip::QemuM7, program, "ardupilotmega").build()
}

/// Plays telemetry, the peer and attackers at the firmware in `elf`; prints the firmware's log too if `log`.
///
/// # Errors
///
/// If a frame comes out that must not, or does not that must, or is rejected for another reason.
pub fn signer(elf: &Path, log: bool) -> Result<()> {
    let relay = Relay::new()?;
    let count = relay.telemetry.len();
    let phases = vec![
        Phase::new(format!(
            "Into the local side: {count} frames of recorded telemetry, and what must not be signed"
        ))
        .step(Relay::telemetry),
        Phase::new(
            "Into the local side: payloads that hold packets, chosen by somebody who has no key",
        )
        .step(Relay::nested),
        Phase::new("Into the link side: the peer, and what it must not get through")
            .step(Relay::attacks),
    ];
    run(relay, elf, phases, log)?.is_complete()?;
    println!("\nEvery frame was signed, verified or rejected as it must be.");
    Ok(())
}

/// What the relay has been seen to do, and its peer.
pub struct Relay {
    /// Recorded telemetry of the vehicle
    telemetry: Vec<Frame>,
    /// What was recorded of the station
    station: Vec<Frame>,
    /// Frames of it without a byte that looks like the beginning of another, so that a damaged one is
    /// rejected once and not again for what it seems to contain
    samples: Vec<Frame>,
    /// The keys of the relay; it signs with the first
    keys: Vec<Vec<u8>>,
    /// What came out of the link side: signed frames, and the beginning of one
    signed: Vec<Frame>,
    pending: Vec<u8>,
    /// The last stamp of the relay, and of its peer
    last: u64,
    last_of_peer: u64,
    /// When the firmware has said last that it starts
    begun: u64,
    resets: Resets,
}

impl Relay {
    /// A relay that has not been seen yet.
    ///
    /// # Errors
    ///
    /// If its key or the telemetry cannot be read.
    pub fn new() -> Result<Self> {
        let key = Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name("chips/demo/demo.key");
        let key = fs::read(&key).with_context(|| key.display().to_string())?;
        let recorded = wire::telemetry()?.into_iter();
        let (telemetry, station): (Vec<_>, _) = recorded.partition(|frame| frame[5] == SYSTEM);
        let starts_nothing =
            |frame: &&Frame| !frame[1..].iter().any(|byte| [0xFD, 0xFE].contains(byte));
        let samples = telemetry.iter().filter(starts_nothing).cloned().collect();
        Ok(Self {
            telemetry,
            station,
            samples,
            keys: vec![key],
            signed: Vec::new(),
            pending: Vec::new(),
            last: 0,
            last_of_peer: 0,
            begun: 0,
            resets: Resets::new(),
        })
    }

    /// Whether the last frame that came out was whole.
    fn is_complete(&self) -> Result<()> {
        ensure!(
            self.pending.is_empty(),
            "half a frame came out of the link side"
        );
        Ok(())
    }

    /// Looks at a frame that came out of the link side; gives it without the signature.
    fn check_signature(&mut self, signed: &[u8]) -> Result<Frame> {
        ensure!(signed[2] & 1 == 1, "a frame left the link side unsigned");
        let original = wire::unsign(signed);
        let ticks = wire::ticks(signed);
        let again = wire::sign(&original, &self.keys[0], LINK_OUT, ticks);
        ensure!(
            signed == again,
            "a frame left the link side with a wrong signature"
        );
        let last = self.last;
        ensure!(ticks > last, "a frame is stamped {ticks}, after {last}");
        self.last = ticks;
        // The firmware was told the time to the second. It goes on above its mark, a tick a frame, until the
        // clock has come after.
        let earliest = self.begun - 2 * TICKS_PER_SECOND;
        let latest = ticks_now().max(self.resets.mark + self.signed.len() as u64);
        let off = earliest.saturating_sub(ticks) + ticks.saturating_sub(latest);
        ensure!(off == 0, "a frame is stamped {off} ticks off");
        Ok(original)
    }

    /// Telemetry, and what must not be signed.
    fn telemetry(&mut self, sending: &mut Sending) -> Result<()> {
        let signed = self.each(|frame| wire::sign(frame, &self.keys[0], LINK_OUT, ticks_now()));
        let station = self.station.iter().cloned();
        sending.passes(Local, "recorded telemetry", same(&self.telemetry));
        let name = "recorded of the station";
        sending.rejected(Local, name, "foreign sender", station);
        sending.rejected(Local, "MAVLink 1", "MAVLink 1", mavlink1());
        sending.rejected(Local, "already signed", "already signed", signed);
        let setup = nested::setup_signing(&nested::KEY);
        sending.rejected(Local, "SETUP_SIGNING", "no presence", vec![setup; EACH]);
        // What comes behind at once is not heard, whole as it is.
        let unknown = |frame: &mut Frame| frame[7..10].fill(0xF0);
        for (name, because, change) in [
            (
                "damaged, a whole one behind",
                "bad checksum",
                damage as fn(&mut Frame),
            ),
            ("unknown, a whole one behind", "unknown message", unknown),
        ] {
            let few = self.samples.iter().take(FEW);
            let bytes = few.map(|frame| [changed(frame, change), frame.clone()].concat());
            sending.unreadable(name, because, bytes);
        }
        sending.passes(
            Local,
            "recorded, after silence",
            same(&self.samples[..EACH]),
        );
        Ok(())
    }

    /// The peer's frames, and everything that must not pass.
    fn attacks(&mut self, sending: &mut Sending) -> Result<()> {
        // They are stamped before they are sent: all of them must arrive within the window.
        let peer = self.telemetry[..2 * FROM_PEER].to_vec();
        let (first, then) = peer.split_at(FROM_PEER);
        let (key, now) = (self.keys[0].clone(), ticks_now());
        let [ahead, behind] = [now + 120 * TICKS_PER_SECOND, now - 61 * TICKS_PER_SECOND];
        let first = self.peer_sends(first, &key);
        let replayed: Vec<Frame> = first[..EACH].iter().map(|(sent, _)| sent.clone()).collect();
        sending.passes(Link, "authentic, from the peer", first);

        let mut reject = |name, because, frames| sending.rejected(Link, name, because, frames);
        let signed =
            |key: &[u8], link_id, ticks| self.each(|frame| wire::sign(frame, key, link_id, ticks));
        let forged = |change: fn(&mut Frame)| {
            self.each(|frame| changed(&wire::sign(frame, &key, LINK_IN, ticks_now()), change))
        };
        let payload = |frame: &mut Frame| {
            frame[10] ^= 1;
            wire::repair(frame);
        };
        reject("the same again", "replayed", replayed);
        reject(
            "own frames, reflected",
            "wrong link",
            self.signed[..EACH].to_vec(),
        );
        reject("made for another link", "wrong link", signed(&key, 3, now));
        reject(
            "payload changed, checksum repaired",
            "bad tag",
            forged(payload),
        );
        reject("tag changed", "bad tag", forged(|frame| flip(frame, 1)));
        reject(
            "link id changed",
            "bad tag",
            forged(|frame| flip(frame, 13)),
        );
        reject(
            "timestamp changed",
            "bad tag",
            forged(|frame| flip(frame, 12)),
        );
        reject("another key", "bad tag", signed(&nested::KEY, LINK_IN, now));
        reject(
            "stamped two minutes ahead",
            "from the future",
            signed(&key, LINK_IN, ahead),
        );
        reject(
            "stamped 61 seconds ago",
            "too old",
            signed(&key, LINK_IN, behind),
        );
        reject("unsigned", "not signed", self.each(Frame::clone));
        reject(
            "damaged",
            "bad checksum",
            self.each(|frame| changed(frame, damage)),
        );
        reject("MAVLink 1", "MAVLink 1", mavlink1());

        // None of it has moved the receiver's clock or window.
        let then = self.peer_sends(then, &key);
        sending.passes(Link, "authentic, after all that", then);
        Ok(())
    }

    /// Frames made of samples.
    fn each(&self, make: impl FnMut(&Frame) -> Frame) -> Vec<Frame> {
        self.samples.iter().take(EACH).map(make).collect()
    }

    /// The next frames of the peer, signed, each with what must come out.
    fn peer_sends(&mut self, frames: &[Frame], key: &[u8]) -> Vec<(Frame, Frame)> {
        let mut sign = |frame: &Frame| {
            self.last_of_peer = (ticks_now() - BEHIND).max(self.last_of_peer + 1);
            wire::sign(frame, key, LINK_IN, self.last_of_peer)
        };
        let frames = frames.iter();
        frames.map(|frame| (sign(frame), frame.clone())).collect()
    }
}

impl Device for Relay {
    const PASSED: [&'static str; 2] = ["signed", "verified"];

    fn started(&mut self, line: &str) -> Result<bool> {
        // It speaks when its clock is set and its ports are open.
        self.begun = ticks_now();
        Ok(line.starts_with("[INFO ] In-line signer") || line.starts_with("[INFO ] Echo"))
    }

    fn open(&mut self, side: Side, bytes: &[u8], out: &mut Vec<u8>, _: &mut Vec<u8>) -> Result<()> {
        if side == Local {
            out.extend(bytes);
            return Ok(());
        }
        self.pending.extend(bytes);
        for signed in wire::take_frames(&mut self.pending)? {
            out.extend(self.check_signature(&signed)?);
            self.signed.push(signed);
        }
        Ok(())
    }

    fn counters(&self, counts: [Counts; 2]) -> Vec<String> {
        let counters = Self::PASSED.iter().zip(counts);
        let lines = counters.map(|(name, Counts { passed, rejected })| {
            format!("[INFO ] {name}: {passed}, rejected: {rejected}, ")
        });
        lines.collect()
    }

    fn reset(&mut self) -> [Vec<u8>; 2] {
        self.prepare_for_reset()
    }
}

/// Frames that must come out as they are sent, but for a signature.
fn same(frames: &[Frame]) -> impl Iterator<Item = (Frame, Frame)> {
    frames.iter().cloned().zip(frames.iter().cloned())
}

fn changed(frame: &Frame, change: fn(&mut Frame)) -> Frame {
    let mut frame = frame.clone();
    change(&mut frame);
    frame
}

fn damage(frame: &mut Frame) {
    frame[10] ^= 0x40;
}

/// Changes the byte that is `from_end` bytes from the end.
fn flip(frame: &mut Frame, from_end: usize) {
    let at = frame.len() - from_end;
    frame[at] ^= 1;
}

/// HEARTBEATs of MAVLink 1.
fn mavlink1() -> Vec<Frame> {
    let heartbeat = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];
    vec![heartbeat.to_vec(); EACH]
}

/// This machine's time, in ticks of 10 microseconds since 2015.
fn ticks_now() -> u64 {
    let epoch = SystemTime::UNIX_EPOCH + Duration::from_secs(1_420_070_400);
    // A clock before 2015 shows in the first verdict.
    ticks_in(SystemTime::now().duration_since(epoch).unwrap_or_default())
}

fn ticks_in(duration: Duration) -> u64 {
    (duration.as_micros() / 10) as u64
}
