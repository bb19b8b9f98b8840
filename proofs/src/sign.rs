//! S1, S2, V3: what signing writes, what the tag covers, and that it verifies.

use mavlink_signing::field::{CHECKSUM_SIZE, HEADER_SIZE, SIGNATURE_SIZE, TAG_SIZE};
use mavlink_signing::{
    Frame, FrameRef, Header, Profile, ReplayGuard, SignError, SigningKey, Stamp, Tag, Window,
    authenticate, dialect, sign_frame,
};

/// S1: signing sets the flag, computes a new checksum and appends link id, timestamp and tag. Every
/// other byte stays. Signing again is rejected and changes nothing.
///
/// S2, the sender's half: the tag is the one over exactly the bytes before it, asked for once.
///
/// `checksum` and `tag` are what the code under test computes, or the models that stand for it;
/// `index` is the byte that is compared.
///
/// # Panics
///
/// If the property does not hold.
pub fn signs_in_place<P: Profile>(
    header: Header,
    payload: &[u8],
    key: &SigningKey<P>,
    stamp: Stamp,
    index: usize,
    checksum: impl Fn(&[u8], u8) -> u16,
    tag: impl Fn(&[u8]) -> Tag,
) {
    let before = Frame::new(header, payload).expect("a known message");
    let mut frame = Frame::new(header, payload).expect("the same");
    assert!(!frame.is_signed());
    assert_eq!(sign_frame(&mut frame, key, stamp), Ok(()));
    assert!(frame.is_signed());

    let (bytes, before) = (frame.as_bytes(), before.as_bytes());
    let crc_at = HEADER_SIZE + payload.len();
    let signature_at = crc_at + CHECKSUM_SIZE;
    let tag_at = signature_at + SIGNATURE_SIZE - TAG_SIZE;
    assert_eq!(bytes.len(), tag_at + TAG_SIZE);
    assert_eq!(bytes[2], before[2] | 1);
    if index < crc_at && index != 2 {
        assert_eq!(bytes[index], before[index]);
    }
    let crc_extra = dialect::crc_extra(header.message_id).expect("a known message");
    let crc = checksum(&bytes[1..crc_at], crc_extra);
    assert_eq!([bytes[crc_at], bytes[crc_at + 1]], crc.to_le_bytes());
    assert_eq!(bytes[signature_at], stamp.link_id);
    let ticks = stamp.timestamp.ticks().to_le_bytes();
    let written = tag(&bytes[..tag_at]);
    for i in 0..6 {
        assert_eq!(bytes[signature_at + 1 + i], ticks[i]);
        assert_eq!(bytes[tag_at + i], written[i]);
    }

    let kept = (bytes.len(), bytes.get(index).copied());
    let again = sign_frame(&mut frame, key, stamp);
    assert_eq!(again, Err(SignError::AlreadySigned));
    let bytes = frame.as_bytes();
    assert_eq!((bytes.len(), bytes.get(index).copied()), kept);
}

/// S2: what a signed frame says, its header, stamp and payload, is a matter of its transcript alone, the
/// bytes before its tag. With another tag in place of its own, `bytes` say the same. So two frames with
/// equal transcripts say the same. `index` is the byte of the payload that is compared.
///
/// Returns the frame's length; `None` if `bytes` do not begin with a signed frame.
///
/// # Panics
///
/// If the property does not hold.
pub fn transcript_says_all(bytes: &mut [u8], other: Tag, index: usize) -> Option<usize> {
    let (length, said) = what_is_said(bytes, index)?;
    for i in 0..TAG_SIZE {
        bytes[length - TAG_SIZE + i] = other[i];
    }
    assert_eq!(what_is_said(bytes, index), Some((length, said)));
    Some(length)
}

/// A signed frame's length, and its header, stamp, length of the payload and byte of it.
#[expect(clippy::type_complexity, reason = "compared once, as a whole")]
fn what_is_said(bytes: &[u8], index: usize) -> Option<(usize, (Header, Stamp, u8, Option<u8>))> {
    let frame = FrameRef::parse(bytes).ok()?;
    let stamp = frame.signature()?.stamp;
    let bytes = frame.as_bytes();
    let byte = (index < bytes[1].into()).then(|| bytes[HEADER_SIZE + index]);
    Some((bytes.len(), (frame.header(), stamp, bytes[1], byte)))
}

