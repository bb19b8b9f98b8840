//! Seeds of the targets about sealed links.

use mavseal_proofs::link::Step;

use super::Seeds;
use crate::sealed::{Arrival, Gcm, History, Line, Packets, Sealing, Shape};

/// As SMACCMPilot's template has it: with keys that are published.
const KEYS_MK: &str = include_str!("../../../keys/tests/keys/smaccmpilot.mk");
/// A vehicle and two stations.
const TOML: &str = include_str!("../../../keys/tests/keys/two_stations.toml");

impl Seeds {
    pub(super) fn sealed(&mut self) {
        self.arrivals();
        self.sealings();
        self.links();
        self.lines();
        self.packings();
        self.ciphers();
        self.key_files();
    }

    fn arrivals(&mut self) {
        const ALL: u8 = 15;
        for (name, right, near, limit) in [
            ("genuine", ALL, 1, 3),
            ("genuine_after_a_jump", ALL, 100, 3),
            ("same_place_again", ALL, 0, 3),
            ("late", ALL, -1, 3),
            ("wrong_tag", 7, 1, 3),
            ("worn_out", ALL, 1, 0),
            ("unknown_sender", 1, 1, 3),
            ("too_short", 0, 1, 3),
        ] {
            for epochs in [false, true] {
                let input = Arrival {
                    epochs,
                    shared: limit == 0,
                    limit,
                    last: [[2, 0, 900], [3, 1, 0]],
                    right,
                    near,
                    bytes: &[1; 95],
                };
                let format = if epochs { "epochs" } else { "counters" };
                self.add("open_package", &format!("{name}_{format}"), &input);
            }
        }
        let end = Arrival {
            last: [[0xFFFF, 0xFFFF, 0xFFFE]; 2],
            right: ALL,
            near: 1,
            limit: 1,
            bytes: &[1; 97],
            ..Arrival::default()
        };
        self.add("open_package", "behind_the_last_counter", &end);
        let epoch = Arrival {
            epochs: true,
            near: 0,
            ..end
        };
        self.add("open_package", "behind_the_last_epoch", &epoch);
    }

    fn sealings(&mut self) {
        for (name, first, mark, fails) in [
            ("never_used", [0, 0], [0; 4], false),
            ("resumed", [1, 2], [0, 0, 0, 7], false),
            (
                "last_counter_and_epoch",
                [0xFFFF, 0xFFFE],
                [0, 0, 0, 0xFFFE],
                false,
            ),
            (
                "no_counter_and_epoch",
                [0xFFFF; 2],
                [0, 0, 0, 0xFFFF],
                false,
            ),
            ("mark_of_more_than_16_bits", [0, 1], [0, 0, 1, 1], false),
            ("unit_that_fails", [0, 5], [0, 0, 0, 5], true),
        ] {
            let input = Sealing {
                numbers: [[0, 0x4353], [0, 5], first],
                mark,
                fails,
                at: 79,
                bytes: [0x5A; 16],
            };
            self.add("seal_open", name, &input);
        }
    }

