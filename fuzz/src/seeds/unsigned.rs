//! Seeds of the targets about frames without signature and about the message that carries a key.

use super::{
    BEAT, HEARTBEAT, MAVLINK1, SETUP_SIGNING, Seeds, TIMESYNC, UNKNOWN, changed, signed, unsigned,
};
use crate::frames::{ALL_REPAIRS, Packaged};
use crate::input::{Head, Message, Moment, Receiver, Stamped};
use crate::unsigned::{Asked, Shared};

/// RADIO_STATUS, which radios cannot sign.
const RADIO_STATUS: u32 = 109;

/// Packets that are acted on, and packets that are not.
fn packets() -> Vec<(&'static str, Vec<u8>)> {
    let heartbeat = || unsigned(HEARTBEAT, &BEAT);
    vec![
        ("unsigned", heartbeat()),
        ("radio_status", unsigned(RADIO_STATUS, &[1; 9])),
        ("empty_payload", unsigned(TIMESYNC, &[])),
        ("max_payload_255", unsigned(TIMESYNC, &[0xFD; 255])),
        ("setup_signing", unsigned(SETUP_SIGNING, &[7; 42])),
        ("setup_signing_cut", unsigned(SETUP_SIGNING, &[7; 12])),
        ("setup_signing_empty", unsigned(SETUP_SIGNING, &[0])),
        ("setup_signing_too_long", unsigned(SETUP_SIGNING, &[7; 60])),
        (
            "setup_signing_signed",
            signed(SETUP_SIGNING, &[7; 42], 0, 0),
        ),
        ("signed", signed(RADIO_STATUS, &[1; 9], 0, 0)),
        ("forged", changed(signed(RADIO_STATUS, &[1; 9], 0, 0), 33)),
        ("payload_changed", changed(heartbeat(), 12)),
        ("checksum_changed", changed(heartbeat(), 19)),
        ("mavlink1", MAVLINK1.to_vec()),
    ]
}

impl Seeds {
    pub(super) fn unsigned(&mut self, telemetry: &[Vec<u8>]) {
        let recorded = super::recorded(telemetry).into_iter();
        let recorded = recorded.map(|(name, frame)| (name, frame.to_vec()));
        let packets = packets().into_iter();
        let packets = packets.map(|(name, packet)| (name.to_owned(), packet));
        for (name, bytes) in packets.chain(recorded) {
            let packet = packet(&bytes);
            self.add("unsigned_policy", &name, &trusted_port(packet.clone()));
            self.add("setup_signing", &name, &shared([7; 32], packet));
        }
        let heartbeat = unsigned(HEARTBEAT, &BEAT);
        let unknown = Packaged {
            repairs: ALL_REPAIRS & !1,
            message: Message::any(UNKNOWN),
            ..packet(&heartbeat)
        };
        let name = "unknown_message";
        self.add("unsigned_policy", name, &trusted_port(unknown.clone()));
        self.add("setup_signing", name, &shared([7; 32], unknown));
        self.policies();
        self.signed_packets();
        self.keys();
    }

    fn policies(&mut self) {
        for (name, bytes) in [
            ("heartbeat", unsigned(HEARTBEAT, &BEAT)),
            ("radio_status", unsigned(RADIO_STATUS, &[1; 9])),
            ("radio_status_signed", signed(RADIO_STATUS, &[1; 9], 0, 0)),
        ] {
            for (policy, link_id, way) in [
                (0, 3, "reject"),
                (1, 3, "radio_status_alone"),
                (2, 4, "other_port"),
                (3, 3, "answered"),
                (3, 4, "answered_otherwise"),
            ] {
                let input = Asked {
                    policy,
                    link_id,
                    ..trusted_port(packet(&bytes))
                };
                self.add("unsigned_policy", &format!("{name}_{way}"), &input);
            }
        }
    }

    /// What is signed is verified or not, and never asked about.
    fn signed_packets(&mut self) {
        let bytes = signed(RADIO_STATUS, &[1; 9], 0, 0);
        let packet = packet(&bytes);
        for (name, link_id, after) in [("replayed", 0, 1), ("of_another_link", 1, 0)] {
            let packet = Packaged {
                receiver: Receiver {
                    link_id,
                    first: Moment::after_now(after),
                    ..packet.receiver
                },
                ..packet.clone()
            };
            self.add("unsigned_policy", name, &trusted_port(packet));
        }
    }

    fn keys(&mut self) {
        let mut cut = [7; 32];
        cut[20..].fill(0);
        for (name, key, initial) in [
            ("key_of_zeros", [0; 32], Moment::default()),
            ("key_that_ends_with_zeros", cut, Moment::after_now(0)),
            ("end_of_time", [0xFF; 32], Moment::before_the_end(0)),
        ] {
            let input = Shared {
                target: [0; 2],
                initial,
                ..shared(key, Packaged::default())
            };
            self.add("setup_signing", name, &input);
        }
        let long = [7; 43];
        let mut beyond = [0; 8];
        beyond[6] = 1;
        for (name, bytes) in [
            ("payload_of_42", &long[..42]),
            ("payload_of_43", &long),
            ("timestamp_beyond_48_bits", &beyond),
            ("no_payload", &[]),
        ] {
            self.add("setup_signing", name, &shared([7; 32], packet(bytes)));
        }
    }
}

/// A packet as it is, to a receiver that takes what is signed for link 0 and stamped now.
fn packet(bytes: &[u8]) -> Packaged<'_> {
    let now = Moment::after_now(0);
    Packaged {
        now,
        receiver: Receiver {
            link_id: 0,
            past: 100,
            ahead: 10,
            first: now,
        },
        bytes,
        ..Packaged::default()
    }
}

/// A packet that comes in on the port that is trusted.
fn trusted_port(packet: Packaged<'_>) -> Asked<'_> {
    Asked {
        policy: 2,
        trusted: 3,
        link_id: 3,
        answers: 0x5555,
        packet,
    }
}

/// A packet beside a key for the component 190 of system 1.
fn shared(secret_key: [u8; 32], packet: Packaged<'_>) -> Shared<'_> {
    Shared {
        target: [1, 190],
        initial: Moment::after_now(0),
        secret_key,
        head: Head {
            fields: [2, 17, 255, 1],
            message: Message::known(HEARTBEAT),
        },
        stamped: Stamped {
            link_id: 3,
            moment: Moment::after_now(0),
        },
        // The last byte of the key.
        index: 41,
        packet,
    }
}
