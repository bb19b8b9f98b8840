//! V1: a frame is accepted if and only if every condition holds.

use mavlink_signing::dialect::crc_extra;
use mavlink_signing::field::{CHECKSUM_SIZE, HEADER_SIZE, SIGNATURE_SIZE, TAG_SIZE};
use mavlink_signing::{
    FrameRef, KEY_SIZE, KeyError, MessageId, Profile, SigningKey, Tag, Timestamp, VerifyError,
    authenticate,
};

use crate::model::Resumed;

/// V1: [`authenticate`] and [`ReplayGuard::admit`](mavlink_signing::ReplayGuard::admit) give the verdict
/// of `specified`, which reads the bytes naively. Header, payload and bytes that come out are the
/// frame's. What is rejected changes nothing.
///
/// `checksum` and `tag` are what the code under test computes, or the models that stand for it.
/// Returns the verdict.
///
/// # Errors
///
/// The verdict, where it is a rejection.
///
/// # Panics
///
/// If the property does not hold.
pub fn accepted_iff<P: Profile>(
    bytes: &[u8],
    key: &SigningKey<P>,
    before: Resumed,
    now: Timestamp,
    checksum: impl Fn(&[u8], u8) -> u16,
    tag: impl Fn(&[u8]) -> Tag,
) -> Result<Timestamp, VerifyError> {
    let frame = FrameRef::parse(bytes)?;
    let expected = specified(frame.as_bytes(), before, now, checksum, tag);
    let mut after = before.replay();
    let verdict = authenticate(frame, key).and_then(|authentic| after.admit(authentic, now));
    match verdict {
        Ok(verified) => {
            assert_eq!(expected, Ok(verified.stamp().timestamp));
            assert_eq!(verified.payload().len(), bytes[1] as usize);
            assert_eq!(verified.payload().as_ptr(), bytes[HEADER_SIZE..].as_ptr());
            assert_eq!(verified.as_bytes().len(), frame.as_bytes().len());
            assert_eq!(verified.as_bytes().as_ptr(), bytes.as_ptr());
            assert_eq!(verified.header(), frame.header());
            assert_eq!(verified.stamp().link_id, before.link_id);
            assert_eq!(after.last(), Some(verified.stamp().timestamp));
        }
        Err(error) => {
            assert_eq!(expected, Err(error));
            assert_eq!(after, before.replay());
        }
    }
    expected
}

/// SHA-256 of nothing, as FIPS 180-4's examples and everybody's tables have it: two halves of it.
const OF_NO_PASSPHRASE: [u128; 2] = [
    0xe3b0_c442_98fc_1c14_9afb_f4c8_996f_b924,
    0x27ae_41e4_649b_934c_a495_991b_7852_b855,
];

/// V1: a key is taken if and only if it is neither zeros alone, nor 0xFF alone, nor that of the empty pass-phrase; the
/// error names which.
///
/// # Panics
///
/// If the property does not hold.
#[must_use]
pub fn key_is_taken<P: Profile>(secret: &[u8; KEY_SIZE]) -> Option<SigningKey<P>> {
    let key = SigningKey::new(secret);
    let halves = [0, KEY_SIZE / 2].map(|at| {
        let half = secret[at..].first_chunk().expect("16 bytes");
        u128::from_be_bytes(*half)
    });
    let expected = match halves {
        [0, 0] => Some(KeyError::AllZero),
        [u128::MAX, u128::MAX] => Some(KeyError::Erased),
        OF_NO_PASSPHRASE => Some(KeyError::EmptyPassphrase),
        _ => None,
    };
    assert_eq!(key.as_ref().err(), expected.as_ref());
    key.ok()
}

