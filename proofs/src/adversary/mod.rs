//! D1 to D6 for signed links: an adversary who owns the link, what payloads contain, the power, the flash and old keys,
//! against three ends as the firmware builds them.
//!
//! Nothing foreign is signed, obeyed or handed on; nothing is used or accepted twice; every device starts again; and
//! honest frames get through within the stated time.

mod node;

use std::collections::{HashMap, HashSet};

use mavlink_signing::crc::checksum;
use mavlink_signing::dialect::crc_extra;
use mavlink_signing::field::{CHECKSUM_SIZE, SIGNATURE_SIZE};
use mavlink_signing::{
    Frame, FrameRef, Packet, RESERVATION, RolloverState, Stamp, TICKS_PER_SECOND, Window,
};
use mavseal_relay::{IDLE, LineEvent, Side};

use node::{Node, Told, at, key_bytes, packet, signed};

const SECOND: u64 = TICKS_PER_SECOND;
const HOUR: u64 = 3_600 * SECOND;
const DAY: u64 = 24 * HOUR;
/// 2026-11.
const START: u64 = 37_555_200_000_000;
/// The station, which offers keys, and two boards.
const NODES: usize = 3;
const GROUND: usize = 0;
/// Honest frames get through within this time, once power and line hold: what a restart skips at both ends, and what a
/// clock without the time is behind. And some seconds for what is lost.
const SOON: u64 = 2 * RESERVATION + 20 * SECOND;
/// What the attacker would like to be the key.
const EVIL: u64 = 666;

/// HEARTBEAT, COMMAND_LONG, SETUP_SIGNING and TUNNEL.
const HEARTBEAT: u32 = 0;
const COMMAND: u32 = 76;
const SETUP: u32 = 256;
const TUNNEL: u32 = 385;

/// What the attacker has put into a payload of the equipment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub enum Nested {
    /// A SETUP_SIGNING with a key of his own.
    Setup,
    /// A command in the name of the station.
    Command,
    /// A HEARTBEAT of the equipment itself.
    Beat,
}

/// What happens to bytes on the local line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub enum Edit {
    /// Nothing.
    None,
    /// So many bytes are lost here.
    Lose(u8, u8),
    /// A byte comes in between.
    Insert(u8, u8),
    /// A byte is changed.
    Change(u8, u8),
    /// The sender pauses, for so many milliseconds.
    Pause(u8, u16),
}

/// What may happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub enum Step {
    /// A node's equipment sends HEARTBEATs; who of the others does not hear them, bit by bit.
    Beat(u8, u8),
    /// It sends a packet whose payload the attacker has chosen, on a line that may have a fault, which may be reported.
    Tunnel(u8, Nested, Edit, bool),
    /// Milliseconds pass.
    Wait(u16),
    /// Hours pass.
    Sleep(u8),
    /// The attacker does not take what leaves a node on the link, for so many milliseconds.
    Hold(u8, u16),
    /// The attacker plays a recording to a node, so many frames back.
    Replay(u8, u16),
    /// He sends a node bytes of his own: the front of a packet that announces much, or noise.
    Noise(u8, [u8; 4]),
    /// He has a key that was in use before, and signs with it as anybody, so many days ahead.
    OldKey(u8, u8, u16),
    /// The power of a node fails inside the write after so many.
    CutAfter(u8, u8),
    /// It fails now.
    Off(u8),
    /// It is back, everywhere.
    On,
    /// A GNSS receiver tells a node another time, again and again.
    Spoof(u8, u64),
    /// A word of a node's flash can no longer be read.
    Spoil(u8, u16),
    /// The station offers a new key.
    Offer,
    /// Somebody brings it to a board.
    SetUp(u8),
    /// A node drops the old key, if it may.
    Retire(u8),
}

/// What a history was made of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Frames that were signed, and handed on.
    pub signed: u32,
    /// Frames that were handed on.
    pub handed_on: u32,
    /// Key changes that came to their end at one node.
    pub retired: u32,
    /// Ticks until everybody heard everybody.
    pub took: u64,
}

