//! Seeds of the targets about what outlives a restart.

use mavseal_proofs::keys::{CHANGE, Event, Side};
use mavseal_proofs::mark::Cut;

use super::Seeds;
use crate::flash::Slots;
use crate::memory::{Change, Runs};

impl Seeds {
    pub(super) fn memory(&mut self) {
        let cut = |after, left| Cut {
            after,
            left: [left; 4],
        };
        let whole = cut(u8::MAX, 0);
        for (name, cuts) in [
            ("no_cut", vec![whole, whole]),
            ("first_word_missing", vec![cut(0, 0), whole]),
            ("second_word_missing", vec![cut(1, 0), whole]),
            ("second_word_unreadable", vec![cut(1, 2), whole]),
            ("second_word_weak", vec![cut(1, 3), whole, whole]),
            ("erase_not_begun", vec![cut(4, 0), whole]),
            ("erase_done", vec![cut(4, 1), whole]),
            ("erase_unreadable", vec![cut(4, 2), whole]),
            ("after_the_erase", vec![cut(5, 2), whole]),
            (
                "one_after_the_other",
                vec![cut(1, 3), cut(1, 2), cut(4, 3), cut(0, 1), whole],
            ),
        ] {
            let input = Runs {
                uses: 5,
                ahead: 0,
                cuts,
            };
            self.add("store_crash", name, &input);
        }
        let with = |at: usize, event| {
            let mut events = CHANGE.to_vec();
            events.insert(at, event);
            events.extend(CHANGE);
            events
        };
        let (ours, theirs) = (Side::Initiator, Side::Responder);
        for (name, events) in [
            ("changed", CHANGE.to_vec()),
            ("changed_twice", [CHANGE, CHANGE].concat()),
            ("setup_twice", with(2, Event::Setup(0))),
            ("restart_after_the_offer", with(1, Event::Restart(ours))),
            ("restart_after_the_setup", with(2, Event::Restart(theirs))),
            ("offer_not_stored", with(0, Event::Fail(ours, false))),
            (
                "setup_stored_and_not_told",
                with(1, Event::Fail(theirs, true)),
            ),
            ("confirmation_not_stored", with(4, Event::Fail(ours, false))),
            ("retired_too_early", with(4, Event::Retire(ours))),
            (
                "withdrawn",
                [&CHANGE[..2], &[Event::Withdraw, Event::Setup(0)], &CHANGE].concat(),
            ),
        ] {
            self.add("key_change", name, &Change { events });
        }
        self.slots();
    }

    fn slots(&mut self) {
        let whole = Slots {
            region: [0, 2],
            provided: [1, 2],
            cuts: [3, 7, 11, 0],
            ..Slots::default()
        };
        let (ours, theirs) = (Side::Initiator, Side::Responder);
        // Power that failed comes back with a restart.
        let cut = |side, at: usize| {
            let mut events = CHANGE.to_vec();
            events.insert(at + 1, Event::Restart(side));
            events.insert(at, Event::Fail(side, false));
            events.extend(CHANGE);
            events
        };
        let rejected = |side, at: usize| {
            let mut events = CHANGE.to_vec();
            events.insert(at, Event::Fail(side, true));
            events.extend(CHANGE);
            events
        };
        for (name, events) in [
            ("changed_until_pages_turn", [CHANGE; 4].concat()),
            ("cut_in_the_offer", cut(ours, 0)),
            ("cut_in_the_setup", cut(theirs, 1)),
            ("cut_in_our_confirmation", cut(ours, 4)),
            ("cut_in_their_confirmation", cut(theirs, 7)),
            ("cut_in_our_retirement", cut(ours, 8)),
            ("cut_in_their_retirement", cut(theirs, 9)),
            ("offer_rejected", rejected(ours, 0)),
            ("retirement_rejected", rejected(ours, 8)),
            (
                "two_keys_offered",
                vec![
                    Event::Offer,
                    Event::Setup(3),
                    Event::Withdraw,
                    Event::Withdraw,
                ],
            ),
            ("no_key", vec![Event::Setup(0), Event::Retire(ours)]),
            (
                "withdrawn",
                [&CHANGE[..2], &[Event::Withdraw, Event::Setup(0)], &CHANGE].concat(),
            ),
        ] {
            let starts = if name.starts_with("cut") { 0x55 } else { 0 };
            let input = Slots {
                events,
                starts,
                ..whole.clone()
            };
            self.add("key_slots", name, &input);
        }
        for (name, region) in [
            ("start_within_a_page", [1, 2]),
            ("half_a_page", [0, 1]),
            ("no_pages", [0, 0]),
            ("behind_the_flash", [2, 2]),
        ] {
            let input = Slots {
                region,
                ..whole.clone()
            };
            self.add("key_slots", name, &input);
        }
        for (name, provided, failing) in [
            ("provided_again", [1, 1], 0),
            ("provided_zeros", [0, 1], 0),
            ("provided_to_a_bad_flash", [1, 2], 30),
            ("provided_to_a_broken_flash", [1, 2], 255),
        ] {
            let input = Slots {
                provided,
                failing,
                ..whole.clone()
            };
            self.add("key_slots", name, &input);
        }
    }
}
