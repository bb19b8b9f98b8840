//! V1's other side: whatever is changed in a signed frame, it is rejected.

use mavlink_signing::crc::checksum;
use mavlink_signing::field::{CHECKSUM_SIZE, HEADER_SIZE};
use mavlink_signing::{
    Frame, FrameRef, Header, MessageId, Profile, SigningKey, Stamp, VerifyError, authenticate,
    dialect, sign_frame,
};

/// A change of some bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arbitrary", derive(arbitrary::Arbitrary))]
pub enum Change {
    /// Bits of one byte are turned over.
    Flip {
        /// Which byte, counted round the frame.
        at: u16,
        /// Which of its bits.
        bits: u8,
    },
    /// A byte is put in.
    Insert {
        /// Before which byte, counted round the frame.
        at: u16,
        /// The byte.
        byte: u8,
    },
    /// A byte is taken out.
    Remove {
        /// Which one, counted round the frame.
        at: u16,
    },
}

/// A signed frame, changed in any way, is not authentic; nor is it with its checksum made right again,
/// which anybody can do. Returns the verdict on the latter; `None` if the changes leave the frame as it
/// is.
///
/// # Panics
///
/// If the property does not hold.
pub fn change_is_rejected<P: Profile>(
    header: Header,
    payload: &[u8],
    key: &SigningKey<P>,
    stamp: Stamp,
    changes: &[Change],
) -> Option<VerifyError> {
    let mut frame = Frame::new(header, payload).ok()?;
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    let original = frame.as_bytes();
    authenticate(FrameRef::parse(original).expect("a frame"), key).expect("it is authentic");

    let mut changed = original.to_vec();
    for change in changes {
        apply(*change, &mut changed);
    }
    let verdict = rejected(original, &changed, key)?;
    repair_checksum(&mut changed);
    Some(rejected(original, &changed, key).unwrap_or(verdict))
}

/// Why the frame at the front of `changed` is not authentic; `None` if it is the original.
fn rejected<P: Profile>(
    original: &[u8],
    changed: &[u8],
    key: &SigningKey<P>,
) -> Option<VerifyError> {
    if changed.starts_with(original) {
        return None;
    }
    let frame = FrameRef::parse(changed).map_err(VerifyError::from);
    let verdict = frame.and_then(|frame| authenticate(frame, key));
    Some(verdict.expect_err("a changed frame was taken for authentic"))
}

fn apply(change: Change, bytes: &mut Vec<u8>) {
    if bytes.is_empty() {
        return;
    }
    let place = |at| usize::from(at) % bytes.len();
    match change {
        Change::Flip { at, bits } => {
            let at = place(at);
            bytes[at] ^= bits;
        }
        Change::Insert { at, byte } => bytes.insert(place(at), byte),
        Change::Remove { at } => {
            bytes.remove(place(at));
        }
    }
}

/// Makes the checksum of what begins like a frame right, if the message is known.
pub fn repair_checksum(bytes: &mut [u8]) {
    let [_, payload_length, _, _, _, _, _, a, b, c, ..] = *bytes else {
        return;
    };
    let Some(crc_extra) = dialect::crc_extra(MessageId::from_le_bytes([a, b, c])) else {
        return;
    };
    let end = HEADER_SIZE + usize::from(payload_length);
    if let Some((covered, rest)) = bytes.split_at_mut_checked(end)
        && let Some(written) = rest.first_chunk_mut::<CHECKSUM_SIZE>()
    {
        *written = checksum(&covered[1..], crc_extra).to_le_bytes();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use mavlink_signing::{Hmac, Timestamp};
    use proptest::prelude::*;

    fn check(payload: &[u8], changes: &[Change]) -> Option<VerifyError> {
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let stamp = Stamp {
            link_id: 1,
            timestamp: Timestamp::ZERO,
        };
        change_is_rejected(HEARTBEAT, payload, &key, stamp, changes)
    }

    fn change() -> impl Strategy<Value = Change> {
        prop_oneof![
            (any::<u16>(), any::<u8>()).prop_map(|(at, bits)| Change::Flip { at, bits }),
            (any::<u16>(), any::<u8>()).prop_map(|(at, byte)| Change::Insert { at, byte }),
            any::<u16>().prop_map(|at| Change::Remove { at }),
        ]
    }

    proptest! {
        #[test]
        fn v1_changes(
            payload in proptest::collection::vec(any::<u8>(), 0..=255),
            changes in proptest::collection::vec(change(), 0..4),
        ) {
            let _ = check(&payload, &changes);
        }
    }

    /// Each bit that is under the checksum, or the checksum itself, is then caught by the tag.
    #[test]
    fn v1_each_bit() {
        for at in 0..3 + 25 {
            for bit in 0..8 {
                let verdict = check(&[1, 2, 3], &[Change::Flip { at, bits: 1 << bit }]);
                let verdict = verdict.expect("a change");
                if (3..7).contains(&at) || (10..13).contains(&at) || at >= 15 {
                    assert_eq!(verdict, VerifyError::BadTag, "byte {at}");
                }
            }
        }
        assert_eq!(check(&[1, 2, 3], &[]), None);
    }
}
