//! What can be wrong with a key, a frame to send and a frame received, and who is at fault.

use core::fmt;

use crate::field::{MAX_PAYLOAD_SIZE, TIMESTAMP_SIZE};
use crate::header::MessageId;

/// A mark could not be stored. The memory is at fault, or worn out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NotStored;

/// Why a frame cannot be made or signed. The caller is at fault, not the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SignError {
    /// More than 255 bytes of payload: this many.
    PayloadTooLong(usize),
    /// The dialect that this was built with does not define the message.
    UnknownMessage(MessageId),
    /// The frame to take over was damaged before it came here.
    BadChecksum,
    /// The frame already carries a signature.
    AlreadySigned,
    /// All 48-bit timestamps of the link have been used; only a new key helps.
    TimestampsExhausted,
    /// A mark above the frame's timestamp cannot be stored. This end's memory is at fault.
    NotStored,
}

impl From<NotStored> for SignError {
    fn from(_: NotStored) -> Self {
        Self::NotStored
    }
}

/// Why bytes are not a MAVLink 2 frame. A damaged link, or a sender that speaks something else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ParseError {
    /// The bytes end before the frame does.
    Truncated,
    /// The first byte is not 0xFD, but this.
    BadMagic(u8),
    /// The sender set incompatibility flags that this library does not know: all flags.
    UnknownIncompatFlags(u8),
}

/// Why a received frame is rejected. Nothing has changed in the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum VerifyError {
    /// The bytes are not a MAVLink 2 frame.
    Parse(ParseError),
    /// The sender does not sign.
    NotSigned,
    /// The dialect that this was built with does not define the message.
    UnknownMessage(MessageId),
    /// The frame was damaged on its way, or built with another definition of the message.
    BadChecksum,
    /// Another key, another profile, or a forgery.
    BadTag,
    /// Authentic, but made for this other link or direction: a reflection, or a wrong set-up.
    WrongLink(u8),
    /// Authentic, but stamped later than the window allows: one of the two clocks is wrong.
    FromFuture,
    /// Authentic, but stamped earlier than the window allows: delayed, or a clock is wrong.
    TooOld,
    /// Authentic, but not newer than a frame already accepted: a replay, or reordered.
    Replayed,
    /// Authentic, but sent by this end itself: in the name of a system, and on a link, that it signs for.
    Reflected,
    /// Signed, where only unsigned frames belong. The caller is at fault.
    Signed,
    /// Would be accepted, but no mark above its timestamp can be stored. This end's memory is at fault.
    NotStored,
}

impl From<NotStored> for VerifyError {
    fn from(_: NotStored) -> Self {
        Self::NotStored
    }
}

impl From<ParseError> for VerifyError {
    fn from(error: ParseError) -> Self {
        Self::Parse(error)
    }
}

impl fmt::Display for SignError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PayloadTooLong(length) => write!(
                f,
                "a payload has at most {MAX_PAYLOAD_SIZE} bytes, this one has {length}"
            ),
            Self::UnknownMessage(id) => write!(f, "message {id} is not in the dialect"),
            Self::BadChecksum => f.write_str("the frame to sign is damaged: bad checksum"),
            Self::AlreadySigned => f.write_str("the frame is already signed"),
            Self::TimestampsExhausted => {
                write!(f, "all timestamps of {TIMESTAMP_SIZE} bytes are used up")
            }
            Self::NotStored => f.write_str("no mark above the timestamp can be stored"),
        }
    }
}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated => f.write_str("the frame is cut short"),
            Self::BadMagic(byte) => {
                write!(f, "a MAVLink 2 frame begins with 0xFD, not {byte:#04X}")
            }
            Self::UnknownIncompatFlags(flags) => {
                write!(f, "unknown incompatibility flags {flags:#04X}")
            }
        }
    }
}

impl fmt::Display for VerifyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parse(error) => error.fmt(f),
            Self::NotSigned => f.write_str("the frame is not signed"),
            Self::UnknownMessage(id) => write!(f, "message {id} is not in the dialect"),
            Self::BadChecksum => f.write_str("bad checksum"),
            Self::BadTag => f.write_str("bad tag: another key or a forgery"),
            Self::WrongLink(link_id) => write!(f, "made for link {link_id}"),
            Self::FromFuture => f.write_str("stamped in the future"),
            Self::TooOld => f.write_str("stamped too long ago"),
            Self::Replayed => f.write_str("not newer than the last accepted frame"),
            Self::Reflected => f.write_str("of a system that this end signs for: sent back"),
            Self::Signed => f.write_str("the frame is signed"),
            Self::NotStored => f.write_str("no mark above the timestamp can be stored"),
        }
    }
}

impl core::error::Error for SignError {}
impl core::error::Error for ParseError {}
impl core::error::Error for VerifyError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Parse(error) => Some(error),
            _ => None,
        }
    }
}
