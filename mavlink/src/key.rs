//! Signing keys: made once, never shown.

use core::fmt;

use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;
use zeroize::Zeroize;

use crate::field::KEY_SIZE;
use crate::frame::Tag;
use crate::profile::{Hmac, Profile};

/// Why bytes are not a key. The caller is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum KeyError {
    /// Not 32 bytes, but this many.
    WrongLength(usize),
    /// All bytes are zero, as in memory that was never written.
    AllZero,
    /// All bytes are 0xFF: what erased flash reads as.
    Erased,
    /// The key of the empty pass-phrase, which everybody knows.
    EmptyPassphrase,
    /// One of this project's demonstration keys, which everybody knows, where a key is to be kept.
    Published,
}

impl fmt::Display for KeyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WrongLength(length) => {
                write!(f, "a key has {KEY_SIZE} bytes, this one has {length}")
            }
            Self::AllZero => f.write_str("a key of zeros only is no key"),
            Self::Erased => f.write_str("a key of 0xFF only is erased flash"),
            Self::EmptyPassphrase => {
                f.write_str("the key of the empty pass-phrase is known to all")
            }
            Self::Published => f.write_str("a demonstration key is known to all"),
        }
    }
}

impl core::error::Error for KeyError {}

/// A key, prepared for one profile.
///
/// There is no way to read it back, and [`Debug`] does not show it. Its memory is wiped when it is dropped.
/// What its preparation leaves on the stack is not.
pub struct SigningKey<P = Hmac> {
    profile: P,
}

impl<P: Profile> SigningKey<P> {
    /// The key in `bytes`, which should come from a random generator.
    ///
    /// The caller wipes its own copy.
    ///
    /// # Errors
    ///
    /// [`KeyError::WrongLength`] unless there are 32 bytes; [`KeyError::AllZero`] and [`KeyError::Erased`] for
    /// storage that nobody has written a key to; [`KeyError::EmptyPassphrase`].
    pub fn new(bytes: &[u8]) -> Result<Self, KeyError> {
        let key: &[u8; KEY_SIZE] = bytes
            .try_into()
            .map_err(|_| KeyError::WrongLength(bytes.len()))?;
        if is_same(key, &[0; KEY_SIZE]) {
            return Err(KeyError::AllZero);
        }
        if is_same(key, &[0xFF; KEY_SIZE]) {
            return Err(KeyError::Erased);
        }
        if is_same(key, &EMPTY_PASSPHRASE) {
            return Err(KeyError::EmptyPassphrase);
        }
        Ok(Self {
            profile: P::new(key),
        })
    }

    /// The key that a pass-phrase stands for: SHA-256 of its UTF-8 bytes, as MAVProxy and Mission
    /// Planner make it of one in ASCII.
    ///
    /// The key is as hard to guess as the pass-phrase: an attacker tries a billion hashes a second. A
    /// newline at the end of `passphrase` is part of it, and changes the key.
    ///
    /// # Errors
    ///
    /// [`KeyError::EmptyPassphrase`]. No pass-phrase is known to give another.
    pub fn from_passphrase(passphrase: &str) -> Result<Self, KeyError> {
        let mut bytes = passphrase_key(passphrase);
        let key = Self::new(&bytes);
        bytes.zeroize();
        key
    }

    /// A few digits to compare by eye. Two ends that show the same have the same key and profile, but for
    /// one pair in 2^32.
    ///
    /// It gives away 32 bits about the key. That is nothing of a random key, but a guess at a pass-phrase
    /// can be checked with it.
    #[must_use]
    pub fn fingerprint(&self) -> Fingerprint {
        // No frame begins with this byte, so that no frame has this tag on purpose.
        let [a, b, c, d, ..] = self.tag(b"mavseal key fingerprint");
        Fingerprint([a, b, c, d])
    }

    pub(crate) fn tag(&self, covered: &[u8]) -> Tag {
        self.profile.tag(covered)
    }
}

/// The 32 bytes of [`SigningKey::from_passphrase`], to be stored. The caller wipes them.
#[must_use]
pub fn passphrase_key(passphrase: &str) -> [u8; KEY_SIZE] {
    Sha256::digest(passphrase).into()
}

/// SHA-256 of nothing.
const EMPTY_PASSPHRASE: [u8; KEY_SIZE] = [
    0xE3, 0xB0, 0xC4, 0x42, 0x98, 0xFC, 0x1C, 0x14, 0x9A, 0xFB, 0xF4, 0xC8, 0x99, 0x6F, 0xB9, 0x24,
    0x27, 0xAE, 0x41, 0xE4, 0x64, 0x9B, 0x93, 0x4C, 0xA4, 0x95, 0x99, 0x1B, 0x78, 0x52, 0xB8, 0x55,
];

/// The keys of this project's demonstrations: `chips/demo/demo.key`, and the key of `chips/demo/demo.passphrase`.
const PUBLISHED: [[u8; KEY_SIZE]; 2] = [
    *b"mavseal demo key, not a secret!!",
    [
        0xF1, 0x98, 0x55, 0xFA, 0xC1, 0x5A, 0xD5, 0x25, 0x2F, 0x84, 0x1F, 0xB1, 0xC5, 0x98, 0x45,
        0x89, 0xDE, 0x2D, 0x43, 0x76, 0xE5, 0x78, 0x39, 0xB3, 0x64, 0xAF, 0x92, 0x28, 0xEF, 0x0A,
        0x9A, 0x5C,
    ],
];

/// Whether everybody has these bytes, from this project's demonstrations: no key to keep.
#[must_use]
pub fn is_published(key: &[u8; KEY_SIZE]) -> bool {
    PUBLISHED.iter().any(|known| is_same(key, known))
}

/// Looks at every byte, so that time says nothing about where the first other one is.
fn is_same(one: &[u8; KEY_SIZE], other: &[u8; KEY_SIZE]) -> bool {
    one.ct_eq(other).into()
}

/// What [`SigningKey::fingerprint`] shows: 4 bytes, as `1a2b-3c4d`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fingerprint(
    /// The bytes, in the order in which they are shown.
    pub [u8; 4],
);

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d] = self.0;
        write!(f, "{a:02x}{b:02x}-{c:02x}{d:02x}")
    }
}

impl<P> fmt::Debug for SigningKey<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SigningKey(redacted)")
    }
}
