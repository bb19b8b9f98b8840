//! O1, N1 and P1 of one end of a sealed link that has a clock, over restarts, against a naive model.

use std::collections::BTreeSet;
use std::time::Duration;

use mavlink_commsec::radio::Status;
use mavlink_commsec::{AesGcm, Credential, Sealer, SenderId, hx};
use mavlink_signing::{LinkClock, Timestamp};
use mavseal_relay::sealed::{
    HighWaterMarks, Place, Radio, SealedEndpoint, SealedEvent, SealedRejectReason,
};
use mavseal_relay::{Direction, Endpoint, Side};
use mavseal_store::Region;
use mavseal_store::model::{Flash, PAGE_SIZE};

/// What may happen to an end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub enum Step {
    /// Time passes.
    Pass {
        /// In milliseconds.
        milliseconds: u16,
    },
    /// HEARTBEATs come from the local side.
    Send {
        /// How many.
        count: u8,
    },
    /// A package of the peer arrives.
    Arrive {
        /// Its counter, from what the clock says.
        from_clock: i16,
    },
    /// A package arrives that was accepted before.
    Again {
        /// Which one, counted round.
        which: u8,
    },
    /// The radio says what its status is, or somebody in its place.
    Answer,
    /// The end is switched off and on.
    Restart,
}

/// Counters in a second, and in how many seconds packages are fresh, and a sender may run ahead.
const PER_SECOND: i64 = 64;
const FRESH: i64 = 60 * PER_SECOND;
const LEAD: i64 = 30 * PER_SECOND;
/// Ticks in a second.
const SECOND: u64 = 100_000;
/// When the keys were made.
const ORIGIN: u64 = 1 << 45;

const OWN: Credential = credential(7);
const PEER: Credential = credential(5);

const fn credential(id: u32) -> Credential {
    Credential {
        id: SenderId(id),
        key: [id as u8; 16],
        salt: 9,
    }
}

/// The time that an end is given.
struct Time(u64);

impl LinkClock for Time {
    fn now(&mut self) -> Timestamp {
        Timestamp::from_ticks(ORIGIN + self.0).expect("48 bits")
    }

    fn monotonic(&mut self) -> u64 {
        self.0
    }
}

type Flashes = (Flash<2>, Flash<2>);

fn places((sent, accepted): Flashes) -> (Place<Flash<2>>, [Place<Flash<2>>; 1]) {
    let region = Region {
        start: 0,
        page_size: PAGE_SIZE as u32,
    };
    ((sent, region), [(accepted, region)])
}

/// An end, and the naive model of it.
struct Bench {
    end: SealedEndpoint<Flash<2>, 1>,
    time: Time,
    events: Vec<SealedEvent>,
    /// What was used last, or lies below the mark; and above that, after a restart, nothing is known.
    used: i64,
    /// What was accepted, over all starts; and up to where everything is rejected since this one.
    accepted: BTreeSet<i64>,
    floor: i64,
    /// When the radio was asked in this start, and whether it has not answered.
    asked: Option<(u64, bool)>,
}

impl Bench {
    fn new(marks: HighWaterMarks<Flash<2>, 1>, time: u64) -> Self {
        let radio = Radio::Vehicle {
            system_id: 1,
            component_id: 68,
        };
        let end = SealedEndpoint::new(&OWN, &[PEER], marks, radio, Duration::ZERO);
        let origin = Timestamp::from_ticks(ORIGIN).expect("48 bits");
        let mut bench = Self {
            end: end.expect("keys").clocked(origin),
            time: Time(time),
            events: Vec::new(),
            used: 0,
            accepted: BTreeSet::new(),
            floor: 0,
            asked: None,
        };
        bench.poll();
        bench
    }

    fn clock(&self) -> i64 {
        (self.time.0 * 64 / SECOND) as i64
    }

    /// Gives the end what is due, and takes what goes out.
    fn poll(&mut self) {
        let Self {
            end, time, events, ..
        } = self;
        let mut observe = |event| events.push(event);
        end.poll(time, &mut observe);
        for side in [Side::Local, Side::Link] {
            while !end.pending(side).is_empty() {
                let count = end.pending(side).len();
                end.sent(side, count, time, &mut observe);
            }
        }
        let due = self.asked.is_none_or(|(at, _)| self.time.0 >= at + SECOND);
        if due {
            self.asked = Some((self.time.0, true));
        }
    }

