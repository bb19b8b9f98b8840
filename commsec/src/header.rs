//! The header of a package, in two formats: who sealed it, and where in the sender's order.

use core::fmt;

use crate::error::OpenError;
use crate::field::HEADER_SIZE;
use crate::sender::{EpochCounter, EpochSenderId, SenderId};

/// What a package says of itself, unsealed but under the tag. The format that SMACCMPilot speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PackageHeader {
    /// Who sealed it.
    pub sender: SenderId,
    /// Its number among everything that this sender seals: 1 to 2^32 - 2.
    pub counter: u32,
}

impl PackageHeader {
    /// The header in its 8 bytes on the wire, big-endian.
    #[must_use]
    pub const fn from_wire(wire: &[u8; HEADER_SIZE]) -> Self {
        let [a, b, c, d, e, f, g, h] = *wire;
        Self {
            sender: SenderId(u32::from_be_bytes([a, b, c, d])),
            counter: u32::from_be_bytes([e, f, g, h]),
        }
    }

    /// Its 8 bytes on the wire, big-endian.
    #[must_use]
    pub const fn to_wire(self) -> [u8; HEADER_SIZE] {
        let [a, b, c, d] = self.sender.0.to_be_bytes();
        let [e, f, g, h] = self.counter.to_be_bytes();
        [a, b, c, d, e, f, g, h]
    }
}

/// The header of SMACCMPilot's draft "commsec re-do", which their software never sent. It has a 16-bit
/// number for each start of the sender.
///
/// ```text
/// counter | epoch | sender id
///    4    |   2   |     2        big-endian
/// ```
///
/// A sender stores once at each start, not again and again while it counts. A receiver of the other format
/// reads the counter as a sender, which it mostly does not know. If it does, and key and salt are the same,
/// it is a package of that sender. So each key must have one header alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EpochHeader {
    /// Epoch and counter: its place among everything that this sender seals.
    pub sequence: EpochCounter,
    /// Who sealed it.
    pub sender: EpochSenderId,
}

impl EpochHeader {
    /// The header in its 8 bytes on the wire, big-endian.
    #[must_use]
    pub const fn from_wire(wire: &[u8; HEADER_SIZE]) -> Self {
        let [a, b, c, d, e, f, g, h] = *wire;
        Self {
            sequence: EpochCounter {
                epoch: u16::from_be_bytes([e, f]),
                counter: u32::from_be_bytes([a, b, c, d]),
            },
            sender: EpochSenderId(u16::from_be_bytes([g, h])),
        }
    }

    /// Its 8 bytes on the wire, big-endian.
    #[must_use]
    pub const fn to_wire(self) -> [u8; HEADER_SIZE] {
        let [a, b, c, d] = self.sequence.counter.to_be_bytes();
        let [e, f] = self.sequence.epoch.to_be_bytes();
        let [g, h] = self.sender.0.to_be_bytes();
        [a, b, c, d, e, f, g, h]
    }
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for super::PackageHeader {}
    impl Sealed for super::EpochHeader {}
    impl Sealed for super::SenderId {}
    impl Sealed for super::EpochSenderId {}
}

/// The two headers there are, [`PackageHeader`] and [`EpochHeader`]. Both are 8 bytes of the nonce, so a
/// key belongs to one of them.
pub trait HeaderFormat: Copy + Eq + fmt::Debug + sealed::Sealed {
    /// Who sealed a package.
    type Id: Sender<PackageHeader = Self>;
    /// A package's sequence number among everything that its sender seals: later ones are greater.
    type Sequence: Copy + Ord + fmt::Debug;
    /// Below the first sequence number of all.
    const ZERO: Self::Sequence;
    /// The greatest sequence number, which no sender uses.
    const NEVER_USED: Self::Sequence;

