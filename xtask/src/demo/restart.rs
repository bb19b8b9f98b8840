//! `cargo xtask demo --restart`: the relay is reset at any moment, and its key is changed meanwhile.

use std::{path::Path, time::Instant};

use anyhow::{Context, Result, bail, ensure};

use super::{
    Act, BEHIND, Came, Demo, Direction, EACH, LINK_IN, LINK_OUT, MAX_DELAY, TICKS_PER_SECOND,
    exchange, print_log, table, ticks_in, ticks_now,
    wire::{self, Frame},
};

/// How long the link may be deaf after a restart: the reservation, and what the peer's clock is behind.
const PROMISED: f32 = 10.0 + 0.5;
/// How many seconds a stamp may be behind.
const WINDOW: u64 = 60;
/// The system and component that take a key: `chips/qemu-m7/src/bin/relay.rs`.
const SYSTEM: u8 = 1;
const COMPONENT: u8 = 25;
/// SETUP_SIGNING: its payload is 8 bytes of time, two of targets, and the key.
const SETUP_SIGNING: u16 = 256;
const SETUP_SIZE: u8 = 42;
/// Frames that the relay signs between two resets.
const SIGNED: usize = 100;

/// Runs the play.
///
/// # Errors
/// If a stamp is given or a frame accepted twice, a key is lost, or the link stays deaf.
pub(super) fn run(elf: &Path) -> Result<()> {
    let mut play = Play::begin(elf)?;
    let old = play.demo.key.clone();
    let new: Vec<u8> = old.iter().map(|byte| !byte).collect();

    play.signs("telemetry", &old)?;
    play.hears("new frames", &old)?;
    play.end_of_run()?;

    play.reset()?;
    play.rejects_recorded()?;
    play.signs("telemetry", &old)?;
    play.is_back(&old)?;
    play.hears("new frames", &old)?;
    // A key over the cable: this end signs with it at once, the peer does not have it yet.
    play.setup(&new)?;
    play.signs("with the new key", &new)?;
    play.hears("with the old key", &old)?;
    play.end_of_run()?;

    play.reset()?;
    play.is_back(&old)?;
    play.signs("with the new key", &new)?;
    play.hears("with the old key", &old)?;
    play.hears("with the new key", &new)?;
    play.said("[INFO ] New key heard: done");
    play.end_of_run()?;

    play.reset()?;
    play.rejects_recorded()?;
    play.is_back(&old)?;
    play.hears("with the new key", &new)?;
    play.hears("with the old key", &old)?;
    // The key in use once more: the old one goes.
    play.setup(&new)?;
    play.said("[INFO ] Old key retired: done");
    play.rejects("with the old key", &old, "bad tag")?;
    play.hears("with the new key", &new)?;
    play.end_of_run()?;

    play.reset()?;
    play.rejects("with the old key", &old, "bad tag")?;
    play.signs("with the new key", &new)?;
    play.is_back(&new)?;
    play.hears("with the new key", &new)?;
    play.end_of_run()?;
    play.finish()
}

/// The relay, what it has been seen to do in this run, and all that is to hold over its restarts.
struct Play {
    demo: Demo,
    telemetry: Vec<Frame>,
    /// Every frame of the peer that was accepted.
    recorded: Vec<Frame>,
    /// The last stamps that the relay, and the peer, have given.
    last: u64,
    last_of_peer: u64,
    runs: usize,
    reset_at: Instant,
    /// Seconds from a reset until the peer was heard.
    back_after: Vec<f32>,
    local: Vec<Act>,
    link: Vec<Act>,
    /// Lines that the relay must have logged in this run.
    expected: Vec<&'static str>,
    /// All acts, with the run before each.
    all: [Vec<Act>; 2],
}

impl Play {
    fn begin(elf: &Path) -> Result<Self> {
        // Without a byte that begins another packet, so that each is rejected once.
        let mut telemetry = wire::telemetry()?;
        telemetry.retain(|frame| !frame[1..].iter().any(|byte| [0xFD, 0xFE].contains(byte)));
        telemetry.truncate(SIGNED);
        Ok(Self {
            demo: Demo::boot(elf)?,
            telemetry,
            recorded: Vec::new(),
            last: 0,
            last_of_peer: 0,
            runs: 1,
            reset_at: Instant::now(),
            back_after: Vec::new(),
            local: Vec::new(),
            link: Vec::new(),
            expected: Vec::new(),
            all: [Vec::new(), Vec::new()],
        })
    }

