//! What became of packets, packages and frames at one end of a sealed link, and how often.

use mavlink_commsec::hx;
use mavlink_commsec::radio::{RadioError, Status};
use mavlink_commsec::{OpenError, PackError, SealError, SenderId, UnpackError};
use mavlink_signing::{DecodeError, ParseError};
use mavseal_store::ReserveError;
use strum::{Display, IntoStaticStr, VariantArray};

use crate::event::Direction;

/// Why something was not passed on.
#[derive(Clone, Copy, Debug, Display, IntoStaticStr, VariantArray, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SealedRejectReason {
    /// A packet with unknown incompatibility flags.
    #[strum(serialize = "unknown flags")]
    UnknownIncompatFlags,
    /// A packet with a message that the dialect does not define.
    #[strum(serialize = "unknown message")]
    UnknownMessage,
    /// A packet that was damaged on its way here.
    #[strum(serialize = "bad checksum")]
    BadChecksum,
    /// A packet with more bytes than fit into a message.
    #[strum(serialize = "longer than a message")]
    TooLong,
    /// A message to be sealed, but all counters of the key are used up.
    #[strum(serialize = "counter exhausted")]
    CounterExhausted,
    /// A message to be sealed, and the cipher failed.
    #[strum(serialize = "cipher failed")]
    CipherFailed,
    /// A message to be sealed, but the counters run too far ahead of the clock that they follow: too many packages, or
    /// the clock was set back.
    #[strum(serialize = "ahead of the clock")]
    AheadOfClock,
    /// A message to be sealed or just opened, but no mark above its counter can be stored.
    #[strum(serialize = "not stored")]
    NotStored,
    /// A frame without content.
    #[strum(serialize = "empty frame")]
    EmptyFrame,
    /// A frame with more content than there may be.
    #[strum(serialize = "frame too long")]
    LongFrame,
    /// A frame that ends in an escape.
    #[strum(serialize = "cut escape")]
    TruncatedEscape,
    /// A frame with an unknown tag.
    #[strum(serialize = "unknown tag")]
    UnknownKind,
    /// Air data that is no package.
    #[strum(serialize = "wrong length")]
    WrongLength,
    /// A package that claims to be from somebody who is not permitted.
    #[strum(serialize = "unknown sender")]
    UnknownSender,
    /// A package with the counter that no sender uses.
    #[strum(serialize = "no counter")]
    NoCounter,
    /// A package that was opened before, is far behind the newest of its sender, or from before a restart.
    #[strum(serialize = "stale")]
    Stale,
    /// A package of a peer that has passed over too many counters since the start.
    #[strum(serialize = "jump too far")]
    JumpTooFar,
    /// A package that is too old by the clock.
    #[strum(serialize = "too old")]
    TooOld,
    /// A package that is too new by the clock.
    #[strum(serialize = "from the future")]
    FromFuture,
    /// A package of a sender for whose key too many packages with a wrong tag have come.
    #[strum(serialize = "key worn out")]
    IntegrityLimitReached,
    /// A package sealed with another key, damaged, or forged.
    #[strum(serialize = "bad tag")]
    BadTag,
    /// What is left of an opened message, which is no packet.
    #[strum(serialize = "no packet")]
    NoPacket,
    /// Radio data that is no status.
    #[strum(serialize = "no status")]
    NoStatus,
    /// A status that was not asked for, or came after the time for the next question.
    #[strum(serialize = "not asked")]
    NotAsked,
    /// What was to go out on a line that was closed: a frame to the radio, or what is left of a package's packets.
    #[strum(serialize = "line closed")]
    LineClosed,
    /// An error that this version does not know.
    #[strum(serialize = "other")]
    Other,
}

