//! Who seals packages, and a package's sequence number among all of its sender.

use core::fmt;

/// Who sealed a package: a vehicle or a ground station, by the number that the key file gives it.
///
/// Any number; SMACCMPilot's own receivers know only 0 to 15.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SenderId(
    /// The number.
    pub u32,
);

/// Who sealed a package with an [`EpochHeader`](crate::EpochHeader), which has 16 bits for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EpochSenderId(
    /// The number.
    pub u16,
);

impl From<EpochSenderId> for SenderId {
    fn from(id: EpochSenderId) -> Self {
        Self(id.0.into())
    }
}

impl fmt::Display for SenderId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl fmt::Display for EpochSenderId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// An epoch and a counter in it. Of two, that of the later epoch is the later one, whatever the counters.
///
/// Receivers also accept the counter 0, with which the draft begins, in every epoch but the first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EpochCounter {
    // In front of the counter, since the derived order compares it first.
    /// Which start of the sender: 0 to 2^16 - 2.
    pub epoch: u16,
    /// The place in the epoch: 1 to 2^32 - 2.
    pub counter: u32,
}

impl EpochCounter {
    /// The inverse of [`to_number`](Self::to_number); `None` beyond 48 bits.
    #[must_use]
    pub const fn from_number(number: u64) -> Option<Self> {
        match number.to_be_bytes() {
            [0, 0, a, b, c, d, e, f] => Some(Self {
                epoch: u16::from_be_bytes([a, b]),
                counter: u32::from_be_bytes([c, d, e, f]),
            }),
            _ => None,
        }
    }

    /// Both as one number of 48 bits, the epoch in the high bits. It goes up where this does: for a mark in
    /// storage.
    #[must_use]
    pub const fn to_number(self) -> u64 {
        let [a, b] = self.epoch.to_be_bytes();
        let [c, d, e, f] = self.counter.to_be_bytes();
        u64::from_be_bytes([0, 0, a, b, c, d, e, f])
    }
}

impl fmt::Display for EpochCounter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { epoch, counter } = self;
        write!(f, "{counter} of epoch {epoch}")
    }
}
