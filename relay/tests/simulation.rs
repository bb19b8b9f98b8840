//! Histories of a link: failing power, wrong clocks, loss, silence, and an attacker who has recorded
//! everything. Each is made from one number, which a failure names.

use std::{
    cell::{Cell, RefCell},
    collections::HashSet,
    fmt::Write as _,
    rc::Rc,
};

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use mavlink_signing::{
    Authenticate, Frame, FrameRef, Header, KEY_SIZE, Links, MessageId, Profile, RESERVATION,
    SigningKey, Source, Stamper, Streams, Sync, TICKS_PER_SECOND, Tag, Timekeeper, Timestamp,
    VerifyError, Window, ZeroizeOnDrop, sign_frame,
};
use mavseal_relay::Kept;
use mavseal_store::{
    Region,
    model::{Failure, Flash, PAGE_SIZE},
};

/// The link is back after this, in ticks: the reservation that was skipped, the one that a board without a
/// clock is behind, and some seconds for frames that are lost; and as much longer as the fastest clock is
/// ahead, or the stamps of a burst or of the restarts before.
const STATED: u64 = 2 * RESERVATION + 15 * SECOND;
/// How far trusted clocks are apart at most, when they are asked, in ticks.
const CLOCKS_APART: u64 = 2 * SECOND;
const SECOND: u64 = TICKS_PER_SECOND;
const HOUR: u64 = 3600 * SECOND;
const WEEK: u64 = 7 * 24 * HOUR;
const START: u64 = 37_555_200_000_000;
const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};
/// A ground station and two boards.
const NODES: usize = 3;
const GROUND: usize = 0;

/// A profile that is fast and not secure: there is no forger here, and millions of frames.
struct Fast(u64);

impl ZeroizeOnDrop for Fast {}

impl Profile for Fast {
    fn new(key: &[u8; KEY_SIZE]) -> Self {
        Self(u64::from_le_bytes([key[0]; 8]))
    }

    fn tag(&self, covered: &[u8]) -> Tag {
        let mixed = covered.iter().fold(self.0, |mixed, byte| {
            (mixed ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3)
        });
        let [a, b, c, d, e, f, ..] = mixed.to_le_bytes();
        [a, b, c, d, e, f]
    }
}

/// Numbers from one number (splitmix64).
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// From 0 to `end - 1`.
    fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    fn one_in(&mut self, count: u64) -> bool {
        self.below(count) == 0
    }
}

/// A flash that outlives the program that runs on it.
#[derive(Clone)]
struct Memory(Rc<RefCell<Flash<2>>>);

impl ErrorType for Memory {
    type Error = Failure;
}

impl ReadNorFlash for Memory {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failure> {
        self.0.borrow_mut().read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.borrow().capacity()
    }
}

impl NorFlash for Memory {
    const WRITE_SIZE: usize = <Flash<2> as NorFlash>::WRITE_SIZE;
    const ERASE_SIZE: usize = PAGE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        self.0.borrow_mut().erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        self.0.borrow_mut().write(offset, bytes)
    }
}

/// What tells a node the time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Told {
    /// Nothing: a board without clock.
    Nothing,
    /// A real-time clock, so many ticks off, asked at the start and every hour.
    Hourly(i64),
    /// An operating system, asked all the time.
    Always,
}

struct Node {
    link_id: u8,
    told: Told,
    /// Its timer goes wrong by so many parts in a million.
    drift: i64,
    memory: Memory,
    started: u64,
    /// When it was last told the time.
    asked: u64,
    timer: Rc<Cell<u64>>,
    running: Option<Running>,
    /// Its last stamp, restarts included.
    last: Option<u64>,
    /// Every frame that it has accepted, by link and stamp.
    accepted: HashSet<(u8, u64)>,
}

struct Running {
    kept: Kept<Memory, Box<dyn FnMut() -> u64>>,
    stamper: Stamper,
    receiver: Streams<4>,
}

impl Node {
    fn new(link_id: u8, told: Told, drift: i64, chance: u64) -> Self {
        Self {
            link_id,
            told,
            drift,
            memory: Memory(Rc::new(RefCell::new(Flash::new(chance)))),
            started: START,
            asked: START,
            timer: Rc::new(Cell::new(0)),
            running: None,
            last: None,
            accepted: HashSet::new(),
        }
    }