struct World {
    now: u64,
    nodes: [Node; NODES],
    /// The number of the newest key.
    latest: u64,
    /// Packets that the equipment of each node has sent.
    sent: [HashSet<Vec<u8>>; NODES],
    /// Frames that the attacker made with an old key, and which.
    forged: HashMap<Vec<u8>, u64>,
    /// What lay in payloads: whole packets.
    nested: HashSet<Vec<u8>>,
    /// Every packet that was ever signed, and every frame that was on the link.
    signed: HashSet<Vec<u8>>,
    recorded: Vec<Vec<u8>>,
    /// Whose local line had a fault since a packet was signed.
    damaged: [bool; NODES],
    /// Makes every packet one of its own.
    serial: u32,
    /// The attacker has signed with an old key.
    led_away: bool,
    /// Who has not been heard yet, and by whom, since the power holds.
    deaf: HashSet<(usize, usize)>,
    report: Report,
}

/// D1 to D6: plays `steps`, then lets the power hold, and sees that everybody is heard in time.
///
/// `synced` says who has a trusted clock, bit by bit. `chance` decides what cuts leave in flash.
///
/// # Panics
///
/// If a property does not hold.
#[must_use]
pub fn play(steps: &[Step], synced: u8, chance: u64) -> Report {
    let mut world = World::new(synced, chance);
    world.start_all();
    for step in steps {
        world.step(*step);
    }
    world.heal();
    world.report
}

impl World {
    fn new(synced: u8, chance: u64) -> Self {
        let node = |id: usize| {
            let mixed = chance.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ id as u64;
            let told = match (synced >> id & 1, mixed >> 60) {
                (1, _) => Told::Right,
                (_, 0 | 1) => Told::Dead,
                _ => Told::Nothing,
            };
            Node::new(id as u8 + 1, told, mixed)
        };
        Self {
            now: START,
            nodes: [node(0), node(1), node(2)],
            latest: 0,
            sent: Default::default(),
            forged: HashMap::new(),
            nested: HashSet::new(),
            signed: HashSet::new(),
            recorded: Vec::new(),
            damaged: [false; NODES],
            serial: 0,
            led_away: false,
            deaf: HashSet::new(),
            report: Report::default(),
        }
    }

    fn start_all(&mut self) {
        for node in &mut self.nodes {
            node.start(self.now);
        }
    }

    fn step(&mut self, step: Step) {
        let of = |node: u8| usize::from(node) % NODES;
        match step {
            Step::Beat(node, lost) => self.beat(of(node), lost),
            Step::Tunnel(node, nested, edit, reported) => {
                self.tunnel(of(node), nested, edit, reported);
            }
            Step::Wait(millis) => self.wait(u64::from(millis) * SECOND / 1000),
            Step::Sleep(hours) => self.wait(u64::from(hours) * HOUR),
            Step::Hold(node, millis) => {
                let until = self.now + u64::from(millis) * SECOND / 1000;
                self.nodes[of(node)].hold(until);
            }
            Step::Replay(node, back) => {
                let count = self.recorded.len();
                if let Some(at) = count.checked_sub(1 + usize::from(back) % count.max(1)) {
                    let frame = self.recorded[at].clone();
                    self.arrives(of(node), &frame);
                }
            }
            Step::Noise(node, bytes) => {
                let [a, b, c, d] = bytes;
                let announced =
                    [[0xFD, a | 0x80, 0, b], [0xFE, a, b, c], bytes][usize::from(d) % 3];
                self.arrives(of(node), &announced);
            }
            Step::OldKey(node, system, days) => self.old_key(of(node), of(system), days),
            Step::CutAfter(node, steps) => self.nodes[of(node)].cut(Some(steps.into())),
            Step::Off(node) => self.nodes[of(node)].cut(None),
            Step::On => self.start_all(),
            Step::Spoof(node, time) => self.nodes[of(node)].spoof(self.now, time),
            Step::Spoil(node, word) => self.nodes[of(node)].spoil(word),
            Step::Offer => self.offer(),
            Step::SetUp(node) => self.set_up(of(node)),
            Step::Retire(node) => self.retire(of(node)),
        }
    }