    fn links(&mut self) {
        let send = |from| Step::Send { from };
        let deliver = |back| Step::Deliver { back };
        let restart = |end, ahead| Step::Restart { end, ahead };
        let damage = |bit| Step::Damage { back: 0, bit };
        let noise = |byte| Step::Noise { byte };
        for (name, first, steps) in [
            (
                "both_ways",
                [0, 1],
                vec![
                    send(0),
                    deliver(0),
                    send(1),
                    deliver(0),
                    send(2),
                    deliver(0),
                ],
            ),
            ("lost", [0, 1], vec![send(1), send(1), send(1), deliver(0)]),
            ("twice", [0, 1], vec![send(1), deliver(0), deliver(0)]),
            (
                "reordered",
                [0, 1],
                vec![send(1), send(1), deliver(0), deliver(1)],
            ),
            (
                "damaged_then_whole",
                [0, 1],
                vec![send(0), damage(400), deliver(0)],
            ),
            (
                "damaged_boundary",
                [0, 1],
                vec![send(0), damage(0), deliver(0)],
            ),
            (
                "noise_before_a_frame",
                [0, 1],
                vec![noise(0x7E), noise(0x7C), send(0), deliver(0)],
            ),
            (
                "receiver_restarted",
                [0, 1],
                vec![
                    send(1),
                    deliver(0),
                    restart(0, 0),
                    deliver(0),
                    send(1),
                    deliver(0),
                ],
            ),
            (
                "sender_restarted",
                [0, 1],
                vec![
                    send(1),
                    deliver(0),
                    restart(1, 9),
                    send(1),
                    deliver(0),
                    deliver(1),
                ],
            ),
            (
                "end_of_counters_and_epochs",
                [0xFFFF, 0xFFFE],
                vec![
                    send(1),
                    deliver(0),
                    send(1),
                    restart(1, 0),
                    send(1),
                    deliver(0),
                ],
            ),
            (
                "last_epoch",
                [0xFFFE, 0],
                vec![send(0), deliver(0), restart(0, 0), send(0), deliver(0)],
            ),
        ] {
            for epochs in [false, true] {
                let format = if epochs { "epochs" } else { "counters" };
                let input = History {
                    epochs,
                    first,
                    steps: steps.clone(),
                };
                self.add("sealed_link", &format!("{name}_{format}"), &input);
            }
        }
    }

    fn lines(&mut self) {
        let status = [
            0x42, 0xC8, 0x28, 0x03, 0xE8, 0x7E, 0x23, 3, 0xDE, 0, 1, 0, 2, 0, 3, 0, 4, 0, 5, 0,
            0x7C, 2, 0xBC, 3, 0x20,
        ];
        let long = [0x7E, 0].into_iter().chain([0x55; 101]).chain([0x7E]);
        for (name, radio, payload, noise) in [
            ("status", true, &status[..], &[][..]),
            ("request", true, b"B\r", &[0x7E, 0, 1]),
            ("package_of_boundaries", false, &[0x7E; 96], &[0x7E, 0x7E]),
            ("no_payload", false, &[], &[0x7E, 0, 0x7E]),
            ("one_too_many", false, &[1; 101], &[0x7E, 7, 1]),
            ("cut_escape", false, &[3, 4], &[0x7E, 0, 1, 2, 0x7C, 0x7E]),
            (
                "escapes",
                false,
                &[0x7C, 0x7E],
                &[0x7E, 0, 0x7C, 0x5E, 0x7C, 0x5C, 0x7C, 0, 0x7C, 0x7C, 0x7E],
            ),
            (
                "shared_boundary",
                false,
                &[3],
                &[0x7E, 0, 1, 2, 0x7E, 0, 3, 4, 0x7E],
            ),
            ("too_long", false, &[1; 96], &long.collect::<Vec<_>>()),
        ] {
            let debug = [&[0x44], &status[1..], &[9, 1, 2, 3, 4]].concat();
            let bytes = [payload, noise].concat();
            let payload = payload.len() as u8;
            let input = Line {
                radio,
                payload,
                bytes: &bytes,
            };
            self.add("hx_decoder", name, &input);
            if name == "status" {
                let input = Line {
                    radio,
                    payload: 30,
                    bytes: &debug,
                };
                self.add("hx_decoder", "debug_status", &input);
            }
        }
    }

