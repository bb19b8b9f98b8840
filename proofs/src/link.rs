//! O1, N1 and F1 together, over whole histories: a vehicle and two stations, against a naive model.

use std::collections::BTreeSet;

use mavlink_commsec::hx::{Decoder, Frame, FrameKind};
use mavlink_commsec::{Cipher, Credential, EpochHeader, Opener, PackageHeader, Plaintext, Sealer};

use crate::cipher::Specified;
use crate::opening::{PASSED_OVER, WINDOW};

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
    /// An end is switched off and on again. It has marks in storage: one above what it sealed last, or the
    /// next epoch, and those that it accepted last.
    Restart {
        /// Which end, counted round.
        end: u8,
        /// How far above what it sealed last its mark is, or how often it was switched on in between.
        ahead: u8,
    },
}

/// A header, and how those who use it start again.
pub trait Linked: Specified {
    /// The mark of an end that has never been switched on, in a history that begins at `first`.
    fn first_mark(first: u32) -> u64;

    /// The mark after this run, which began with `mark`.
    fn next_mark<C: Cipher>(mark: u64, sealer: &Option<Sealer<C, Self>>, ahead: u8) -> u64;

    /// A sender that begins with `mark`, if it can.
    fn start<C: Cipher>(own: &Credential<Self::Id>, mark: u64) -> Option<Sealer<C, Self>>;

    /// A place below that of the first package after `mark`, and near it.
    fn before(mark: u64) -> Self::Sequence;

    /// A place as a number that no other has: the epoch from bit 32 on, and the counter.
    fn number(sequence: Self::Sequence) -> u64;
}

/// The mark is a counter above all that were used.
impl Linked for PackageHeader {
    fn first_mark(first: u32) -> u64 {
        first.into()
    }

    fn next_mark<C: Cipher>(_: u64, sealer: &Option<Sealer<C>>, ahead: u8) -> u64 {
        let next = sealer.as_ref().and_then(Sealer::next_counter);
        u64::from(next.unwrap_or(u32::MAX)) + u64::from(ahead)
    }

    fn start<C: Cipher>(own: &Credential, mark: u64) -> Option<Sealer<C>> {
        let first = mark.try_into().unwrap_or(u32::MAX);
        let key = own.prepare().expect("a key");
        Some(Sealer::resume(key, own.id, first))
    }

    fn before(mark: u64) -> u32 {
        mark.max(1) as u32 - 1
    }

    fn number(counter: u32) -> u64 {
        counter.into()
    }
}

/// The mark is the next epoch.
impl Linked for EpochHeader {
    fn first_mark(first: u32) -> u64 {
        // So that histories at the end of all counters are at the end of all epochs.
        (first >> 16).into()
    }

    fn next_mark<C: Cipher>(mark: u64, _: &Option<Sealer<C, Self>>, ahead: u8) -> u64 {
        mark + 1 + u64::from(ahead)
    }

    fn start<C: Cipher>(own: &Credential<Self::Id>, mark: u64) -> Option<Sealer<C, Self>> {
        let key = own.prepare().expect("a key");
        Sealer::begin(key, own.id, mark).ok()
    }

    fn before(mark: u64) -> Self::Sequence {
        Self::place_of(mark.max(1) as u16 - 1, 0)
    }

    fn number(sequence: Self::Sequence) -> u64 {
        sequence.to_number()
    }
}

/// What one end knows of another, in plain numbers and sets.
#[derive(Clone, Default)]
struct Heard {
    /// Everything up to here is rejected since the last start.
    floor: u64,
    /// Everything accepted, over all starts.
    accepted: BTreeSet<u64>,
    /// How many places were passed over since the last start.
    passed_over: u64,
}

impl Heard {
    fn newest(&self) -> u64 {
        self.floor.max(self.accepted.last().copied().unwrap_or(0))
    }

