//! Makes whole what a mutation has broken: lengths, checksums and tags, with the target's own key.
//!
//! So fuzzing reaches what lies behind those checks, and the code under test makes them all, as it
//! does outside. The arithmetic is that of other people's crates.

use std::sync::LazyLock;

use crc::{CRC_16_MCRF4XX, Crc, Table};
use mavlink_signing::dialect::crc_extra;
use mavlink_signing::field::{
    CHECKSUM_SIZE, HEADER_SIZE, HEADER_SIZE_V1, MAGIC, MAGIC_V1, MAX_PAYLOAD_SIZE, SIGNATURE_SIZE,
    SIGNED_FLAG, TAG_SIZE, TIMESTAMP_SIZE,
};
use mavlink_signing::{
    Frame, Hmac, KeyRing, MessageId, Profile, SigningKey, Stamp, Tag, Timestamp, sign_frame,
};

use crate::input::Head;

/// The key of every target, known to anyone.
pub const SECRET: [u8; 32] = *b"the key of every fuzz target....";

/// The key, prepared once.
pub static KEY: LazyLock<SigningKey<Hmac>> =
    LazyLock::new(|| SigningKey::new(&SECRET).expect("a key"));

/// The same, as an end of a link has it.
pub static KEYS: LazyLock<KeyRing<Hmac>> =
    LazyLock::new(|| SigningKey::new(&SECRET).expect("a key").into());

/// The checksum, by the crate `crc`, 16 bytes at a time.
#[must_use]
pub fn checksum(covered: &[u8], crc_extra: u8) -> u16 {
    static CRC: Crc<u16, Table<16>> = Crc::<u16, Table<16>>::new(&CRC_16_MCRF4XX);
    let mut digest = CRC.digest();
    digest.update(covered);
    digest.update(&[crc_extra]);
    digest.finalize()
}

/// The tag, by the profile itself, which is fast; `diff_hmac` compares it with another.
#[must_use]
pub fn tag(covered: &[u8]) -> Tag {
    static PROFILE: LazyLock<Hmac> = LazyLock::new(|| Hmac::new(&SECRET));
    PROFILE.tag(covered)
}

/// A HEARTBEAT, signed.
///
/// # Panics
///
/// Never.
#[must_use]
pub fn signed(key: &SigningKey<Hmac>, stamp: Stamp) -> Frame {
    let mut frame = Frame::new(Head::default().into(), &[]).expect("in every dialect");
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    frame
}

/// Writes magic byte, length and flags so that `bytes` begin with a packet of a kind, as long as they
/// allow, and cuts what is behind it: 1 MAVLink 1, 2 unsigned, 3 signed; 0 leaves them as they are.
pub fn shape(bytes: &mut Vec<u8>, kind: u8) {
    let (magic, header, trailer) = match kind {
        0 => return,
        1 => (MAGIC_V1, HEADER_SIZE_V1, CHECKSUM_SIZE),
        2 => (MAGIC, HEADER_SIZE, CHECKSUM_SIZE),
        _ => (MAGIC, HEADER_SIZE, CHECKSUM_SIZE + SIGNATURE_SIZE),
    };
    let payload = bytes.len().saturating_sub(header + trailer);
    let payload = payload.min(MAX_PAYLOAD_SIZE);
    bytes.resize(header + payload + trailer, 0);
    bytes[0] = magic;
    bytes[1] = payload as u8;
    if kind > 1 {
        bytes[2] = if kind > 2 { SIGNED_FLAG } else { 0 };
    }
}

/// Where the parts of a packet lie.
#[derive(Clone, Copy, Debug)]
pub struct Parts {
    /// Its message.
    pub id: MessageId,
    /// Where its checksum begins.
    pub checksum: usize,
    /// Where its signature begins, if it has one.
    pub signature: Option<usize>,
    /// Its length.
    pub end: usize,
}

/// The parts of the packet at the front of `bytes`; `None` if there is no whole one.
#[must_use]
pub fn parts(bytes: &[u8]) -> Option<Parts> {
    let length = usize::from(*bytes.get(1)?);
    let (id, checksum, signed) = match *bytes {
        [MAGIC_V1, _, _, _, _, id, ..] => (id.into(), HEADER_SIZE_V1 + length, false),
        [MAGIC, _, flags @ 0..=1, _, _, _, _, a, b, c, ..] => {
            let id = MessageId::from_le_bytes([a, b, c]);
            (id, HEADER_SIZE + length, flags == SIGNED_FLAG)
        }
        _ => return None,
    };
    let signature = signed.then_some(checksum + CHECKSUM_SIZE);
    let end = signature.map_or(checksum + CHECKSUM_SIZE, |at| at + SIGNATURE_SIZE);
    (end <= bytes.len()).then_some(Parts {
        id,
        checksum,
        signature,
        end,
    })
}

impl Parts {
    /// Writes another message id into `packet`, whose parts these are.
    pub fn set_id(&mut self, packet: &mut [u8], id: MessageId) {
        let wire = id.to_le_bytes();
        if packet[0] == MAGIC_V1 {
            packet[5] = wire[0];
            self.id = wire[0].into();
        } else {
            packet[7..HEADER_SIZE].copy_from_slice(&wire);
            self.id = id;
        }
    }

    /// Writes link id and timestamp, if there is a signature.
    pub fn restamp(self, packet: &mut [u8], link_id: Option<u8>, timestamp: Option<Timestamp>) {
        let Some(at) = self.signature else { return };
        if let Some(link_id) = link_id {
            packet[at] = link_id;
        }
        if let Some(timestamp) = timestamp {
            packet[at + 1..][..TIMESTAMP_SIZE].copy_from_slice(&timestamp.to_wire());
        }
    }

    /// Makes the checksum right, if the message is known.
    pub fn repair_checksum(self, packet: &mut [u8]) {
        if let Some(crc_extra) = crc_extra(self.id) {
            let checksum = checksum(&packet[1..self.checksum], crc_extra);
            packet[self.checksum..][..CHECKSUM_SIZE].copy_from_slice(&checksum.to_le_bytes());
        }
    }

    /// Makes the tag right, if there is a signature: the tag.
    pub fn repair_tag(self, packet: &mut [u8]) -> Option<Tag> {
        self.signature.map(|_| {
            let at = self.end - TAG_SIZE;
            let tag = tag(&packet[..at]);
            packet[at..self.end].copy_from_slice(&tag);
            tag
        })
    }
}

/// Makes the packets in a stream right, one after another from the front, and lets `each` change what
/// lies under checksum and tag before. Bit `n` of `spared` leaves packet `n`, modulo 16, as it is.
pub fn stream(bytes: &mut [u8], spared: u16, mut each: impl FnMut(&mut [u8], Parts)) {
    let mut rest = bytes;
    let mut number = 0;
    while !rest.is_empty() {
        let Some(parts) = parts(rest) else {
            rest = &mut rest[1..];
            continue;
        };
        let (packet, behind) = rest.split_at_mut(parts.end);
        if spared >> (number % 16) & 1 == 0 {
            each(packet, parts);
            parts.repair_checksum(packet);
            parts.repair_tag(packet);
        }
        number += 1;
        rest = behind;
    }
}
