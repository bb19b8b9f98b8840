//! Seeds of the target about an end in time.

use super::Seeds;
use crate::input::Moment;
use crate::time::{End, Happening};

impl Seeds {
    pub(super) fn time(&mut self) {
        let happens = |kind, jump, after| Happening {
            wait: 18,
            kind,
            jump,
            after,
        };
        let [tell, told, system_time] = [1, 2, 3].map(|kind| happens(kind, 21, 0));
        let [send, hear, again, start] = [4, 5, 6, 7].map(|kind| happens(kind, 0, 5));
        // Beyond the reservation by which the clock begins before the mark.
        let late = happens(5, 21, 0);
        let later = |happening: Happening, wait| Happening { wait, ..happening };
        let now = Moment::after_now(0);
        for (name, mark, happenings) in [
            ("sent_and_heard", now, vec![tell, send, hear, send, hear]),
            ("heard_again", now, vec![tell, hear, again, hear, again]),
            (
                "heard_again_after_a_start",
                now,
                vec![late, hear, send, happens(7, 0, 0), again, send, late],
            ),
            (
                "power_fails_in_the_first_mark",
                now,
                vec![start, send, happens(7, 0, 1), send, hear, start, send],
            ),
            (
                "power_fails_when_a_frame_comes",
                now,
                vec![happens(7, 0, 1), late, start, again, late],
            ),
            (
                "first_mark_of_all",
                Moment::default(),
                vec![tell, send, hear, start, again, send],
            ),
            (
                "a_time_that_has_passed",
                now,
                vec![happens(1, -40, 0), send, hear],
            ),
            (
                "told_twice",
                now,
                vec![tell, happens(1, 10, 0), happens(1, -10, 0), hear],
            ),
            (
                "no_time_at_all",
                Moment::default(),
                vec![happens(1, 0, 0), hear],
            ),
            (
                "not_trusted",
                now,
                vec![told, told, system_time, tell, told, hear],
            ),
            ("from_the_future", now, vec![tell, happens(5, 24, 0), hear]),
            ("too_old", now, vec![tell, happens(5, -24, 0), hear]),
            (
                "more_than_a_year_ahead",
                now,
                vec![happens(5, 44, 0), hear, send],
            ),
            (
                "a_day_ahead_without_a_clock",
                now,
                vec![happens(5, 34, 0), hear, send, happens(5, -20, 0)],
            ),
            (
                "slewed",
                now,
                vec![
                    tell,
                    later(happens(5, 12, 0), 30),
                    later(happens(5, -12, 0), 30),
                ],
            ),
            (
                "told_too_long_ago",
                now,
                vec![tell, later(hear, 33), hear, happens(5, 24, 0)],
            ),
            (
                "end_of_time",
                Moment::before_the_end(3),
                vec![send, send, send, hear, start, send],
            ),
            (
                "behind_the_end_of_time",
                Moment::before_the_end(0),
                vec![send, start, send],
            ),
        ] {
            let input = End {
                drift: 12,
                mark,
                records: 0,
                chance: 0,
                happenings,
            };
            self.add("kept_link", name, &input);
        }
        for (name, records, happenings) in [
            ("no_number_left", 1, vec![late, send]),
            (
                "numbers_end_in_use",
                3,
                vec![late, send, start, late, start, late, send],
            ),
            ("a_region_that_does_not_fit", 0, vec![]),
        ] {
            let input = End {
                drift: 12,
                mark: now,
                records,
                chance: 0,
                happenings,
            };
            self.add("kept_link", name, &input);
        }
    }
}
