//! Sealing: one message, one counter, one package.

use core::fmt;

use zeroize::Zeroizing;

use crate::cipher::{AesGcm, Cipher, Plaintext};
use crate::header::{EpochHeader, HeaderFormat, PackageHeader};
use crate::key::SealingKey;
use crate::package::Package;
use crate::sender::{EpochCounter, EpochSenderId, SenderId};

/// The counter of the first package that is ever sealed with a key, or in an epoch.
pub const FIRST_COUNTER: u32 = 1;

/// The counter that is never sent: when it is next, the key is used up.
const END: u32 = u32::MAX;

/// The epoch that is never sent: when it is next, the key is used up.
const END_OF_EPOCHS: u16 = u16::MAX;

/// Seals messages as one sender, each under a counter that was never used before. One for the whole
/// device, however many lines it has.
///
/// It owns its key and is not copied. Two sealers with one key, salt and id would use one nonce twice. That
/// gives away both messages and lets anybody forge. Nothing here can see what an earlier run has used: see
/// [`resume`](Sealer::resume) and, for packages with epochs, [`begin`](Sealer::begin).
#[derive(Debug)]
pub struct Sealer<C: Cipher = AesGcm, H: HeaderFormat = PackageHeader> {
    key: SealingKey<C, H>,
    id: H::Id,
    next: H::Sequence,
}

impl<C: Cipher> Sealer<C> {
    /// A sender with a key that was never used before, not even in an earlier run: it counts from 1. With a
    /// key that is part of an image, this is right once in the key's life and never again.
    #[must_use]
    pub const fn new(key: SealingKey<C>, id: SenderId) -> Self {
        Self::resume(key, id, FIRST_COUNTER)
    }

    /// A sender that counts from `first`, or from 1 if that is greater: for a key that was used before.
    ///
    /// `first` must be greater than every counter used before the restart. That takes a mark in storage,
    /// written ahead of use, which lives as long as the key. If the mark is erased, make a new key.
    /// Receivers accept the jump. With 2^32 - 1, and so for every mark beyond 32 bits, it seals nothing.
    #[must_use]
    pub const fn resume(key: SealingKey<C>, id: SenderId, first: u32) -> Self {
        let next = if first < FIRST_COUNTER {
            FIRST_COUNTER
        } else {
            first
        };
        Self { key, id, next }
    }

    /// The next package has this counter at least: for counters that follow a clock. It never goes back. What is
    /// passed over is used up.
    pub fn advance_to(&mut self, counter: u32) {
        self.next = self.next.max(counter);
    }
}

impl<C: Cipher> Sealer<C, EpochHeader> {
    /// A sender that counts from 1 in the epoch `mark`, in which nothing was sealed before with this key.
    ///
    /// `mark` is a number in storage that starts at 0. A number above it must be stored before this is
    /// called: one epoch for each start, used or not. A number beyond 16 bits is rejected, not cut.
    ///
    /// # Errors
    ///
    /// [`EpochError`]: the epochs of the key are used up, after 65,535 starts. Only a new key helps.
    pub fn begin(
        key: SealingKey<C, EpochHeader>,
        id: EpochSenderId,
        mark: u64,
    ) -> Result<Self, EpochError> {
        match u16::try_from(mark) {
            Ok(epoch) if epoch != END_OF_EPOCHS => {
                let next = EpochCounter {
                    epoch,
                    counter: FIRST_COUNTER,
                };
                Ok(Self { key, id, next })
            }
            _ => Err(EpochError),
        }
    }
}

impl<C: Cipher, H: HeaderFormat> Sealer<C, H> {
    /// Who it seals as.
    #[must_use]
    pub const fn id(&self) -> H::Id {
        self.id
    }

    /// The sequence number of the next package: counter, and with [`EpochHeader`] epoch. `None` when all
    /// are used up.
    pub fn next_sequence(&self) -> Option<H::Sequence> {
        (H::counter(self.next) != END).then_some(self.next)
    }

    /// The counter of the next package; `None` when all are used up.
    #[must_use]
    pub fn next_counter(&self) -> Option<u32> {
        self.next_sequence().map(H::counter)
    }

    /// Seals `message` under the next counter.
    ///
    /// # Errors
    ///
    /// [`SealError::CounterExhausted`] after 2^32 - 2 packages, with [`EpochHeader`] of one epoch, and from
    /// then on always. [`SealError::Cipher`] from a cipher that can fail, which [`AesGcm`] cannot. In both
    /// cases there is nothing to send. A message is never handed on unsealed.
    pub fn seal(&mut self, message: &Plaintext) -> Result<Package, SealError> {
        let sequence = self.next_sequence().ok_or(SealError::CounterExhausted)?;
        // First, so that a failure in between uses the counter up.
        self.next = H::next(sequence);
        let header = H::new(self.id, sequence);
        let mut sealed = Zeroizing::new(*message);
        let tag = self
            .key
            .seal(header, &mut sealed)
            .map_err(|_| SealError::Cipher)?;
        Ok(Package::new(header, &sealed, &tag))
    }
}

/// Why nothing is sealed, and nothing must be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SealError {
    /// All counters of the key, or of the epoch, have been used; only a new key helps, or a new epoch.
    CounterExhausted,
    /// The cipher's hardware failed. The counter is used up, the message is not lost.
    Cipher,
}

impl fmt::Display for SealError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::CounterExhausted => "all counters of the key are used up",
            Self::Cipher => "the cipher failed",
        })
    }
}

impl core::error::Error for SealError {}

/// A sender cannot begin: all epochs of the key have been used; only a new key helps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EpochError;

impl fmt::Display for EpochError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("all epochs of the key are used up")
    }
}

impl core::error::Error for EpochError {}
