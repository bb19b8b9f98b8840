//! One end of a link as the firmware builds it: relay, keys, marks and clock, on a flash whose power may fail.

use std::cell::{Cell, RefCell};
use std::collections::HashSet;
use std::rc::Rc;

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use mavlink_signing::{
    Frame, FrameRef, Header, KEY_SIZE, KeyChangeError, LinkClock, Links, MessageId, Profile,
    RolloverState, SetupSigning, SigningKey, Stamp, Stamper, StreamTable, Tag, TimeSource,
    Timestamp, Window, ZeroizeOnDrop, sign_frame,
};
use mavseal_relay::{
    Endpoint, FirstKey, ForwardMode, LineEvent, LinkFlash, LinkMemory, Presence, Relay, Side,
    TimeError,
};
use mavseal_store::Region;
use mavseal_store::model::{Failure, Flash, PAGE_SIZE};

/// Where keys and marks are, each in two pages of its own.
const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};
/// Pages of a node's flash: two for its keys, two for each mark.
const PAGES: usize = 6;
const YEAR: u64 = 365 * 24 * 3_600 * 100_000;
/// How long somebody who brings a key waits until the line is silent: 200 milliseconds.
pub(super) const QUIET: u64 = 20_000;
/// The component that SETUP_SIGNING names.
pub(super) const COMPONENT: u8 = 25;

/// A profile that is fast and not secure: there is no forger here, and millions of frames.
pub(super) struct Fast(u64);

impl ZeroizeOnDrop for Fast {}

impl Profile for Fast {
    fn new(key: &[u8; KEY_SIZE]) -> Self {
        Self(key.iter().fold(0, |mixed, byte| {
            (mixed ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3)
        }))
    }

    fn tag(&self, covered: &[u8]) -> Tag {
        let mixed = covered.iter().fold(self.0, |mixed, byte| {
            (mixed ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3)
        });
        let [a, b, c, d, e, f, ..] = mixed.to_le_bytes();
        [a, b, c, d, e, f]
    }
}

pub(super) fn key_bytes(number: u64) -> [u8; KEY_SIZE] {
    let mut bytes = [7; KEY_SIZE];
    bytes[..8].copy_from_slice(&number.to_le_bytes());
    bytes
}

pub(super) fn key(number: u64) -> SigningKey<Fast> {
    SigningKey::new(&key_bytes(number)).expect("not zeros")
}

pub(super) fn at(ticks: u64) -> Timestamp {
    Timestamp::from_ticks(ticks).expect("48 bits")
}

/// A packet of this system, without signature.
pub(super) fn packet(system_id: u8, message: u32, payload: &[u8]) -> Frame {
    let header = Header {
        compat_flags: 0,
        sequence: 0,
        system_id,
        component_id: 1,
        message_id: MessageId::new(message).expect("24 bits"),
    };
    Frame::new(header, payload).expect("in the dialect")
}

pub(super) fn signed(mut frame: Frame, number: u64, stamp: Stamp) -> Frame {
    sign_frame(&mut frame, &key(number), stamp).expect("not signed yet");
    frame
}

/// Two pages of a flash that outlives the program that runs on it.
#[derive(Clone)]
struct Pages(Rc<RefCell<Flash<PAGES>>>, u32);

impl ErrorType for Pages {
    type Error = Failure;
}

impl ReadNorFlash for Pages {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failure> {
        self.0.borrow_mut().read(self.1 + offset, bytes)
    }

    fn capacity(&self) -> usize {
        2 * PAGE_SIZE
    }
}

impl NorFlash for Pages {
    const WRITE_SIZE: usize = <Flash<PAGES> as NorFlash>::WRITE_SIZE;
    const ERASE_SIZE: usize = PAGE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        self.0.borrow_mut().erase(self.1 + from, self.1 + to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        self.0.borrow_mut().write(self.1 + offset, bytes)
    }
}

/// What tells a node the time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Told {
    /// Nothing.
    Nothing,
    /// A trusted clock.
    Right,
    /// A real-time clock without a battery: the time of two years ago.
    Dead,
}

/// What a node remembers, as far as it shows it: words written to flash, clock and keys.
pub(super) type Remembered = (u64, String);