    fn wait(&mut self, ticks: u64) {
        self.now += ticks;
        for node in 0..NODES {
            let (link, local) = self.nodes[node].poll(self.now);
            self.left(node, &link, &local);
        }
    }

    /// A packet of the equipment of `node` that is like no other.
    fn own_packet(&mut self, node: usize, message: u32, rest: &[u8]) -> Vec<u8> {
        self.serial += 1;
        let payload = [&self.serial.to_le_bytes(), rest, &[1]].concat();
        let frame = packet(node as u8 + 1, message, &payload);
        let bytes = frame.as_bytes().to_vec();
        self.sent[node].insert(bytes.clone());
        bytes
    }

    fn beat(&mut self, node: usize, lost: u8) {
        let bytes = self.own_packet(node, HEARTBEAT, &[]);
        self.local(node, &[(0, &bytes)], None, lost);
    }

    fn tunnel(&mut self, node: usize, nested: Nested, edit: Edit, reported: bool) {
        let inner = match nested {
            Nested::Setup => {
                let mut payload = vec![0; 8];
                payload.extend([node as u8 + 1, node::COMPONENT]);
                payload.extend(key_bytes(EVIL));
                packet(255, SETUP, &payload)
            }
            Nested::Command => packet(GROUND as u8 + 1, COMMAND, &[9; 33]),
            Nested::Beat => packet(node as u8 + 1, HEARTBEAT, &[0xEE; 9]),
        };
        self.nested.insert(inner.as_bytes().to_vec());
        let beat = self.own_packet(node, HEARTBEAT, &[]);
        let padding = vec![7; usize::from(self.serial as u8) % 90];
        let tunnel = self.own_packet(node, TUNNEL, &[&padding, inner.as_bytes()].concat());
        let mut line = [beat, tunnel].concat();
        let place = |at: u8| usize::from(at) % line.len();
        let mut pause = None;
        let mut cut = line.len();
        match edit {
            Edit::None => {}
            Edit::Lose(at, count) => {
                let from = place(at);
                let to = line.len().min(from + 1 + usize::from(count));
                line.drain(from..to);
                cut = from;
            }
            Edit::Insert(at, byte) => {
                cut = place(at);
                line.insert(cut, byte);
            }
            Edit::Change(at, byte) => {
                cut = place(at);
                line[cut] ^= byte;
            }
            Edit::Pause(at, millis) => {
                cut = place(at);
                let ticks = u64::from(millis) * SECOND / 1000;
                // Behind a fault, no sender pauses for so long as ends deafness: that is what the idle time means.
                let most = if self.damaged[node] { IDLE } else { u64::MAX };
                pause = Some(ticks.min(most));
            }
        }
        // A loss from the end of one packet to the beginning of another in a payload leaves no trace but the report.
        let whole = split_front(&line);
        let traceless = whole.iter().any(|it| self.nested.contains(it));
        // One damaged packet in 2^16 has a right checksum again: nobody can tell it from what was sent.
        self.sent[node].extend(whole);
        let (before, after) = line.split_at(cut);
        let faulty = !matches!(edit, Edit::None | Edit::Pause(..)) && (reported || traceless);
        let fault = faulty.then_some(LineEvent::Overrun);
        self.local(node, &[(0, before)], fault, 0);
        self.local(node, &[(pause.unwrap_or(0), after)], None, 0);
        self.damaged[node] |= !matches!(edit, Edit::None | Edit::Pause(..));
        if let Some(pause) = pause {
            self.now += pause;
        }
    }

    /// Bytes on the local line of a node; what goes out on the link comes to the others, but for those in `lost`.
    fn local(&mut self, node: usize, pieces: &[(u64, &[u8])], fault: Option<LineEvent>, lost: u8) {
        let (link, local) = self.nodes[node].feed(self.now, Side::Local, pieces, fault);
        for frame in self.left(node, &link, &local) {
            for to in (0..NODES).filter(|to| *to != node && lost >> to & 1 == 0) {
                self.arrives(to, &frame);
            }
        }
    }

