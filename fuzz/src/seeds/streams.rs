//! Seeds of the targets about streams and histories.

use mavseal_proofs::history::Step;
use mavseal_proofs::pipes::Turn;

use super::{
    BEAT, HEARTBEAT, MAVLINK1, SETUP_SIGNING, Seeds, TEN_SECONDS, TIMESYNC, changed, signed,
    unsigned,
};
use crate::input::Moment;
use crate::ports::{Behaviour, Faulty, Poll};
use crate::streams::{History, Piped, Stream};

impl Seeds {
    pub(super) fn streams(&mut self, telemetry: &[Vec<u8>]) {
        let inner = unsigned(HEARTBEAT, &BEAT);
        let outer = unsigned(TIMESYNC, &[&[0xFD, 0xFE][..], &inner].concat());
        let recorded: Vec<_> = telemetry.iter().take(12).flatten().copied().collect();
        let everything = [
            &b"noise\xFD\xFEnoise"[..],
            &inner,
            &MAVLINK1,
            &[0xFD, 0xFF],
            &signed(HEARTBEAT, &[0xFE; 60], 0, 0),
            &changed(inner.clone(), 9),
        ];
        for (name, bytes, spared, cuts) in [
            ("telemetry", recorded, 0, [64, 1, 7]),
            ("some_of_everything", everything.concat(), 0, [1, 280, 3]),
            ("packet_in_packet", outer.clone(), 0, [9, 9, 9]),
            ("packet_in_damaged_packet", changed(outer, 4), 1, [9, 9, 9]),
            (
                "announces_255_bytes",
                [&[0xFD, 255][..], &inner].concat(),
                0,
                [2, 30, 30],
            ),
            (
                "announces_255_bytes_mavlink1",
                [&[0xFE, 255][..], &inner].concat(),
                0,
                [2, 30, 30],
            ),
            ("unknown_flags", changed(inner.clone(), 2), 0, [3, 3, 3]),
            (
                "unknown_message_then_heartbeat",
                [changed(inner.clone(), 9), inner].concat(),
                0,
                [5, 5, 5],
            ),
        ] {
            for (next_byte, silence) in [(true, 0), (false, 11)] {
                let bytes = &bytes[..];
                let input = Stream {
                    next_byte,
                    spared,
                    silence,
                    cuts,
                    bytes,
                };
                let resync = if next_byte {
                    "next_byte"
                } else {
                    "announced_end"
                };
                self.add("decoder_chunks", &format!("{name}_{resync}"), &input);
            }
        }
    }

    pub(super) fn histories(&mut self) {
        let sign = Step::Sign { payload_length: 9 };
        let deliver = |back| Step::Deliver { back };
        let sender = |ticks| Step::SenderClock { ticks };
        let receiver = |ticks| Step::ReceiverClock { ticks };
        let start = Moment::after_now(0);
        let end = Moment::before_the_end(0);
        for (name, start, steps) in [
            ("delivered", start, vec![sign, deliver(0), sign, deliver(0)]),
            ("delivered_twice", start, vec![sign, deliver(0), deliver(0)]),
            ("reordered", start, vec![sign, sign, deliver(0), deliver(1)]),
            ("lost", start, vec![sign, sign, sign, deliver(0)]),
            (
                "damaged",
                start,
                vec![sign, Step::Damage { back: 0, bit: 100 }, deliver(0)],
            ),
            (
                "delayed_in_the_window",
                start,
                vec![sign, receiver(TEN_SECONDS), deliver(0)],
            ),
            (
                "delayed_too_long",
                start,
                vec![sign, receiver(TEN_SECONDS + 1), deliver(0)],
            ),
            (
                "sender_ahead",
                start,
                vec![sender(TEN_SECONDS), sign, deliver(0)],
            ),
            (
                "sender_too_far_ahead",
                start,
                vec![sender(TEN_SECONDS + 1), sign, deliver(0)],
            ),
            (
                "sender_goes_back",
                start,
                vec![sign, deliver(0), sender(-5), sign, deliver(0)],
            ),
            (
                "end_of_time",
                end,
                vec![sender(i64::MAX), sign, deliver(0), sign, deliver(0)],
            ),
            (
                "from_the_beginning",
                Moment::default(),
                vec![sender(i64::MIN), sign, deliver(0)],
            ),
        ] {
            self.add("replay_model", name, &History { start, steps });
        }
    }