/// A vehicle or the station, with what it has done so far.
pub(super) struct Node {
    pub(super) id: u8,
    /// What tells it the time, hourly and at each start.
    pub(super) told: Told,
    /// Its timer goes wrong by so many parts in a million.
    drift: i64,
    flash: Rc<RefCell<Flash<PAGES>>>,
    spoiled: bool,
    started: u64,
    asked: u64,
    /// Until when nothing leaves it on the link, and what waits in its local port meanwhile.
    held_until: u64,
    waiting: Vec<u8>,
    timer: Rc<Cell<u64>>,
    running: Option<Running>,
    /// Every frame that left it on the link, by stamp and key; its last stamp with each key.
    pub(super) stamps: HashSet<(u64, u64)>,
    /// Every packet that left it on the local side.
    pub(super) handed_on: HashSet<Vec<u8>>,
}

struct Running {
    relay: Relay<Fast, StreamTable<4>>,
    memory: LinkMemory<Pages, Box<dyn FnMut() -> u64>>,
}

impl Node {
    pub(super) fn new(id: u8, told: Told, chance: u64) -> Self {
        Self {
            id,
            told,
            drift: (chance % 401) as i64 - 200,
            flash: Rc::new(RefCell::new(Flash::new(chance))),
            spoiled: false,
            started: 0,
            asked: 0,
            held_until: 0,
            waiting: Vec::new(),
            timer: Rc::new(Cell::new(0)),
            running: None,
            stamps: HashSet::new(),
            handed_on: HashSet::new(),
        }
    }

    pub(super) fn runs(&self) -> bool {
        self.running.is_some()
    }

    /// Power on, unless it is: it starts, whatever was cut before.
    pub(super) fn start(&mut self, now: u64) {
        if self.running.is_none() {
            self.flash.borrow_mut().restart();
            self.try_start(now);
            assert!(self.running.is_some(), "it starts");
        }
    }

    /// The same, where the power may fail meanwhile.
    pub(super) fn try_start(&mut self, now: u64) {
        self.waiting.clear();
        self.started = now;
        self.asked = 0;
        self.timer = Rc::new(Cell::new(0));
        let timer = Rc::clone(&self.timer);
        let timer: Box<dyn FnMut() -> u64> = Box::new(move || timer.get());
        let pages = |at: u32| Pages(Rc::clone(&self.flash), at * 2 * PAGE_SIZE as u32);
        let flash = LinkFlash {
            keys: pages(0),
            marks: [pages(1), pages(2)],
            region: REGION,
        };
        let first = key_bytes(0);
        let opened = LinkMemory::open(flash, FirstKey::Own(&first), timer);
        let Ok((keys, memory)) = opened else {
            return;
        };
        let receiver = StreamTable::new(Links::Any, Window::ONE_MINUTE);
        let stamper = Stamper::new(self.id);
        let relay = Relay::new(keys, stamper, receiver, ForwardMode::StripSignature);
        let mut relay = relay.expect("streams remember what is sent");
        relay.keep_setup(self.id, COMPONENT);
        self.running = Some(Running { relay, memory });
        self.at(now);
    }

    /// Takes the power away now, or inside the write after so many more.
    pub(super) fn cut(&mut self, after: Option<u32>) {
        match after {
            Some(steps) => self.flash.borrow_mut().cut_after(steps),
            None => {
                self.flash.borrow_mut().cut();
                self.running = None;
            }
        }
    }

    /// From now on the power holds, and what goes out is taken.
    pub(super) fn mend(&mut self) {
        self.held_until = 0;
        self.fails();
        self.flash.borrow_mut().restart();
    }

    /// One word of its flash can no longer be read: once in its life, and in one copy of a record.
    pub(super) fn spoil(&mut self, word: u16) {
        if !self.spoiled {
            self.spoiled = true;
            let offset = usize::from(word) * 8 % (PAGES * PAGE_SIZE);
            self.flash.borrow_mut().spoil(offset);
        }
    }

    /// Whether the power has failed; then nothing runs any more.
    fn fails(&mut self) -> bool {
        let failed = !self.flash.borrow().has_power();
        if failed {
            self.running = None;
        }
        failed
    }

    /// What runs, at this moment.
    fn at(&mut self, now: u64) -> Option<&mut Running> {
        let elapsed = (now - self.started) as i64;
        self.timer
            .set((elapsed + elapsed / 1_000_000 * self.drift) as u64);
        let running = self.running.as_mut()?;
        if now - self.asked > 3_600 * 100_000 {
            self.asked = now;
            let used = running
                .memory
                .clock
                .floor(running.relay.keys().signing_slot());
            let told = match self.told {
                Told::Nothing => None,
                Told::Right => Some(now),
                // It is believed by a board that has never heard the time.
                Told::Dead => Some(now - 2 * YEAR).filter(|_| used > at(now - YEAR)),
            };
            // Where a former friend has led everybody ahead, a right clock is not believed; a new key ends that.
            let result =
                told.map(|told| running.memory.clock.update(TimeSource::Trusted, at(told)));
            let dead = self.told == Told::Dead && result.is_some();
            assert!(
                !dead || result == Some(Err(TimeError::BehindMark)),
                "{result:?} {used:?} {}",
                self.id
            );
        }
        Some(running)
    }