    /// Bytes on the link come to a node.
    fn arrives(&mut self, to: usize, bytes: &[u8]) {
        let before = self.nodes[to].remembered(self.now);
        let (link, local) = self.nodes[to].feed(self.now, Side::Link, &[(0, bytes)], None);
        let after = self.nodes[to].remembered(self.now);
        let rejected = local.is_empty() && link.is_empty() && after.is_some();
        assert!(
            !rejected || before == after,
            "a rejected frame changed something"
        );
        self.left(to, &link, &local);
        self.nodes[to].confirm();
    }

    /// Looks at what left a node: on the link, signed frames, which are given; on the local side, packets.
    fn left(&mut self, node: usize, link: &[u8], local: &[u8]) -> Vec<Vec<u8>> {
        assert_eq!(self.nodes[node].take_setup(), None, "a key from a payload");
        let mut frames = Vec::new();
        for frame in split(link) {
            let parsed = FrameRef::parse(&frame).expect("whole");
            let stamp = parsed.signature().expect("signed").stamp;
            let plain = unsigned(&frame);
            assert!(!self.nested.contains(&plain), "a payload was signed");
            assert_eq!(stamp.link_id, node as u8 + 1);
            let by = |number: &u64| {
                let plain = FrameRef::parse(&plain).expect("whole");
                let again = signed(Frame::try_from(plain).expect("whole"), *number, stamp);
                again.as_bytes() == frame
            };
            let number = (0..=self.latest).rev().find(by);
            let number = number.expect("signed with a key that was given");
            let stamps = &mut self.nodes[node].stamps;
            let stamped = (number, stamp.timestamp.ticks());
            assert!(stamps.insert(stamped), "the stamp {stamped:?} twice");
            assert!(
                self.sent[node].remove(&plain),
                "signed, and never sent, or twice"
            );
            self.report.signed += 1;
            self.damaged[node] = false;
            self.signed.insert(plain);
            self.recorded.push(frame.clone());
            frames.push(frame);
        }
        for packet in split(local) {
            assert!(!self.nested.contains(&packet), "a payload was handed on");
            let handed_on = &mut self.nodes[node].handed_on;
            assert!(handed_on.insert(packet.clone()), "handed on twice");
            let forged = self.forged.get(&packet);
            if let Some(number) = forged {
                let number = *number;
                assert!(self.nodes[node].has_key(number) || !self.nodes[node].runs());
                continue;
            }
            assert!(
                self.signed.contains(&packet),
                "handed on, and never signed by anybody"
            );
            assert_ne!(packet[5], node as u8 + 1, "its own");
            self.report.handed_on += 1;
            self.deaf.remove(&(usize::from(packet[5]) - 1, node));
        }
        frames
    }

    /// The attacker signs with a key that the node may still have, and that is to be replaced or was.
    fn old_key(&mut self, to: usize, system: usize, days: u16) {
        let Some(number) = self.latest.checked_sub(1) else {
            return;
        };
        self.led_away = true;
        self.serial += 1;
        let frame = packet(
            system as u8 + 1,
            COMMAND,
            &[&self.serial.to_le_bytes()[..], &[8; 29]].concat(),
        );
        let plain = frame.as_bytes().to_vec();
        let ticks = self.now + u64::from(days) * DAY / 64;
        let stamp = Stamp {
            link_id: system as u8 + 1,
            timestamp: at(ticks),
        };
        self.forged.insert(plain, number);
        let frame = signed(frame, number, stamp);
        self.arrives(to, frame.as_bytes());
    }

    fn offer(&mut self) {
        let settled = |node: &Node| node.state() == Some(RolloverState::Settled);
        let numbers = self.nodes.each_ref().map(|node| node.number(self.latest));
        let same = numbers
            .iter()
            .all(|it| it.is_some() && *it == numbers[GROUND]);
        if self.nodes.iter().all(settled) && same {
            let offered = self.nodes[GROUND].offer(self.now, self.latest + 1);
            assert!(
                offered || !self.nodes[GROUND].runs(),
                "a new key was refused"
            );
            // Where the power failed, it may be stored all the same.
            self.latest += 1;
        }
    }

