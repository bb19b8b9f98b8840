//! Opening: who may seal, in which order, and the message once its tag is verified.

use core::fmt;
use core::ops::RangeInclusive;

use heapless::Vec;
use zeroize::Zeroizing;

use crate::cipher::{AesGcm, Cipher, Plaintext};
use crate::error::OpenError;
use crate::header::{HeaderFormat, PackageHeader};
use crate::key::{Credential, SealingKey, SealingKeyError};
use crate::pack::Packets;
use crate::package::Parts;
use crate::seen::Seen;
use crate::sender::SenderId;

/// How many wrong tags a key survives within a run, unless [`Opener::with_limit`] says otherwise: 2^32 - 1. RFC
/// 9001 calls this the integrity limit. The count is kept in memory, and is 0 again after a restart.
///
/// NIST SP 800-38D, appendix C, asks for a bound with tags of 64 bits, as each forgery that passes would tell of the
/// hash key and make the next easier. Its table allows 2^32 decryptions with a key for messages of up to 2^11 bytes;
/// these have 80. One forged package passes with at most 6 chances in 2^64: what is authenticated is a polynomial
/// of degree 6 in the hash key, 5 blocks of message and one of lengths. 2^32 of them pass with fewer than one
/// chance in 2^29.
///
/// The limit also lets an attacker without a key end a link until the restart. At 57,600 baud, which carry 58
/// packages a second, that takes 2.3 years; with a million packages a second, 72 minutes. On a network as fast as
/// that bound the rate in front of this. [`Opener::failed_opens`] tells long before.
pub const INTEGRITY_LIMIT: u32 = u32::MAX;

/// A package that was sealed with the key of a permitted sender, and was not accepted before.
///
/// Made by [`Opener::open`] alone and not copied, so that it is acted on once. The message is wiped when it
/// is dropped. What a move leaves of it on the stack is not.
pub struct Opened<H = PackageHeader> {
    header: H,
    message: Zeroizing<Plaintext>,
}

impl<H: HeaderFormat> Opened<H> {
    /// Who sealed it.
    pub fn sender(&self) -> H::Id {
        self.header.sender()
    }

    /// Its sequence number among everything that this sender has sealed: the counter, or with
    /// [`EpochHeader`](crate::EpochHeader) epoch and counter.
    pub fn sequence(&self) -> H::Sequence {
        self.header.sequence()
    }

    /// The counter, with [`EpochHeader`](crate::EpochHeader) in its epoch.
    #[must_use]
    pub fn counter(&self) -> u32 {
        H::counter(self.sequence())
    }

    /// The message, 80 bytes.
    #[must_use]
    pub fn plaintext(&self) -> &Plaintext {
        &self.message
    }

    /// The MAVLink packets in the message.
    #[must_use]
    pub fn packets(&self) -> Packets<'_> {
        Packets::new(&self.message)
    }
}

impl<H: fmt::Debug> fmt::Debug for Opened<H> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Opened")
            .field("header", &self.header)
            .finish_non_exhaustive()
    }
}

/// What a receiver remembers of one sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Row<I, P> {
    sender: I,
    /// Which of the keys is this sender's.
    key: usize,
    /// What was accepted of this sender.
    seen: Seen<P>,
}

/// A key, and how many packages for it had a wrong tag.
struct Guarded<C, H> {
    key: SealingKey<C, H>,
    failed: u32,
}

/// Opens packages of up to `N` permitted senders, each package once.
///
/// Packages may overtake one another: what comes up to [`REORDER_WINDOW`](crate::REORDER_WINDOW) counters behind the
/// newest of its sender is accepted, once. With [`EpochHeader`](crate::EpochHeader) that is within the newest epoch.
///
/// One for the whole device, however many lines it has. It is not copied: a copy would accept again what
/// the original has accepted. Forgetting it does the same: see [`resume`](Self::resume). It remembers in
/// memory alone. A program that acts on a message before a mark above it is stored may act again after a
/// restart.
pub struct Opener<const N: usize, C: Cipher = AesGcm, H: HeaderFormat = PackageHeader> {
    keys: Vec<Guarded<C, H>, N>,
    rows: Vec<Row<H::Id, H::Sequence>, N>,
    limit: u32,
}

impl<const N: usize, C: Cipher, H: HeaderFormat> Opener<N, C, H> {
    /// A receiver that permits nobody yet, and gives a key up after [`INTEGRITY_LIMIT`] wrong tags.
    #[must_use]
    pub const fn new() -> Self {
        Self::with_limit(INTEGRITY_LIMIT)
    }

    /// A receiver that permits nobody yet, and gives a key up after `limit` wrong tags.
    #[must_use]
    pub const fn with_limit(limit: u32) -> Self {
        Self {
            keys: Vec::new(),
            rows: Vec::new(),
            limit,
        }
    }

    /// Gives a key up after `limit` wrong tags from now on, those counted so far among them.
    pub const fn set_limit(&mut self, limit: u32) {
        self.limit = limit;
    }

