//! The relay is reset while the link is in use, and its key is changed meanwhile.

use std::{
    path::Path,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, ensure};

use super::{
    BEHIND, EACH, LINK_IN, Relay, TICKS_PER_SECOND,
    nested::{KEY, setup_signing},
    same, ticks_in, ticks_now,
};
use crate::{
    run,
    scenario::{
        Phase, Sending,
        Side::{Link, Local},
    },
    wire::{self, Frame},
};

/// How many seconds a stamp may be behind.
const WINDOW: u64 = 60;
/// How far beyond the stamps in use a mark is stored: an eighth of the time since the start, at least and at
/// most so many ticks. `relay/src/persistent_clock.rs`
const RESERVED: [u64; 2] = [TICKS_PER_SECOND / 100, 10 * TICKS_PER_SECOND];
/// How long the link may be deaf after a reset: most that is reserved, and what the peer's clock is behind.
const DEAF_FOR: Duration = Duration::from_millis(10_500);
/// Frames that the relay signs at a time.
const SIGNED: usize = 100;

/// Plays resets at the firmware in `elf`, and a change of its key; prints the firmware's log too if `log`.
///
/// # Errors
///
/// If a stamp is given or a frame accepted twice, a key is lost, or the link stays deaf.
pub fn restart(elf: &Path, log: bool) -> Result<()> {
    let relay = Relay::new()?;
    let old = relay.keys[0].clone();
    let new: Vec<u8> = old.iter().map(|byte| !byte).collect();
    let phases = vec![
        Phase::new("Run 1: the board is new")
            .step(peer("new frames", &old))
            .step(Relay::signs)
            .step(Relay::hears_below_own_last)
            .step(Relay::signs),
        Phase::new("Run 2, after a reset: the relay gets a new key over the cable; its peer has the old one")
            .reset()
            .step(Relay::rejects_old)
            .step(peer("with the old key", &old))
            .step(setup(&new, false))
            .step(Relay::signs)
            .step(not_present)
            .step(peer("with the old key", &old)),
        Phase::new("Run 3, after a reset: the peer takes the new key")
            .reset()
            .step(Relay::rejects_old)
            .step(peer("with the old key", &old))
            .step(peer("with the new key", &new))
            .step(|_, sending| {
                sending.says("[INFO ] New key heard: done");
                Ok(())
            })
            .step(Relay::signs),
        Phase::new("Run 4, after a reset: the same key over the cable again, so the old one goes")
            .reset()
            .step(Relay::rejects_old)
            .step(peer("with the new key", &new))
            .step(peer("with the old key", &old))
            .step(Relay::signs)
            .step(setup(&new, true))
            .step(Relay::signs)
            .step(peer("with the old key", &old))
            .step(peer("with the new key", &new)),
        Phase::new("Run 5, after a reset: the old key stays away")
            .reset()
            .step(Relay::rejects_old)
            .step(peer("with the old key", &old))
            .step(peer("with the new key", &new))
            .step(Relay::signs),
    ];
    let relay = run(relay, elf, phases, log)?;
    relay.is_complete()?;
    let deaf_for = relay.resets.deaf_for.iter();
    let seconds = deaf_for.map(|time| format!("{:.1}", time.as_secs_f32()));
    println!(
        "\nNo stamp was given and no frame accepted twice, and no key was lost. After the resets the peer was \
         heard within {} s; {} s are allowed.",
        Vec::from_iter(seconds).join(", "),
        DEAF_FOR.as_secs_f32()
    );
    Ok(())
}

/// What is to be known of resets.
pub(super) struct Resets {
    /// When the last was
    at: Instant,
    /// No mark in flash can be beyond this, in ticks
    pub(super) mark: u64,
    /// From each until the peer was heard
    deaf_for: Vec<Duration>,
    /// How many there were
    count: usize,
    /// Frames of the peer that were accepted, each with its key
    accepted: Vec<(Frame, Vec<u8>)>,
}

impl Resets {
    pub(super) fn new() -> Self {
        Self {
            at: Instant::now(),
            mark: 0,
            deaf_for: Vec::new(),
            count: 0,
            accepted: Vec::new(),
        }
    }
}

/// New frames of the peer. They are verified if their key is one of the relay's.
fn peer(
    name: &'static str,
    key: &[u8],
) -> impl FnOnce(&mut Relay, &mut Sending) -> Result<()> + use<> {
    let key = key.to_vec();
    move |relay, sending| {
        // From now on at the latest, what the peer stamps is beyond the mark.
        let beyond = (relay.resets.mark + BEHIND + 1).saturating_sub(ticks_now());
        thread::sleep(Duration::from_micros(10 * beyond));
        let samples = relay.samples[..EACH].to_vec();
        let frames = relay.peer_sends(&samples, &key);
        let signed = frames.iter().map(|(signed, _)| signed.clone());
        if !relay.keys.contains(&key) {
            sending.rejected(Link, name, "bad tag", signed);
            return Ok(());
        }
        let resets = &mut relay.resets;
        if resets.deaf_for.len() < resets.count {
            let deaf = resets.at.elapsed();
            ensure!(deaf < DEAF_FOR, "deaf for {deaf:?} after a reset");
            resets.deaf_for.push(deaf);
        }
        resets
            .accepted
            .extend(signed.map(|frame| (frame, key.clone())));
        sending.passes(Link, name, frames);
        Ok(())
    }
}

