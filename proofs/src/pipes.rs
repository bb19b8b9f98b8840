//! L1 over whole streams: the relay between pipes in memory, against its parts in sequence.

use std::collections::VecDeque;
use std::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavlink_signing::{
    DecodeError, Decoder, Frame, KeyRing, KeySlot, Packet, Profile, ReplayGuard, Resync,
    SigningKey, Stamper, Timestamp, Window, dialect,
};
use mavseal_relay::{
    Counters, ForwardMode, Forwarded, RejectReason, Relay, Senders, Signer, Verifier, adapter,
};

/// The link id of what the relay signs.
pub const LINK_OUT: u8 = 1;
/// The link id of what it accepts.
pub const LINK_IN: u8 = 2;

/// What both ports allow in one turn of the relay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub struct Turn {
    /// Bytes that arrive on the plain and on the link side.
    pub arrive: [u8; 2],
    /// Bytes that the local and the link side take.
    pub room: [u8; 2],
}

/// One side's port.
struct Pipe {
    /// What will arrive, and how much of it has.
    input: VecDeque<u8>,
    arrived: usize,
    output: Vec<u8>,
    room: usize,
}

impl Pipe {
    fn new(input: &[u8]) -> Self {
        Self {
            input: input.iter().copied().collect(),
            arrived: 0,
            output: Vec::new(),
            room: 0,
        }
    }

    fn turn(&mut self, arrive: usize, room: usize) {
        self.arrived = self.arrived.saturating_add(arrive).min(self.input.len());
        self.room = room;
    }
}

impl ErrorType for Pipe {
    type Error = Infallible;
}

impl ReadReady for Pipe {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.arrived > 0)
    }
}

impl Read for Pipe {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        assert!(self.arrived > 0, "the relay never waits for input");
        let count = buffer.len().min(self.arrived);
        for (slot, byte) in buffer.iter_mut().zip(self.input.drain(..count)) {
            *slot = byte;
        }
        self.arrived -= count;
        Ok(count)
    }
}

impl WriteReady for Pipe {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.room > 0)
    }
}

