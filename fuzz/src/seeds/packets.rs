//! Seeds of the targets about one packet.

use mavseal_proofs::tamper::Change;

use super::{
    BEAT, HEARTBEAT, MAVLINK1, SETUP_SIGNING, Seeds, TEN_SECONDS, TIMESYNC, UNKNOWN, changed,
    recorded, signed, unsigned,
};
use crate::frames::{ALL_REPAIRS, Packaged, Tampered, ToSign};
use crate::input::{Head, Message, Moment, Receiver, Stamped};

/// A packet with all that can be wrong with it.
fn kinds() -> Vec<(&'static str, Vec<u8>)> {
    let heartbeat = || signed(HEARTBEAT, &BEAT, 0, 0);
    vec![
        ("heartbeat_unsigned", unsigned(HEARTBEAT, &BEAT)),
        ("heartbeat_signed", heartbeat()),
        ("heartbeat_signed_link3", signed(HEARTBEAT, &BEAT, 3, 0)),
        (
            "heartbeat_signed_in_the_future",
            signed(HEARTBEAT, &BEAT, 0, 1),
        ),
        (
            "heartbeat_signed_long_ago",
            signed(HEARTBEAT, &BEAT, 0, -TEN_SECONDS - 1),
        ),
        ("heartbeat_mavlink1", MAVLINK1.to_vec()),
        ("empty_payload", signed(HEARTBEAT, &[], 0, 0)),
        ("max_payload_255", signed(HEARTBEAT, &[0xFD; 255], 0, 0)),
        (
            "trailing_zero_truncated",
            signed(TIMESYNC, &[0, 0, 0, 0, 0, 0, 0, 0, 1], 0, 0),
        ),
        ("setup_signing", unsigned(SETUP_SIGNING, &[7; 42])),
        (
            "setup_signing_signed",
            signed(SETUP_SIGNING, &[7; 42], 0, 0),
        ),
        ("payload_changed", changed(heartbeat(), 12)),
        ("checksum_changed", changed(heartbeat(), 19)),
        ("timestamp_changed", changed(heartbeat(), 22)),
        ("tag_changed", changed(heartbeat(), 33)),
        ("unknown_flags", changed(heartbeat(), 2)),
        ("bad_magic", changed(heartbeat(), 0)),
        ("unknown_message", changed(heartbeat(), 9)),
        ("cut_in_the_header", heartbeat()[..6].to_vec()),
        ("cut_in_the_payload", heartbeat()[..14].to_vec()),
        ("cut_in_the_signature", heartbeat()[..33].to_vec()),
    ]
}

impl Seeds {
    pub(super) fn any_bytes(&mut self, telemetry: &[Vec<u8>]) {
        for (name, packet) in kinds() {
            self.bytes("verify_frame", name, packet);
        }
        for (name, frame) in recorded(telemetry) {
            self.bytes("verify_frame", &name, frame.to_vec());
        }
        let two = [signed(HEARTBEAT, &BEAT, 0, 0), unsigned(TIMESYNC, &[1; 16])].concat();
        self.bytes("verify_frame", "two_frames", two);
    }

    fn package(&mut self, name: &str, input: &Packaged<'_>) {
        for target in ["verify_repaired", "relay_packet"] {
            self.add(target, name, input);
        }
    }

