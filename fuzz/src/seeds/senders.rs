//! Seeds of the target about several senders.

use super::Seeds;
use crate::input::{Moment, Receiver};
use crate::senders::{Arrival, Arrivals};

/// A frame of a stream, stamped so many ticks after the clock.
const fn frame(sender: u8, after: i16) -> Arrival {
    Arrival {
        jump: 0,
        sender,
        after,
        kind: 0,
    }
}

/// A frame of its own that comes back to the receiver.
const fn own(sender: u8, after: i16) -> Arrival {
    Arrival {
        kind: 3,
        ..frame(sender, after)
    }
}

const fn spoilt(kind: u8) -> Arrival {
    Arrival {
        kind,
        ..frame(1, 0)
    }
}

/// The frame that is remembered, so many before the last, once more.
const fn again(back: u8) -> Arrival {
    Arrival {
        kind: 7,
        ..frame(back, 0)
    }
}

impl Seeds {
    pub(super) fn senders(&mut self) {
        let receiver = Receiver {
            link_id: 1,
            past: 100,
            ahead: 10,
            first: Moment::after_now(0),
        };
        let later = Arrival {
            // 2^7 ticks: beyond the window.
            jump: 8,
            ..frame(1, 0)
        };
        let earlier = Arrival {
            jump: -8,
            ..frame(1, 0)
        };
        // Streams that differ in the link, the system, the component alone.
        let (one, link, system, component) = (1, 2, 0b101, 0b1_0001);
        for (name, only, rows, arrivals) in [
            ("accepted", false, 2, vec![frame(one, 0), frame(one, 1)]),
            (
                "not_newer",
                false,
                2,
                vec![frame(one, 1), frame(one, 1), frame(one, 0)],
            ),
            (
                "before_the_mark",
                false,
                2,
                vec![frame(one, -1), frame(one, 0)],
            ),
            (
                "newest_in_the_window",
                false,
                2,
                vec![frame(one, 10), frame(one, 11)],
            ),
            (
                "too_old",
                false,
                2,
                vec![frame(one, -100), frame(one, -101)],
            ),
            (
                "every_part_makes_a_stream",
                false,
                2,
                [one, link, system, component].map(|of| frame(of, 0)).into(),
            ),
            (
                "repeated",
                false,
                2,
                vec![frame(one, 0), frame(link, 0), again(0), again(1)],
            ),
            (
                "one_stream_runs_ahead",
                false,
                2,
                vec![
                    frame(one, 10),
                    frame(link, 0),
                    frame(link, 1),
                    frame(one, 9),
                ],
            ),
            (
                "full",
                false,
                1,
                vec![
                    frame(one, 0),
                    frame(link, 0),
                    frame(system, 5),
                    frame(system, 11),
                    frame(one, 1),
                    again(0),
                    frame(link, 1),
                ],
            ),
            (
                "one_row",
                false,
                0,
                vec![frame(one, 0), frame(link, 1), again(0)],
            ),
            (
                "reflected",
                false,
                2,
                vec![own(one, 0), own(one, 1), frame(one, 1), frame(one, 2)],
            ),
            (
                "reflected_late",
                false,
                2,
                vec![own(one, 0), again(0), frame(one, 5), own(one, 2)],
            ),
            (
                "reflected_before_the_mark",
                false,
                2,
                vec![own(one, -9), frame(one, -5), frame(one, 0)],
            ),
            (
                "reflected_when_full",
                false,
                0,
                vec![frame(link, 0), own(one, 0), frame(one, 1)],
            ),
            (
                "own_streams_leave_half",
                false,
                2,
                vec![
                    own(one, 0),
                    own(system, 1),
                    own(component, 2),
                    frame(component, 3),
                    frame(one, 3),
                    frame(link, 3),
                ],
            ),
            (
                "own_streams_of_two_links",
                false,
                0,
                vec![own(one, 0), own(one, 1), own(link, 2), frame(3, 3)],
            ),
            (
                "reflected_of_another_link",
                true,
                2,
                vec![own(link, 0), own(one, 0)],
            ),
            (
                "one_link_alone",
                true,
                2,
                vec![frame(one, 0), frame(link, 0)],
            ),
            (
                "spoilt",
                false,
                2,
                vec![spoilt(4), spoilt(5), spoilt(6), frame(one, 0)],
            ),
            (
                "spoilt_ahead_of_a_stream",
                false,
                2,
                vec![frame(one, 0), later, spoilt(5), frame(one, 1)],
            ),
            (
                "clock_goes_on_and_back",
                false,
                2,
                vec![frame(one, 0), later, again(1), earlier, again(0)],
            ),
        ] {
            let input = Arrivals {
                receiver,
                only,
                rows,
                arrivals,
            };
            self.add("streams_model", name, &input);
        }
        let end = Arrivals {
            receiver: Receiver {
                past: u16::MAX,
                ahead: u16::MAX,
                first: Moment::before_the_end(1),
                ..receiver
            },
            arrivals: vec![frame(one, 0), frame(one, 1), frame(one, 1), frame(link, 1)],
            ..Arrivals::default()
        };
        self.add("streams_model", "end_of_time", &end);
    }
}