    /// What a package would add to the places passed over; `None` if it is not accepted.
    fn accepts(&self, number: u64) -> Option<u64> {
        let newest = self.newest();
        if number <= newest {
            let same_epoch = number >> 32 == newest >> 32;
            let late = newest - number <= WINDOW.into() && same_epoch && number > self.floor;
            return (late && !self.accepted.contains(&number)).then_some(0);
        }
        let jump = match ((number >> 32) - (newest >> 32), number & 0xFFFF_FFFF) {
            (0, _) => number - newest - 1,
            (epochs, counter) => epochs * 65_536 + counter.max(1) - 1,
        };
        (self.passed_over + jump <= PASSED_OVER).then_some(jump)
    }
}

/// What the naive model knows.
struct Naive {
    /// Everything sent: by whom, with which number.
    sent: Vec<(usize, u64)>,
    /// Every nonce: salt, sender, number.
    nonces: BTreeSet<(u32, usize, u64)>,
    /// What each end has heard of each.
    heard: [[Heard; ENDS]; ENDS],
}

impl Naive {
    fn new(floor: u64) -> Self {
        let heard = || Heard {
            floor,
            ..Heard::default()
        };
        Self {
            sent: Vec::new(),
            nonces: BTreeSet::new(),
            heard: [(); ENDS].map(|()| [(); ENDS].map(|()| heard())),
        }
    }

    /// Whether `to` accepts a package that arrives intact, which is then remembered.
    fn accepts(&mut self, to: usize, from: usize, number: u64) -> bool {
        let hears = to != from && (to == 0 || from == 0);
        let heard = &mut self.heard[to][from];
        let jump = heard.accepts(number).filter(|_| hears);
        if let Some(jump) = jump {
            heard.passed_over += jump;
            heard.accepted.insert(number);
        }
        jump.is_some()
    }

    /// `end` starts again, with marks above all that it has accepted.
    fn restart(&mut self, end: usize) {
        for heard in &mut self.heard[end] {
            heard.floor = heard.newest();
            heard.passed_over = 0;
        }
    }

    fn accepted(&self) -> usize {
        let heard = self.heard.as_flattened().iter();
        heard.map(|heard| heard.accepted.len()).sum()
    }
}

/// One end: what it seals with, if it can, what it opens with, and its serial line.
struct End<C: Cipher, H: Linked> {
    mark: u64,
    sealer: Option<Sealer<C, H>>,
    opener: Opener<2, C, H>,
    decoder: Decoder,
}

/// The id of the vehicle.
const VEHICLE: u32 = 7;

/// What the key file says of end `end`.
fn credential<H: Specified>(end: usize) -> Credential<H::Id> {
    let end = end as u8;
    Credential {
        id: H::id(VEHICLE + u32::from(end)),
        key: [end + 1; 16],
        salt: salt(end.into()),
    }
}

fn salt(end: usize) -> u32 {
    1000 + (end % 2) as u32
}

/// Whom `end` hears: a station the vehicle, the vehicle both stations.
fn peers<H: Specified>(end: usize) -> Vec<Credential<H::Id>> {
    let ends = if end == 0 { 1..ENDS } else { 0..1 };
    ends.map(credential::<H>).collect()
}

impl<C: Cipher, H: Linked> End<C, H> {
    fn start(end: usize, mark: u64, last: impl Fn(H::Id) -> H::Sequence) -> Self {
        Self {
            mark,
            sealer: H::start(&credential::<H>(end), mark),
            opener: Opener::from_credentials(&peers::<H>(end), last).expect("there is room"),
            decoder: Decoder::new(),
        }
    }

    fn restart(&mut self, end: usize, ahead: u8) {
        let mark = H::next_mark(self.mark, &self.sealer, ahead);
        let lasts: Vec<_> = self.opener.senders().collect();
        let last = |sender| {
            let mut known = lasts.iter();
            known.find(|(id, _)| *id == sender).expect("known").1
        };
        *self = Self::start(end, mark, last);
    }

