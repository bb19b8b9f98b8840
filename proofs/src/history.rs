//! R1 and T1 together, over whole histories: what a link accepts, against a naive model.

use mavlink_signing::{
    Frame, FrameRef, Profile, ReplayGuard, SigningKey, Stamper, Timestamp, VerifyError, Window,
    authenticate, sign_frame,
};

use crate::model::HEARTBEAT;

/// What may happen on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub enum Step {
    /// The sender signs a frame.
    Sign {
        /// Bytes of its payload.
        payload_length: u8,
    },
    /// A frame arrives, for the first time or again.
    Deliver {
        /// Which one: 0 is the last that was signed, 1 the one before.
        back: u8,
    },
    /// A frame arrives with one bit changed.
    Damage {
        /// Which one.
        back: u8,
        /// Which bit, counted round the frame.
        bit: u16,
    },
    /// The sender's clock jumps.
    SenderClock {
        /// By so many ticks of 10 microseconds.
        ticks: i64,
    },
    /// The receiver's clock jumps.
    ReceiverClock {
        /// By so many ticks of 10 microseconds.
        ticks: i64,
    },
}

/// The naive model: everything that was ever signed and accepted, in plain numbers.
struct Naive {
    sender: i64,
    receiver: i64,
    window: Window,
    signed: Vec<i64>,
    accepted: Vec<i64>,
}

impl Naive {
    /// The stamp of the next frame, if one is left.
    fn sign(&mut self) -> Option<i64> {
        let next = self.signed.last().map_or(0, |last| last + 1);
        let stamp = next.max(self.sender);
        (stamp < 1 << 48).then(|| {
            self.signed.push(stamp);
            stamp
        })
    }

    /// The verdict on an undamaged frame.
    fn receive(&mut self, stamp: i64) -> Result<(), VerifyError> {
        let age = self.receiver - stamp;
        if -age > self.window.ahead as i64 {
            return Err(VerifyError::FromFuture);
        }
        if age > self.window.past as i64 {
            return Err(VerifyError::TooOld);
        }
        if self.accepted.iter().any(|accepted| stamp <= *accepted) {
            return Err(VerifyError::Replayed);
        }
        self.accepted.push(stamp);
        Ok(())
    }
}

/// R1 and T1 in every history: the sender's stamps and the receiver's verdicts are those of a naive
/// model. A frame with a changed bit is rejected. Returns how many frames were accepted.
///
/// Both clocks begin 10 seconds after `start`; the window takes 10 seconds either way.
///
/// # Panics
///
/// If the property does not hold.
pub fn history<P: Profile>(key: &SigningKey<P>, start: Timestamp, steps: &[Step]) -> usize {
    let window = Window {
        past: 1_000_000,
        ahead: 1_000_000,
    };
    let mut stamper = Stamper::new(1);
    let mut replay = ReplayGuard::new(1, window);
    let mut frames = Vec::new();
    let clock = start.saturating_add(1_000_000).ticks() as i64;
    let mut naive = Naive {
        sender: clock,
        receiver: clock,
        window,
        signed: Vec::new(),
        accepted: Vec::new(),
    };
    for step in steps {
        match *step {
            Step::Sign { payload_length } => {
                let stamp = stamper.stamp(at(naive.sender)).ok();
                let expected = naive.sign();
                assert_eq!(stamp.map(|stamp| stamp.timestamp), expected.map(at));
                if let Some(stamp) = stamp {
                    let payload = [0x5A; 255];
                    let payload = &payload[..payload_length.into()];
                    let mut frame = Frame::new(HEARTBEAT, payload).expect("a known message");
                    sign_frame(&mut frame, key, stamp).expect("not signed yet");
                    frames.push(frame);
                }
            }
            Step::Deliver { back } => {
                if let Some(sent) = which(frames.len(), back) {
                    let verdict = receive(
                        frames[sent].as_bytes(),
                        key,
                        &mut replay,
                        at(naive.receiver),
                    );
                    assert_eq!(verdict, naive.receive(naive.signed[sent]));
                }
            }
            Step::Damage { back, bit } => {
                if let Some(sent) = which(frames.len(), back) {
                    let mut bytes = frames[sent].as_bytes().to_vec();
                    let bit = usize::from(bit) % (8 * bytes.len());
                    bytes[bit / 8] ^= 1 << (bit % 8);
                    let verdict = receive(&bytes, key, &mut replay, at(naive.receiver));
                    assert!(verdict.is_err(), "bit {bit}");
                }
            }
            Step::SenderClock { ticks } => naive.sender = jump(naive.sender, ticks),
            Step::ReceiverClock { ticks } => naive.receiver = jump(naive.receiver, ticks),
        }
        let last = naive.accepted.last().copied().map(at);
        assert_eq!(replay.last(), last);
    }
    naive.accepted.len()
}

fn at(ticks: i64) -> Timestamp {
    Timestamp::from_ticks(ticks as u64).expect("48 bits")
}

fn jump(clock: i64, ticks: i64) -> i64 {
    clock.saturating_add(ticks).clamp(0, (1 << 48) - 1)
}

fn which(count: usize, back: u8) -> Option<usize> {
    count.checked_sub(usize::from(back) + 1)
}

fn receive<P: Profile>(
    bytes: &[u8],
    key: &SigningKey<P>,
    replay: &mut ReplayGuard,
    now: Timestamp,
) -> Result<(), VerifyError> {
    let authentic = authenticate(FrameRef::parse(bytes)?, key)?;
    replay.admit(authentic, now).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_signing::Hmac;
    use proptest::prelude::*;

    fn step() -> impl Strategy<Value = Step> {
        let ticks = prop_oneof![-5..5_i64, -1_000_001..1_000_001_i64, any::<i64>()];
        prop_oneof![
            4 => any::<u8>().prop_map(|payload_length| Step::Sign { payload_length }),
            6 => (0..6_u8).prop_map(|back| Step::Deliver { back }),
            2 => (0..6_u8, any::<u16>()).prop_map(|(back, bit)| Step::Damage { back, bit }),
            1 => ticks.clone().prop_map(|ticks| Step::SenderClock { ticks }),
            1 => ticks.prop_map(|ticks| Step::ReceiverClock { ticks }),
        ]
    }

    fn check(start: Timestamp, steps: &[Step]) -> usize {
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        history(&key, start, steps)
    }

    proptest! {
        #[test]
        fn r1_history(
            steps in proptest::collection::vec(step(), 0..60),
            start in prop_oneof![Just(0), 0..1_u64 << 48],
        ) {
            check(Timestamp::from_ticks(start).expect("48 bits"), &steps);
        }
    }

    /// At the end of time the last stamp is given once.
    #[test]
    fn t1_history_ends() {
        let sign = Step::Sign { payload_length: 3 };
        let deliver = Step::Deliver { back: 0 };
        let accepted = check(Timestamp::MAX, &[sign, sign, deliver, deliver]);
        assert_eq!(accepted, 1);
    }

    #[test]
    fn r1_history_of_each_verdict() {
        let sign = Step::Sign { payload_length: 3 };
        let deliver = |back| Step::Deliver { back };
        let later = Step::ReceiverClock { ticks: 1_000_001 };
        let earlier = Step::ReceiverClock { ticks: -2_000_002 };
        let steps = [sign, sign, deliver(0), deliver(1), deliver(0)];
        assert_eq!(check(Timestamp::ZERO, &steps), 1);
        let steps = [sign, later, deliver(0), earlier, deliver(0)];
        assert_eq!(
            check(Timestamp::from_ticks(5_000_000).expect("48 bits"), &steps),
            0
        );
    }
}
