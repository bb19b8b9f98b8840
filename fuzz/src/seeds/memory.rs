//! Seeds of the targets about what outlives a restart.

use mavseal_proofs::keys::{CHANGE, Event, Side};
use mavseal_proofs::mark::Cut;

use super::Seeds;
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
    }
}