    pub(super) fn pipes(&mut self, telemetry: &[Vec<u8>]) {
        let slowly = vec![
            Turn {
                arrive: [40, 40],
                room: [7, 9]
            };
            6
        ];
        let heartbeat = || unsigned(HEARTBEAT, &BEAT);
        let verified = |ago| {
            // The lowest bytes of the timestamp say how long ago, from 16 ticks ahead on.
            let mut frame = signed(HEARTBEAT, &BEAT, 2, 0);
            frame[22..28].copy_from_slice(&u64::to_le_bytes(ago)[..6]);
            frame
        };
        let recorded: Vec<_> = telemetry.iter().take(8).flatten().copied().collect();
        let now = Moment::after_now(0);
        let end = Moment::before_the_end(0);
        for (name, now, local, link) in [
            ("telemetry", now, recorded, vec![]),
            ("both_ways", now, heartbeat(), verified(20)),
            (
                "verified_in_order",
                now,
                vec![],
                [verified(30), verified(20)].concat(),
            ),
            (
                "replayed",
                now,
                vec![],
                [verified(20), verified(20)].concat(),
            ),
            ("too_old", now, vec![], verified(1_000_017)),
            ("from_the_future", now, vec![], verified(15)),
            ("reflected", now, vec![], signed(HEARTBEAT, &BEAT, 1, 0)),
            ("unsigned_from_the_secure_side", now, vec![], heartbeat()),
            ("signed_from_the_plain_side", now, verified(20), vec![]),
            ("mavlink1", now, MAVLINK1.to_vec(), MAVLINK1.to_vec()),
            (
                "setup_signing",
                now,
                unsigned(SETUP_SIGNING, &[7; 42]),
                signed(SETUP_SIGNING, &[7; 42], 2, 0),
            ),
            (
                "timestamps_used_up",
                end,
                [heartbeat(), heartbeat()].concat(),
                vec![],
            ),
            (
                "unknown_flags",
                now,
                changed(heartbeat(), 2),
                changed(heartbeat(), 2),
            ),
            (
                "unknown_message",
                now,
                changed(heartbeat(), 9),
                changed(heartbeat(), 9),
            ),
        ] {
            for (way, whole, turns) in
                [("whole", true, vec![]), ("stripped", false, slowly.clone())]
            {
                let bytes = [&local[..], &link].concat();
                let (local, bytes) = (local.len() as u16, &bytes[..]);
                let input = Piped {
                    whole,
                    now,
                    spared: 0,
                    turns,
                    local,
                    bytes,
                };
                self.add("relay", &format!("{name}_{way}"), &input);
            }
        }
        for (name, at) in [("payload", 12), ("tag", 33)] {
            let bytes = &changed(signed(HEARTBEAT, &BEAT, 2, 0), at)[..];
            let input = Piped {
                now,
                spared: 1,
                bytes,
                ..Piped::default()
            };
            self.add("relay", &format!("{name}_changed"), &input);
        }
    }

    pub(super) fn ports(&mut self) {
        let local = unsigned(HEARTBEAT, &BEAT);
        let bytes = [&local[..], &signed(HEARTBEAT, &BEAT, 2, 0)].concat();
        let input = |polls| Faulty {
            link_ids: [1, 2],
            start: Moment::after_now(0),
            polls,
            local: local.len() as u16,
            bytes: &bytes,
        };
        let port = |fault| Behaviour {
            arrive: 60,
            room: 10,
            fault,
        };
        let poll = |local, link| Poll {
            ticks: 0,
            ports: [port(local), port(link)],
        };
        for (fault, name) in (1..).zip([
            "reading_not_ready",
            "reading_fails",
            "reading_ends",
            "writing_not_ready",
            "writing_fails",
            "writing_takes_nothing",
        ]) {
            let polls = vec![
                poll(0, 0),
                poll(0, 0),
                poll(fault, 0),
                poll(0, fault),
                poll(fault, fault),
            ];
            self.add("relay_ports", name, &input(polls));
        }
        let mut silent = vec![poll(0, 0); 8];
        silent[0].ports.iter_mut().for_each(|port| port.arrive = 5);
        silent[1].ports.iter_mut().for_each(|port| port.arrive = 0);
        silent[2] = Poll {
            ticks: u16::MAX,
            ports: [Behaviour::default(); 2],
        };
        silent[3] = silent[2];
        self.add("relay_ports", "silent_within_a_packet", &input(silent));
        let same = Faulty {
            link_ids: [2, 2],
            ..input(vec![])
        };
        self.add("relay_ports", "same_link_id_both_ways", &same);
    }
}