    /// Somebody brings the newest key to a board, and to the station, whose offer may be lost.
    fn set_up(&mut self, node: usize) {
        let offers = self.nodes[GROUND].has_key(self.latest);
        if node == GROUND || !offers || self.latest == 0 || !self.nodes[node].runs() {
            return;
        }
        for presence in [false, true] {
            let key = [self.latest, self.now];
            let (taken, (link, local)) = self.nodes[node].set_up(self.now, key, presence);
            self.now += node::QUIET;
            self.left(node, &link, &local);
            assert!(presence || !taken, "a key without presence");
            if taken {
                self.nodes[node].apply(self.now, self.latest, self.now);
            }
        }
    }

    /// A node drops the old key when every other has the new one alone, or with it.
    fn retire(&mut self, node: usize) {
        let all = self.nodes.iter().all(|it| it.has_key(self.latest));
        let signs = self
            .nodes
            .iter()
            .all(|it| it.number(self.latest) == Some(self.latest));
        if all && signs && self.nodes[node].state() == Some(RolloverState::Confirmed) {
            self.nodes[node].retire();
            self.report.retired += 1;
        }
    }

    /// From now on the power holds, and everybody sends a frame a second, of which a third is lost; the attacker goes on.
    /// Where he had a key of old, it is changed first.
    fn heal(&mut self) {
        for node in &mut self.nodes {
            node.mend();
        }
        self.start_all();
        self.settle();
        if self.led_away {
            self.offer();
            self.settle();
        }
        // A packet that was signed before its sender's clock was set back, and held up, leaves first.
        for round in 0..3 {
            self.exchange(round);
        }
        let from = self.now;
        let by = from + self.stated();
        for sender in 0..NODES {
            let others = (0..NODES).filter(|to| *to != sender);
            self.deaf.extend(others.map(|to| (sender, to)));
        }
        for round in 0.. {
            if self.deaf.is_empty() {
                break;
            }
            assert!(self.now <= by, "deaf: {:?}\n{}", self.deaf, self.describe());
            self.exchange(round);
        }
        self.report.took = self.now - from;
    }

    /// In which time everybody is heard: a node that has accepted what is stamped ahead of the time waits until that has
    /// passed; what it stamps meanwhile, another that knows the time hears when it is no further ahead than the window.
    fn stated(&mut self) -> u64 {
        let (now, latest) = (self.now, self.latest);
        let ahead = self
            .nodes
            .iter_mut()
            .map(|node| node.ahead(now, latest))
            .max();
        let ahead = ahead.unwrap_or(0);
        SOON + ahead + ahead.saturating_sub(Window::ONE_MINUTE.ahead)
    }

    /// A second in which everybody sends, a third is lost, and the attacker plays recordings, noise and old keys.
    fn exchange(&mut self, round: u32) {
        self.wait(SECOND);
        for sender in 0..NODES {
            self.beat(sender, 1 << ((round as usize + sender) % NODES));
            let round = round as u16;
            self.step(Step::Replay(sender as u8, round.wrapping_mul(7)));
            self.step(Step::Noise(sender as u8, [round as u8, 0, 0, 0]));
            if self.led_away && round < 8 {
                self.step(Step::OldKey(sender as u8, sender as u8 + 1, 300 * 64));
            }
        }
    }

    /// A change of the key that has begun comes to its end.
    fn settle(&mut self) {
        let by = self.now + 2 * SOON + self.stated();
        for round in 0.. {
            let done = self.nodes.iter().all(|node| {
                let key = node.number(self.latest);
                let settled = node.state() == Some(RolloverState::Settled);
                settled && key == self.nodes[GROUND].number(self.latest)
            });
            if done {
                return;
            }
            assert!(
                self.now < by,
                "the change of key hangs\n{}",
                self.describe()
            );
            for node in 0..NODES {
                self.set_up(node);
            }
            self.exchange(round);
            for node in 0..NODES {
                self.retire(node);
            }
        }
    }