    /// What the end makes of bytes.
    fn give(&mut self, side: Side, bytes: &[u8]) -> Vec<SealedEvent> {
        self.events.clear();
        let mut taken = 0;
        while taken < bytes.len() {
            let Self {
                end, time, events, ..
            } = self;
            let mut observe = |event| events.push(event);
            taken += end.received(side, &bytes[taken..], time, &mut observe);
            self.poll();
        }
        std::mem::take(&mut self.events)
    }

    fn send(&mut self) {
        let expected = self.clock().max(self.used + 1);
        let heartbeat = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];
        let events = self.give(Side::Local, &heartbeat);
        let last = if expected > self.clock() + LEAD {
            let ahead = SealedRejectReason::AheadOfClock;
            SealedEvent::Rejected(Direction::Outbound, ahead)
        } else {
            self.used = expected;
            SealedEvent::Sealed(expected as u32)
        };
        assert_eq!(events, [SealedEvent::Packed, last]);
    }

    /// A package of the peer with this counter; whether it is accepted.
    fn arrive(&mut self, counter: i64) -> bool {
        let key = PEER.prepare().expect("a key");
        let mut sealer: Sealer = Sealer::resume(key, PEER.id, counter as u32);
        let mut message = [0; 80];
        message[..3].copy_from_slice(&[0xFE, 0, 0]);
        message[6] = 1;
        let package = sealer.seal(&message).expect("a counter is left");
        let bytes: Vec<u8> = hx::Frame::from(&package).encode().collect();
        let events = self.give(Side::Link, &bytes);

        let newest = self.accepted.last().copied().unwrap_or(0).max(self.floor);
        let late = counter > self.floor && newest - counter <= 64;
        let fresh = counter > newest || (late && !self.accepted.contains(&counter));
        let reason = if !fresh {
            Some(SealedRejectReason::Stale)
        } else if counter < self.clock() - FRESH {
            Some(SealedRejectReason::TooOld)
        } else if counter > self.clock() + FRESH {
            Some(SealedRejectReason::FromFuture)
        } else {
            self.accepted.insert(counter);
            None
        };
        let expected = match reason {
            Some(reason) => SealedEvent::Rejected(Direction::Inbound, reason),
            None => SealedEvent::Opened(PEER.id, counter as u32),
        };
        assert_eq!(events, [expected], "counter {counter} at {}", self.clock());
        reason.is_none()
    }

    /// A status is taken if a question is open, and then told.
    fn answer(&mut self) -> bool {
        let status = Status::default();
        let wire = status.to_wire();
        let frame = hx::Frame::new(hx::FrameKind::Radio, &wire).expect("a frame");
        let bytes: Vec<u8> = frame.encode().collect();
        let events = self.give(Side::Link, &bytes);
        let (at, open) = self.asked.expect("asked at the start");
        if !open {
            let not_asked = SealedRejectReason::NotAsked;
            let rejected = SealedEvent::Rejected(Direction::Inbound, not_asked);
            assert_eq!(events, [rejected]);
            return false;
        }
        assert_eq!(events[0], SealedEvent::Radio(status));
        self.asked = Some((at, false));
        // It goes out by itself, or not, as other packets do.
        for event in events {
            if let SealedEvent::Sealed(counter) = event {
                self.used = counter.into();
            }
        }
        true
    }

    /// The end after a restart, with what it may have forgotten: some seconds' worth, and no more.
    fn restarted(self) -> Self {
        let (sent, [accepted]) = self.end.into_flashes();
        let (sent, accepted) = places((sent, accepted));
        let marks = HighWaterMarks::open::<AesGcm>(&OWN, &[PEER], sent, accepted);
        let mut after = Self::new(marks.expect("marks"), self.time.0);
        let next = i64::from(after.end.next_counter().expect("one is left"));
        assert!(next > self.used && next <= self.used.max(1) + 1 + 20 * PER_SECOND);
        let newest = self.accepted.last().copied().unwrap_or(0);
        let (_, floor) = after.end.peers().next().expect("a peer");
        assert!(i64::from(floor) >= newest);
        after.used = next - 1;
        after.floor = floor.into();
        after.accepted = self.accepted;
        after
    }
}

