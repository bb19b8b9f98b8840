//! K1 and R1 for both ends at once: every interleaving of a change of key, with an attacker who drops, repeats, reorders
//! and reflects frames and brings SETUP_SIGNING again, and with power that fails, up to stated bounds.
//!
//! An explicit-state explorer over the real step functions. Kani does not come to an end for both ends.

use mavlink_signing::{
    Authenticate, Frame, FrameRef, KeyChangeError, KeyRing, KeySlot, ReplayGuard, RolloverState,
    SigningKey, Stamp, Timestamp, Window, sign_frame,
};
use stateright::{Checker, Model, Property};

use crate::key_memory::{self, FIRST, Memory, bytes, key};
use crate::model::{AnyTag, HEARTBEAT};

/// Frames that each end sends, and keys that the station offers, at most.
const FRAMES: usize = 2;
const OFFERS: u8 = 2;
/// Times that the power of each end fails while something is stored, or between.
const FAILURES: u8 = 1;

/// What an end holds: phase, slot of the old key, old and new key.
type Ring = (u8, bool, u8, u8);

/// One end: the station, which offers keys, or the vehicle, which takes them over.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct End {
    ring: Ring,
    heard: bool,
    /// What a restart will find in its place.
    trace: Option<Ring>,
    failures: u8,
    /// The last stamp accepted under the key in each slot, and above which a mark is stored.
    last: [u8; 2],
    /// The keys of what it has sent; the stamp is the place.
    sent: Vec<u8>,
    /// Which frames of the other it has accepted.
    accepted: Vec<u8>,
    /// The newest key that it was given or has heard.
    may_use: u8,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct State {
    ends: [End; 2],
    /// Keys of the SETUP_SIGNINGs that were made.
    setups: Vec<u8>,
    offered: u8,
    withdrawn: bool,
    /// What must not happen, and did.
    wrong: Option<&'static str>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Action {
    Offer,
    SetUp(usize),
    Withdraw,
    Send(usize),
    /// To an end, of what the other has sent; or its own, reflected.
    Deliver(usize, usize),
    Reflect(usize, usize),
    Confirm(usize),
    Retire(usize),
    Restart(usize),
    /// The next of these is cut; whether a restart finds it done.
    Cut(usize, Stored, bool),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stored {
    Offer,
    SetUp,
    Confirm,
    Retire,
}

const PHASES: [RolloverState; 4] = [
    RolloverState::Settled,
    RolloverState::Offered,
    RolloverState::Applied,
    RolloverState::Confirmed,
];

fn memory(ring: Ring) -> key_memory::Model {
    let (phase, base_is_b, old, new) = ring;
    let base = if base_is_b { KeySlot::B } else { KeySlot::A };
    key_memory::Model::holding(PHASES[usize::from(phase)], base, old, new)
}

fn ring_of(memory: &key_memory::Model) -> Ring {
    let (phase, base, old, new) = memory.stored();
    let phase = PHASES
        .iter()
        .position(|it| *it == phase)
        .expect("one of four");
    (phase as u8, base == KeySlot::B, old, new)
}

fn frame(number: u8, link_id: u8, place: usize) -> Frame {
    let mut frame = Frame::new(HEARTBEAT, &[]).expect("in every dialect");
    let stamp = Stamp {
        link_id,
        timestamp: Timestamp::from_ticks(place as u64 + 1).expect("48 bits"),
    };
    sign_frame(&mut frame, &key::<AnyTag>(number), stamp).expect("not signed yet");
    frame
}

fn guard(link_id: u8, last: u8) -> ReplayGuard {
    let window = Window {
        past: u64::MAX,
        ahead: u64::MAX,
    };
    let first = Timestamp::from_ticks(u64::from(last) + 1).expect("48 bits");
    ReplayGuard::resume(link_id, window, first)
}

impl End {
    fn new() -> Self {
        Self {
            ring: (0, false, FIRST, FIRST),
            heard: false,
            trace: None,
            failures: 0,
            last: [0; 2],
            sent: Vec::new(),
            accepted: Vec::new(),
            may_use: FIRST,
        }
    }

    fn keys(&self) -> KeyRing<AnyTag> {
        let mut keys = memory(self.ring).restart();
        if self.heard {
            let frame = frame(self.ring.3, 1, 0);
            let parsed = FrameRef::parse(frame.as_bytes()).expect("whole");
            let authentic = keys.authenticate(parsed).expect("its new key");
            let verified = guard(1, 0).admit(authentic, Timestamp::ZERO);
            keys.on_accepted(&verified.expect("new"));
            assert!(keys.confirm_pending());
        }
        keys
    }

    fn signs_with(&self) -> u8 {
        match self.ring.0 {
            0 | 1 => self.ring.2,
            _ => self.ring.3,
        }
    }

    fn hears(&self, number: u8) -> bool {
        let frame = frame(number, 1, 0);
        let parsed = FrameRef::parse(frame.as_bytes()).expect("whole");
        self.keys().authenticate(parsed).is_ok()
    }

    /// Has `act` done to the keys. Cut, nothing is done now; `found` says what a restart finds.
    fn change(
        &mut self,
        new: Option<u8>,
        cut: Option<bool>,
        act: impl FnOnce(&mut KeyRing<AnyTag>, &mut key_memory::Model) -> Result<(), KeyChangeError>,
    ) {
        let mut keys = self.keys();
        if let Some(new) = new.map(|new| SigningKey::new(&bytes(new)).expect("a key"))
            && let Some(slot) = keys.slot_for(&new)
        {
            // What was remembered of the slot is forgotten first.
            *slot.of_mut(&mut self.last) = 0;
        }
        let mut memory = memory(self.ring);
        if let Some(found) = cut {
            memory.fail(found);
        }
        let _ = act(&mut keys, &mut memory);
        if cut.is_some() {
            let restarted = memory.restart::<AnyTag>();
            let _ = restarted;
            self.trace = Some(ring_of(&memory));
            return self.restart();
        }
        self.ring = ring_of(&memory);
        self.heard = keys.confirm_pending();
        let signing = frame_of(&keys);
        assert_eq!(signing, frame(self.signs_with(), 1, 0).as_bytes());
    }

    fn restart(&mut self) {
        self.failures += 1;
        self.ring = self.trace.take().unwrap_or(self.ring);
        self.heard = false;
    }

    /// A frame comes in; whether it was accepted.
    fn receive(&mut self, number: u8, link_id: u8, own_link: u8, place: usize) -> bool {
        let frame = frame(number, link_id, place);
        let parsed = FrameRef::parse(frame.as_bytes()).expect("whole");
        let mut keys = self.keys();
        let Ok(authentic) = keys.authenticate(parsed) else {
            return false;
        };
        let slot = authentic.key().slot;
        let mut guard = guard(3 - own_link, *slot.of(&self.last));
        let Ok(verified) = guard.admit(authentic, Timestamp::ZERO) else {
            return false;
        };
        keys.on_accepted(&verified);
        self.heard = keys.confirm_pending();
        *slot.of_mut(&mut self.last) = place as u8 + 1;
        self.may_use = self.may_use.max(number);
        true
    }
}

fn frame_of(keys: &KeyRing<AnyTag>) -> Vec<u8> {
    let mut frame = Frame::new(HEARTBEAT, &[]).expect("in every dialect");
    let stamp = Stamp {
        link_id: 1,
        timestamp: Timestamp::from_ticks(1).expect("48 bits"),
    };
    sign_frame(&mut frame, keys.signing(), stamp).expect("not signed yet");
    frame.as_bytes().to_vec()
}

impl State {
    fn act(&mut self, action: Action) {
        match action {
            Action::Offer => self.offer(None),
            Action::SetUp(at) => self.set_up(at, None),
            Action::Withdraw => {
                let before = self.ends[0].ring;
                self.ends[0].change(None, None, |keys, memory| keys.withdraw(memory));
                if self.ends[0].ring != before {
                    self.withdrawn = true;
                    self.setups.push(self.ends[0].signs_with());
                }
            }
            Action::Send(end) => {
                let number = self.ends[end].signs_with();
                self.ends[end].sent.push(number);
            }
            Action::Deliver(to, place) => {
                let number = self.ends[1 - to].sent[place];
                let (link_id, own) = (2 - to as u8, to as u8 + 1);
                if self.ends[to].receive(number, link_id, own, place) {
                    if self.ends[to].accepted.contains(&(place as u8)) {
                        self.wrong = Some("a frame was accepted twice");
                    }
                    self.ends[to].accepted.push(place as u8);
                    self.ends[to].accepted.sort_unstable();
                }
            }
            Action::Reflect(to, place) => {
                let number = self.ends[to].sent[place];
                let own = to as u8 + 1;
                if self.ends[to].receive(number, own, own, place) {
                    self.wrong = Some("a frame of its own was accepted");
                }
            }
            Action::Confirm(end) => {
                self.ends[end].change(None, None, |keys, memory| keys.confirm(memory));
            }
            Action::Retire(end) => {
                self.ends[end].change(None, None, |keys, memory| keys.retire(memory));
            }
            Action::Restart(end) => self.ends[end].restart(),
            Action::Cut(_, Stored::Offer, found) => self.offer(Some(found)),
            Action::Cut(_, Stored::SetUp, found) => {
                self.set_up(self.setups.len() - 1, Some(found));
            }
            Action::Cut(end, Stored::Confirm, found) => {
                self.ends[end].change(None, Some(found), |keys, memory| keys.confirm(memory));
            }
            Action::Cut(end, Stored::Retire, found) => {
                self.ends[end].change(None, Some(found), |keys, memory| keys.retire(memory));
            }
        }
        for end in &self.ends {
            if end.signs_with() > end.may_use {
                self.wrong = Some("a key was used too early");
            }
        }
    }

    fn offer(&mut self, cut: Option<bool>) {
        let number = FIRST + 1 + self.offered;
        let settled = self.ends[0].ring.0 == 0;
        self.ends[0].change(Some(number), cut, |keys, memory| {
            keys.offer(&bytes(number), memory)
        });
        if settled {
            self.offered += 1;
            if self.ends[0].ring.0 == 1 {
                self.setups.push(number);
            }
        }
    }

    fn set_up(&mut self, at: usize, cut: Option<bool>) {
        let number = self.setups[at];
        self.ends[1].may_use = self.ends[1].may_use.max(number);
        self.ends[1].change(Some(number), cut, |keys, memory| {
            keys.apply(&bytes(number), memory)
        });
    }

    /// Whether a change that has begun comes to its end if nothing more goes wrong.
    fn comes_to_an_end(&self) -> bool {
        let mut state = self.clone();
        for end in &mut state.ends {
            // The old stamps are behind.
            end.sent = vec![0; 100];
        }
        for round in 0..6 {
            // Whoever changes the key drops the one before, and brings the new one again.
            for end in [0, 1] {
                state.act(Action::Retire(end));
            }
            if state.ends[0].ring.0 == 1 {
                state.setups.push(state.ends[0].ring.3);
                state.set_up(state.setups.len() - 1, None);
            }
            for end in [1, 0] {
                let place = 100 + round;
                while state.ends[end].sent.len() <= place {
                    let number = state.ends[end].signs_with();
                    state.ends[end].sent.push(number);
                }
                state.act(Action::Deliver(1 - end, place));
                state.act(Action::Confirm(1 - end));
            }
        }
        let [ours, theirs] = &state.ends;
        (ours.ring.0, theirs.ring.0) == (0, 0) && ours.ring.2 == theirs.ring.2
    }
}

struct Change;

impl Model for Change {
    type State = State;
    type Action = Action;

    fn init_states(&self) -> Vec<State> {
        vec![State {
            ends: [End::new(), End::new()],
            setups: Vec::new(),
            offered: 0,
            withdrawn: false,
            wrong: None,
        }]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Action>) {
        let offers = state.offered < OFFERS;
        if offers {
            actions.push(Action::Offer);
        }
        // The last two: SETUP_SIGNING comes again, but not after a later one was used to its end.
        let setups = state.setups.len();
        actions.extend((setups.saturating_sub(1)..setups).map(Action::SetUp));
        actions.push(Action::Withdraw);
        for (end, it) in state.ends.iter().enumerate() {
            if it.sent.len() < FRAMES {
                actions.push(Action::Send(end));
            }
            actions.extend((0..state.ends[1 - end].sent.len()).map(|at| Action::Deliver(end, at)));
            actions.extend((0..it.sent.len()).map(|at| Action::Reflect(end, at)));
            actions.extend([Action::Confirm(end), Action::Retire(end)]);
            if it.failures < FAILURES {
                actions.push(Action::Restart(end));
                for found in [true, false] {
                    let cut = |what| Action::Cut(end, what, found);
                    actions.extend([cut(Stored::Confirm), cut(Stored::Retire)]);
                    if end == 0 && offers {
                        actions.push(cut(Stored::Offer));
                    }
                    if end == 1 && setups > 0 {
                        actions.push(cut(Stored::SetUp));
                    }
                }
            }
        }
    }

    fn next_state(&self, state: &State, action: Action) -> Option<State> {
        let mut next = state.clone();
        next.act(action);
        Some(next)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        fn deaf(state: &State) -> [bool; 2] {
            let [ours, theirs] = &state.ends;
            [
                !ours.hears(theirs.signs_with()),
                !theirs.hears(ours.signs_with()),
            ]
        }
        vec![
            Property::always("nothing happens that must not", |_, state: &State| {
                state.wrong.is_none()
            }),
            Property::always("never are both deaf", |_, state| deaf(state) != [true; 2]),
            Property::always("without a withdrawal, nobody is", |_, state: &State| {
                state.withdrawn || deaf(state) == [false; 2]
            }),
            Property::always("a change can be brought to its end", |_, state: &State| {
                state.withdrawn || state.comes_to_an_end()
            }),
            Property::sometimes("a change comes to its end", |_, state: &State| {
                state
                    .ends
                    .iter()
                    .all(|end| end.ring.0 == 0 && end.ring.2 > FIRST)
            }),
            Property::sometimes("a key is withdrawn", |_, state: &State| state.withdrawn),
        ]
    }
}

#[test]
fn k1_every_interleaving() {
    let checker = Change.checker().threads(2).spawn_bfs().join();
    println!("{} states", checker.unique_state_count());
    checker.assert_properties();
    assert!(checker.unique_state_count() > 10_000);
}