/// SETUP_SIGNING on the local port; it goes no further. It must come before anything else, or be signed with the key
/// in use. That key once more has the one before retire.
fn setup(key: &[u8], signed: bool) -> impl FnOnce(&mut Relay, &mut Sending) -> Result<()> + use<> {
    let key = key.to_vec();
    move |relay, sending| {
        let mut frame = setup_signing(&key);
        let mut name = "SETUP_SIGNING, before anything else";
        if signed {
            frame = wire::sign(&frame, &relay.keys[0], LINK_IN, ticks_now());
            name = "SETUP_SIGNING, signed with the key in use";
        }
        sending.rejected(Local, name, "SETUP_SIGNING", [frame]);
        sending.says("[INFO ] SETUP_SIGNING: done");
        if relay.keys[0] == key {
            relay.keys.truncate(1);
            sending.says("[INFO ] Old key retired: done");
        } else {
            relay.keys.insert(0, key);
        }
        Ok(())
    }
}

/// Later, nobody is believed who has no key.
fn not_present(relay: &mut Relay, sending: &mut Sending) -> Result<()> {
    let frame = setup_signing(&KEY);
    let forged = wire::sign(&frame, &KEY, LINK_IN, ticks_now());
    sending.rejected(Local, "SETUP_SIGNING, later", "no presence", [frame]);
    let name = "SETUP_SIGNING, signed with another key";
    sending.rejected(Local, name, "bad tag", [forged]);
    relay.signs(sending)
}

impl Relay {
    /// Before a reset: what the mark can be after it, and half a frame for each side.
    pub(super) fn prepare_for_reset(&mut self) -> [Vec<u8>; 2] {
        let [least, most] = RESERVED;
        let reserved = (ticks_in(self.resets.at.elapsed()) / 8).clamp(least, most);
        let used = self.last.max(self.last_of_peer);
        self.resets.mark = self.resets.mark.max(used + reserved);
        self.resets.at = Instant::now();
        self.resets.count += 1;
        let frames = [&self.samples[0], &self.resets.accepted[0].0];
        frames.map(|frame| frame[..frame.len() / 2].to_vec())
    }

    /// Telemetry, to be signed.
    fn signs(&mut self, sending: &mut Sending) -> Result<()> {
        sending.passes(Local, "telemetry", same(&self.samples[..SIGNED]));
        Ok(())
    }

    /// Frames of the peer with new stamps, which are older than the last that the relay has given.
    fn below_own_last(&self) -> Result<Vec<Frame>> {
        let (first, last) = (self.last - EACH as u64, self.last_of_peer);
        ensure!(last < first, "the peer's stamps are ahead of the relay's");
        // Each key has a mark of its own. This one's is beyond what the relay has signed with it.
        let key = self.keys.first().context("a relay has a key")?;
        let frames = self.samples.iter().take(EACH).zip(first..);
        let signed = frames.map(|(frame, ticks)| wire::sign(frame, key, LINK_IN, ticks));
        Ok(signed.collect())
    }

    /// They are accepted as long as the relay runs on.
    fn hears_below_own_last(&mut self, sending: &mut Sending) -> Result<()> {
        let frames = self.below_own_last()?;
        self.last_of_peer = self.last;
        let out = self.samples.iter().cloned();
        let name = "new, below the relay's own last stamp";
        sending.passes(Link, name, frames.into_iter().zip(out));
        Ok(())
    }

    /// After a reset: what was accepted before, and what may have been, as the mark is beyond it.
    fn rejects_old(&mut self, sending: &mut Sending) -> Result<()> {
        let now = ticks_now();
        let mut reject = |name, because, belongs: fn(bool, u64) -> bool| {
            let mut accepted = self.resets.accepted.clone();
            accepted.retain(|(frame, key)| {
                let age = now.saturating_sub(wire::ticks(frame)) / TICKS_PER_SECOND;
                belongs(self.keys.contains(key), age)
            });
            if !accepted.is_empty() {
                let frames = accepted.into_iter().map(|(frame, _)| frame);
                sending.rejected(Link, name, because, frames);
            }
        };
        // What is near the edge of the window may leave it on its way.
        reject("accepted before, again", "replayed", |known, age| {
            known && age <= WINDOW / 2
        });
        reject(
            "accepted over a minute ago, again",
            "too old",
            |known, age| known && age > WINDOW,
        );
        reject(
            "accepted before, with a key that has gone",
            "bad tag",
            |known, _| !known,
        );
        let below = self.below_own_last()?;
        sending.rejected(Link, "new, below the mark", "replayed", below);
        Ok(())
    }
}
