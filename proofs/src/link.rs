//! O1, N1 and F1 together, over whole histories: a vehicle and two stations, against a naive model.

use std::collections::BTreeSet;

use mavlink_commsec::hx::{Decoder, Frame, Tag};
use mavlink_commsec::{Cipher, Credential, Message, Opener, Sealer, SenderId};

/// How many ends a link has: a vehicle, 0, and two stations, 1 and 2.
pub const ENDS: usize = 3;

/// What may happen on a link. What is sent and never delivered is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub enum Step {
    /// An end seals a message and sends the package.
    Send {
        /// Which end, counted round.
        from: u8,
    },
    /// A package arrives at all ends, for the first time or again.
    Deliver {
        /// Which one: 0 is the last that was sent, 1 the one before.
        back: u8,
    },
    /// A package arrives at all ends, with one bit of its frame changed.
    Damage {
        /// Which one.
        back: u8,
        /// Which bit, counted round the frame.
        bit: u16,
    },
    /// A byte that nobody sent arrives at all ends.
    Noise {
        /// The byte.
        byte: u8,
    },
    /// An end is switched off and on again. It has marks in storage: one above what it sealed last, and
    /// those that it accepted last.
    Restart {
        /// Which end, counted round.
        end: u8,
        /// How far above what it sealed last its mark is.
        ahead: u8,
    },
}

/// What the naive model knows, in plain numbers and sets.
#[derive(Default)]
struct Naive {
    /// Everything sent: by whom, with which counter.
    sent: Vec<(usize, u32)>,
    /// Every nonce: salt, sender, counter.
    nonces: BTreeSet<(u32, u32, u32)>,
    /// Everything accepted: by whom, from whom, with which counter.
    accepted: BTreeSet<(usize, usize, u32)>,
}

impl Naive {
    /// Whether `to` accepts a package that arrives intact: it is newer than all before.
    fn accepts(&self, to: usize, from: usize, counter: u32) -> bool {
        let hears = to != from && (to == 0 || from == 0);
        let before =
            |(by, of, old): &(usize, usize, u32)| *by == to && *of == from && *old >= counter;
        hears && !self.accepted.iter().any(before)
    }
}

/// One end: what it seals with, what it opens with, and its serial line.
struct End<C: Cipher> {
    sealer: Sealer<C>,
    opener: Opener<2, C>,
    decoder: Decoder,
}

/// What the key file says of end `end`.
fn credential(end: usize) -> Credential {
    let end = end as u8;
    Credential {
        id: SenderId(u32::from(end) + 7),
        key: [end + 1; 16],
        salt: 1000 + u32::from(end % 2),
    }
}

/// Whom `end` hears: a station the vehicle, the vehicle both stations.
fn peers(end: usize) -> Vec<Credential> {
    let ends = if end == 0 { 1..ENDS } else { 0..1 };
    ends.map(credential).collect()
}

impl<C: Cipher> End<C> {
    fn start(end: usize, first: u32, last: impl Fn(SenderId) -> u32) -> Self {
        let own = credential(end);
        let key = own.prepare().expect("a key");
        Self {
            sealer: Sealer::resume(key, own.id, first),
            opener: Opener::of(&peers(end), last).expect("there is room"),
            decoder: Decoder::new(),
        }
    }

    fn restart(&mut self, end: usize, ahead: u8) {
        let next = self.sealer.next_counter().unwrap_or(u32::MAX);
        let lasts: Vec<_> = self.opener.senders().collect();
        let last = |sender| {
            let mut known = lasts.iter();
            known.find(|(id, _)| *id == sender).expect("known").1
        };
        *self = Self::start(end, next.saturating_add(ahead.into()), last);
    }

    /// What is accepted of the packages in `line`: from whom, with which counter, and the message.
    fn receive(&mut self, line: &[u8]) -> Vec<(usize, u32, Message)> {
        let mut accepted = Vec::new();
        for byte in line {
            let Some(Ok(frame)) = self.decoder.push(*byte) else {
                continue;
            };
            if frame.tag() != Tag::AirData {
                continue;
            }
            if let Ok(opened) = self.opener.open(frame.payload()) {
                let from = (opened.sender().0 - 7) as usize;
                accepted.push((from, opened.counter(), *opened.message()));
            }
        }
        accepted
    }
}

/// The message of the package that is the `number`th of all.
fn message(number: usize) -> Message {
    core::array::from_fn(|at| (number * 31 + at) as u8)
}