    fn packings(&mut self) {
        let shape = |version, id, length| Shape {
            wait: 10,
            version,
            id,
            length,
            cut: 0,
        };
        let heartbeat = shape(0, 0, 9);
        let mut message = [[0; 16]; 5];
        message[0][..10].copy_from_slice(&[0xFE, 2, 0, 1, 1, 30, 1, 2, 3, 4]);
        for (name, shapes) in [
            ("heartbeat", vec![heartbeat]),
            (
                "two_that_fill_a_message",
                vec![shape(0, 1, 32), shape(0, 1, 32)],
            ),
            (
                "two_that_do_not_fit",
                vec![shape(0, 1, 33), shape(0, 1, 32), heartbeat],
            ),
            (
                "longest",
                vec![shape(0, 1, 72), shape(2, 1, 68), shape(3, 1, 55)],
            ),
            (
                "too_long",
                vec![shape(0, 1, 73), shape(2, 1, 255), heartbeat],
            ),
            (
                "cut",
                vec![
                    Shape {
                        cut: 1,
                        ..heartbeat
                    },
                    heartbeat,
                ],
            ),
            (
                "trailing",
                vec![
                    Shape {
                        cut: -1,
                        ..heartbeat
                    },
                    heartbeat,
                ],
            ),
            ("unknown_flag", vec![shape(4, 1, 9)]),
            ("no_packet", vec![shape(5, 1, 9)]),
            (
                "waited_long",
                vec![
                    shape(0, 1, 9),
                    Shape {
                        wait: 200,
                        ..shape(0, 2, 9)
                    },
                    shape(0, 3, 9),
                ],
            ),
        ] {
            for old in [false, true] {
                let vehicle = if old { "old_vehicle" } else { "vehicle" };
                let input = Packets {
                    old,
                    polls: true,
                    max_delay: 50,
                    message,
                    shapes: shapes.clone(),
                };
                self.add("pack_packets", &format!("{name}_{vehicle}"), &input);
            }
        }
    }

    fn ciphers(&mut self) {
        let key = std::array::from_fn(|at| at as u8);
        for (name, key, bit, other) in [
            ("reference_b", key, 0, &[1; 16][..]),
            ("key_of_zeros", [0; 16], 639, &[0; 16]),
            ("key_of_ones", [0xFF; 16], 640, &[0xFF; 16]),
            ("last_bit_of_the_tag", key, 703, &[0xFF; 15]),
            ("no_key", key, 320, &[]),
        ] {
            let input = Gcm {
                key,
                nonce: [0, 0, 0x43, 0x53, 0, 0, 0, 5, 0, 0, 0, 1],
                message: [[0x5A; 16]; 5],
                bit,
                other,
            };
            self.add("diff_gcm", name, &input);
        }
    }

    fn key_files(&mut self) {
        let keys_mk = KEYS_MK.replace("[15,", "[115,").replace("[0,", "[100,");
        let one = TOML.rsplit_once("\n[[").map_or("", |(one, _)| one);
        let vehicle_key = "c6dd2b4f9f8d5a6c01f2d8c37b0e94ab";
        let station_key = "8e1f7b2ce4c2935808de17ab4f5c6e22";
        let shared = TOML.replace("8E1F7B2CE4C2935808DE17AB4F5C6E23", station_key);
        let epochs = one.replace("id-counter", "counter-epoch-id");
        for (name, text) in [
            ("keys_mk", keys_mk.clone()),
            ("keys_mk_published", KEYS_MK.to_owned()),
            ("keys_mk_id_out_of_range", keys_mk.replace("ID=7", "ID=16")),
            ("keys_mk_unknown_variable", keys_mk.replace("UAV_ID", "UAV")),
            ("keys_mk_key_too_short", keys_mk.replace("[115,", "[")),
            ("keys_mk_spaces", keys_mk.replace('=', " := ")),
            (
                "two_headers",
                one.replace("salt", "header = \"id-counter\"\nsalt"),
            ),
            (
                "epochs_id_too_large",
                epochs.replace("id = 1", "id = 65536"),
            ),
            ("unknown_header", one.replace("id-counter", "epoch")),
            ("key_of_zeros", one.replace(vehicle_key, &"0".repeat(32))),
            ("key_of_ones", one.replace(vehicle_key, &"f".repeat(32))),
            ("key_too_short", one.replace("c6dd2b4f", "")),
            (
                "published_key",
                one.replace(vehicle_key, "000102030405060708090a0b0c0d0e0f"),
            ),
            ("key_not_quoted", one.replace('"', "")),
            ("vehicle_key_shared", one.replace(vehicle_key, station_key)),
            ("id_twice", TOML.replace("id = 4000000000", "id = 1")),
            (
                "no_station",
                one.split("[[").next().unwrap_or_default().to_owned() + "station = []\n",
            ),
            ("toml", one.to_owned()),
            ("two_stations", TOML.to_owned()),
            ("shared_station_key", shared),
            ("epochs", epochs),
        ] {
            self.bytes("key_file", name, text.into_bytes());
        }
    }
}