/// V3: what is signed verifies, with the same key, at the moment of its stamp, by a receiver of its link
/// that has accepted nothing. What comes out is what went in. `index` is the byte of the payload that is
/// compared.
///
/// # Panics
///
/// If the property does not hold.
pub fn signed_verifies<P: Profile>(
    header: Header,
    payload: &[u8],
    key: &SigningKey<P>,
    stamp: Stamp,
    index: usize,
) {
    let mut frame = Frame::new(header, payload).expect("a known message");
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    let received = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
    let authentic = authenticate(received, key).expect("signed with this key");
    let mut replay = ReplayGuard::new(stamp.link_id, Window::STRICT);
    let verified = replay.admit(authentic, stamp.timestamp).expect("in time");
    assert_eq!(verified.header(), header);
    assert_eq!(verified.stamp(), stamp);
    assert_eq!(verified.payload().len(), payload.len());
    if index < payload.len() {
        assert_eq!(verified.payload()[index], payload[index]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use crate::model::Witness;
    use mavlink_signing::crc::checksum;
    use mavlink_signing::{Hmac, Timestamp};
    use proptest::prelude::*;

    const KEY: [u8; 32] = [7; 32];

    fn stamp(link_id: u8, ticks: u64) -> Stamp {
        Stamp {
            link_id,
            timestamp: Timestamp::from_ticks(ticks).expect("48 bits"),
        }
    }

    /// S1, with the real tag.
    fn s1(payload: &[u8], stamp: Stamp) {
        let key = SigningKey::<Hmac>::new(&KEY).expect("a key");
        let tag = |covered: &[u8]| <Hmac>::new(&KEY).tag(covered);
        for index in 0..payload.len() + 25 {
            signs_in_place(HEARTBEAT, payload, &key, stamp, index, checksum, tag);
        }
    }

    /// S2: every byte under the tag is witnessed.
    fn s2(payload: &[u8], stamp: Stamp) {
        for index in 0..payload.len() as u16 + 25 {
            let key = SigningKey::<Witness>::new(&Witness::key(index)).expect("a key");
            let tag = |covered: &[u8]| Witness::first_tag(index, covered);
            signs_in_place(HEARTBEAT, payload, &key, stamp, 0, checksum, tag);
        }
    }

    fn v3(payload: &[u8], stamp: Stamp) {
        let key = SigningKey::<Hmac>::new(&KEY).expect("a key");
        for index in 0..payload.len() {
            signed_verifies(HEARTBEAT, payload, &key, stamp, index);
        }
    }

    fn edges(check: impl Fn(&[u8], Stamp)) {
        for length in [0, 1, 9, 30, 36, 37, 254, 255] {
            check(&vec![0xA5; length], stamp(0xFF, (1 << 48) - 1));
            check(&vec![0x5A; length], stamp(0, 0));
        }
    }

    #[test]
    fn s1_edges() {
        edges(s1);
    }

    #[test]
    fn s2_edges() {
        edges(s2);
    }

    #[test]
    fn s2_transcript() {
        let key = SigningKey::<Hmac>::new(&KEY).expect("a key");
        for length in 0..=255 {
            let mut frame = Frame::new(HEARTBEAT, &vec![0xA5; length]).expect("a frame");
            sign_frame(&mut frame, &key, stamp(1, 0x0102_0304_0506)).expect("signed");
            for index in 0..=length {
                let mut bytes = frame.as_bytes().to_vec();
                let said = transcript_says_all(&mut bytes, [0x5A; 6], index);
                assert_eq!(said, Some(length + 25));
            }
        }
    }

    #[test]
    fn v3_edges() {
        edges(v3);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]

        #[test]
        fn s1_random(
            payload in proptest::collection::vec(any::<u8>(), 0..=255),
            link_id: u8,
            ticks in 0..1_u64 << 48,
        ) {
            s1(&payload, stamp(link_id, ticks));
        }

        #[test]
        fn s2_random(
            payload in proptest::collection::vec(any::<u8>(), 0..=255),
            link_id: u8,
            ticks in 0..1_u64 << 48,
        ) {
            s2(&payload, stamp(link_id, ticks));
        }

        #[test]
        fn v3_random(
            payload in proptest::collection::vec(any::<u8>(), 0..=255),
            link_id: u8,
            ticks in 0..1_u64 << 48,
        ) {
            v3(&payload, stamp(link_id, ticks));
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::HEARTBEAT;
    use crate::model::any_stamp;
    use crate::model::{AnyTag, Witness, any_checksum};
    use mavlink_signing::field::MAX_FRAME_SIZE;

    fn signs<const LENGTH: usize>() {
        let payload: [u8; LENGTH] = kani::any();
        let chosen = kani::any();
        let key = SigningKey::<Witness>::new(&Witness::key(chosen)).expect("a key");
        let tag = |covered: &[u8]| Witness::first_tag(chosen, covered);
        let index = kani::any();
        let stamp = any_stamp();
        signs_in_place(HEARTBEAT, &payload, &key, stamp, index, any_checksum, tag);
        kani::cover!(
            usize::from(chosen) == LENGTH + 18,
            "the last byte that is covered"
        );
        kani::cover!(index == LENGTH + 24, "the last byte of the frame");
    }

    crate::model::for_payload_lengths! { signs:
        s1_signs_in_place_0 0 unwind 33,
        s1_signs_in_place_1 1 unwind 33,
        s1_signs_in_place_9 9 unwind 36,
        s1_signs_in_place_30 30 unwind 57,
        s1_signs_in_place_255 255 unwind 282,
    }

    #[kani::proof]
    #[kani::unwind(9)]
    fn s2_transcript_says_all() {
        let mut bytes: [u8; MAX_FRAME_SIZE] = kani::any();
        let said = transcript_says_all(&mut bytes, kani::any(), kani::any());
        kani::cover!(said == Some(MAX_FRAME_SIZE), "the longest frame");
        kani::cover!(said == Some(25), "the shortest frame");
    }

    fn verifies<const LENGTH: usize>() {
        let payload: [u8; LENGTH] = kani::any();
        let mut secret: [u8; 32] = kani::any();
        secret[31] = 1;
        let key = SigningKey::<AnyTag>::new(&secret).expect("a key");
        let index: usize = kani::any();
        signed_verifies(HEARTBEAT, &payload, &key, any_stamp(), index);
        kani::cover!(true, "it ends");
    }

    crate::model::for_payload_lengths! { verifies:
        v3_signed_verifies_0 0 unwind 33,
        v3_signed_verifies_9 9 unwind 36,
        v3_signed_verifies_30 30 unwind 57,
    }
}
