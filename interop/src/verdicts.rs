//! Tampered and replayed frames of every message: the same verdict, or a listed difference.

use anyhow::Result;
use rand::rngs::SmallRng;

use crate::{
    here::{self, Here},
    hex,
    messages::Message,
    peers::Peer,
    report::Judge,
    scenarios::{Maker, Scenario},
};

const DIRECTIONS: [&str; 2] = ["tampered, to both", "replayed, to both"];

/// Each scenario with each message, to receivers that have forgotten everything.
pub(crate) fn run(
    peer: &mut dyn Peer,
    messages: &[Message],
    here: &mut Here,
    key: &[u8; 32],
    random: &mut SmallRng,
    judge: &mut Judge,
) -> Result<()> {
    for direction in DIRECTIONS {
        judge.begin(peer.name(), peer.version(), direction, messages.len());
        for (at, message) in messages.iter().enumerate() {
            let now = here::now()?;
            let mut maker = Maker {
                here,
                key,
                message,
                other: &messages[(at + 1) % messages.len()],
                now,
                random,
            };
            let scenarios = if direction == DIRECTIONS[0] {
                maker.tampered()?
            } else {
                maker.replayed()?
            };
            for scenario in scenarios {
                play(peer, here, message, &scenario, now, judge)?;
            }
        }
    }
    Ok(())
}

fn play(
    peer: &mut dyn Peer,
    here: &mut Here,
    message: &Message,
    scenario: &Scenario,
    now: u64,
    judge: &mut Judge,
) -> Result<()> {
    peer.restart(now)?;
    here.restart();
    let (mut right, mut theirs, mut ours) = (Vec::new(), Vec::new(), Vec::new());
    for step in &scenario.steps {
        right.push(step.passes);
        ours.push(here.verify(&step.frame, now + step.after).is_ok());
        theirs.push(peer.accepts(&step.frame)?);
    }
    let example = || {
        let frames: Vec<_> = scenario
            .steps
            .iter()
            .map(|step| hex::encode(&step.frame))
            .collect();
        format!("{}: {}", message.name, frames.join(" "))
    };
    if ours != right {
        let what = format!("here, {}: {ours:?}, and right is {right:?}", scenario.name);
        judge.fail(what, example);
    }
    judge.compare(peer.name(), scenario.name, &right, &theirs, example);
    Ok(())
}
