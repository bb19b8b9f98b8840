//! A stand-in for AES-GCM that tells what it was asked about.

use mavlink_commsec::field::{HEADER_SIZE, KEY_SIZE, SALT_SIZE};
use mavlink_commsec::{Cipher, CipherError, Header, Message, Nonce, Tag, ZeroizeOnDrop};

/// What a [`Told`] cipher says of tags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// All are right.
    Right,
    /// All are wrong, and what they are about has been decrypted by then.
    Wrong,
    /// The hardware fails.
    Fails,
}

/// A cipher whose output is its input, bit for bit turned over, with nonce and tag mixed in: whoever
/// knows the output knows what was asked. Its verdict is chosen with the key.
///
/// It decrypts before it looks at the tag, as an implementation may. With any verdict it is any cipher
/// as far as acceptance goes: an over-approximation. It keeps nothing secret.
#[derive(Debug)]
pub struct Told(Verdict);

impl Told {
    /// The key of a cipher with this verdict.
    #[must_use]
    pub const fn key(verdict: Verdict) -> [u8; KEY_SIZE] {
        let mut key = [1; KEY_SIZE];
        key[0] = verdict as u8;
        key
    }

    /// The byte at `index` of what comes out of `message`, either way.
    #[must_use]
    pub fn byte(nonce: &Nonce, message: &Message, tag: &Tag, index: usize) -> u8 {
        let mixed = match index {
            0..12 => nonce[index],
            12..20 => tag[index - 12],
            _ => 0,
        };
        !message[index] ^ mixed
    }

    fn turn(nonce: &Nonce, message: &mut Message, tag: &Tag) {
        let before = *message;
        for (index, byte) in message.iter_mut().enumerate() {
            *byte = Self::byte(nonce, &before, tag, index);
        }
    }

    /// The tag that it gives to everything under `nonce`.
    #[must_use]
    pub fn tag(nonce: &Nonce) -> Tag {
        let [.., a, b, c, d, e, f, g, h] = *nonce;
        [h, g, f, e, d, c, b, a]
    }
}

impl ZeroizeOnDrop for Told {}

impl Cipher for Told {
    fn new(key: &[u8; KEY_SIZE]) -> Self {
        Self(match key[0] {
            0 => Verdict::Right,
            1 => Verdict::Wrong,
            _ => Verdict::Fails,
        })
    }

    fn seal(&self, nonce: &Nonce, message: &mut Message) -> Result<Tag, CipherError> {
        let tag = Self::tag(nonce);
        Self::turn(nonce, message, &tag);
        match self.0 {
            Verdict::Fails => Err(CipherError),
            _ => Ok(tag),
        }
    }

    fn open(&self, nonce: &Nonce, message: &mut Message, tag: &Tag) -> Result<(), CipherError> {
        Self::turn(nonce, message, tag);
        match self.0 {
            Verdict::Right => Ok(()),
            _ => Err(CipherError),
        }
    }
}

/// The nonce of a package, by the definition: the salt, then the header as it is sent.
#[must_use]
pub fn nonce_of(salt: u32, header: Header) -> Nonce {
    let mut nonce = [0; SALT_SIZE + HEADER_SIZE];
    nonce[..4].copy_from_slice(&salt.to_be_bytes());
    nonce[4..8].copy_from_slice(&header.sender.0.to_be_bytes());
    nonce[8..].copy_from_slice(&header.counter.to_be_bytes());
    nonce
}