    /// Power on, unless it is.
    fn start(&mut self, now: u64) {
        if self.running.is_some() {
            return;
        }
        self.memory.0.borrow_mut().restart();
        self.started = now;
        self.timer = Rc::new(Cell::new(0));
        let timer = Rc::clone(&self.timer);
        let timer: Box<dyn FnMut() -> u64> = Box::new(move || timer.get());
        let mut kept = Kept::new(self.memory.clone(), REGION, timer).expect("far from 2104");
        assert_eq!(kept.sync(), Sync::Unsynced);
        self.asked = 0;
        let floor = kept.floor();
        assert!(self.last.is_none_or(|last| floor.ticks() > last));
        self.running = Some(Running {
            stamper: kept.stamper(self.link_id),
            receiver: Streams::resume(Links::Any, Window::LINK, floor),
            kept,
        });
    }

    /// What runs, at this moment; `None` if nothing does.
    fn at(&mut self, now: u64) -> Option<&mut Running> {
        let elapsed = (now - self.started) as i64;
        self.timer
            .set((elapsed + elapsed / 1_000_000 * self.drift) as u64);
        let running = self.running.as_mut()?;
        let told = match self.told {
            Told::Nothing => None,
            Told::Hourly(_) if now - self.asked < HOUR => None,
            Told::Hourly(off) => Some(now.saturating_add_signed(off)),
            Told::Always => Some(now),
        };
        if let Some(told) = told {
            running.kept.tell(Source::Trusted, at(told));
            self.asked = now;
        }
        Some(running)
    }

    /// Whether the power failed at a write; then nothing runs any more.
    fn fails(&mut self) -> bool {
        let failed = !self.memory.0.borrow().has_power();
        if failed {
            self.running = None;
        }
        failed
    }

    fn send(&mut self, now: u64, key: &SigningKey<Fast>) -> Option<Frame> {
        let link_id = self.link_id;
        let running = self.at(now)?;
        let stamp = running.kept.stamp(&mut running.stamper);
        let failed = self.fails();
        let stamp = stamp
            .inspect_err(|_| assert!(failed, "no stamp under power"))
            .ok()?;
        // A stamp that was given is used, also if the power fails with it.
        let ticks = stamp.timestamp.ticks();
        assert!(self.last.is_none_or(|last| ticks > last), "{ticks} again");
        self.last = Some(ticks);
        let header = Header {
            compat_flags: 0,
            sequence: 0,
            system_id: link_id,
            component_id: 1,
            message_id: MessageId::from(0),
        };
        let mut frame = Frame::new(header, &[1]).expect("a heartbeat");
        sign_frame(&mut frame, key, stamp).expect("unsigned");
        let sent = FrameRef::parse(frame.as_bytes()).expect("whole");
        let running = self.running.as_mut()?;
        running.receiver.sent(sent);
        Some(frame)
    }

    fn receive(&mut self, now: u64, mut key: &SigningKey<Fast>, frame: &Frame, look: bool) -> bool {
        let Some(running) = self.at(now) else {
            return false;
        };
        let frame = FrameRef::parse(frame.as_bytes()).expect("whole");
        let authentic = Authenticate::authenticate(&key, frame).expect("undamaged");
        let stamp = authentic.stamp();
        let state = |running: &Running| {
            let mut text = format!("{:?}", running.kept);
            write!(text, "{:?}", running.receiver).expect("memory");
            text
        };
        let before = look.then(|| state(running));
        let writes = self.memory.0.borrow().writes();
        let running = self.running.as_mut().expect("it runs");
        let verdict = running.kept.admit(&mut running.receiver, authentic);
        if let Ok(verified) = &verdict {
            Authenticate::heard(&mut key, verified);
        }
        let verdict = verdict.map(drop);
        if let Err(error) = verdict {
            assert!(before.is_none_or(|before| before == state(running)));
            if error == VerifyError::NotStored {
                assert!(self.fails(), "not stored under power");
            } else {
                let after = self.memory.0.borrow().writes();
                assert_eq!(after, writes, "a refused frame costs a write");
            }
            return false;
        }
        assert_ne!(stamp.link_id, self.link_id, "its own, reflected");
        let id = (stamp.link_id, stamp.timestamp.ticks());
        assert!(self.accepted.insert(id), "{id:?} accepted twice");
        true
    }
}

/// A history, and how its link ended.
struct World {
    chance: Chance,
    now: u64,
    key: SigningKey<Fast>,
    nodes: [Node; NODES],
    /// Every frame that was ever sent.
    recorded: Vec<Frame>,
    restarts: u32,
}

