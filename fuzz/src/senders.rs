//! Target: a receiver of several senders.

use mavlink_signing::field::TAG_SIZE;
use mavlink_signing::{
    AntiReplay, Frame, FrameRef, Header, Links, MessageId, Stamp, Stream, StreamTable, Timestamp,
    VerifyError, Window, authenticate, sign_frame,
};
use mavseal_proofs::model::Resumed;
use mavseal_proofs::streams::{reflected, step};
use mavseal_relay::RejectReason;

use crate::input::{Receiver, input};
use crate::reached::reached;
use crate::repair::KEY;

input! {
    /// A frame that arrives.
    #[derive(Copy, Default)]
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
}

input! {
    /// What arrives at a receiver, from its mark on.
    #[derive(Default)]
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
}

/// The naive model: every frame that was ever accepted, or sent while there was room for its stream.
struct Naive {
    links: Links,
    window: Window,
    first: Timestamp,
    room: usize,
    seen: Vec<(Stream, Timestamp)>,
    /// The streams that had their first frame from this end.
    own: Vec<Stream>,
    /// The links on which a stream of this end's has no row.
    closed: Vec<u8>,
}

impl Naive {
    /// The verdict on an authentic frame.
    fn receive(
        &mut self,
        stream: Stream,
        stamped: Timestamp,
        now: Timestamp,
    ) -> Result<(), VerifyError> {
        let age = i128::from(now.ticks()) - i128::from(stamped.ticks());
        let mut of = self.seen.iter().filter(|(of, _)| *of == stream);
        if !self.takes(stream) {
            Err(VerifyError::WrongLink(stream.link_id))
        } else if -age > self.window.ahead.into() {
            Err(VerifyError::FromFuture)
        } else if age > self.window.past.into() {
            Err(VerifyError::TooOld)
        } else if stamped < self.first || of.any(|(_, last)| stamped <= *last) {
            Err(VerifyError::Replayed)
        } else if !self.has_room(stream) {
            Err(VerifyError::StreamsFull)
        } else {
            self.seen.push((stream, stamped));
            Ok(())
        }
    }

    fn send(&mut self, stream: Stream, stamped: Timestamp) {
        if !self.takes(stream) {
            return;
        }
        let rows = self.rows();
        if rows.iter().all(|(of, _)| *of != stream) {
            if rows.len() >= self.room || self.own.len() >= self.room / 2 {
                self.closed.push(stream.link_id);
                return;
            }
            self.own.push(stream);
        }
        self.seen.push((stream, stamped));
    }

    fn takes(&self, stream: Stream) -> bool {
        self.links == Links::Any || self.links == Links::Only(stream.link_id)
    }

    fn has_room(&self, stream: Stream) -> bool {
        let rows = self.rows();
        let closed = match self.closed.first() {
            None => false,
            Some(first) => *first == stream.link_id || self.closed.iter().any(|it| it != first),
        };
        (rows.len() < self.room && !closed) || rows.iter().any(|(of, _)| *of == stream)
    }

    /// Each stream, and when the newest of its frames was stamped.
    fn rows(&self) -> Vec<(Stream, Timestamp)> {
        let mut rows: Vec<(Stream, Timestamp)> = Vec::new();
        for (stream, stamped) in &self.seen {
            match rows.iter_mut().find(|(of, _)| of == stream) {
                Some((_, last)) => *last = *stamped.max(last),
                None => rows.push((*stream, *stamped)),
            }
        }
        rows
    }
}

/// Frames of several streams, authentic, reflected or neither, in any order, while the clock jumps: every
/// verdict is that of a naive model, and so is every row after it (R2).
pub fn streams_model(input: &Arrivals) {
    match input.rows % 3 {
        0 => run::<1>(input),
        1 => run::<2>(input),
        _ => run::<4>(input),
    }
}

fn run<const N: usize>(input: &Arrivals) {
    let Resumed {
        link_id,
        window,
        first,
    } = input.receiver.into();
    let links = if input.only {
        Links::Only(link_id)
    } else {
        Links::Any
    };
    let mut streams = StreamTable::<N>::resume(links, window, first);
    let mut naive = Naive {
        links,
        window,
        first,
        room: N,
        seen: Vec::new(),
        own: Vec::new(),
        closed: Vec::new(),
    };
    let mut now = first;
    for arrival in &input.arrivals {
        now = jump(now, arrival.jump);
        let kind = arrival.kind % 8;
        let frame = match kind {
            7 => naive.seen.iter().nth_back(arrival.sender.into()).copied(),
            _ => Some((sender(arrival.sender), move_by(now, arrival.after.into()))),
        };
        let Some((stream, timestamp)) = frame else {
            continue;
        };
        let header = Header {
            compat_flags: 0,
            sequence: 0,
            system_id: stream.system_id,
            component_id: stream.component_id,
            message_id: MessageId::from(0),
        };
        let stamp = Stamp {
            link_id: stream.link_id,
            timestamp,
        };
        let (verdict, expected) = match kind {
            3 => {
                naive.send(stream, timestamp);
                let rejection = reflected(&mut streams, &KEY, header, stamp, now);
                (Err(rejection), naive.receive(stream, timestamp, now))
            }
            4..=6 => {
                let (bytes, rejection) = spoilt(header, stamp, kind);
                (receive(&bytes, &mut streams, now), Err(rejection))
            }
            7 => {
                let mut frame = Frame::new(header, &[]).expect("a known message");
                sign_frame(&mut frame, &KEY, stamp).expect("not signed yet");
                let verdict = receive(frame.as_bytes(), &mut streams, now);
                (verdict, naive.receive(stream, timestamp, now))
            }
            _ => {
                let verdict = step(&mut streams, first, &KEY, header, stamp, now);
                (verdict, naive.receive(stream, timestamp, now))
            }
        };
        assert_eq!(verdict, expected);
        reached(verdict.map_err(RejectReason::from));
        reached(verdict);
        let rows = naive.rows().into_iter();
        assert!(streams.rows().eq(rows.map(|(of, last)| (of, Some(last)))));
    }
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

/// A frame that is not authentic, and the verdict on it.
fn spoilt(header: Header, stamp: Stamp, kind: u8) -> (Vec<u8>, VerifyError) {
    let mut frame = Frame::new(header, &[7]).expect("a known message");
    if kind == 4 {
        return (frame.as_bytes().to_vec(), VerifyError::NotSigned);
    }
    sign_frame(&mut frame, &KEY, stamp).expect("not signed yet");
    let mut bytes = frame.as_bytes().to_vec();
    let tag = bytes.len() - TAG_SIZE;
    if kind == 5 {
        bytes[tag] ^= 1;
        (bytes, VerifyError::BadTag)
    } else {
        bytes[10] ^= 1;
        (bytes, VerifyError::BadChecksum)
    }
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
