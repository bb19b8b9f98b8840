//! Target: a receiver of several senders.

use std::collections::BTreeSet;

use arbitrary::Arbitrary;
use mavlink_signing::field::{HEADER_SIZE, TAG_SIZE};
use mavlink_signing::{
    AntiReplay, Frame, FrameRef, Header, Links, Stamp, Stream, StreamTable, Timestamp, VerifyError,
    authenticate, sign_frame,
};
use mavseal_proofs::model::Resumed;
use mavseal_proofs::streams::{reflected, step};
use mavseal_relay::RejectReason;

use crate::input::{Head, Receiver};
use crate::repair::KEY;

/// A frame that arrives.
#[derive(Arbitrary, Clone, Copy, Debug)]
pub struct Arrival {
    /// How far the receiver's clock jumps before: not at all, or 2^(n - 1) ticks either way, n
    /// counted round 48 of them.
    pub jump: i8,
    /// Whose frame it is: 2 bits each for link, system and component.
    pub sender: u8,
    /// How many ticks after the receiver's clock it is stamped.
    pub after: i16,
    /// Modulo 8: 3 the receiver's own, reflected; 4 not signed; 5 forged; 6 damaged; 7 instead one
    /// that is remembered, `sender` before the last; mostly authentic.
    pub kind: u8,
}

/// What arrives at a receiver, from its mark on.
#[derive(Arbitrary, Clone, Debug)]
pub struct Arrivals {
    /// Its window and mark, and the link that it may take alone.
    pub receiver: Receiver,
    /// Whether it takes that link alone.
    pub only: bool,
    /// How many rows it has: 1, 2, 4; modulo 3.
    pub rows: u8,
    /// What arrives.
    pub arrivals: Vec<Arrival>,
}

/// The naive model: every frame that was ever accepted, and what is known of each stream.
struct Naive {
    links: Links,
    receiver: Resumed,
    room: usize,
    /// All that were accepted, in order.
    accepted: Vec<(Stream, Timestamp)>,
    rows: Vec<(Stream, Timestamp)>,
    /// The first tick that is fresh in every stream.
    floor: u64,
    /// Systems and links that this end has signed for.
    own: [BTreeSet<u8>; 2],
}

impl Naive {
    /// The verdict on an authentic frame.
    fn receive(&mut self, frame: (Stream, Timestamp), now: Timestamp) -> Result<(), VerifyError> {
        let (stream, stamped) = frame;
        let age = i128::from(now.ticks()) - i128::from(stamped.ticks());
        let Resumed { window, .. } = self.receiver;
        let last = self.rows.iter().find(|(of, _)| *of == stream);
        if !self.takes(stream) {
            Err(VerifyError::WrongLink(stream.link_id))
        } else if self.is_own(stream) {
            Err(VerifyError::Reflected)
        } else if -age > window.ahead.into() {
            Err(VerifyError::FromFuture)
        } else if age > window.past.into() {
            Err(VerifyError::TooOld)
        } else if stamped.ticks() < self.floor || last.is_some_and(|(_, last)| stamped <= *last) {
            Err(VerifyError::Replayed)
        } else {
            assert!(!self.accepted.contains(&frame), "accepted twice");
            self.accepted.push(frame);
            self.remember(frame);
            Ok(())
        }
    }

    fn remember(&mut self, frame: (Stream, Timestamp)) {
        if let Some(row) = self.rows.iter_mut().find(|(of, _)| *of == frame.0) {
            row.1 = frame.1;
        } else {
            self.rows.push(frame);
        }
        if self.rows.len() > self.room {
            // Of several oldest ones the first; but the new one only if no other is as old.
            let key = |at: &usize| (self.rows[*at].1, *at);
            let oldest = (0..self.rows.len()).min_by_key(key).expect("one at least");
            let given_up = if self.rows[oldest].1 == frame.1 {
                self.room
            } else {
                oldest
            };
            let (_, last) = self.rows.swap_remove(given_up);
            self.floor = self.floor.max(last.ticks() + 1);
        }
    }

    fn send(&mut self, stream: Stream) {
        self.own[0].insert(stream.system_id);
        self.own[1].insert(stream.link_id);
    }

    /// An end signs for one link; if it does not, for all of them.
    fn is_own(&self, stream: Stream) -> bool {
        let [systems, links] = &self.own;
        systems.contains(&stream.system_id) && (links.len() > 1 || links.contains(&stream.link_id))
    }

    fn takes(&self, stream: Stream) -> bool {
        self.links == Links::Any || self.links == Links::Only(stream.link_id)
    }
}