impl World {
    fn new(number: u64) -> Self {
        let mut chance = Chance(number);
        let apart = CLOCKS_APART / 2;
        let mut node = |id: usize| {
            let off = chance.below(2 * apart) as i64 - apart as i64;
            let told = match (id, chance.below(4)) {
                (GROUND, 0) => Told::Hourly(off),
                (GROUND, _) => Told::Always,
                (_, 0) => Told::Hourly(off),
                _ => Told::Nothing,
            };
            let drift = chance.below(401) as i64 - 200;
            Node::new(id as u8 + 1, told, drift, chance.next())
        };
        let nodes = [node(0), node(1), node(2)];
        Self {
            chance,
            now: START,
            key: SigningKey::new(&[7; KEY_SIZE]).expect("a key"),
            nodes,
            recorded: Vec::new(),
            restarts: 0,
        }
    }

    fn any_node(&mut self) -> usize {
        self.chance.below(NODES as u64) as usize
    }

    /// Sends a frame to all others, of which some is lost: one in `loss`. Who accepted it.
    fn exchange(&mut self, from: usize, loss: u64) -> [bool; NODES] {
        let mut accepted = [false; NODES];
        let Some(frame) = self.nodes[from].send(self.now, &self.key) else {
            return accepted;
        };
        for (to, accepted) in accepted.iter_mut().enumerate() {
            if to != from && !self.chance.one_in(loss) {
                let look = self.chance.one_in(16);
                *accepted = self.nodes[to].receive(self.now, &self.key, &frame, look);
                self.nodes[to].fails();
            }
        }
        self.recorded.push(frame);
        accepted
    }

    /// The attacker plays some of what it has recorded to one node.
    fn replay(&mut self) {
        let to = self.any_node();
        for _ in 0..1 + self.chance.below(4) {
            let Some(count @ 1..) = Some(self.recorded.len() as u64) else {
                return;
            };
            // Old and new alike.
            let back = self.chance.below(count).min(self.chance.below(count));
            let frame = self.recorded[(count - 1 - back) as usize].clone();
            self.nodes[to].receive(self.now, &self.key, &frame, back.is_multiple_of(16));
            self.nodes[to].fails();
        }
    }

    fn step(&mut self) {
        let node = self.any_node();
        match self.chance.below(64) {
            0..=27 => {
                for _ in 0..1 + self.chance.below(3) {
                    self.exchange(node, 3);
                }
            }
            28..=37 => self.now += self.chance.below(2 * SECOND),
            38..=40 => self.now += self.chance.below(120 * SECOND),
            // A long silence.
            41 => self.now += self.chance.below(4 * HOUR),
            42..=47 => {
                let steps = self.chance.below(6) as u32;
                self.nodes[node].memory.0.borrow_mut().cut_after(steps);
            }
            48 | 49 => {
                self.nodes[node].memory.0.borrow_mut().cut();
                self.nodes[node].running = None;
            }
            50..=55 => self.start_all(),
            56..=60 => self.replay(),
            61 => self.spoof(node),
            62 => {
                let (now, node) = (self.now, &mut self.nodes[node]);
                if let Some(running) = node.at(now) {
                    running.kept.tell(Source::Bounded, at(now));
                }
            }
            _ if self.chance.one_in(4) => self.week(node),
            _ => {}
        }
    }

    fn start_all(&mut self) {
        for node in &mut self.nodes {
            self.restarts += u32::from(node.running.is_none());
            node.start(self.now);
        }
    }

    /// A GNSS receiver says whatever an attacker wants, again and again.
    fn spoof(&mut self, node: usize) {
        let told = at(self.chance.below(1 << 48));
        let Some(running) = self.nodes[node].at(self.now) else {
            return;
        };
        let mut moved = 0;
        for _ in 0..20 {
            let before = running.kept.now();
            moved += running.kept.tell(Source::Bounded, told);
            assert!(running.kept.now() >= before, "never back");
        }
        assert!(moved <= SECOND, "{moved} by spoofing");
    }

    /// One node lies in a shed for a week; the others go on without it.
    fn week(&mut self, shed: usize) {
        self.nodes[shed].memory.0.borrow_mut().cut();
        self.nodes[shed].running = None;
        for _ in 0..14 {
            self.now += WEEK / 14;
            for node in 0..NODES {
                if node != shed {
                    self.exchange(node, 3);
                }
            }
        }
    }