    /// A receiver that permits everybody in `credentials`. `last` gives the counter up to which everything
    /// of a sender is rejected: 0 (of epoch 0) for one that was never heard.
    ///
    /// Senders with one key and salt have one count of wrong tags. Senders that share a key and not its
    /// salt have one count each, so the key sees as many times the limit.
    ///
    /// # Errors
    ///
    /// [`PermitError`].
    pub fn from_credentials(
        credentials: &[Credential<H::Id>],
        last: impl Fn(H::Id) -> H::Sequence,
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

    /// Permits `senders`. All of them seal with `key`, and none was ever heard.
    ///
    /// SMACCMPilot's ground stations share one key: each can then speak as any other, and read what it
    /// says. Give each its own.
    ///
    /// # Errors
    ///
    /// [`PermitError`]. Nobody is permitted then.
    pub fn permit(&mut self, key: SealingKey<C, H>, senders: &[H::Id]) -> Result<(), PermitError> {
        self.add(key, senders.iter().map(|sender| (*sender, H::ZERO)))
    }

    /// Permits `senders`, all of which seal with `key`. Each comes with the counter up to which everything
    /// of it is rejected: for a receiver that kept marks over a restart.
    ///
    /// That counter is the last one rejected: one less than a mark above all that was accepted. A mark
    /// stored ahead costs as many genuine packages after a restart.
    ///
    /// # Errors
    ///
    /// As [`permit`](Self::permit).
    pub fn resume(
        &mut self,
        key: SealingKey<C, H>,
        senders: &[(H::Id, H::Sequence)],
    ) -> Result<(), PermitError> {
        self.add(key, senders.iter().copied())
    }

    fn add(
        &mut self,
        key: SealingKey<C, H>,
        senders: impl Iterator<Item = (H::Id, H::Sequence)> + Clone,
    ) -> Result<(), PermitError> {
        let count = senders.clone().count();
        if count == 0 {
            return Err(PermitError::NoSender);
        }
        for (at, (sender, _)) in senders.clone().enumerate() {
            let mut before = senders.clone().take(at);
            let twice = before.any(|(other, _)| other == sender);
            if twice || self.row(sender).is_some() {
                return Err(PermitError::DuplicateSender(sender.into()));
            }
        }
        if count > N.saturating_sub(self.rows.len()) {
            return Err(PermitError::TableFull);
        }
        // No key is without a sender, so there is room for a key wherever there is for a sender.
        let guarded = Guarded { key, failed: 0 };
        let key = self.keys.len();
        self.keys
            .push(guarded)
            .map_err(|_| PermitError::TableFull)?;
        for (sender, last) in senders {
            let seen = Seen::up_to(last);
            let pushed = self.rows.push(Row { sender, key, seen });
            pushed.map_err(|_| PermitError::TableFull)?;
        }
        Ok(())
    }

    /// Every permitted sender, and the newest counter accepted from it, or what it was resumed with.
    pub fn senders(&self) -> impl Iterator<Item = (H::Id, H::Sequence)> {
        self.rows.iter().map(|row| (row.sender, row.seen.newest))
    }

    /// For proofs, which unwind every search: each sender, its newest counter, [`behind`](Self::behind) and
    /// [`passed_over`](Self::passed_over).
    #[cfg(kani)]
    pub fn memory(&self) -> impl Iterator<Item = (H::Id, H::Sequence, u64, u32)> {
        self.rows
            .iter()
            .map(|Row { sender, seen, .. }| (*sender, seen.newest, seen.behind, seen.passed_over))
    }

    /// Which of the 64 counters behind the newest of `sender` are rejected: accepted before, or at or below what it was
    /// resumed with. Bit 0 is the one directly behind. `None` if it is not permitted.
    #[must_use]
    pub fn behind(&self, sender: H::Id) -> Option<u64> {
        Some(self.row(sender)?.seen.behind)
    }

    /// How many counters of `sender` were passed over since the start, each new epoch counted as 2^16, except by
    /// [`open_between`](Self::open_between). `None` if it is not permitted.
    #[must_use]
    pub fn passed_over(&self, sender: H::Id) -> Option<u32> {
        Some(self.row(sender)?.seen.passed_over)
    }

    /// How many packages for the key of `sender` had a wrong tag. `None` if it is not permitted. Senders
    /// with one key have one count.
    #[must_use]
    pub fn failed_opens(&self, sender: H::Id) -> Option<u32> {
        let row = self.row(sender)?;
        Some(self.keys.get(row.key)?.failed)
    }

    /// Opens `package` if it has 96 bytes, its sender is permitted, it was not accepted before and is not too old for
    /// that to be known, and its tag is right. Then remembers it.
    ///
    /// Jumps forward are accepted, so that loss is survived: up to [`MAX_PASSED_OVER`](crate::MAX_PASSED_OVER)
    /// counters in all.
    ///
    /// # Errors
    ///
    /// [`OpenError::WrongLength`], [`OpenError::UnknownSender`], [`OpenError::NoCounter`],
    /// [`OpenError::Stale`] or [`OpenError::StaleInEpoch`], [`OpenError::IntegrityLimitReached`],
    /// [`OpenError::BadTag`], [`OpenError::JumpTooFar`], looked for in this order. Nothing has changed then, except
    /// that a wrong tag is counted.
    pub fn open(&mut self, package: &[u8]) -> Result<Opened<H>, OpenError> {
        self.admit(package, None)
    }

    /// The same for senders whose counters follow a clock, as this end's does. A package is accepted only if its
    /// sequence number lies in `fresh`, which is what such a clock can have now. How far it jumps does not matter then.
    ///
    /// # Errors
    ///
    /// As [`open`](Self::open), with [`OpenError::TooOld`] and [`OpenError::FromFuture`] in place of
    /// [`OpenError::JumpTooFar`].
    pub fn open_between(
        &mut self,
        package: &[u8],
        fresh: RangeInclusive<H::Sequence>,
    ) -> Result<Opened<H>, OpenError> {
        self.admit(package, Some(fresh))
    }

    fn admit(
        &mut self,
        package: &[u8],
        fresh: Option<RangeInclusive<H::Sequence>>,
    ) -> Result<Opened<H>, OpenError> {
        let Parts {
            header,
            sealed,
            tag,
        } = Parts::<H>::parse(package)?;
        let unknown = OpenError::UnknownSender(header.sender().into());
        let mut rows = self.rows.iter_mut();
        let row = rows.find(|row| row.sender == header.sender());
        let row = row.ok_or(unknown)?;
        if header.is_exhausted() {
            return Err(OpenError::NoCounter(header.sender().into()));
        }
        if !row.seen.is_fresh(header) {
            return Err(header.stale(row.seen.newest));
        }
        let Guarded { key, failed } = self.keys.get_mut(row.key).ok_or(unknown)?;
        if *failed >= self.limit {
            return Err(OpenError::IntegrityLimitReached);
        }
        // Wiped on every way out: a cipher may decrypt before it has looked at the tag.
        let mut message = Zeroizing::new(*sealed);
        if key.open(header, &mut message, tag).is_err() {
            *failed = failed.saturating_add(1);
            return Err(OpenError::BadTag);
        }
        // Behind the tag, so that it tells of somebody who has the key.
        match fresh {
            None => row.seen.passed_over = row.seen.pass_over(header)?,
            Some(fresh) if header.sequence() < *fresh.start() => {
                return Err(OpenError::TooOld(header.sender().into()));
            }
            Some(fresh) if header.sequence() > *fresh.end() => {
                return Err(OpenError::FromFuture(header.sender().into()));
            }
            Some(_) => {}
        }
        row.seen.record(header);
        Ok(Opened { header, message })
    }

    fn row(&self, sender: H::Id) -> Option<&Row<H::Id, H::Sequence>> {
        self.rows.iter().find(|row| row.sender == sender)
    }

    /// For proofs: with one key more, and the wrong tags counted for it.
    #[cfg(kani)]
    #[must_use]
    pub fn with_key(mut self, key: SealingKey<C, H>, failed: u32) -> Self {
        core::mem::forget(self.keys.push(Guarded { key, failed }));
        self
    }

    /// For proofs: with one sender more, which of the keys is its own, the newest accepted, which of those behind it
    /// are rejected, and how many were passed over.
    #[cfg(kani)]
    #[must_use]
    pub fn with_sender(
        mut self,
        sender: H::Id,
        key: usize,
        newest: H::Sequence,
        behind: u64,
        passed_over: u32,
    ) -> Self {
        let seen = Seen {
            newest,
            behind,
            passed_over,
        };
        let _ = self.rows.push(Row { sender, key, seen });
        self
    }
}

impl<const N: usize, C: Cipher, H: HeaderFormat> Default for Opener<N, C, H> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize, C: Cipher, H: HeaderFormat> fmt::Debug for Opener<N, C, H> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Opener")
            .field("senders", &self.rows)
            .field("limit", &self.limit)
            .finish_non_exhaustive()
    }
}

/// Why senders cannot be permitted. The caller is at fault. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PermitError {
    /// The bytes are no key.
    Key(SealingKeyError),
    /// A key that nobody seals with.
    NoSender,
    /// This sender is permitted twice, or has been before.
    DuplicateSender(SenderId),
    /// There are more senders than rows.
    TableFull,
}

impl From<SealingKeyError> for PermitError {
    fn from(error: SealingKeyError) -> Self {
        Self::Key(error)
    }
}

impl fmt::Display for PermitError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Key(error) => error.fmt(f),
            Self::NoSender => f.write_str("a key without a sender"),
            Self::DuplicateSender(sender) => write!(f, "sender {sender} is permitted twice"),
            Self::TableFull => f.write_str("the table of senders is full"),
        }
    }
}

impl core::error::Error for PermitError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Key(error) => Some(error),
            _ => None,
        }
    }
}