    fn describe(&self) -> String {
        let nodes = self.nodes.iter().map(Node::describe);
        nodes.collect::<Vec<_>>().join("\n")
    }
}

/// The packets in `bytes`, which hold whole ones.
fn split(mut bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut packets = Vec::new();
    while !bytes.is_empty() {
        let packet = FrameRef::parse(bytes).expect("whole packets").as_bytes();
        packets.push(packet.to_vec());
        bytes = &bytes[packet.len()..];
    }
    packets
}

/// The whole packets at the front of `bytes`.
fn split_front(mut bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut packets = Vec::new();
    while let Ok(packet) = Packet::parse(bytes, crc_extra) {
        packets.push(packet.as_bytes().to_vec());
        bytes = &bytes[packet.as_bytes().len()..];
    }
    packets
}

/// The packet that was signed: without signature and flag, with a checksum of its own.
fn unsigned(frame: &[u8]) -> Vec<u8> {
    let id = FrameRef::parse(frame).expect("whole").header().message_id;
    let mut packet = frame[..frame.len() - SIGNATURE_SIZE - CHECKSUM_SIZE].to_vec();
    packet[2] = 0;
    let sum = checksum(&packet[1..], crc_extra(id).expect("in the dialect"));
    packet.extend(sum.to_le_bytes());
    packet
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn node() -> impl Strategy<Value = u8> {
        0..NODES as u8
    }

    fn edit() -> impl Strategy<Value = Edit> {
        let magic = || prop_oneof![Just(0xFD), Just(0xFE), any::<u8>()];
        prop_oneof![
            2 => Just(Edit::None),
            2 => (any::<u8>(), 0..40_u8).prop_map(|(at, count)| Edit::Lose(at, count)),
            1 => (any::<u8>(), magic()).prop_map(|(at, byte)| Edit::Insert(at, byte)),
            1 => (any::<u8>(), 1..=255_u8).prop_map(|(at, byte)| Edit::Change(at, byte)),
            2 => (any::<u8>(), any::<u16>()).prop_map(|(at, millis)| Edit::Pause(at, millis)),
        ]
    }

    fn step() -> impl Strategy<Value = Step> {
        let nested = prop_oneof![
            Just(Nested::Setup),
            Just(Nested::Command),
            Just(Nested::Beat)
        ];
        let tunnel = (node(), nested, edit(), any::<bool>());
        prop_oneof![
            8 => (node(), 0..8_u8).prop_map(|(node, lost)| Step::Beat(node, lost)),
            5 => tunnel.prop_map(|(node, nested, edit, told)| Step::Tunnel(node, nested, edit, told)),
            4 => (0..3000_u16).prop_map(Step::Wait),
            1 => any::<u8>().prop_map(Step::Sleep),
            2 => (node(), 0..2000_u16).prop_map(|(node, millis)| Step::Hold(node, millis)),
            4 => (node(), any::<u16>()).prop_map(|(node, back)| Step::Replay(node, back)),
            2 => (node(), any::<[u8; 4]>()).prop_map(|(node, bytes)| Step::Noise(node, bytes)),
            2 => (node(), node(), any::<u16>()).prop_map(|(to, of, days)| Step::OldKey(to, of, days)),
            3 => (node(), 0..20_u8).prop_map(|(node, steps)| Step::CutAfter(node, steps)),
            1 => node().prop_map(Step::Off),
            3 => Just(Step::On),
            1 => (node(), any::<u64>()).prop_map(|(node, time)| Step::Spoof(node, time)),
            1 => (node(), any::<u16>()).prop_map(|(node, word)| Step::Spoil(node, word)),
            3 => Just(Step::Offer),
            4 => node().prop_map(Step::SetUp),
            4 => node().prop_map(Step::Retire),
        ]
    }

    fn histories(count: u32) {
        let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig::with_cases(count));
        let steps = proptest::collection::vec(step(), 0..60);
        let input = (steps, 0..8_u8, any::<u64>());
        let ran = runner.run(&input, |(steps, synced, chance)| {
            let _ = play(&steps, synced, chance);
            Ok(())
        });
        if let Err(error) = ran {
            panic!("{error}");
        }
    }

    #[test]
    fn d_histories() {
        histories(1_000);
    }

    #[test]
    #[ignore = "some minutes, optimised; `cargo xtask test --all` runs it"]
    fn d_100_000_histories() {
        histories(100_000);
    }

    /// A packet held up at one that drifted for a week leads the others away after the clocks were set back.
    #[test]
    fn d_drifted_for_a_week() {
        let steps = [
            Step::Beat(2, 0),
            Step::Beat(0, 0),
            Step::Beat(2, 2),
            Step::Sleep(195),
            Step::Beat(2, 2),
            Step::Beat(2, 2),
            Step::Hold(1, 1),
            Step::Beat(1, 0),
            Step::Replay(1, 260),
        ];
        let _ = play(&steps, 4, 7_422_475_801_365_370_742);
    }

    /// Every kind of fault on the local line at every byte, alone, with each payload: nothing of it is obeyed or signed,
    /// and the line comes back.
    #[test]
    fn d_each_fault() {
        for at in 0..=255 {
            for (edit, told) in [
                (Edit::Lose(at, 0), false),
                (Edit::Lose(at, 0), true),
                (Edit::Lose(at, at % 40), true),
                (Edit::Insert(at, 0xFE), false),
                (Edit::Change(at, 0x80), false),
                (Edit::Pause(at, 60_000), false),
            ] {
                let nested = [Nested::Setup, Nested::Command, Nested::Beat][usize::from(at) % 3];
                let steps = [
                    Step::Beat(1, 0),
                    Step::Wait(200),
                    Step::Tunnel(1, nested, edit, told),
                    Step::Tunnel(1, nested, Edit::None, false),
                ];
                let report = play(&steps, 7, 0);
                assert!(report.signed >= 4 && report.handed_on >= 4);
            }
        }
    }

    /// What is lost from the end of a packet on, up to what lies in the next one's payload, leaves no trace but the report.
    #[test]
    fn d_traceless_loss() {
        let mut traceless = 0;
        for count in 0..40 {
            let mut world = World::new(7, 0);
            world.start_all();
            world.step(Step::Beat(1, 0));
            let before = world.report.signed;
            world.step(Step::Tunnel(1, Nested::Beat, Edit::Lose(17, count), false));
            // The HEARTBEAT in front of it alone.
            traceless += u32::from(world.report.signed == before + 1);
            world.heal();
        }
        assert_eq!(traceless, 40);
    }

    /// The power fails inside any write of the first start, and again: a device starts all the same.
    #[test]
    fn d_cut_at_the_first_start() {
        for chance in 0..4 {
            for cut in 0..40 {
                let mut node = Node::new(1, Told::Right, chance);
                for again in 0..3 {
                    node.cut(Some(cut >> again));
                    node.try_start(START);
                    node.mend();
                }
                node.start(START);
                assert!(node.runs());
            }
        }
    }

    /// What a front of a packet announces holds up what comes behind it for less than a second.
    #[test]
    fn d_held_up() {
        let mut world = World::new(7, 0);
        world.start_all();
        for _ in 0..3 {
            let before = world.report.handed_on;
            world.step(Step::Noise(0, [0xFF, 0, 0, 0]));
            world.step(Step::Beat(1, 0));
            world.wait(SECOND);
            assert_eq!(world.report.handed_on, before + 2);
        }
    }

    /// A change of key goes through, whoever knows the time, and although a former friend led everybody away.
    #[test]
    fn d_change() {
        for synced in 0..8 {
            let steps = [
                Step::OldKey(1, 0, 64 * 200),
                Step::Offer,
                Step::OldKey(0, 1, 64 * 300),
                Step::OldKey(1, 0, 64 * 300),
                Step::SetUp(1),
                Step::OldKey(2, 0, 64 * 364),
                Step::OldKey(1, 2, 64 * 364),
                Step::Sleep(9),
            ];
            let report = play(&steps, synced, 1);
            assert!(report.retired >= 6, "both changes, at every end");
        }
    }
}
