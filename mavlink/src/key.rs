//! Signing keys: made once, never shown.

use core::fmt;

use sha2::{Digest, Sha256};
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
    /// All bytes are zero, as in storage that was never written, or was erased.
    AllZero,
}

impl fmt::Display for KeyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WrongLength(length) => {
                write!(f, "a key has {KEY_SIZE} bytes, this one has {length}")
            }
            Self::AllZero => f.write_str("a key of zeros only is no key"),
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
    /// [`KeyError::WrongLength`] unless there are 32 bytes; [`KeyError::AllZero`] for storage
    /// that nobody has written a key to.
    pub fn new(bytes: &[u8]) -> Result<Self, KeyError> {
        let key: &[u8; KEY_SIZE] = bytes
            .try_into()
            .map_err(|_| KeyError::WrongLength(bytes.len()))?;
        // Looks at every byte, so that time says nothing about where the first other one is.
        if key.iter().fold(0, |all, byte| all | byte) == 0 {
            return Err(KeyError::AllZero);
        }
        Ok(Self {
            profile: P::new(key),
        })
    }

    /// The key that a pass-phrase stands for: SHA-256 of its UTF-8 bytes, as MAVProxy and Mission
    /// Planner make it of one in ASCII.
    ///
    /// The key is as hard to guess as the pass-phrase: an attacker tries a billion hashes a second. A
    /// newline at the end of `passphrase` is part of it, and changes the key. An empty one is accepted.
    ///
    /// # Errors
    ///
    /// [`KeyError::AllZero`], which no pass-phrase is known to give.
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
