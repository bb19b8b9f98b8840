//! Sealing: one message, one counter, one package.

use zeroize::Zeroizing;

use crate::cipher::{AesGcm, Cipher, Message};
use crate::error::SealError;
use crate::key::{Key, SenderId};
use crate::package::{Header, Package};

/// The counter of the first package that is ever sealed with a key.
pub const FIRST_COUNTER: u32 = 1;

/// The counter that is never sent: when it is next, the key is used up.
const END: u32 = u32::MAX;

/// Seals messages as one sender, each under a counter that was never used before.
///
/// It owns its key and is not copied: two sealers with one key, salt and id would use one nonce twice,
/// which gives away both messages and lets anybody forge. Nothing here can see what an earlier run has
/// used; see [`resume`](Self::resume).
#[derive(Debug)]
pub struct Sealer<C: Cipher = AesGcm> {
    key: Key<C>,
    id: SenderId,
    next: u32,
}

impl<C: Cipher> Sealer<C> {
    /// A sender with a key that was never used before, not even in an earlier run: it counts from 1.
    #[must_use]
    pub const fn new(key: Key<C>, id: SenderId) -> Self {
        Self::resume(key, id, FIRST_COUNTER)
    }

    /// A sender that counts from `first`, or from 1 if that is greater: for a key that was used before.
    ///
    /// `first` must be greater than every counter used before the restart, which takes a mark in
    /// storage that is written ahead of use. Receivers accept the jump. With 2^32 - 1 it seals nothing.
    #[must_use]
    pub const fn resume(key: Key<C>, id: SenderId, first: u32) -> Self {
        let next = if first < FIRST_COUNTER {
            FIRST_COUNTER
        } else {
            first
        };
        Self { key, id, next }
    }

    /// Who it seals as.
    #[must_use]
    pub const fn id(&self) -> SenderId {
        self.id
    }

    /// The counter of the next package; `None` when all are used up.
    #[must_use]
    pub const fn next_counter(&self) -> Option<u32> {
        if self.next == END {
            None
        } else {
            Some(self.next)
        }
    }

    /// Seals `message` under the next counter.
    ///
    /// # Errors
    ///
    /// [`SealError::CounterExhausted`] after 2^32 - 2 packages, and from then on always.
    /// [`SealError::Cipher`] from a cipher that can fail, which [`AesGcm`] cannot. In both cases there is
    /// nothing to send; a message is never handed on unsealed.
    pub fn seal(&mut self, message: &Message) -> Result<Package, SealError> {
        let counter = self.next_counter().ok_or(SealError::CounterExhausted)?;
        // First, so that a failure in between uses the counter up.
        self.next = counter.saturating_add(1);
        let header = Header {
            sender: self.id,
            counter,
        };
        let mut sealed = Zeroizing::new(*message);
        let tag = self
            .key
            .seal(header, &mut sealed)
            .map_err(|_| SealError::Cipher)?;
        Ok(Package::new(header, &sealed, &tag))
    }
}