    /// A GNSS receiver says whatever an attacker wants, again and again.
    pub(super) fn spoof(&mut self, now: u64, time: u64) {
        let Some(Running { memory, .. }) = self.at(now) else {
            return;
        };
        let mut moved = 0;
        for _ in 0..20 {
            let before = memory.clock.now();
            let told = memory
                .clock
                .update(TimeSource::Bounded, at(time % (1 << 48)));
            moved += told.expect("never behind the mark");
            assert!(memory.clock.now() >= before, "never back");
        }
        assert!(moved <= 100_000, "{moved} by spoofing");
    }

    pub(super) fn remembered(&mut self, now: u64) -> Option<Remembered> {
        let running = self.at(now)?;
        let shown = format!("{:?}{:?}", running.memory.clock, running.relay.keys());
        Some((self.flash.borrow().writes(), shown))
    }

    /// Bytes come in on `side`, in the given pieces, at the times that are added. What goes out: on the link, and on the
    /// local side.
    pub(super) fn feed(
        &mut self,
        now: u64,
        side: Side,
        pieces: &[(u64, &[u8])],
        fault: Option<LineEvent>,
    ) -> (Vec<u8>, Vec<u8>) {
        let (mut link, mut local) = (Vec::new(), Vec::new());
        let mut time = now;
        let (held_until, mut waiting) = (self.held_until, std::mem::take(&mut self.waiting));
        for (pause, piece) in pieces {
            time += pause;
            let Some(Running { relay, memory }) = self.at(time) else {
                return (link, local);
            };
            let clock = &mut memory.clock;
            let held = time < held_until;
            if side == Side::Local {
                waiting.extend_from_slice(piece);
            }
            // What waits in the port came before this moment.
            let taken = relay.received(Side::Local, &waiting, clock, &mut |_| ());
            waiting.drain(..taken);
            let mut rest = if side == Side::Link { *piece } else { &[] };
            loop {
                relay.poll(clock, &mut |_| ());
                let taken = relay.received(side, rest, clock, &mut |_| ());
                rest = &rest[taken..];
                let mut buffer = [0; 300];
                let mut moved = taken > 0;
                for (side, output) in [(Side::Link, &mut link), (Side::Local, &mut local)] {
                    if held && side == Side::Link {
                        continue;
                    }
                    let count = relay.transmit(side, &mut buffer, clock, &mut |_| ());
                    output.extend_from_slice(&buffer[..count]);
                    moved |= count > 0;
                }
                let taken = relay.received(Side::Local, &waiting, clock, &mut |_| ());
                waiting.drain(..taken);
                moved |= taken > 0;
                if !moved {
                    let rests = rest.is_empty() && (held || waiting.is_empty());
                    assert!(rests, "what it cannot take waits for something");
                    break;
                }
            }
        }
        self.waiting = waiting;
        if let (Some(fault), Some(Running { relay, memory })) = (fault, self.running.as_mut()) {
            relay.line_event(side, fault, &mut memory.clock, &mut |_| ());
        }
        self.fails();
        (link, local)
    }

    /// Nothing leaves it on the link until then.
    pub(super) const fn hold(&mut self, until: u64) {
        self.held_until = until;
    }

    /// What time may have brought.
    pub(super) fn poll(&mut self, now: u64) -> (Vec<u8>, Vec<u8>) {
        self.feed(now, Side::Link, &[(0, &[])], None)
    }

    /// The number of the key that it signs with, at most `latest`; `None` while it is off.
    pub(super) fn number(&self, latest: u64) -> Option<u64> {
        let print = self.running.as_ref()?.relay.keys().signing().fingerprint();
        let found = (0..=latest)
            .rev()
            .find(|it| key(*it).fingerprint() == print);
        Some(found.expect("one of the keys that were given"))
    }

    pub(super) fn state(&self) -> Option<RolloverState> {
        let running = self.running.as_ref()?;
        Some(running.relay.keys().rollover_state())
    }