/// O1, N1 and F1 in every history: no nonce is used twice, whoever restarts; no end accepts a package
/// twice, or one that was not made for it, or one that was damaged; and every package that arrives intact
/// and is newer than those accepted of its sender is accepted, with the message that was sealed. Returns
/// how many were accepted.
///
/// Every end counts from `first`.
///
/// # Panics
///
/// If the property does not hold.
#[must_use]
pub fn history<C: Cipher>(first: u32, steps: &[Step]) -> usize {
    let mut ends: [End<C>; ENDS] = core::array::from_fn(|end| End::start(end, first, |_| 0));
    let mut naive = Naive::default();
    let mut lines: Vec<Vec<u8>> = Vec::new();
    for step in steps {
        match *step {
            Step::Send { from } => {
                let from = usize::from(from) % ENDS;
                let sealer = &mut ends[from].sealer;
                let counter = sealer.next_counter();
                let sealed = sealer.seal(&message(lines.len()));
                assert_eq!(sealed.is_ok(), counter.is_some());
                if let (Ok(package), Some(counter)) = (sealed, counter) {
                    let Credential { id, salt, .. } = credential(from);
                    assert!(naive.nonces.insert((salt, id.0, counter)), "a nonce twice");
                    naive.sent.push((from, counter));
                    lines.push(Frame::from(&package).encode().collect());
                }
            }
            Step::Deliver { back } => {
                let Some(sent) = which(lines.len(), back) else {
                    continue;
                };
                let (from, counter) = naive.sent[sent];
                for (to, end) in ends.iter_mut().enumerate() {
                    let accepted = end.receive(&lines[sent]);
                    let mut expected = Vec::new();
                    if naive.accepts(to, from, counter) {
                        naive.accepted.insert((to, from, counter));
                        expected.push((from, counter, message(sent)));
                    }
                    assert_eq!(accepted, expected, "at {to}");
                }
            }
            Step::Damage { back, bit } => {
                let Some(sent) = which(lines.len(), back) else {
                    continue;
                };
                let mut line = lines[sent].clone();
                let bit = usize::from(bit) % (8 * line.len());
                line[bit / 8] ^= 1 << (bit % 8);
                for end in &mut ends {
                    assert_eq!(end.receive(&line), [], "bit {bit}");
                }
            }
            Step::Noise { byte } => {
                for end in &mut ends {
                    assert_eq!(end.receive(&[byte]), []);
                }
            }
            Step::Restart { end, ahead } => {
                let end = usize::from(end) % ENDS;
                ends[end].restart(end, ahead);
            }
        }
    }
    naive.accepted.len()
}

fn which(count: usize, back: u8) -> Option<usize> {
    count.checked_sub(usize::from(back) + 1)
}

#[cfg(test)]
mod twins {
    use super::*;
    use mavlink_commsec::AesGcm;

    /// A step, and what it is about: in order, twice, late.
    fn step(random: &mut fastrand::Rng) -> Step {
        let back = |random: &mut fastrand::Rng| match random.u8(..5) {
            back @ 1..=2 => 3 * back - random.u8(0..3),
            _ => 0,
        };
        match random.u8(..14) {
            0..5 => Step::Send {
                from: random.u8(..3),
            },
            5..11 => Step::Deliver { back: back(random) },
            11 => Step::Damage {
                back: back(random),
                bit: random.u16(..),
            },
            12 => Step::Noise {
                byte: match random.u8(..4) {
                    0 => 0x7E,
                    1 => 0x7C,
                    2 => random.u8(..2),
                    _ => random.u8(..),
                },
            },
            _ => Step::Restart {
                end: random.u8(..3),
                ahead: random.u8(..),
            },
        }
    }

    /// The history number `seed`, with the real cipher; what it is, if the property does not hold.
    fn run(seed: u64) -> usize {
        let mut random = fastrand::Rng::with_seed(seed);
        let first = match random.u8(..10) {
            0 => random.u32(..),
            1 => u32::MAX - random.u32(..10),
            _ => 1,
        };
        let count = random.usize(..24);
        let steps: Vec<_> = (0..count).map(|_| step(&mut random)).collect();
        let run = std::panic::catch_unwind(|| history::<AesGcm>(first, &steps));
        run.unwrap_or_else(|_| panic!("history {seed}: {first}, {steps:?}"))
    }

    /// 100,000 histories, two at a time.
    #[test]
    fn o1_histories() {
        let half = |from: u64| move || (from..from + 50_000).map(run).sum::<usize>();
        let other = std::thread::spawn(half(50_000));
        let accepted = half(0)() + other.join().expect("every history");
        assert!(accepted > 200_000, "{accepted} accepted");
    }

    /// One history of each kind, counted by hand.
    #[test]
    fn n1_history_by_hand() {
        let send = |from| Step::Send { from };
        let deliver = |back| Step::Deliver { back };
        let check = |steps: &[Step]| history::<AesGcm>(1, steps);
        // The vehicle's package is accepted by both stations, a station's by the vehicle.
        assert_eq!(check(&[send(0), deliver(0)]), 2);
        assert_eq!(check(&[send(1), deliver(0), send(2), deliver(0)]), 2);
        // Twice, late, and lost.
        assert_eq!(check(&[send(1), deliver(0), deliver(0)]), 1);
        assert_eq!(check(&[send(1), send(1), deliver(0), deliver(1)]), 1);
        assert_eq!(check(&[send(1), send(1), deliver(0)]), 1);
        // Damaged, and then whole.
        let damage = Step::Damage { back: 0, bit: 400 };
        assert_eq!(check(&[send(1), damage, deliver(0)]), 1);
        // After a restart of either end nothing is accepted again, and what is new is.
        let restart = |end, ahead| Step::Restart { end, ahead };
        let again = [send(1), deliver(0), restart(0, 0), deliver(0)];
        assert_eq!(check(&again), 1);
        let new = [send(1), deliver(0), restart(1, 200), send(1), deliver(0)];
        assert_eq!(check(&new), 2);
        // At the end of all counters nothing is sent.
        let last = [send(1), deliver(0), send(1), deliver(0)];
        assert_eq!(history::<AesGcm>(u32::MAX - 1, &last), 1);
        assert_eq!(history::<AesGcm>(u32::MAX, &last), 0);
    }

    /// Every bit of a frame, changed before the frame itself arrives.
    #[test]
    fn f1_history_of_each_bit() {
        for bit in 0..8 * 195 {
            let damage = Step::Damage { back: 0, bit };
            let steps = [Step::Send { from: 0 }, damage, Step::Deliver { back: 0 }];
            assert_eq!(history::<AesGcm>(1, &steps), 2);
        }
    }
}
