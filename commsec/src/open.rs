//! Opening: who may seal, in which order, and the message once the tag has been found right.

use core::fmt;

use heapless::{LinearMap, Vec};
use zeroize::Zeroizing;

use crate::cipher::{AesGcm, Cipher, Message};
use crate::error::{OpenError, PermitError};
use crate::key::{Credential, Key, SenderId};
use crate::pack::Packets;
use crate::package::{Header, Parts};

/// How many wrong tags a key survives, unless [`Opener::with_limit`] says otherwise: 2^24.
///
/// A forger succeeds with one package in 2^61 (a tag of 64 bits over 6 blocks), so with fewer than one
/// in 2^37 before the key is given up. Whoever only wants to stop the link has to send junk for as
/// long: three days at 57,600 baud. NIST SP 800-38D, appendix C, table 2, allows 2^32 tags of this
/// length to be checked with one key.
pub const FAILED_OPENS_LIMIT: u32 = 1 << 24;

/// A package that was sealed with the key of a permitted sender, and is newer than all accepted of
/// him before.
///
/// Made by [`Opener::open`] alone and not copied, so that it is acted on once. The message is wiped when
/// it is dropped.
pub struct Opened {
    header: Header,
    message: Zeroizing<Message>,
}

impl Opened {
    /// Who sealed it.
    #[must_use]
    pub const fn sender(&self) -> SenderId {
        self.header.sender
    }

    /// Its place among what this sender has sealed.
    #[must_use]
    pub const fn counter(&self) -> u32 {
        self.header.counter
    }

    /// The message, 80 bytes.
    #[must_use]
    pub fn message(&self) -> &Message {
        &self.message
    }

    /// The MAVLink packets in the message.
    #[must_use]
    pub fn packets(&self) -> Packets<'_> {
        Packets::new(&self.message)
    }
}

impl fmt::Debug for Opened {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Opened")
            .field("header", &self.header)
            .finish_non_exhaustive()
    }
}

/// What a receiver remembers of one sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Row {
    /// Which of the keys is his.
    key: usize,
    /// The counter of the last package accepted of him; 0 before the first.
    last: u32,
}

/// A key, and how many packages that claimed it had a wrong tag.
struct Guarded<C> {
    key: Key<C>,
    failed: u32,
}

/// Opens packages of up to `N` permitted senders, each package once and each sender's in order.
///
/// It is not copied: a copy would accept again what the original has accepted. Forgetting it does the
/// same: see [`resume`](Self::resume).
pub struct Opener<const N: usize, C: Cipher = AesGcm> {
    keys: Vec<Guarded<C>, N>,
    senders: LinearMap<SenderId, Row, N>,
    limit: u32,
}

impl<const N: usize, C: Cipher> Opener<N, C> {
    /// A receiver that permits nobody yet, and gives a key up after [`FAILED_OPENS_LIMIT`] wrong tags.
    #[must_use]
    pub const fn new() -> Self {
        Self::with_limit(FAILED_OPENS_LIMIT)
    }

    /// A receiver that permits nobody yet, and gives a key up after `limit` wrong tags.
    #[must_use]
    pub const fn with_limit(limit: u32) -> Self {
        Self {
            keys: Vec::new(),
            senders: LinearMap::new(),
            limit,
        }
    }

    /// A receiver that permits everybody in `credentials`, each with the counter up to which everything
    /// of his is refused: what `last` says, 0 for whoever has not been heard before.
    ///
    /// Those who have one key and salt have one count of wrong tags.
    ///
    /// # Errors
    ///
    /// [`PermitError`].
    pub fn of(
        credentials: &[Credential],
        last: impl Fn(SenderId) -> u32,
    ) -> Result<Self, PermitError> {
        let mut opener = Self::new();
        for (at, credential) in credentials.iter().enumerate() {
            let mut before = credentials.iter().take(at);
            if before.any(|other| other.shares_key_with(credential)) {
                continue;
            }
            let sharing = credentials
                .iter()
                .filter(|other| other.shares_key_with(credential));
            let senders = sharing.map(|other| (other.id, last(other.id)));
            opener.add(credential.prepare()?, senders)?;
        }
        Ok(opener)
    }

    /// Permits `senders`, all of whom seal with `key`, and none of whom has been heard before.
    ///
    /// One key for several senders is what SMACCMPilot's ground stations have: each can then speak as
    /// any other, and read what it says. Give each its own.
    ///
    /// # Errors
    ///
    /// [`PermitError`]; nobody is permitted then.
    pub fn permit(&mut self, key: Key<C>, senders: &[SenderId]) -> Result<(), PermitError> {
        self.add(key, senders.iter().map(|sender| (*sender, 0)))
    }

