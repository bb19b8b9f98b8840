//! The floor: the compressions of SHA-256 that a frame needs, and its checksum; nothing else.

use std::slice;

use mavlink_signing::{
    MessageId, dialect,
    field::{CHECKSUM_SIZE, HEADER_SIZE, SIGNATURE_SIZE, TAG_SIZE},
};
use sha2::block_api::compress256;

use crate::{
    checksums::Checksum,
    messages::{KEY, Message},
};

/// Bytes of a block of SHA-256.
const BLOCK: usize = 64;
/// What SHA-256 appends at least: a bit that is set, and the length in 8 bytes.
const PADDING: usize = 1 + 8;
const DIGEST: usize = 32;

/// The state of SHA-256 before the first block (FIPS 180-4, 5.3.3).
const INITIAL: [u32; 8] = [
    0x6a09_e667,
    0xbb67_ae85,
    0x3c6e_f372,
    0xa54f_f53a,
    0x510e_527f,
    0x9b05_688c,
    0x1f83_d9ab,
    0x5be0_cd19,
];

type Block = [u8; BLOCK];

/// Which profile's floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Profile {
    /// HMAC-SHA256, its two compressions that absorb the key done before.
    Hmac,
    /// SHA-256 of key and frame.
    Standard,
}

impl Profile {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Hmac, Self::Standard];

    /// Its name here.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Hmac => "Hmac",
            Self::Standard => "Standard",
        }
    }

    /// Compressions that a frame with `payload` bytes needs.
    #[must_use]
    pub const fn compressions(self, payload: usize) -> usize {
        let covered = HEADER_SIZE + payload + CHECKSUM_SIZE + SIGNATURE_SIZE - TAG_SIZE;
        match self {
            Self::Hmac => (covered + PADDING).div_ceil(BLOCK) + (DIGEST + PADDING).div_ceil(BLOCK),
            Self::Standard => (KEY.len() + covered + PADDING).div_ceil(BLOCK),
        }
    }
}

/// What is left of a frame when nothing but hash and checksum is to be done.
pub struct Input {
    /// The blocks of its hashes, one after another.
    blocks: Vec<Block>,
    /// What lies under the checksum, the message's CRC_EXTRA at its end.
    checked: Vec<u8>,
}

impl Input {
    /// That of `frame`, which is signed with `profile`.
    ///
    /// # Panics
    ///
    /// If the blocks do not make the frame's tag, or are not as many as were computed.
    #[must_use]
    pub fn of(profile: Profile, message: &Message, frame: &[u8]) -> Self {
        let (covered, tag) = frame.split_at(frame.len() - TAG_SIZE);
        let (blocks, digest) = match profile {
            Profile::Hmac => hmac(covered),
            Profile::Standard => {
                let blocks = padded(0, &[&KEY, covered].concat());
                let digest = digest(INITIAL, &blocks);
                (blocks, digest)
            }
        };
        assert_eq!(digest[..TAG_SIZE], *tag, "the blocks of {}", profile.name());
        assert_eq!(blocks.len(), profile.compressions(message.size));

        let id = MessageId::new(message.id).expect("24 bits");
        let crc_extra = dialect::crc_extra(id).expect("a message");
        let mut checked = frame[1..HEADER_SIZE + message.size].to_vec();
        checked.push(crc_extra);
        Self { blocks, checked }
    }

    /// The checksum of the frame.
    #[must_use]
    pub fn checksum<C: Checksum>(&self) -> u16 {
        C::of(&self.checked)
    }

    /// The compressions, one by one, each from the result of the one before.
    #[must_use]
    pub fn compress(&self) -> [u32; 8] {
        let mut state = INITIAL;
        for block in &self.blocks {
            compress256(&mut state, slice::from_ref(block));
        }
        state
    }
}

/// The blocks of inner and outer hash after those of the key, and the outer digest.
fn hmac(covered: &[u8]) -> (Vec<Block>, [u8; DIGEST]) {
    let keyed = |pad: u8| {
        let mut block = [pad; BLOCK];
        for (slot, byte) in block.iter_mut().zip(KEY) {
            *slot ^= byte;
        }
        let mut state = INITIAL;
        compress256(&mut state, &[block]);
        state
    };
    let inner = padded(BLOCK, covered);
    let outer = padded(BLOCK, &digest(keyed(0x36), &inner));
    let whole = digest(keyed(0x5c), &outer);
    ([inner, outer].concat(), whole)
}

/// The blocks of `bytes` at the end of a message, `before` bytes of which are hashed already.
fn padded(before: usize, bytes: &[u8]) -> Vec<Block> {
    let bits = 8 * (before + bytes.len()) as u64;
    let length = (bytes.len() + PADDING).next_multiple_of(BLOCK);
    let mut message = bytes.to_vec();
    message.push(0x80);
    message.resize(length - size_of_val(&bits), 0);
    message.extend(bits.to_be_bytes());
    message.as_chunks().0.to_vec()
}

fn digest(mut state: [u32; 8], blocks: &[Block]) -> [u8; DIGEST] {
    compress256(&mut state, blocks);
    let mut digest = [0; DIGEST];
    for (bytes, word) in digest.as_chunks_mut().0.iter_mut().zip(state) {
        *bytes = word.to_be_bytes();
    }
    digest
}

/// What compresses: the choice that the crate `sha2` makes, by its build or when it runs.
#[must_use]
pub fn backend() -> &'static str {
    if cfg!(any(sha2_backend = "soft", sha2_256_backend = "soft")) {
        return "without special instructions, as built";
    }
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("sha") && std::arch::is_x86_feature_detected!("sse4.1") {
        return "SHA-NI";
    }
    #[cfg(target_arch = "aarch64")]
    if std::arch::is_aarch64_feature_detected!("sha2") {
        return "ARMv8 SHA2";
    }
    "without special instructions"
}

#[cfg(test)]
mod tests {
    use super::Profile;

    #[test]
    fn compressions_of_the_lengths_where_one_more_begins() {
        let count =
            |profile: Profile, lengths: [usize; 4]| lengths.map(|l| profile.compressions(l));
        assert_eq!(count(Profile::Hmac, [0, 36, 37, 255]), [2, 2, 3, 6]);
        assert_eq!(count(Profile::Standard, [0, 4, 5, 255]), [1, 1, 2, 5]);
    }
}