    pub(super) fn packets(&mut self, telemetry: &[Vec<u8>]) {
        let receiver = Receiver {
            link_id: 3,
            past: 100,
            ahead: 10,
            first: Moment::after_now(-200),
        };
        let frame = signed(HEARTBEAT, &BEAT, 0, 0);
        let at = |stamped, now| Packaged {
            repairs: ALL_REPAIRS,
            message: Message::known(HEARTBEAT),
            stamped: Moment::after_now(stamped),
            now: Moment::after_now(now),
            receiver,
            bytes: &frame,
            ..Packaged::default()
        };
        for (name, stamped, now) in [
            ("accepted", 0, 0),
            ("oldest_in_the_window", -100, 0),
            ("too_old", -101, 0),
            ("newest_in_the_window", 10, 0),
            ("from_the_future", 11, 0),
            ("first_after_the_mark", -200, -190),
            ("before_the_mark", -201, -190),
        ] {
            self.package(name, &at(stamped, now));
        }
        for (name, damage_at) in [
            ("flag", 2),
            ("message", 7),
            ("payload", 12),
            ("checksum", 19),
        ] {
            let input = Packaged {
                damage_at,
                damage: 1,
                ..at(0, 0)
            };
            self.package(&format!("damaged_{name}"), &input);
        }
        for (name, damage_at) in [("link", 21), ("timestamp", 22), ("tag", 33)] {
            let input = Packaged {
                damage_at,
                damage: 1,
                ..at(0, 0)
            };
            self.package(&format!("damaged_{name}"), &input);
        }
        for (name, message, repairs) in [
            ("wrong_link", Message::known(HEARTBEAT), ALL_REPAIRS & !8),
            ("unsigned", Message::known(HEARTBEAT), ALL_REPAIRS & !1),
            ("mavlink1", Message::known(HEARTBEAT), ALL_REPAIRS & !2),
            ("setup_signing", Message::known(SETUP_SIGNING), ALL_REPAIRS),
            (
                "setup_signing_unsigned",
                Message::known(SETUP_SIGNING),
                ALL_REPAIRS & !1,
            ),
            ("unknown_message", Message::any(UNKNOWN), ALL_REPAIRS),
        ] {
            self.package(
                name,
                &Packaged {
                    message,
                    repairs,
                    ..at(0, 0)
                },
            );
        }
        let end = Packaged {
            stamped: Moment::before_the_end(0),
            now: Moment::before_the_end(0),
            ..at(0, 0)
        };
        self.package("end_of_time", &end);
        let long = [0x5A; 280];
        self.package(
            "max_payload_255",
            &Packaged {
                bytes: &long,
                ..at(0, 0)
            },
        );
        for (name, frame) in recorded(telemetry) {
            let repairs = ALL_REPAIRS & !4;
            self.package(
                &name,
                &Packaged {
                    repairs,
                    bytes: frame,
                    ..at(0, 0)
                },
            );
        }
    }

    pub(super) fn changes(&mut self) {
        let flip = |at| Change::Flip { at, bits: 1 };
        let head = Head {
            fields: [0, 17, 1, 190],
            message: Message::known(HEARTBEAT),
        };
        for (name, changes) in [
            ("nothing", vec![]),
            ("magic", vec![flip(0)]),
            ("length", vec![flip(1)]),
            ("flag", vec![flip(2)]),
            ("sequence", vec![flip(4)]),
            ("message", vec![flip(7)]),
            ("payload", vec![flip(12)]),
            ("checksum", vec![flip(19)]),
            ("link", vec![flip(21)]),
            ("timestamp", vec![flip(22)]),
            ("first_byte_of_the_tag", vec![flip(28)]),
            ("last_byte_of_the_tag", vec![flip(33)]),
            (
                "payload_longer",
                vec![flip(1), Change::Insert { at: 12, byte: 0 }],
            ),
            ("payload_shorter", vec![flip(1), Change::Remove { at: 18 }]),
            ("cut_short", vec![Change::Remove { at: 33 }]),
            ("and_back_again", vec![flip(12), flip(12)]),
        ] {
            let input = Tampered {
                head,
                changes,
                payload: &BEAT,
                ..Tampered::default()
            };
            self.add("tamper_one", name, &input);
        }
    }

    pub(super) fn signed(&mut self) {
        let long = [0xA5; 256];
        for (name, id, payload, moment) in [
            (
                "heartbeat_signed_link3",
                HEARTBEAT,
                &BEAT[..],
                Moment::after_now(0),
            ),
            ("empty_payload", HEARTBEAT, &[], Moment::default()),
            (
                "max_payload_255",
                TIMESYNC,
                &long[..255],
                Moment::before_the_end(0),
            ),
            (
                "payload_256_is_too_long",
                TIMESYNC,
                &long,
                Moment::after_now(0),
            ),
            (
                "one_block_under_the_tag",
                HEARTBEAT,
                &long[..36],
                Moment::after_now(1),
            ),
            (
                "two_blocks_under_the_tag",
                HEARTBEAT,
                &long[..37],
                Moment::after_now(1),
            ),
            (
                "setup_signing",
                SETUP_SIGNING,
                &long[..42],
                Moment::after_now(2),
            ),
        ] {
            let head = Head {
                fields: [2, 17, 1, 190],
                message: Message::known(id),
            };
            let stamped = Stamped { link_id: 3, moment };
            let input = ToSign {
                head,
                stamped,
                index: 5,
                payload,
            };
            self.add("sign_verify", name, &input);
        }
        let head = Head {
            message: Message::any(UNKNOWN),
            ..Head::default()
        };
        let input = ToSign {
            head,
            payload: &BEAT,
            ..ToSign::default()
        };
        self.add("sign_verify", "unknown_message", &input);
    }
}
