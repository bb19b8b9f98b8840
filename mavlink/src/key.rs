//! Signing keys: made once, never shown.

use core::fmt;

use crate::error::KeyError;
use crate::frame::Tag;
use crate::profile::{Hmac, Profile};

/// Bytes of a key: 32.
pub const KEY_SIZE: usize = 32;

/// A key, prepared for one profile.
///
/// There is no way to read it back and [`Debug`] does not show it. Its memory is wiped when it is
/// dropped; what its preparation leaves on the stack is not.
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

    pub(crate) fn tag(&self, covered: &[u8]) -> Tag {
        self.profile.tag(covered)
    }
}

impl<P> fmt::Debug for SigningKey<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SigningKey(redacted)")
    }
}