/// Frames of several streams, authentic, reflected or neither, in any order, while the clock jumps: every
/// verdict is that of a naive model, which knows all that was ever accepted, and so are every row and the floor after
/// it (R2).
pub fn streams_model(input: Arrivals) {
    match input.rows % 3 {
        0 => run::<1>(&input),
        1 => run::<2>(&input),
        _ => run::<4>(&input),
    }
}

fn run<const N: usize>(input: &Arrivals) {
    let receiver = Resumed::from(input.receiver);
    let first = receiver.first;
    let links = [Links::Any, Links::Only(receiver.link_id)][usize::from(input.only)];
    let mut streams = StreamTable::<N>::resume(links, receiver.window, first);
    let mut naive = Naive {
        links,
        receiver,
        room: N,
        accepted: Vec::new(),
        rows: Vec::new(),
        floor: first.ticks(),
        own: [BTreeSet::new(), BTreeSet::new()],
    };
    let mut now = first;
    for arrival in &input.arrivals {
        now = jump(now, arrival.jump);
        let kind = arrival.kind % 8;
        let again = naive
            .accepted
            .iter()
            .nth_back(arrival.sender.into())
            .copied();
        let new = (sender(arrival.sender), move_by(now, arrival.after.into()));
        let Some(frame) = (if kind == 7 { again } else { Some(new) }) else {
            continue;
        };
        let [link_id, system_id, component_id] = ids(frame.0);
        let header = Header {
            system_id,
            component_id,
            ..Head::default().into()
        };
        let timestamp = frame.1;
        let stamp = Stamp { link_id, timestamp };
        let verdict = match kind {
            3 => {
                naive.send(frame.0);
                Err(reflected(&mut streams, &KEY, header, stamp, now))
            }
            4..=7 => receive(&made(header, stamp, kind), &mut streams, now),
            _ => step(&mut streams, &KEY, header, stamp, now),
        };
        let expected = match kind {
            4 => Err(VerifyError::NotSigned),
            5 => Err(VerifyError::BadTag),
            6 => Err(VerifyError::BadChecksum),
            _ => naive.receive(frame, now),
        };
        assert_eq!(verdict, expected);
        let reason = verdict.err().map(RejectReason::from);
        assert_ne!(reason, Some(RejectReason::Other));
        let rows = naive.rows.iter();
        assert!(streams.rows().eq(rows.map(|(of, last)| (*of, Some(*last)))));
        assert_eq!(streams.floor(), Timestamp::from_ticks(naive.floor));
        assert_eq!(streams.is_own(link_id, system_id), naive.is_own(frame.0));
    }
}

const fn ids(stream: Stream) -> [u8; 3] {
    [stream.link_id, stream.system_id, stream.component_id]
}

/// The stream that 6 bits stand for; its ids are as far from each other as they can be.
fn sender(bits: u8) -> Stream {
    let id = |bits: u8| [0, 1, 0x80, 0xFF][usize::from(bits & 3)];
    Stream {
        link_id: id(bits),
        system_id: id(bits >> 2),
        component_id: id(bits >> 4),
    }
}

pub(crate) fn jump(clock: Timestamp, jump: i8) -> Timestamp {
    match jump.unsigned_abs() {
        0 => clock,
        n => move_by(clock, i64::from(jump.signum()) << ((n - 1) % 48)),
    }
}

/// Neither before the beginning of time nor beyond its end.
pub(crate) fn move_by(clock: Timestamp, ticks: i64) -> Timestamp {
    let moved = clock.ticks().saturating_add_signed(ticks);
    Timestamp::ZERO.saturating_add(moved)
}

/// A frame: 4 without signature; 5 forged; 6 damaged.
fn made(header: Header, stamp: Stamp, kind: u8) -> Vec<u8> {
    let mut frame = Frame::new(header, &[7]).expect("a known message");
    if kind != 4 {
        sign_frame(&mut frame, &KEY, stamp).expect("not signed yet");
    }
    let mut bytes = frame.as_bytes().to_vec();
    let tag = bytes.len() - TAG_SIZE;
    match kind {
        5 => bytes[tag] ^= 1,
        6 => bytes[HEADER_SIZE] ^= 1,
        _ => {}
    }
    bytes
}

/// As a relay asks for it: the verdict beforehand is the verdict, and what is unsigned is not remembered.
fn receive(bytes: &[u8], streams: &mut impl AntiReplay, now: Timestamp) -> Result<(), VerifyError> {
    let frame = FrameRef::parse(bytes)?;
    if !frame.is_signed() {
        streams.record_sent(frame);
    }
    let authentic = authenticate(frame, &KEY)?;
    let expected = streams.check(&authentic, now);
    let verdict = streams.admit(authentic, now).map(drop);
    assert_eq!(verdict, expected);
    verdict
}
