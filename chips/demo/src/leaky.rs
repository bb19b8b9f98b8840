//! A comparison that tells an attacker how much of a forged tag is right: what the constant-time test
//! must find.

use mavlink_signing::field::TAG_SIZE;
use mavlink_signing::{Hmac, Profile};

/// Whether the tag at the end of `frame` is right; stops at the first byte that is not.
pub(crate) fn tag_matches(frame: &[u8], key: &[u8; 32]) -> bool {
    let Some((covered, tag)) = frame.split_last_chunk::<TAG_SIZE>() else {
        return false;
    };
    let right = <Hmac>::new(key).tag(covered);
    right.iter().zip(tag).all(|(right, byte)| right == byte)
}