    /// Permits `senders`, all of whom seal with `key`, each with the counter up to which everything of
    /// his is refused: for a receiver that kept marks over a restart.
    ///
    /// # Errors
    ///
    /// As [`permit`](Self::permit).
    pub fn resume(&mut self, key: Key<C>, senders: &[(SenderId, u32)]) -> Result<(), PermitError> {
        self.add(key, senders.iter().copied())
    }

    fn add(
        &mut self,
        key: Key<C>,
        senders: impl Iterator<Item = (SenderId, u32)> + Clone,
    ) -> Result<(), PermitError> {
        let count = senders.clone().count();
        if count == 0 {
            return Err(PermitError::NoSender);
        }
        for (at, (sender, _)) in senders.clone().enumerate() {
            let mut before = senders.clone().take(at);
            let twice = before.any(|(other, _)| other == sender);
            if twice || self.senders.contains_key(&sender) {
                return Err(PermitError::Twice(sender));
            }
        }
        if count > N.saturating_sub(self.senders.len()) {
            return Err(PermitError::TableFull);
        }
        // No key is without a sender, so that there is room for a key wherever there is for a sender.
        let guarded = Guarded { key, failed: 0 };
        let key = self.keys.len();
        self.keys
            .push(guarded)
            .map_err(|_| PermitError::TableFull)?;
        for (sender, last) in senders {
            let inserted = self.senders.insert(sender, Row { key, last });
            inserted.map_err(|_| PermitError::TableFull)?;
        }
        Ok(())
    }

    /// Every permitted sender, and the counter up to which everything of his is refused.
    pub fn senders(&self) -> impl Iterator<Item = (SenderId, u32)> {
        self.senders.iter().map(|(sender, row)| (*sender, row.last))
    }

    /// How many packages that claimed the key of `sender` had a wrong tag; `None` if nobody has
    /// permitted him. Senders with one key have one count.
    #[must_use]
    pub fn failed_opens(&self, sender: SenderId) -> Option<u32> {
        let row = self.senders.get(&sender)?;
        Some(self.keys.get(row.key)?.failed)
    }

    /// Opens `package` if it has 96 bytes, its sender is permitted, it is newer than all accepted of him
    /// before, and its tag is right; then remembers it.
    ///
    /// Any jump forward is accepted, so that any loss is survived; what comes late is refused.
    ///
    /// # Errors
    ///
    /// [`OpenError::WrongLength`], [`OpenError::UnknownSender`], [`OpenError::Stale`],
    /// [`OpenError::KeyWornOut`], [`OpenError::BadTag`], looked for in this order, which is
    /// SMACCMPilot's. Nothing has changed then, except that a wrong tag is counted.
    pub fn open(&mut self, package: &[u8]) -> Result<Opened, OpenError> {
        let Parts {
            header,
            sealed,
            tag,
        } = Parts::of(package)?;
        let unknown = OpenError::UnknownSender(header.sender);
        let row = self.senders.get_mut(&header.sender).ok_or(unknown)?;
        if header.counter <= row.last {
            return Err(OpenError::Stale {
                counter: header.counter,
                last: row.last,
            });
        }
        let Guarded { key, failed } = self.keys.get_mut(row.key).ok_or(unknown)?;
        if *failed >= self.limit {
            return Err(OpenError::KeyWornOut);
        }
        // Wiped on every way out: a cipher may decrypt before it has looked at the tag.
        let mut message = Zeroizing::new(*sealed);
        if key.open(header, &mut message, tag).is_err() {
            *failed = failed.saturating_add(1);
            return Err(OpenError::BadTag);
        }
        row.last = header.counter;
        Ok(Opened { header, message })
    }

    /// For proofs: with so many wrong tags counted for each key.
    #[cfg(kani)]
    #[must_use]
    pub fn having_failed(mut self, failed: &[u32]) -> Self {
        for (guarded, failed) in self.keys.iter_mut().zip(failed) {
            guarded.failed = *failed;
        }
        self
    }
}

impl<const N: usize, C: Cipher> Default for Opener<N, C> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize, C: Cipher> fmt::Debug for Opener<N, C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Opener")
            .field("senders", &self.senders)
            .field("limit", &self.limit)
            .finish_non_exhaustive()
    }
}