    /// What is accepted of the packages in `line`: from whom, with which number, and the message.
    fn receive(&mut self, line: &[u8]) -> Vec<(usize, u64, Plaintext)> {
        let mut accepted = Vec::new();
        for byte in line {
            let Some(Ok(frame)) = self.decoder.push(*byte) else {
                continue;
            };
            if frame.kind() != FrameKind::AirData {
                continue;
            }
            if let Ok(opened) = self.opener.open(frame.payload()) {
                let from = (opened.sender().into().0 - VEHICLE) as usize;
                accepted.push((from, H::number(opened.sequence()), *opened.plaintext()));
            }
        }
        accepted
    }
}

/// The message of the package that is the `number`th of all.
fn message(number: usize) -> Plaintext {
    core::array::from_fn(|at| (number * 31 + at) as u8)
}

/// O1, N1 and F1 in every history: no nonce is used twice, whichever end restarts. No end accepts a
/// package twice, or one that was not made for it, or one that was damaged. Every package that arrives
/// intact, and is newer than those accepted of its sender, or not too far behind them, is accepted, with the
/// message that was sealed; unless too many were passed over. Returns how many were accepted.
///
/// Every end counts from `first`, or begins with an epoch that is made of it.
///
/// # Panics
///
/// If the property does not hold.
#[must_use]
pub fn history<C: Cipher, H: Linked>(first: u32, steps: &[Step]) -> usize {
    let mark = H::first_mark(first);
    let mut ends: [End<C, H>; ENDS] =
        core::array::from_fn(|end| End::start(end, mark, |_| H::before(mark)));
    let mut naive = Naive::new(H::number(H::before(mark)));
    let mut lines: Vec<Vec<u8>> = Vec::new();
    for step in steps {
        match *step {
            Step::Send { from } => {
                let from = usize::from(from) % ENDS;
                let Some(sealer) = &mut ends[from].sealer else {
                    continue;
                };
                let sequence = sealer.next_sequence();
                let sealed = sealer.seal(&message(lines.len()));
                assert_eq!(sealed.is_ok(), sequence.is_some());
                if let (Ok(package), Some(sequence)) = (sealed, sequence) {
                    // What it was sealed under stands in front of it.
                    let header = package.as_bytes().first_chunk().expect("96 bytes");
                    assert_eq!(H::read(*header), (credential::<H>(from).id, sequence));
                    let number = H::number(sequence);
                    assert!(
                        naive.nonces.insert((salt(from), from, number)),
                        "a nonce twice"
                    );
                    naive.sent.push((from, number));
                    lines.push(Frame::from(&package).encode().collect());
                }
            }
            Step::Deliver { back } => {
                let Some(sent) = which(lines.len(), back) else {
                    continue;
                };
                let (from, number) = naive.sent[sent];
                for (to, end) in ends.iter_mut().enumerate() {
                    let accepted = end.receive(&lines[sent]);
                    let mut expected = Vec::new();
                    if naive.accepts(to, from, number) {
                        expected.push((from, number, message(sent)));
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
                naive.restart(end);
            }
        }
    }
    naive.accepted()
}

fn which(count: usize, back: u8) -> Option<usize> {
    count.checked_sub(usize::from(back) + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_storage::nor_flash::NorFlash as _;
    use mavlink_commsec::AesGcm;
    use mavseal_store::{Binding, HighWaterMark, MarkError, Region};

    use crate::mark::{Cut, Small};

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
        let run = std::panic::catch_unwind(|| {
            if seed.is_multiple_of(4) {
                history::<AesGcm, EpochHeader>(first, &steps)
            } else {
                history::<AesGcm, PackageHeader>(first, &steps)
            }
        });
        run.unwrap_or_else(|_| panic!("history {seed}: {first}, {steps:?}"))
    }

    /// 100,000 histories, a quarter of them with epochs, two at a time.
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
        let check = |steps: &[Step]| {
            let accepted = history::<AesGcm, PackageHeader>(1, steps);
            assert_eq!(history::<AesGcm, EpochHeader>(1, steps), accepted);
            accepted
        };
        // The vehicle's package is accepted by both stations, a station's by the vehicle.
        assert_eq!(check(&[send(0), deliver(0)]), 2);
        assert_eq!(check(&[send(1), deliver(0), send(2), deliver(0)]), 2);
        // Twice, overtaken, and lost.
        assert_eq!(check(&[send(1), deliver(0), deliver(0)]), 1);
        let overtaken = [send(1), send(1), deliver(0), deliver(1), deliver(1)];
        assert_eq!(check(&overtaken), 2);
        assert_eq!(check(&[send(1), send(1), deliver(0)]), 1);
        // Damaged, and then whole.
        let damage = Step::Damage { back: 0, bit: 400 };
        assert_eq!(check(&[send(1), damage, deliver(0)]), 1);
        // After a restart of either end nothing is accepted again, and what is new is.
        let restart = |end, ahead| Step::Restart { end, ahead };
        let again = [send(1), deliver(0), restart(0, 0), deliver(0)];
        assert_eq!(check(&again), 1);
        // Nor what was overtaken before it.
        let late = [send(1), send(1), deliver(0), restart(0, 0), deliver(1)];
        assert_eq!(check(&late), 1);
        let new = [send(1), deliver(0), restart(1, 200), send(1), deliver(0)];
        assert_eq!(check(&new), 2);
        // At the end of all counters nothing is sent.
        let last = [send(1), deliver(0), send(1), deliver(0)];
        assert_eq!(history::<AesGcm, PackageHeader>(u32::MAX - 1, &last), 1);
        assert_eq!(history::<AesGcm, PackageHeader>(u32::MAX, &last), 0);
        // And none in the epoch behind the last.
        assert_eq!(history::<AesGcm, EpochHeader>(0xFFFE_0000, &new), 1);
        assert_eq!(history::<AesGcm, EpochHeader>(0xFFFF_0000, &last), 0);
    }

    /// Epochs from a mark in flash, one for each start and stored before it is used, while the power fails
    /// anywhere: none is used twice.
    #[test]
    fn n1_epochs_of_a_mark_in_flash() {
        let region = Region {
            start: 0,
            page_size: Small::ERASE_SIZE as u32,
        };
        let binding = Binding::new(0x45, [1, 2, 3, 4]);
        let mut random = fastrand::Rng::with_seed(8);
        let (mut begun, mut failed) = (0, 0);
        for _ in 0..200 {
            let mut flash = Small::default();
            let mut used = BTreeSet::new();
            for _ in 0..40 {
                flash.restart(Cut {
                    after: random.u8(..20),
                    left: random.u32(..).to_le_bytes(),
                });
                // A cut before the first mark was whole has used nothing.
                let mark = match HighWaterMark::open(&mut flash, region, binding) {
                    Err(MarkError::NotProvisioned) if used.is_empty() => {
                        HighWaterMark::provision(&mut flash, region, binding, 0).ok()
                    }
                    opened => opened.ok(),
                };
                let Some(mut mark) = mark else {
                    failed += 1;
                    continue;
                };
                let epoch = mark.get();
                if mark.reserve(epoch, 0).is_err() {
                    failed += 1;
                    continue;
                }
                let own = credential::<EpochHeader>(0);
                let sealer = EpochHeader::start::<AesGcm>(&own, epoch).expect("an epoch is left");
                assert!(used.insert(sealer.next_sequence().expect("a counter is left").epoch));
                begun += 1;
            }
        }
        assert!(
            begun > 1000 && failed > 1000,
            "{begun} begun, {failed} failed"
        );
    }

    /// Every bit of a frame, changed before the frame itself arrives.
    #[test]
    fn f1_history_of_each_bit() {
        for bit in 0..8 * 195 {
            let damage = Step::Damage { back: 0, bit };
            let steps = [Step::Send { from: 0 }, damage, Step::Deliver { back: 0 }];
            assert_eq!(history::<AesGcm, PackageHeader>(1, &steps), 2);
            assert_eq!(history::<AesGcm, EpochHeader>(1, &steps), 2);
        }
    }
}
