//! Seeds of the targets about single values.

use super::{BEAT, HEARTBEAT, SETUP_SIGNING, Seeds, TIMESYNC, UNKNOWN};
use crate::input::{Head, Message, Moment, Receiver, Stamped};
use crate::standard::Foreign;
use crate::values::{Checked, Clocks, Keyed};

impl Seeds {
    pub(super) fn values(&mut self) {
        let bytes = [&[7; 32][..], &[0x5A; 274]].concat();
        for length in [0, 28, 55, 56, 64, 119, 120, 274] {
            let input = Keyed {
                key_length: u8::MAX,
                bytes: &bytes[..32 + length],
            };
            self.add("diff_hmac", &format!("message_of_{length}"), &input);
        }
        let mut last = [0; 32];
        last[31] = 1;
        for (name, key) in [
            ("key_of_zeros", &[0; 32][..]),
            ("key_of_zeros_but_the_last", &last),
            ("key_too_short", &[7; 31]),
            ("key_too_long", &[7; 33]),
            ("no_key", &[]),
        ] {
            let input = Keyed {
                key_length: key.len() as u8,
                bytes: key,
            };
            self.add("diff_hmac", name, &input);
        }
        for (name, message) in [
            ("check_value_heartbeat", Message::known(HEARTBEAT)),
            ("check_value_timesync", Message::known(TIMESYNC)),
            ("check_value_setup_signing", Message::known(SETUP_SIGNING)),
            ("check_value_unknown_message", Message::any(UNKNOWN)),
            ("check_value_id_between_two_rows", Message::any(3)),
            (
                "check_value_id_of_more_than_16_bits",
                Message::any(0x1_0000),
            ),
        ] {
            let input = Checked {
                crc: u16::MAX,
                byte: b'9',
                message,
                covered: b"12345678",
            };
            self.add("checksum_table", name, &input);
        }
        let first = Moment::after_now(-50);
        let receiver = Receiver {
            link_id: 3,
            past: 100,
            ahead: 10,
            first,
        };
        for (name, link_id, moment, now) in [
            ("accepted", 3, 0, [0, 1]),
            ("one_tick_twice", 3, 0, [0, 0]),
            ("clock_goes_back", 3, 0, [5, -5]),
            ("wrong_link", 4, 0, [0, 0]),
            ("link_below", 2, 0, [0, 0]),
            ("newest_in_the_window", 3, 10, [0, 0]),
            ("from_the_future", 3, 11, [0, 0]),
            ("oldest_in_the_window", 3, -50, [50, 0]),
            ("too_old", 3, -50, [51, 0]),
            ("before_the_mark", 3, -51, [0, 0]),
        ] {
            let sender = Stamped {
                link_id,
                moment: Moment::after_now(moment),
            };
            let input = Clocks {
                sender,
                receiver,
                now: now.map(Moment::after_now),
                earlier: sender,
                mark: first,
                ahead: 20,
                broken: false,
            };
            self.add("stamps", name, &input);
            let input = Clocks {
                broken: true,
                ..input
            };
            self.add("stamps", &format!("{name}_not_stored"), &input);
        }
        for (name, before) in [
            ("last_stamp", 0),
            ("last_stamp_but_one", 1),
            ("last_stamp_but_two", 2),
        ] {
            let moment = Moment::before_the_end(before);
            let sender = Stamped { link_id: 3, moment };
            self.add(
                "stamps",
                name,
                &Clocks {
                    sender,
                    receiver,
                    now: [moment; 2],
                    earlier: sender,
                    mark: moment,
                    ahead: 20,
                    broken: false,
                },
            );
        }
    }

    pub(super) fn foreign(&mut self) {
        let input = Foreign {
            key: [7; 32],
            head: Head {
                fields: [0, 17, 1, 190],
                message: Message::known(HEARTBEAT),
            },
            stamped: Stamped {
                link_id: 3,
                moment: Moment::before_the_end(9),
            },
            damage_at: 11,
            damage: 1,
            repaired: false,
            payload: &BEAT,
        };
        // Each counted from the byte after the magic one.
        for (name, damage_at) in [
            ("length", 0),
            ("flag", 1),
            ("message", 6),
            ("payload", 11),
            ("checksum", 18),
            ("link", 20),
            ("timestamp", 21),
            ("first_byte_of_the_tag", 27),
            ("last_byte_of_the_tag", 32),
        ] {
            for (repaired, end) in [(false, ""), (true, "_checksum_repaired")] {
                let input = Foreign {
                    damage_at,
                    repaired,
                    ..input
                };
                self.add("diff_standard", &format!("damaged_{name}{end}"), &input);
            }
        }
        let long = [0x5A; 256];
        for (name, id, moment, payload) in [
            ("first_moment", HEARTBEAT, Moment::default(), &BEAT[..]),
            ("in_2026", HEARTBEAT, Moment::after_now(0), &BEAT),
            ("end_of_time", TIMESYNC, Moment::before_the_end(0), &BEAT),
            ("empty_payload", HEARTBEAT, Moment::before_the_end(0), &[]),
            (
                "one_block",
                HEARTBEAT,
                Moment::before_the_end(0),
                &long[..4],
            ),
            (
                "two_blocks",
                HEARTBEAT,
                Moment::before_the_end(0),
                &long[..5],
            ),
            (
                "max_payload_255",
                TIMESYNC,
                Moment::before_the_end(0),
                &long[..255],
            ),
            (
                "payload_256_is_too_long",
                TIMESYNC,
                Moment::default(),
                &long,
            ),
            (
                "setup_signing",
                SETUP_SIGNING,
                Moment::before_the_end(0),
                &long[..42],
            ),
        ] {
            let message = Message::known(id);
            let link_id = 3;
            let input = Foreign {
                head: Head {
                    message,
                    ..input.head
                },
                stamped: Stamped { link_id, moment },
                payload,
                ..input
            };
            self.add("diff_standard", name, &input);
        }
        let unknown = Head {
            message: Message::any(UNKNOWN),
            ..input.head
        };
        let unknown = Foreign {
            head: unknown,
            ..input
        };
        self.add("diff_standard", "unknown_message", &unknown);
        let zeros = Foreign {
            key: [0; 32],
            ..input
        };
        self.add("diff_standard", "key_of_zeros", &zeros);
    }
}