    /// The header of a package.
    fn new(sender: Self::Id, sequence: Self::Sequence) -> Self;
    /// Who sealed it.
    fn sender(self) -> Self::Id;
    /// Its sequence number.
    fn sequence(self) -> Self::Sequence;
    /// The counter in a sequence number.
    fn counter(sequence: Self::Sequence) -> u32;
    /// The sequence number with the next counter.
    fn next(sequence: Self::Sequence) -> Self::Sequence;
    /// The header in its 8 bytes on the wire.
    fn from_wire(wire: &[u8; HEADER_SIZE]) -> Self;
    /// Its 8 bytes on the wire.
    fn to_wire(self) -> [u8; HEADER_SIZE];
    /// Whether its sequence number is above all that a sender uses.
    fn is_exhausted(self) -> bool;
    /// The error that its sequence number was accepted before, or lies too far behind `last`, the newest.
    fn stale(self, last: Self::Sequence) -> OpenError;
    /// From `low` to `high`, in counters; `None` between epochs, and where `high` is the lower one.
    fn distance(low: Self::Sequence, high: Self::Sequence) -> Option<u32>;
    /// How many counters lie between `from` and `to`, each epoch counted as 2^16; 0 if `to` is not above `from`.
    fn passed_over(from: Self::Sequence, to: Self::Sequence) -> u64;
}

/// An id, whose type says which header it belongs to.
pub trait Sender: Copy + Eq + fmt::Debug + Into<SenderId> + sealed::Sealed {
    /// That header.
    type PackageHeader: HeaderFormat<Id = Self>;
}

impl Sender for SenderId {
    type PackageHeader = PackageHeader;
}

impl Sender for EpochSenderId {
    type PackageHeader = EpochHeader;
}

impl HeaderFormat for PackageHeader {
    type Id = SenderId;
    type Sequence = u32;
    const ZERO: u32 = 0;
    const NEVER_USED: u32 = u32::MAX;

    fn new(sender: SenderId, counter: u32) -> Self {
        Self { sender, counter }
    }

    fn sender(self) -> SenderId {
        self.sender
    }

    fn sequence(self) -> u32 {
        self.counter
    }

    fn counter(sequence: u32) -> u32 {
        sequence
    }

    fn next(sequence: u32) -> u32 {
        sequence.saturating_add(1)
    }

    fn from_wire(wire: &[u8; HEADER_SIZE]) -> Self {
        Self::from_wire(wire)
    }

    fn to_wire(self) -> [u8; HEADER_SIZE] {
        self.to_wire()
    }

    fn is_exhausted(self) -> bool {
        self.counter == u32::MAX
    }

    fn stale(self, last: u32) -> OpenError {
        OpenError::Stale {
            counter: self.counter,
            last,
        }
    }

    fn distance(low: u32, high: u32) -> Option<u32> {
        high.checked_sub(low)
    }

    fn passed_over(from: u32, to: u32) -> u64 {
        to.saturating_sub(from).saturating_sub(1).into()
    }
}

impl HeaderFormat for EpochHeader {
    type Id = EpochSenderId;
    type Sequence = EpochCounter;
    const ZERO: EpochCounter = EpochCounter {
        epoch: 0,
        counter: 0,
    };
    const NEVER_USED: EpochCounter = EpochCounter {
        epoch: u16::MAX,
        counter: u32::MAX,
    };

    fn new(sender: EpochSenderId, sequence: EpochCounter) -> Self {
        Self { sequence, sender }
    }

    fn sender(self) -> EpochSenderId {
        self.sender
    }

    fn sequence(self) -> EpochCounter {
        self.sequence
    }

    fn counter(sequence: EpochCounter) -> u32 {
        sequence.counter
    }

    fn next(sequence: EpochCounter) -> EpochCounter {
        EpochCounter {
            counter: sequence.counter.saturating_add(1),
            ..sequence
        }
    }

    fn from_wire(wire: &[u8; HEADER_SIZE]) -> Self {
        Self::from_wire(wire)
    }

    fn to_wire(self) -> [u8; HEADER_SIZE] {
        self.to_wire()
    }

    fn is_exhausted(self) -> bool {
        self.sequence.counter == u32::MAX || self.sequence.epoch == u16::MAX
    }

    fn stale(self, last: EpochCounter) -> OpenError {
        OpenError::StaleInEpoch {
            sequence: self.sequence,
            last,
        }
    }

    fn distance(low: EpochCounter, high: EpochCounter) -> Option<u32> {
        let distance = high.counter.checked_sub(low.counter);
        distance.filter(|_| low.epoch == high.epoch)
    }

    fn passed_over(from: EpochCounter, to: EpochCounter) -> u64 {
        let epochs = to.epoch.checked_sub(from.epoch);
        let (epochs, counters) = match epochs {
            None => (0, 0),
            Some(0) => (0, to.counter.saturating_sub(from.counter)),
            Some(epochs) => (epochs, to.counter),
        };
        (u64::from(epochs) << 16).saturating_add(counters.saturating_sub(1).into())
    }
}