/// O1, N1 and P1 of an end with a clock, in every history. What it seals has the counter that the clock says, or the
/// last one plus one, and is not sealed where that is more than 30 s ahead. What it opens is less than 60 s from its
/// clock and was never opened before, over restarts. A status is taken once for each question, of which there is one a
/// second. After a restart it goes on above all that was used and accepted. Returns how many packages were opened and
/// how many statuses taken.
///
/// # Panics
///
/// If the property does not hold.
#[must_use]
pub fn history(start: u64, steps: &[Step]) -> [usize; 2] {
    let blank = (Flash::default(), Flash::default());
    let (sent, accepted) = places(blank);
    let marks = HighWaterMarks::provision::<AesGcm>(&OWN, &[PEER], sent, accepted);
    let mut bench = Bench::new(marks.expect("blank flashes"), start);
    let (mut opened, mut told) = (0, 0);
    for step in steps {
        match *step {
            Step::Pass { milliseconds } => {
                bench.time.0 += u64::from(milliseconds) * SECOND / 1000;
                bench.events.clear();
                bench.poll();
            }
            Step::Send { count } => (0..count).for_each(|_| bench.send()),
            Step::Arrive { from_clock } => {
                let counter = bench.clock() + i64::from(from_clock);
                let accepted = counter > 0 && bench.arrive(counter);
                opened += usize::from(accepted);
            }
            Step::Again { which } => {
                let count = bench.accepted.len().max(1);
                let again = bench.accepted.iter().nth(usize::from(which) % count);
                if let Some(counter) = again.copied() {
                    assert!(!bench.arrive(counter));
                }
            }
            Step::Answer => told += usize::from(bench.answer()),
            Step::Restart => bench = bench.restarted(),
        }
    }
    [opened, told]
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavseal_relay::sealed::MarksError;
    use mavseal_store::MarkError;
    use proptest::prelude::*;

    fn step() -> impl Strategy<Value = Step> {
        let edge = FRESH as i16;
        let from_clock = prop_oneof![
            -70..70_i16,
            (-2..=2_i16).prop_map(move |near| edge + near),
            (-2..=2_i16).prop_map(move |near| near - edge),
            any::<i16>(),
        ];
        prop_oneof![
            2 => any::<u16>().prop_map(|milliseconds| Step::Pass { milliseconds }),
            1 => (0..1010_u16).prop_map(|milliseconds| Step::Pass { milliseconds }),
            3 => any::<u8>().prop_map(|count| Step::Send { count }),
            6 => from_clock.prop_map(|from_clock| Step::Arrive { from_clock }),
            2 => any::<u8>().prop_map(|which| Step::Again { which }),
            2 => Just(Step::Answer),
            1 => Just(Step::Restart),
        ]
    }

    proptest! {
        #[test]
        fn o1_end_with_a_clock(
            start in prop_oneof![0..10 * SECOND, 0..SECOND * 10_000_000],
            steps in proptest::collection::vec(step(), 0..40),
        ) {
            let _ = history(start, &steps);
        }
    }

    /// More packages than the clock has counters for: 30 s ahead and no further, and on from there after a restart.
    #[test]
    fn n1_end_runs_ahead_of_its_clock() {
        let send = Step::Send { count: 255 };
        let pass = |milliseconds| Step::Pass { milliseconds };
        let burst = [send; 12];
        let after = [Step::Restart, send, pass(20_500), send, Step::Restart, send];
        let _ = history(100 * SECOND, &[&burst[..], &after].concat());
    }

    /// One answer for each question, and a question a second.
    #[test]
    fn p1_end_tells_one_status_a_second() {
        let pass = |milliseconds| Step::Pass { milliseconds };
        let flood = [Step::Answer; 5];
        let mut steps = flood.to_vec();
        for milliseconds in [999, 1, 500, 499, 1, 5000] {
            steps.push(pass(milliseconds));
            steps.extend(flood);
        }
        // At 0, 1, 2 and 7 seconds.
        assert_eq!(history(SECOND, &steps), [0, 4]);
    }

    /// What was held back is too old after a minute, at either edge.
    #[test]
    fn o1_end_is_not_told_what_is_old() {
        let arrive = |from_clock| Step::Arrive { from_clock };
        for (from_clock, opened) in [(-3840, 1), (-3841, 0), (3840, 1), (3841, 0)] {
            let steps = [arrive(from_clock), Step::Again { which: 0 }];
            assert_eq!(history(1000 * SECOND, &steps), [opened, 0]);
        }
    }

    type Opened = Result<HighWaterMarks<Flash<2>, 1>, MarksError>;

    fn open(own: &Credential, peer: Credential, flashes: Flashes) -> Opened {
        let (sent, accepted) = places(flashes);
        HighWaterMarks::open::<AesGcm>(own, &[peer], sent, accepted)
    }

    fn provisioned() -> Flashes {
        let (sent, accepted) = places(Flashes::default());
        let marks = HighWaterMarks::provision::<AesGcm>(&OWN, &[PEER], sent, accepted);
        let (sent, [accepted]) = Bench::new(marks.expect("blank"), 0).end.into_flashes();
        (sent, accepted)
    }

    /// No mark of another counter or key is taken for one's own, and a lost one is not taken for a new one.
    #[test]
    fn n1_end_marks_of_others_are_none() {
        let (sent, accepted) = provisioned();
        let other = |id, byte| Credential {
            key: [byte; 16],
            ..credential(id)
        };
        let of = |opened: Opened, id| {
            let unreadable = MarksError::Mark(SenderId(id), MarkError::Unreadable);
            assert_eq!(opened.err(), Some(unreadable));
        };
        let both = || (sent.clone(), accepted.clone());
        assert!(open(&OWN, PEER, both()).is_ok());
        of(open(&OWN, PEER, (accepted.clone(), sent.clone())), 7);
        of(open(&other(7, 9), PEER, both()), 7);
        of(open(&OWN, other(5, 9), both()), 5);
        of(open(&OWN, credential(6), both()), 6);
        // One key for both: the kind tells them apart.
        of(open(&PEER, PEER, both()), 5);
        let lost = |flashes, id| {
            let none = MarksError::Mark(SenderId(id), MarkError::NotProvisioned);
            assert_eq!(open(&OWN, PEER, flashes).err(), Some(none));
        };
        lost((Flash::default(), accepted.clone()), 7);
        lost((sent.clone(), Flash::default()), 5);
        let none = open(&OWN, PEER, Flashes::default()).err();
        assert_eq!(none, Some(MarksError::NotProvisioned));
    }

    /// Power cuts while marks are provisioned: the board starts, and no cut hides a mark that is in use.
    #[test]
    fn n1_end_provisioning_is_cut() {
        for cut in 0..30 {
            for chance in 0..16 {
                let mut flashes = (Flash::new(chance), Flash::new(chance + 99));
                // Four records of two words in the other flash, then four in this, then two in the other.
                match cut {
                    0..8 => flashes.1.cut_after(cut),
                    8..16 => flashes.0.cut_after(cut - 8),
                    _ => flashes.1.cut_after(cut - 8),
                }
                let (mut sent, mut accepted) = flashes;
                let (own, [other]) = places((sent.clone(), accepted.clone()));
                let region = own.1;
                let cut_one = HighWaterMarks::provision::<AesGcm>(
                    &OWN,
                    &[PEER],
                    (&mut sent, region),
                    [(&mut accepted, other.1)],
                );
                let whole = cut_one.is_ok();
                drop(cut_one);
                assert_eq!(whole, sent.has_power() && accepted.has_power());
                sent.restart();
                accepted.restart();
                let (own, others) = places((sent, accepted));
                let opened = HighWaterMarks::open::<AesGcm>(&OWN, &[PEER], own, others);
                let nothing =
                    cut == 0 && opened.as_ref().err() == Some(&MarksError::NotProvisioned);
                assert!(
                    nothing || opened.is_ok(),
                    "{cut}, {chance}: {:?}",
                    opened.err()
                );
            }
        }
    }
}