    /// Resets the machine while a frame is on its way in on each side, and waits until the relay runs again.
    fn reset(&mut self) -> Result<()> {
        let half = |frame: &Frame| frame[..frame.len() / 2].to_vec();
        let into_local = half(&self.telemetry[0]);
        let into_link = half(&self.recorded[0]);
        self.send_to_local_side(into_local, 0)?;
        self.send_to_link_side(into_link, 0)?;
        self.demo.machine.reset()?;
        self.reset_at = Instant::now();
        self.runs += 1;
        loop {
            let line = self.demo.log.recv_timeout(MAX_DELAY);
            let line = line.context("the firmware does not start again")?;
            let started = line.contains("In-line signer");
            self.demo.lines.push(line);
            if started {
                return Ok(());
            }
        }
    }

    fn send_to_local_side(&mut self, stream: Vec<u8>, expected: usize) -> Result<Came> {
        exchange(&mut self.demo.local, &mut self.demo.link, stream, expected)
    }

    fn send_to_link_side(&mut self, stream: Vec<u8>, expected: usize) -> Result<Came> {
        exchange(&mut self.demo.link, &mut self.demo.local, stream, expected)
    }

    fn fail(&mut self, failure: String) {
        self.demo
            .failures
            .push(format!("run {}: {failure}", self.runs));
    }

    /// Frames from the local side are signed with `key`, each stamp greater than all before any restart.
    fn signs(&mut self, name: &'static str, key: &[u8]) -> Result<()> {
        let came = self.send_to_local_side(self.telemetry.concat(), self.telemetry.len())?;
        for (at, frame) in came.frames.iter().enumerate() {
            let ticks = wire::ticks(frame);
            if ticks <= self.last {
                self.fail(format!("stamp {at} is {ticks}, after {}", self.last));
            }
            self.last = ticks;
            let original = self.telemetry.get(at);
            if original
                .map(|frame| wire::sign(frame, key, LINK_OUT, ticks))
                .as_ref()
                != Some(frame)
            {
                self.fail(format!("{name}: frame {at} is not the telemetry's, signed"));
            }
        }
        if let Some(failure) = came.failure {
            self.fail(failure);
        }
        self.local
            .push(passed(name, self.telemetry.len(), came.frames.len()));
        Ok(())
    }

    /// The next frames of the peer.
    fn peer_frames(&mut self, count: usize, key: &[u8]) -> Vec<Frame> {
        let mut sign = |frame: &Frame| {
            let ticks = ticks_now() - ticks_in(BEHIND);
            self.last_of_peer = ticks.max(self.last_of_peer + 1);
            wire::sign(frame, key, LINK_IN, self.last_of_peer)
        };
        self.telemetry.iter().take(count).map(&mut sign).collect()
    }

    /// New frames of the peer, with `key`, come through.
    fn hears(&mut self, name: &'static str, key: &[u8]) -> Result<()> {
        let frames = self.peer_frames(EACH, key);
        let came = self.send_to_link_side(frames.concat(), EACH)?;
        if came.frames != self.telemetry[..EACH] {
            self.fail(format!("{name}: other frames came than the peer sent"));
        }
        self.link.push(passed(name, EACH, came.frames.len()));
        self.recorded.extend(frames);
        Ok(())
    }

    /// These frames must not come through.
    fn rejects_all(
        &mut self,
        name: &'static str,
        frames: &[Frame],
        why: &'static str,
    ) -> Result<()> {
        let came = self.send_to_link_side(frames.concat(), 0)?;
        if !came.frames.is_empty() {
            self.fail(format!("{name}: {} came through", came.frames.len()));
        }
        self.link.push(rejected(name, frames.len(), why));
        Ok(())
    }

    /// New frames with `key`, which is not one of the link's any more.
    fn rejects(&mut self, name: &'static str, key: &[u8], why: &'static str) -> Result<()> {
        let frames = self.peer_frames(EACH, key);
        self.rejects_all(name, &frames, why)
    }

    /// Everything of the peer that was ever accepted. What is near the window's edge is left out, as it may
    /// leave the window on its way.
    fn rejects_recorded(&mut self) -> Result<()> {
        let now = ticks_now();
        let seconds = |frame: &Frame| now.saturating_sub(wire::ticks(frame)) / TICKS_PER_SECOND;
        let mut old = self.recorded.clone();
        old.retain(|frame| seconds(frame) > WINDOW);
        let mut young = self.recorded.clone();
        young.retain(|frame| seconds(frame) < WINDOW / 2);
        if !old.is_empty() {
            self.rejects_all("accepted over a minute ago, again", &old, "too old")?;
        }
        self.rejects_all("accepted before, again", &young, "replayed")
    }