impl SealedRejectReason {
    /// Every reason, in the order of [`SealedRejectReason`]'s definition.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// The reason in a few words, as in tables.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

impl From<DecodeError> for SealedRejectReason {
    fn from(error: DecodeError) -> Self {
        match error {
            DecodeError::Parse(ParseError::UnknownIncompatFlags(_)) => Self::UnknownIncompatFlags,
            DecodeError::UnknownMessage(_) => Self::UnknownMessage,
            DecodeError::BadChecksum(_) => Self::BadChecksum,
            _ => Self::Other,
        }
    }
}

impl From<PackError> for SealedRejectReason {
    fn from(error: PackError) -> Self {
        match error {
            PackError::TooLong(_) => Self::TooLong,
            _ => Self::Other,
        }
    }
}

impl From<SealError> for SealedRejectReason {
    fn from(error: SealError) -> Self {
        match error {
            SealError::CounterExhausted => Self::CounterExhausted,
            SealError::Cipher => Self::CipherFailed,
            _ => Self::Other,
        }
    }
}

impl From<ReserveError> for SealedRejectReason {
    fn from(_: ReserveError) -> Self {
        Self::NotStored
    }
}

impl From<hx::DecodeError> for SealedRejectReason {
    fn from(error: hx::DecodeError) -> Self {
        match error {
            hx::DecodeError::Empty => Self::EmptyFrame,
            hx::DecodeError::TooLong => Self::LongFrame,
            hx::DecodeError::TruncatedEscape => Self::TruncatedEscape,
            hx::DecodeError::UnknownKind(_) => Self::UnknownKind,
            _ => Self::Other,
        }
    }
}

impl From<OpenError> for SealedRejectReason {
    fn from(error: OpenError) -> Self {
        match error {
            OpenError::WrongLength(_) => Self::WrongLength,
            OpenError::UnknownSender(_) => Self::UnknownSender,
            OpenError::NoCounter(_) => Self::NoCounter,
            OpenError::Stale { .. } => Self::Stale,
            OpenError::JumpTooFar(_) => Self::JumpTooFar,
            OpenError::TooOld(_) => Self::TooOld,
            OpenError::FromFuture(_) => Self::FromFuture,
            OpenError::IntegrityLimitReached => Self::IntegrityLimitReached,
            OpenError::BadTag => Self::BadTag,
            _ => Self::Other,
        }
    }
}

impl From<UnpackError> for SealedRejectReason {
    fn from(_: UnpackError) -> Self {
        Self::NoPacket
    }
}

impl From<RadioError> for SealedRejectReason {
    fn from(_: RadioError) -> Self {
        Self::NoStatus
    }
}

/// What became of something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SealedEvent {
    /// A packet of the local side waits to be sealed, with others or alone.
    Packed,
    /// A package goes out, under this counter.
    Sealed(u32),
    /// A package of this peer was opened, with this counter, and its packets go on to the local side.
    Opened(SenderId, u32),
    /// The radio has answered.
    Radio(Status),
    /// Something goes no further.
    Rejected(Direction, SealedRejectReason),
}

/// How often each thing happened in one direction. Every count stays at the top of its range.
///
/// Anybody who can send can raise the counts of rejections: show them, do not act on them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SealedCounters {
    packages: u32,
    packets: u32,
    rejected: [u32; SealedRejectReason::ALL.len()],
    dropped: u32,
}

impl SealedCounters {
    /// Packages that were sealed, or opened.
    #[must_use]
    pub const fn packages(&self) -> u32 {
        self.packages
    }

    /// Packets that were packed, or handed on to the local side.
    #[must_use]
    pub const fn packets(&self) -> u32 {
        self.packets
    }

    /// Bytes of the local side that belonged to no packet: noise, and packets that were damaged, cut short
    /// or unknown. Always 0 from the radio, where what is between frames is not counted.
    #[must_use]
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }

    /// What was rejected for `reason`.
    #[must_use]
    pub fn rejected(&self, reason: SealedRejectReason) -> u32 {
        self.rejected.get(reason as usize).copied().unwrap_or(0)
    }

    /// Every reason and how often it was given.
    pub fn rejections(&self) -> impl Iterator<Item = (SealedRejectReason, u32)> {
        SealedRejectReason::ALL.iter().copied().zip(self.rejected)
    }

    pub(crate) const fn count_package(&mut self) {
        self.packages = self.packages.saturating_add(1);
    }

    pub(crate) const fn count_packet(&mut self) {
        self.packets = self.packets.saturating_add(1);
    }

    pub(crate) const fn set_dropped(&mut self, dropped: u32) {
        self.dropped = dropped;
    }

    pub(crate) fn count_rejected(&mut self, reason: SealedRejectReason) {
        if let Some(count) = self.rejected.get_mut(reason as usize) {
            *count = count.saturating_add(1);
        }
    }
}