/// The verdict on a whole frame, condition by condition; the timestamp if it is accepted.
fn specified(
    frame: &[u8],
    receiver: Resumed,
    now: Timestamp,
    checksum: impl Fn(&[u8], u8) -> u16,
    tag: impl Fn(&[u8]) -> Tag,
) -> Result<Timestamp, VerifyError> {
    if frame[2] != 1 {
        return Err(VerifyError::NotSigned);
    }
    let id = MessageId::from_le_bytes([frame[7], frame[8], frame[9]]);
    let Some(crc_extra) = crc_extra(id) else {
        return Err(VerifyError::UnknownMessage(id));
    };
    let crc_at = frame.len() - SIGNATURE_SIZE - CHECKSUM_SIZE;
    let crc = u16::from_le_bytes([frame[crc_at], frame[crc_at + 1]]);
    if checksum(&frame[1..crc_at], crc_extra) != crc {
        return Err(VerifyError::BadChecksum);
    }
    let expected = tag(&frame[..frame.len() - TAG_SIZE]);
    if frame.last_chunk() != Some(&expected) {
        return Err(VerifyError::BadTag);
    }
    let [link_id, a, b, c, d, e, f, ..] = *frame
        .last_chunk::<SIGNATURE_SIZE>()
        .expect("long enough for a signature");
    if link_id != receiver.link_id {
        return Err(VerifyError::WrongLink(link_id));
    }
    let ticks = [f, e, d, c, b, a]
        .into_iter()
        .fold(0, |ticks, byte| ticks << 8 | u64::from(byte));
    if ticks > now.ticks() && ticks - now.ticks() > receiver.window.ahead {
        return Err(VerifyError::FromFuture);
    }
    if ticks < now.ticks() && now.ticks() - ticks > receiver.window.past {
        return Err(VerifyError::TooOld);
    }
    if ticks < receiver.first.ticks() {
        return Err(VerifyError::Replayed);
    }
    Ok(Timestamp::from_ticks(ticks).expect("6 bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use crate::model::Witness;
    use mavlink_signing::crc::checksum;
    use mavlink_signing::{Frame, Hmac, Stamp, Window, passphrase_key, sign_frame};
    use proptest::prelude::*;

    const KEY: [u8; 32] = [7; 32];

    fn signed(payload: &[u8], link_id: u8, ticks: u64) -> Vec<u8> {
        let mut frame = Frame::new(HEARTBEAT, payload).expect("a frame");
        let stamp = Stamp {
            link_id,
            timestamp: Timestamp::from_ticks(ticks).expect("48 bits"),
        };
        let key = SigningKey::<Hmac>::new(&KEY).expect("a key");
        sign_frame(&mut frame, &key, stamp).expect("signed");
        frame.as_bytes().to_vec()
    }

    fn check(bytes: &[u8], before: Resumed, now: u64) {
        let key = SigningKey::<Hmac>::new(&KEY).expect("a key");
        let tag = |covered: &[u8]| <Hmac>::new(&KEY).tag(covered);
        let now = Timestamp::from_ticks(now).expect("48 bits");
        let _ = accepted_iff(bytes, &key, before, now, checksum, tag);
    }

    proptest! {
        /// Moments so close that every verdict on time is likely.
        #[test]
        fn v1_random(
            payload in proptest::collection::vec(any::<u8>(), 0..=255),
            link_id in 0..3_u8,
            times: [u8; 3],
            past in 0..200_u64,
            ahead in 0..200_u64,
            // Often no damage, else one byte.
            damage in proptest::option::of((any::<prop::sample::Index>(), 1..=255_u8)),
        ) {
            let [stamp, now, first] = times.map(|tick| 1_000 + u64::from(tick));
            let mut bytes = signed(&payload, link_id, stamp);
            if let Some((at, flip)) = damage {
                let at = at.index(bytes.len());
                bytes[at] ^= flip;
            }
            let first = Timestamp::from_ticks(first).expect("48 bits");
            check(&bytes, Resumed { link_id: 1, window: Window { past, ahead }, first }, now);
        }
    }

    /// S2, the receiver's half: every byte under the tag is witnessed, and none of the tag.
    #[test]
    fn s2_received() {
        let window = Window { past: 0, ahead: 0 };
        for length in [0, 1, 9, 37, 255] {
            for index in 0..length + 25 {
                let key = SigningKey::<Witness>::new(&Witness::key(index)).expect("a key");
                let mut frame = Frame::new(HEARTBEAT, &vec![0x5A; length.into()]).expect("a frame");
                let stamp = Stamp {
                    link_id: 1,
                    timestamp: Timestamp::from_ticks(0x0102_0304_0506).expect("48 bits"),
                };
                sign_frame(&mut frame, &key, stamp).expect("signed");
                let before = Resumed {
                    link_id: 1,
                    window,
                    first: Timestamp::ZERO,
                };
                // The sender has asked for a tag once already: a receiver has a key of its own.
                let key = SigningKey::<Witness>::new(&Witness::key(index)).expect("a key");
                let tag = |covered: &[u8]| Witness::first_tag(index, covered);
                let now = stamp.timestamp;
                let verdict = accepted_iff(frame.as_bytes(), &key, before, now, checksum, tag);
                assert_eq!(verdict, Ok(now));
            }
        }
    }

    #[test]
    fn v1_keys() {
        for none in [[0; KEY_SIZE], [0xFF; KEY_SIZE], passphrase_key("")] {
            assert!(key_is_taken::<Hmac>(&none).is_none());
            for place in 0..KEY_SIZE {
                for bit in 0..8 {
                    let mut secret = none;
                    secret[place] ^= 1 << bit;
                    assert!(key_is_taken::<Hmac>(&secret).is_some());
                }
            }
        }
    }

    #[test]
    fn v1_edges_of_time() {
        let max = Timestamp::MAX.ticks();
        let moments = [0, 1, 5, 6, max - 6, max - 5, max - 1, max];
        for stamp in moments {
            let bytes = signed(&[1, 2, 3], 1, stamp);
            for now in moments {
                for first in moments {
                    let first = Timestamp::from_ticks(first).expect("48 bits");
                    for (past, ahead) in [(0, 0), (5, 0), (0, 5), (u64::MAX, u64::MAX)] {
                        check(
                            &bytes,
                            Resumed {
                                link_id: 1,
                                window: Window { past, ahead },
                                first,
                            },
                            now,
                        );
                    }
                }
            }
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::{AnyTag, Witness, any_checksum, any_prefix, any_timestamp, checksum_calls};
    use mavlink_signing::field::MAX_FRAME_SIZE;

    #[kani::proof]
    #[kani::unwind(33)]
    #[kani::stub(mavlink_signing::crc::checksum, any_checksum)]
    fn v1_accepted_iff() {
        let bytes: [u8; MAX_FRAME_SIZE] = kani::any();
        let bytes = any_prefix(&bytes);
        let secret: [u8; 32] = kani::any();
        let Some(key) = key_is_taken::<AnyTag>(&secret) else {
            return;
        };
        let tag = |_: &[u8]| {
            [
                secret[0], secret[1], secret[2], secret[3], secret[4], secret[5],
            ]
        };
        let verdict = accepted_iff(
            bytes,
            &key,
            Resumed::any(),
            any_timestamp(),
            any_checksum,
            tag,
        );

        // Once by the code, once by the specification; about other bytes the answers would differ.
        assert!(matches!(checksum_calls(), 0 | 2));
        kani::cover!(verdict.is_ok(), "accepted");
        kani::cover!(
            verdict.is_ok() && bytes.len() == MAX_FRAME_SIZE,
            "the longest"
        );
        kani::cover!(verdict == Err(VerifyError::BadChecksum), "damaged");
        kani::cover!(verdict == Err(VerifyError::BadTag), "forged");
        kani::cover!(
            matches!(verdict, Err(VerifyError::WrongLink(_))),
            "wrong link"
        );
        kani::cover!(verdict == Err(VerifyError::FromFuture), "from the future");
        kani::cover!(verdict == Err(VerifyError::TooOld), "too old");
        kani::cover!(
            verdict == Err(VerifyError::Replayed),
            "every condition but the last"
        );
    }

    #[kani::proof]
    #[kani::unwind(33)]
    #[kani::stub(mavlink_signing::crc::checksum, any_checksum)]
    fn s2_tag_covers_what_was_received() {
        let bytes: [u8; MAX_FRAME_SIZE] = kani::any();
        let bytes = any_prefix(&bytes);
        let index = kani::any();
        let key = SigningKey::<Witness>::new(&Witness::key(index)).expect("a key");
        let tag = |covered: &[u8]| Witness::first_tag(index, covered);
        let verdict = accepted_iff(
            bytes,
            &key,
            Resumed::any(),
            any_timestamp(),
            any_checksum,
            tag,
        );
        kani::cover!(verdict.is_ok() && index == 0, "the first byte");
        kani::cover!(
            verdict.is_ok() && index == 273,
            "the last byte of the longest frame"
        );
        kani::cover!(
            verdict.is_ok() && usize::from(index) == bytes.len() - 6,
            "none of the tag"
        );
    }
}
