//! Seeds of the target about one end of a sealed link.

use super::Seeds;
use crate::ends::{Ends, Stage};
use crate::ports::Behaviour;

/// Ports that do all they are asked.
const WELL: [Behaviour; 2] = [Behaviour {
    arrive: u8::MAX,
    room: u8::MAX,
    fault: 0,
}; 2];

fn stage(kind: u8, of: u8) -> Stage {
    Stage {
        kind,
        of,
        ticks: 0,
        ports: WELL,
    }
}

/// The same after a time that is longer than the maximum delay.
fn later(kind: u8, of: u8) -> Stage {
    Stage {
        ticks: 2000,
        ..stage(kind, of)
    }
}

impl Seeds {
    pub(super) fn ends(&mut self) {
        let bytes = |length: u8| stage(2, length);
        let air = |length: u8| stage(3, length);
        let mut unknown = vec![0xFD, 1, 0, 0, 1, 1, 1, 0xFE, 0xFF, 0x7F, 9, 1, 1];
        unknown.extend([0xFE, 0, 1, 1, 1, 0, 1, 1]);
        let flags = [0xFD, 9, 4, 0, 1, 1, 1, 0, 0, 0].iter().chain(&[7; 11]);
        let flags: Vec<u8> = flags.copied().collect();
        let damaged = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE2];
        let long = [[0x7E, 0].to_vec(), vec![1; 101]].concat();
        let none = &[][..];
        for (name, stages, bytes) in [
            (
                "packets_both_ways",
                vec![
                    stage(1, 20),
                    stage(0, 0),
                    stage(4, 30),
                    stage(5, 3),
                    later(1, 60),
                    later(16, 0),
                ],
                none,
            ),
            (
                "package_again",
                vec![stage(4, 9), stage(4, 9), stage(7, 0), stage(7, 1)],
                none,
            ),
            (
                "package_again_after_a_restart",
                vec![
                    stage(4, 9),
                    stage(4, 9),
                    stage(13, 0),
                    stage(7, 0),
                    stage(7, 1),
                    stage(4, 9),
                ],
                none,
            ),
            (
                "counters_go_on_after_a_restart",
                vec![
                    stage(0, 0),
                    stage(13, 0),
                    stage(0, 0),
                    stage(13, 0),
                    stage(0, 0),
                ],
                none,
            ),
            (
                "damaged_package",
                vec![stage(4, 9), stage(4, 9), stage(8, 50)],
                none,
            ),
            ("package_of_a_stranger", vec![stage(6, 9)], none),
            ("message_of_no_packet", vec![stage(9, 3)], &[1, 2, 3][..]),
            ("short_package", vec![stage(10, 5)], &[1; 5]),
            (
                "answers_of_the_radio",
                vec![stage(12, 7), stage(12, 7), later(16, 0)],
                none,
            ),
            ("radio_data_of_no_status", vec![stage(11, 2)], b"OK"),
            ("packet_too_long", vec![stage(1, 100)], none),
            ("damaged_packet", vec![bytes(17)], &damaged),
            ("unknown_message", vec![bytes(255)], &unknown),
            ("unknown_flags", vec![bytes(255)], &flags),
            ("empty_frame", vec![air(3)], &[0x7E, 0, 0x7E]),
            ("unknown_tag", vec![air(4)], &[0x7E, 9, 1, 0x7E]),
            ("cut_escape", vec![air(5)], &[0x7E, 0, 1, 0x7D, 0x7E]),
            (
                "cut_escape_of_a_radio",
                vec![air(5)],
                &[0x7E, 0, 1, 0x7C, 0x7E],
            ),
            ("long_frame", vec![air(255)], &long),
            (
                "power_fails_in_a_mark",
                vec![
                    stage(14, 0),
                    stage(14, 1),
                    stage(0, 0),
                    stage(4, 9),
                    stage(13, 0),
                    stage(0, 0),
                    stage(7, 0),
                ],
                none,
            ),
            (
                "power_fails_in_its_checksum",
                vec![
                    stage(14, 6),
                    stage(14, 7),
                    stage(0, 0),
                    stage(4, 9),
                    stage(13, 0),
                    stage(0, 0),
                    stage(7, 0),
                ],
                none,
            ),
            (
                "flash_rejects",
                vec![
                    stage(15, 0),
                    stage(15, 1),
                    stage(0, 0),
                    stage(4, 9),
                    stage(5, 9),
                ],
                none,
            ),
        ] {
            for station in [false, true] {
                let input = Ends {
                    station,
                    first: [[0, 0], [0, 1]],
                    max_delay: 50,
                    stages: stages.clone(),
                    bytes,
                    ..Ends::default()
                };
                let of = if station { "station" } else { "vehicle" };
                self.add("sealed_end", &format!("{name}_{of}"), &input);
            }
        }
        let beats = Ends {
            first: [[0xFFFF, 0xFFFE], [0xFFFF, 0xFFFE]],
            stages: vec![
                stage(0, 0),
                stage(0, 0),
                stage(4, 9),
                stage(4, 9),
                stage(13, 0),
                stage(0, 0),
            ],
            ..Ends::default()
        };
        self.add("sealed_end", "last_counters", &beats);
        let broken = Ends {
            broken: true,
            first: [[0, 0], [0, 1]],
            ..beats
        };
        self.add("sealed_end", "broken_cipher", &broken);
        for (fault, name) in (1..).zip(["ready", "read", "ended", "room", "write", "full"]) {
            let failing = [(0, 0), (4, 1), (0, 1), (4, 0)].map(|(kind, port)| {
                let mut failing = stage(kind, 9);
                failing.ports[port].fault = fault;
                failing
            });
            // What a fault kept waiting, in small pieces.
            let mut slow = stage(16, 0);
            slow.ports[0].room = 7;
            slow.ports[1].room = 7;
            let stages = [&failing[..], &[slow; 30]].concat();
            let input = Ends {
                first: [[0, 0], [0, 1]],
                stages,
                ..Ends::default()
            };
            self.add("sealed_end", &format!("port_fails_{name}"), &input);
        }
    }
}
