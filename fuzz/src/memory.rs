//! Targets about what outlives a restart: the mark in flash, and keys while they are changed.

use arbitrary::Arbitrary;
use mavlink_signing::Hmac;
use mavseal_proofs::keys::{self, Event};
use mavseal_proofs::mark::{self, Cut, Small};
use mavseal_store::{Binding, HighWaterMark};

/// Runs of a program that uses values below a mark, each ended by a cut of the power.
#[derive(Arbitrary, Clone, Debug)]
pub struct Runs {
    /// Values that each run uses; modulo 8.
    pub uses: u8,
    /// How far ahead a mark is stored.
    pub ahead: u8,
    /// Where each run ends.
    pub cuts: Vec<Cut>,
}

/// The mark after every run, against what was used in it; the same with each word unreadable, and for other keys
/// (T2).
pub fn store_crash(input: Runs) {
    let mut flash = Small::default();
    let uses = input.uses % 8;
    let (used, _) = mark::runs(&mut flash, &input.cuts, uses, input.ahead.into());
    for word in 0..mark::WORDS {
        let found = mark::spoiled(flash, word, used);
        // Without a cut each record has its copy.
        let cut = input.cuts.iter().any(|cut| cut.after < u8::MAX);
        assert!(found || cut || input.cuts.is_empty());
    }
    if used.is_some() {
        let other = Binding::new(input.uses, [input.ahead; 4]);
        mark::foreign(&mut flash, other);
        let anew = HighWaterMark::provision(&mut flash, mark::REGION, other, 0);
        let _ = anew.expect("the power is there");
        mark::foreign(&mut flash, mark::BINDING);
    }
}

/// What happens while keys are changed.
#[derive(Arbitrary, Clone, Debug)]
pub struct Change {
    /// In order.
    pub events: Vec<Event>,
}

/// Both ends of a link whose key is changed, whatever is lost and wherever the power fails (K1).
pub fn key_change(input: Change) {
    // Each event is tried on every key that there ever was.
    let events = &input.events[..input.events.len().min(100)];
    let memories = [keys::Model::new(), keys::Model::new()];
    keys::change::<Hmac, _>(memories, events);
}
