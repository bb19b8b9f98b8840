//! What can be wrong with a key, a package to send and a package received, and who is at fault.

use core::fmt;

use mavlink_signing::ParseError;

use crate::field::{KEY_SIZE, PACKAGE_SIZE};
use crate::header::{EpochCounter, SenderId};
use crate::hx;

/// Why bytes are not a key. The caller is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SealingKeyError {
    /// Not 16 bytes, but this many.
    WrongLength(usize),
    /// All bytes are zero: what memory that was never written reads as.
    AllZero,
    /// All bytes are 0xFF: what erased flash reads as.
    Erased,
}

/// Why senders cannot be permitted. The caller is at fault; nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PermitError {
    /// The key is none.
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

/// Why nothing is sealed, and nothing may be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SealError {
    /// All counters of the key, or of the epoch, have been used; only a new key helps, or a new epoch.
    CounterExhausted,
    /// The cipher's hardware failed. The counter is used up, the message is not lost.
    Cipher,
}

/// A sender cannot begin: all epochs of the key have been used; only a new key helps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EpochError;

/// Why a received package is rejected. The receiver remembers nothing of it but, for
/// [`BadTag`](Self::BadTag), that one more was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum OpenError {
    /// Not 96 bytes, but this many: bytes were lost, or this is no package.
    WrongLength(usize),
    /// Nobody has permitted this sender.
    UnknownSender(SenderId),
    /// A counter, or an epoch, of ones only, which no sender uses: nothing would be newer.
    NoCounter(SenderId),
    /// Not newer than the last package accepted of its sender: a replay, a duplicate, reordered, or a
    /// sender that has started to count anew. Whoever sent it need not have the key.
    Stale {
        /// The counter that the package claims.
        counter: u32,
        /// The counter of the last package accepted of that sender.
        last: u32,
    },
    /// The same of a package with an epoch.
    StaleInEpoch {
        /// Epoch and counter that the package claims.
        sequence: EpochCounter,
        /// Those of the last package accepted of that sender.
        last: EpochCounter,
    },
    /// So many packages with a wrong tag have come that no further one is tried before the next start.
    IntegrityLimitReached,
    /// Another key or salt, damage on the way, or a forgery.
    BadTag,
}

/// Why a packet is not packed. The caller is at fault; nothing has changed but the count of rejections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PackError {
    /// The packet has more bytes than fit into a message: this many. It can only be sent unsealed, or
    /// not at all.
    TooLong(usize),
    /// The bytes do not begin with a whole packet of MAVLink 1 or 2.
    Parse(ParseError),
    /// A packet of MAVLink 2, for a vehicle that knows none and would lose what is behind it.
    LegacyVehicle,
    /// More bytes than the packet in front of them: this many.
    Trailing(usize),
}

/// Why a message that was opened does not hold whole packets to its end. Its sender is at fault: he
/// has the key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct UnpackError {
    /// How many bytes of the message, from its front, are packets and zeros between them.
    pub offset: usize,
    /// Why what follows is no packet.
    pub fault: ParseError,
}

/// Why bytes cannot be framed. The caller is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum FrameError {
    /// There are none; SMACCMPilot's radio never recovers from an empty frame.
    Empty,
    /// More than 100: this many.
    TooLong(usize),
}

/// Why a received frame is dropped. A damaged line, or a sender that speaks something else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum DecodeError {
    /// It has a tag and nothing behind it.
    Empty,
    /// More than 100 bytes.
    TooLong,
    /// It ends between an escape and the byte that was escaped.
    TruncatedEscape,
    /// Neither air data nor radio data, but this.
    UnknownKind(u8),
}

/// Why bytes of a radio are not the status that was asked for. They may be another answer of it: text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RadioError {
    /// Neither 25 bytes that begin with `B` nor 30 that begin with `D`; so many bytes.
    NoStatus(usize),
}

impl fmt::Display for SealingKeyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WrongLength(length) => {
                write!(f, "a key has {KEY_SIZE} bytes, this one has {length}")
            }
            Self::AllZero => f.write_str("a key of zeros only is no key"),
            Self::Erased => f.write_str("a key of 0xFF only is erased flash"),
        }
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

impl fmt::Display for SealError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::CounterExhausted => "all counters of the key are used up",
            Self::Cipher => "the cipher failed",
        })
    }
}

impl fmt::Display for EpochError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("all epochs of the key are used up")
    }
}

impl fmt::Display for OpenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WrongLength(length) => write!(
                f,
                "a package has {PACKAGE_SIZE} bytes, this one has {length}"
            ),
            Self::UnknownSender(sender) => write!(f, "sender {sender} is not permitted"),
            Self::NoCounter(sender) => {
                write!(f, "sender {sender} has used up its counters, or its epochs")
            }
            Self::Stale { counter, last } => write!(
                f,
                "counter {counter} is not newer than {last}, the last accepted"
            ),
            Self::StaleInEpoch { sequence, last } => write!(
                f,
                "counter {sequence} is not newer than {last}, the last accepted"
            ),
            Self::IntegrityLimitReached => f.write_str("too many wrong tags: the key is worn out"),
            Self::BadTag => f.write_str("bad tag: another key or a forgery"),
        }
    }
}

impl fmt::Display for PackError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong(length) => {
                write!(f, "a packet of {length} bytes does not fit into a message")
            }
            Self::Parse(error) => error.fmt(f),
            Self::LegacyVehicle => f.write_str("a MAVLink 2 packet for a vehicle of MAVLink 1"),
            Self::Trailing(length) => write!(f, "{length} bytes behind the packet"),
        }
    }
}

impl fmt::Display for UnpackError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { offset, fault } = self;
        write!(f, "no packet at byte {offset} of the message: {fault}")
    }
}

impl fmt::Display for FrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("an empty frame"),
            Self::TooLong(length) => write!(
                f,
                "a frame has at most {} bytes, this one has {length}",
                hx::MAX_PAYLOAD_SIZE
            ),
        }
    }
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("an empty frame"),
            Self::TooLong => write!(f, "a frame of more than {} bytes", hx::MAX_PAYLOAD_SIZE),
            Self::TruncatedEscape => f.write_str("a frame that ends in an escape"),
            Self::UnknownKind(tag) => write!(f, "a frame with the unknown tag {tag:#04X}"),
        }
    }
}

impl fmt::Display for RadioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoStatus(length) => write!(f, "{length} bytes that are no status of a radio"),
        }
    }
}

impl core::error::Error for SealingKeyError {}
impl core::error::Error for SealError {}
impl core::error::Error for EpochError {}
impl core::error::Error for OpenError {}
impl core::error::Error for FrameError {}
impl core::error::Error for DecodeError {}
impl core::error::Error for RadioError {}
impl core::error::Error for PermitError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Key(error) => Some(error),
            _ => None,
        }
    }
}
impl core::error::Error for PackError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Parse(error) => Some(error),
            _ => None,
        }
    }
}
impl core::error::Error for UnpackError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        Some(&self.fault)
    }
}