impl Write for Pipe {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        assert!(self.room > 0, "the relay never waits for output");
        let count = bytes.len().min(self.room);
        self.output.extend(&bytes[..count]);
        self.room -= count;
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// L1 over whole streams, whatever arrives on both sides, in whatever pieces, and however much each side
/// takes at a time. Each direction hands on exactly what its part makes of the packets found, in order
/// and complete, and counts the rest. The clock stands at `now`.
///
/// `senders` are those that are signed for. `keys` makes the key each time, as it cannot be copied. Returns the counters, plain to secure first.
///
/// # Panics
///
/// If the property does not hold.
pub fn pipes<P: Profile>(
    keys: impl Fn() -> SigningKey<P>,
    forward: ForwardMode,
    senders: Senders,
    now: Timestamp,
    local: &[u8],
    link: &[u8],
    turns: &[Turn],
) -> [Counters; 2] {
    let replay = || ReplayGuard::new(LINK_IN, Window::STRICT);
    let relay = Relay::new(keys(), Stamper::new(LINK_OUT), replay(), forward);
    let mut relay = relay.expect("two link ids").senders(senders);
    let (mut local_pipe, mut link_pipe) = (Pipe::new(local), Pipe::new(link));
    let mut clock = || now;
    for turn in turns {
        local_pipe.turn(turn.arrive[0].into(), turn.room[0].into());
        link_pipe.turn(turn.arrive[1].into(), turn.room[1].into());
        let polled = adapter::poll(
            &mut relay,
            &mut local_pipe,
            &mut link_pipe,
            &mut clock,
            &mut |_| {},
        );
        assert!(polled.outbound.is_ok() && polled.inbound.is_ok());
    }
    loop {
        local_pipe.turn(usize::MAX, usize::MAX);
        link_pipe.turn(usize::MAX, usize::MAX);
        let polled = adapter::poll(
            &mut relay,
            &mut local_pipe,
            &mut link_pipe,
            &mut clock,
            &mut |_| {},
        );
        if !polled.moved() {
            break;
        }
    }

    let mut keys = KeyRing::from(keys());
    let mut signer = Signer::new(Stamper::new(LINK_OUT)).for_senders(senders);
    let signed = in_sequence(Resync::Silence, local, |packet| {
        signer.sign(packet, &keys, &mut { now })
    });
    let mut verifier = Verifier::new(KeySlot::A, replay(), forward);
    let verified = in_sequence(Resync::NextByte, link, |packet| {
        match verifier.verify(packet, &mut keys, &mut { now })? {
            Forwarded::Verified(frame) => Ok(frame),
            Forwarded::Unsigned(_) => panic!("handed on without a policy"),
        }
    });
    assert_eq!(link_pipe.output, signed.output);
    assert_eq!(local_pipe.output, verified.output);
    let counted = [*relay.outbound(), *relay.inbound()];
    for (counters, expected) in counted.iter().zip([signed, verified]) {
        assert_eq!(counters.passed(), expected.passed);
        assert_eq!(counters.dropped(), expected.dropped);
        for (reason, count) in counters.rejections() {
            let rejected = expected.rejected.iter().filter(|other| **other == reason);
            assert_eq!(count as usize, rejected.count(), "{reason}");
        }
    }
    counted
}

/// What one direction makes of a stream that comes in one piece.
#[derive(Default)]
struct Expected {
    output: Vec<u8>,
    passed: u32,
    rejected: Vec<RejectReason>,
    dropped: u32,
}

fn in_sequence(
    resync: Resync,
    mut stream: &[u8],
    mut treat: impl FnMut(Packet<'_>) -> Result<Frame, RejectReason>,
) -> Expected {
    let mut decoder = Decoder::new(resync, dialect::crc_extra);
    let mut expected = Expected::default();
    while !stream.is_empty() {
        stream = &stream[decoder.write(stream)..];
        while let Some(found) = decoder.read() {
            match found
                .map_err(|error: DecodeError| error.into())
                .and_then(&mut treat)
            {
                Ok(frame) => {
                    expected.passed += 1;
                    expected.output.extend(frame.as_bytes());
                }
                Err(rejection) => expected.rejected.push(rejection),
            }
        }
    }
    expected.dropped = decoder.dropped();
    expected
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use mavlink_signing::{Hmac, Stamp, sign_frame};
    use proptest::prelude::*;

    const NOW: u64 = 5_000_000;

    fn key() -> SigningKey<Hmac> {
        SigningKey::new(&[7; 32]).expect("a key")
    }

    fn at(ticks: u64) -> Timestamp {
        Timestamp::from_ticks(ticks).expect("48 bits")
    }

    /// Frames, signed for a link or not, damaged or not, and noise.
    fn stream() -> impl Strategy<Value = Vec<u8>> {
        let frame = (
            proptest::collection::vec(any::<u8>(), 0..=255),
            proptest::option::of((1..3_u8, NOW - 5..NOW + 2)),
            any::<prop::sample::Index>(),
            proptest::bool::weighted(0.2),
        )
            .prop_map(|(payload, signature, place, damaged)| {
                let mut frame = Frame::new(HEARTBEAT, &payload).expect("a frame");
                if let Some((link_id, ticks)) = signature {
                    let timestamp = at(ticks);
                    sign_frame(&mut frame, &key(), Stamp { link_id, timestamp }).expect("signed");
                }
                let mut bytes = frame.as_bytes().to_vec();
                let place = place.index(bytes.len());
                bytes[place] ^= u8::from(damaged);
                bytes
            });
        let noise = proptest::collection::vec(any::<u8>(), 0..40);
        proptest::collection::vec(prop_oneof![4 => frame, 1 => noise], 0..8)
            .prop_map(|parts| parts.concat())
    }

    fn turn() -> impl Strategy<Value = Turn> {
        (any::<[u8; 2]>(), any::<[u8; 2]>()).prop_map(|(arrive, room)| Turn { arrive, room })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn l1_pipes(
            local in stream(),
            link in stream(),
            turns in proptest::collection::vec(turn(), 0..40),
            whole: bool,
            any: bool,
        ) {
            let forward = if whole { ForwardMode::KeepSignature } else { ForwardMode::StripSignature };
            let senders = if any { Senders::Any } else { Senders::FirstHeartbeat };
            pipes(key, forward, senders, at(NOW), &local, &link, &turns);
        }
    }

    /// What went in signed on the link side comes out; nothing of it is signed again.
    #[test]
    fn l1_pipes_pass() {
        let mut frame = Frame::new(HEARTBEAT, &[1, 2, 3]).expect("a frame");
        let local = frame.as_bytes().to_vec();
        let timestamp = at(NOW);
        let stamp = Stamp {
            link_id: LINK_IN,
            timestamp,
        };
        sign_frame(&mut frame, &key(), stamp).expect("signed");
        let link = frame.as_bytes().repeat(2);
        let [out, back] = pipes(
            key,
            ForwardMode::KeepSignature,
            Senders::FirstHeartbeat,
            timestamp,
            &local,
            &link,
            &[],
        );
        assert_eq!(out.passed(), 1);
        assert_eq!(
            (back.passed(), back.rejected(RejectReason::Replayed)),
            (1, 1)
        );
    }
}