    /// Whether it accepts what is signed with key `number`.
    pub(super) fn has_key(&self, number: u64) -> bool {
        use mavlink_signing::Authenticate;
        let stamp = Stamp {
            link_id: 9,
            timestamp: Timestamp::ZERO,
        };
        let frame = signed(packet(9, 0, &[1]), number, stamp);
        let frame = FrameRef::parse(frame.as_bytes()).expect("whole");
        let running = self.running.as_ref();
        running.is_some_and(|it| it.relay.keys().authenticate(frame).is_ok())
    }

    /// A SETUP_SIGNING that somebody brings by a cable; whether it was taken in, and what went out meanwhile.
    pub(super) fn set_up(
        &mut self,
        now: u64,
        [number, initial]: [u64; 2],
        presence: bool,
    ) -> (bool, (Vec<u8>, Vec<u8>)) {
        let setup = SetupSigning {
            target_system: self.id,
            target_component: COMPONENT,
            secret_key: key_bytes(number),
            initial_timestamp: at(initial),
        };
        let header = packet(255, 0, &[0]);
        let header = FrameRef::parse(header.as_bytes()).expect("whole").header();
        let frame = setup.to_frame(header).expect("in the dialect");
        self.presence(if presence {
            Presence::Shown
        } else {
            Presence::Absent
        });
        let pieces: [(u64, &[u8]); 2] = [(QUIET, &[]), (0, frame.as_bytes())];
        let output = self.feed(now, Side::Local, &pieces, None);
        self.presence(Presence::Absent);
        let taken = self.take_setup();
        assert!(taken.is_none_or(|key| key == key_bytes(number)));
        (taken.is_some(), output)
    }

    fn presence(&mut self, presence: Presence) {
        if let Some(running) = &mut self.running {
            running.relay.set_presence(presence);
        }
    }

    /// The key of a SETUP_SIGNING that it has taken in.
    pub(super) fn take_setup(&mut self) -> Option<[u8; KEY_SIZE]> {
        let setup = self.running.as_mut()?.relay.take_setup()?;
        Some(setup.secret_key)
    }

    /// Takes over key `number`.
    pub(super) fn apply(&mut self, now: u64, number: u64, initial: u64) {
        let id = self.id;
        let Some(Running { relay, memory }) = self.at(now) else {
            return;
        };
        let setup = SetupSigning {
            target_system: id,
            target_component: COMPONENT,
            secret_key: key_bytes(number),
            initial_timestamp: at(initial),
        };
        let applied = relay.apply_setup(&setup, &mut memory.clock, &mut memory.store);
        self.stored_or_off(applied);
    }

    /// Offers key `number`, for whoever knows the time; whether it did.
    pub(super) fn offer(&mut self, now: u64, number: u64) -> bool {
        let Some(Running { relay, memory }) = self.at(now) else {
            return false;
        };
        let (bytes, initial) = (key_bytes(number), at(now));
        let offered = relay.offer_key(&bytes, initial, &mut memory.clock, &mut memory.store);
        self.stored_or_off(offered)
    }

    /// Goes over to a new key that it has heard.
    pub(super) fn confirm(&mut self) {
        if let Some(Running { relay, memory }) = &mut self.running {
            let confirmed = relay.confirm_key(&mut memory.store);
            self.stored_or_off(confirmed);
        }
    }

    pub(super) fn retire(&mut self) {
        if let Some(Running { relay, memory }) = &mut self.running {
            let retired = relay.retire_key(&mut memory.store);
            self.stored_or_off(retired);
        }
    }

    /// Under power the flash does not fail.
    fn stored_or_off(&mut self, result: Result<(), KeyChangeError>) -> bool {
        if result == Err(KeyChangeError::NotStored) {
            assert!(self.fails(), "not stored under power");
        }
        result.is_ok()
    }

    /// Ticks by which its clock, or its last stamp with the key in use, is ahead of the time.
    pub(super) fn ahead(&mut self, now: u64, latest: u64) -> u64 {
        let number = self.number(latest);
        let stamps = self.stamps.iter().filter(|(by, _)| Some(*by) == number);
        let last = stamps.map(|(_, ticks)| *ticks).max().unwrap_or(0);
        let clock = self.at(now).map_or(0, |it| it.memory.clock.now().ticks());
        last.max(clock).saturating_sub(now)
    }

    pub(super) fn describe(&self) -> String {
        let Some(running) = &self.running else {
            return format!("{}: off", self.id);
        };
        format!(
            "{}: {:?}, {:?}, {:?} {:?}",
            self.id,
            self.told,
            running.relay,
            running.memory.clock,
            running.relay.keys()
        )
    }
}