    /// Seconds by which each node is ahead: its clock, where it began, what it sent last.
    fn describe(&mut self) -> String {
        let now = self.now;
        let ahead = |ticks: u64| (ticks as i64 - now as i64) as f64 / SECOND as f64;
        let nodes = self.nodes.iter_mut().map(|node| {
            let (told, drift, last) = (node.told, node.drift, node.last);
            let Some(running) = node.at(now) else {
                return String::from("off\n");
            };
            format!(
                "{told:?}, {drift} ppm, {:?}: clock {:.1}, floor {:.1}, last {:.1}\n",
                running.kept.sync(),
                ahead(running.kept.now().ticks()),
                ahead(running.kept.floor().ticks()),
                ahead(last.unwrap_or_default()),
            )
        });
        nodes.collect()
    }

    /// From now on the power holds, and everybody sends a frame a second; a third is lost and the attacker
    /// goes on. How long it takes until everybody has accepted a frame of everybody.
    fn heal(&mut self) -> Back {
        for node in &mut self.nodes {
            node.memory.0.borrow_mut().restart();
        }
        self.start_all();
        let from = self.now;
        let ahead = self.ahead();
        let mut back = [[false; NODES]; NODES];
        while back.iter().enumerate().any(|(sender, by)| {
            by.iter()
                .enumerate()
                .any(|(to, back)| to != sender && !back)
        }) {
            assert!(
                self.now - from <= STATED + ahead,
                "deaf: {back:?}\n{}",
                self.describe()
            );
            for (sender, by) in back.iter_mut().enumerate() {
                let accepted = self.exchange(sender, 3);
                for (back, accepted) in by.iter_mut().zip(accepted) {
                    *back |= accepted;
                }
            }
            self.replay();
            self.now += SECOND;
        }
        Back {
            took: self.now - from,
            ahead,
        }
    }

    /// Ticks by which the fastest clock is ahead of the right time.
    fn ahead(&mut self) -> u64 {
        let now = self.now;
        let clocks = self.nodes.iter_mut().filter_map(|node| {
            let clock = node.at(now)?.kept.now().ticks();
            Some(clock.max(node.last.unwrap_or_default()))
        });
        clocks
            .map(|clock| clock.saturating_sub(now))
            .max()
            .unwrap_or(0)
    }
}

/// How the link came back.
struct Back {
    /// Ticks until everybody had accepted a frame of everybody.
    took: u64,
    /// Ticks by which the fastest clock was ahead, or the last stamp, when that began.
    ahead: u64,
}

fn at(ticks: u64) -> Timestamp {
    Timestamp::from_ticks(ticks).expect("48 bits")
}

/// What became of many histories.
#[derive(Default)]
struct Report {
    /// Seconds until the link was back.
    seconds: Vec<u64>,
    /// Seconds by which the fastest clock was ahead.
    ahead: Vec<u64>,
    frames: usize,
    restarts: u32,
}

fn run(numbers: std::ops::Range<u64>) {
    let mut report = Report::default();
    for number in numbers {
        let run = std::panic::catch_unwind(|| {
            let mut world = World::new(number);
            world.start_all();
            for _ in 0..40 + number % 80 {
                world.step();
            }
            (world.heal(), world.recorded.len(), world.restarts)
        });
        let Ok((back, frames, restarts)) = run else {
            panic!("history {number}");
        };
        report.seconds.push(back.took / SECOND);
        report.ahead.push(back.ahead / SECOND);
        report.frames += frames;
        report.restarts += restarts;
    }
    println!(
        "{} histories, {} frames, {} restarts",
        report.seconds.len(),
        report.frames,
        report.restarts
    );
    for (what, mut seconds) in [
        ("the link is back after", report.seconds),
        ("the fastest clock was ahead by", report.ahead),
    ] {
        seconds.sort_unstable();
        let of = |part: usize| seconds[(seconds.len() - 1) * part / 1000];
        println!(
            "{what} (s): median {}, 90 % {}, 99 % {}, 99.9 % {}, most {}",
            of(500),
            of(900),
            of(990),
            of(999),
            of(1000)
        );
    }
}

#[test]
fn links_come_back_and_nothing_is_used_twice() {
    run(0..3_000);
}

#[test]
#[ignore = "some minutes: 100,000 histories"]
fn links_come_back_and_nothing_is_used_twice_in_100_000_histories() {
    run(0..100_000);
}