    /// Frames of the peer, one at a time, until one comes through, which must be soon enough.
    ///
    /// While the firmware starts, a frame may come through only when the next ones are sent: the last
    /// ones then came.
    fn is_back(&mut self, key: &[u8]) -> Result<()> {
        let mut sent = Vec::new();
        loop {
            let frame = self.peer_frames(1, key);
            let came = self.send_to_link_side(frame.concat(), 0)?;
            let seconds = self.reset_at.elapsed().as_secs_f32();
            sent.extend(frame);
            let above = came.frames.len();
            if above == 0 {
                ensure!(
                    seconds < 2.0 * PROMISED,
                    "deaf for {seconds:.1} s after a restart"
                );
                continue;
            }
            if seconds > PROMISED {
                self.fail(format!("deaf for {seconds:.1} s after a restart"));
            }
            self.back_after.push(seconds);
            let Some(deaf) = sent.len().checked_sub(above) else {
                bail!("{above} frames came of {} that were sent", sent.len());
            };
            self.link
                .push(rejected("new, below the mark", deaf, "replayed"));
            self.link.push(passed("above it", above, above));
            self.recorded.extend(sent.split_off(deaf));
            return Ok(());
        }
    }

    /// SETUP_SIGNING with `key`, on the local port; it goes no further.
    fn setup(&mut self, key: &[u8]) -> Result<()> {
        let mut frame = vec![0xFD, SETUP_SIZE, 0, 0, 0, 255, 190];
        frame.extend(&u32::from(SETUP_SIGNING).to_le_bytes()[..3]);
        frame.extend(ticks_now().to_le_bytes());
        frame.extend([SYSTEM, COMPONENT]);
        frame.extend(key);
        frame.extend([0; 2]);
        wire::repair(&mut frame);
        let came = self.send_to_local_side(frame, 0)?;
        if !came.frames.is_empty() {
            self.fail("SETUP_SIGNING went on to the radio".into());
        }
        self.local
            .push(rejected("SETUP_SIGNING", 1, "SETUP_SIGNING"));
        self.said("[INFO ] SETUP_SIGNING: done");
        Ok(())
    }

    fn said(&mut self, line: &'static str) {
        self.expected.push(line);
    }

    /// Compares the log of this run, and its counters, with what was seen at the ports.
    fn end_of_run(&mut self) -> Result<()> {
        let acts = [
            std::mem::take(&mut self.local),
            std::mem::take(&mut self.link),
        ];
        let directions = [Direction::Outbound, Direction::Inbound];
        let counted = [0, 1].map(|at| {
            let sum = |count: fn(&Act) -> usize| acts[at].iter().map(count).sum::<usize>();
            let passed = sum(|act| act.passed);
            let rejected = sum(|act| act.rejected);
            format!(
                "{}{passed}, rejected: {rejected}, ",
                directions[at].summary()
            )
        });
        let mut found = [false; 2];
        let mut lines = Vec::new();
        while found != [true; 2] {
            let Ok(line) = self.demo.log.recv_timeout(MAX_DELAY) else {
                self.fail(format!("the firmware did not count {counted:?}"));
                break;
            };
            for (found, counted) in found.iter_mut().zip(&counted) {
                *found |= line.starts_with(counted);
            }
            lines.push(line);
        }
        for (acts, direction) in acts.iter().zip(directions) {
            let said = lines.iter().filter_map(|line| direction.rejections(line));
            let said: Vec<String> = said.flat_map(|(why, times)| vec![why; times]).collect();
            let expected: Vec<&str> = acts
                .iter()
                .flat_map(|act| vec![act.rejection.unwrap_or_default(); act.rejected])
                .collect();
            if said != expected {
                self.fail(format!("{direction:?}: rejected because {said:?}"));
            }
        }
        for expected in std::mem::take(&mut self.expected) {
            if !lines.iter().any(|line| line == expected) {
                self.fail(format!("the firmware has not said {expected:?}"));
            }
        }
        self.demo.lines.extend(lines);
        for (all, acts) in self.all.iter_mut().zip(acts) {
            all.extend(acts);
        }
        Ok(())
    }

    fn finish(mut self) -> Result<()> {
        self.demo.machine.stop()?;
        println!("The firmware's log, in {} runs:", self.runs);
        print_log(&self.demo.lines);
        let [local, link] = &self.all;
        println!("\nInto the local side:\n{}", table("signed", local));
        println!("\nInto the link side:\n{}", table("verified", link));
        let seconds: Vec<String> = self
            .back_after
            .iter()
            .map(|seconds| format!("{seconds:.1}"))
            .collect();
        println!(
            "\nthe peer was heard again {} s after a reset; promised: {PROMISED}",
            seconds.join(", ")
        );
        ensure!(
            self.demo.failures.is_empty(),
            "the demonstration failed:\n  {}",
            self.demo.failures.join("\n  ")
        );
        println!("Nothing was used twice, and no key was lost.");
        Ok(())
    }
}

fn passed(name: &'static str, frames: usize, passed: usize) -> Act {
    Act {
        name,
        frames,
        rejection: None,
        passed,
        rejected: frames - passed.min(frames),
    }
}

fn rejected(name: &'static str, frames: usize, why: &'static str) -> Act {
    Act {
        name,
        frames,
        rejection: Some(why),
        passed: 0,
        rejected: frames,
    }
}
