//! Target: the profile `Standard` against somebody else's signature.

use arbitrary::Arbitrary;
use mavlink_core::consts::MAX_FRAME_SIZE;
use mavlink_core::{MAVLinkV2MessageRaw, SigningConfig, SigningData};
use mavlink_signing::dialect::crc_extra;
use mavlink_signing::field::{SIGNATURE_SIZE, TAG_SIZE};
use mavlink_signing::{
    Frame, FrameRef, MessageId, SigningKey, Stamp, Standard, VerifyError, authenticate, sign_frame,
};

use crate::input::{Head, Stamped};
use crate::repair;

/// A frame to sign, and how it is damaged then.
#[derive(Arbitrary, Clone, Debug)]
pub struct Foreign<'a> {
    /// The key.
    pub key: [u8; 32],
    /// The frame's header.
    pub head: Head,
    /// Its stamp.
    pub stamped: Stamped,
    /// Which byte is damaged, modulo their number; never the magic byte, which tells a packet from
    /// noise.
    pub damage_at: u16,
    /// The bits of it that are flipped; none stands for all.
    pub damage: u8,
    /// Whether the checksum is made right after that.
    pub repaired: bool,
    /// Its payload.
    pub payload: &'a [u8],
}

/// The year 2059 in ticks.
const LATER: u64 = 1 << 47;

/// The profile `Standard` against the crates `mavlink-core` and `hmac-sha256` (S3): equal tags, and each
/// end takes what the other has signed and nothing that is damaged.
///
/// A known difference: `mavlink-core` goes by the machine's clock, rejects new streams a minute behind
/// it and stamps nothing earlier. So before [`LATER`] its tags alone are compared.
pub fn diff_standard(input: Foreign<'_>) {
    let Ok(key) = SigningKey::<Standard>::new(&input.key) else {
        let none = [[0; 32], [0xFF; 32], hmac_sha256::Hash::hash(b"")];
        return assert!(none.contains(&input.key));
    };
    let stamp = Stamp::from(input.stamped);
    let Ok(mut frame) = Frame::new(input.head.into(), input.payload) else {
        return;
    };
    sign_frame(&mut frame, &key, stamp).expect("not signed yet");
    let bytes = frame.as_bytes();
    let (covered, tag) = bytes.split_last_chunk().expect("a tag");
    let digest = hmac_sha256::Hash::hash(&[&input.key, covered].concat());
    assert_eq!(*tag, digest[..TAG_SIZE]);
    let mut their_tag = [0; TAG_SIZE];
    raw(bytes).calculate_signature(&input.key, &mut their_tag);
    assert_eq!(*tag, their_tag);

    let damaged = input.damaged(bytes);
    assert_eq!(verify(&damaged, &key).is_ok(), damaged == bytes);
    assert_eq!(verify(bytes, &key), Ok(()));
    if stamp.timestamp.ticks() < LATER {
        return;
    }
    let config = SigningConfig::new(input.key, stamp.link_id, true, false);
    let peer = SigningData::from_config(config);
    assert!(damaged == bytes || !accepts(&peer, &damaged));
    assert!(accepts(&peer, bytes));
    // Its clock has followed the stamp, which is now the one that it gives itself.
    let unsigned = bytes.len() - SIGNATURE_SIZE;
    let mut theirs = raw(&bytes[..unsigned]);
    peer.sign_message(&mut theirs);
    assert_eq!(theirs.raw_bytes(), bytes);
}

impl Foreign<'_> {
    /// The frame with its damage; undamaged if that was in the checksum and is repaired.
    fn damaged(&self, bytes: &[u8]) -> Vec<u8> {
        let mut damaged = bytes.to_vec();
        let at = 1 + usize::from(self.damage_at) % (bytes.len() - 1);
        damaged[at] ^= if self.damage == 0 { 0xFF } else { self.damage };
        if let Some(parts) = repair::parts(&damaged).filter(|_| self.repaired) {
            parts.repair_checksum(&mut damaged);
        }
        damaged
    }
}

fn verify(bytes: &[u8], key: &SigningKey<Standard>) -> Result<(), VerifyError> {
    authenticate(FrameRef::parse(bytes)?, key).map(drop)
}

/// Whether the peer takes the frame that `bytes` are, checksum and signature.
fn accepts(peer: &SigningData, bytes: &[u8]) -> bool {
    let raw = raw(bytes);
    let crc_extra = MessageId::new(raw.message_id()).and_then(crc_extra);
    raw.raw_bytes() == bytes
        && crc_extra.is_some_and(|extra| raw.has_valid_crc_with_extra_crc(extra))
        && peer.verify_signature(&raw)
}

/// The frame as the peer holds it.
fn raw(bytes: &[u8]) -> MAVLinkV2MessageRaw {
    let mut raw = [0; MAX_FRAME_SIZE];
    raw[..bytes.len()].copy_from_slice(bytes);
    MAVLinkV2MessageRaw::from_bytes_unparsed(raw)
}
