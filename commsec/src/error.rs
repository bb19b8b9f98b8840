//! What can be wrong with a received package, and who is at fault.

use core::fmt;

use crate::field::PACKAGE_SIZE;
use crate::sender::{EpochCounter, SenderId};

/// Why a received package is rejected. The receiver remembers nothing of it, except that it counts a
/// [`BadTag`](Self::BadTag).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum OpenError {
    /// Not 96 bytes, but this many: bytes were lost, or this is no package.
    WrongLength(usize),
    /// Nobody has permitted this sender.
    UnknownSender(SenderId),
    /// A counter, or an epoch, whose bits are all ones. No sender uses it: nothing would be newer.
    NoCounter(SenderId),
    /// Accepted before, or more than 64 counters behind the newest accepted from its sender: a replay, a duplicate,
    /// very late, or a sender that counts from the beginning again. Anybody can send one without the key.
    Stale {
        /// The counter that the package claims.
        counter: u32,
        /// The counter of the newest package accepted from that sender.
        last: u32,
    },
    /// The same of a package with an epoch; or of an older epoch.
    StaleInEpoch {
        /// Epoch and counter that the package claims.
        sequence: EpochCounter,
        /// Those of the newest package accepted from that sender.
        last: EpochCounter,
    },
    /// Its tag is right, but it is so far above the newest accepted from its sender that more than
    /// [`MAX_PASSED_OVER`](crate::MAX_PASSED_OVER) counters would have been passed over since the start.
    JumpTooFar(SenderId),
    /// Its tag is right, but its counter is below those that [`Opener::open_between`](crate::Opener::open_between) was
    /// told to accept: the package was held back, or a clock is wrong.
    TooOld(SenderId),
    /// Its tag is right, but its counter is above those: a clock is wrong.
    FromFuture(SenderId),
    /// Too many packages with a wrong tag have come. No further one is tried before the next start.
    IntegrityLimitReached,
    /// Another key or salt, damage on the way, or a forgery.
    BadTag,
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
                "counter {counter} is a replay or too old: {last} is the newest accepted"
            ),
            Self::StaleInEpoch { sequence, last } => write!(
                f,
                "counter {sequence} is a replay or too old: {last} is the newest accepted"
            ),
            Self::JumpTooFar(sender) => {
                write!(f, "sender {sender} has passed over too many counters")
            }
            Self::TooOld(sender) => write!(f, "a package of sender {sender} is too old"),
            Self::FromFuture(sender) => {
                write!(f, "a package of sender {sender} is from the future")
            }
            Self::IntegrityLimitReached => f.write_str("too many wrong tags: the key is worn out"),
            Self::BadTag => f.write_str("bad tag: another key or a forgery"),
        }
    }
}

impl core::error::Error for OpenError {}
