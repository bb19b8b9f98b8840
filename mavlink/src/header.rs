//! The header of a MAVLink 2 frame and the message id in it.

use core::fmt;

use crate::field::{HEADER_SIZE, MAGIC};

/// Which message a frame carries: 24 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MessageId(u32);

impl MessageId {
    /// The message id `id`; `None` beyond 24 bits.
    #[must_use]
    pub const fn new(id: u32) -> Option<Self> {
        if id < 1 << 24 { Some(Self(id)) } else { None }
    }

    /// The message id in 3 bytes, little-endian, as in a header.
    #[must_use]
    pub const fn from_le_bytes(wire: [u8; 3]) -> Self {
        let [a, b, c] = wire;
        Self(u32::from_le_bytes([a, b, c, 0]))
    }

    /// Its 3 bytes in a header, little-endian.
    #[must_use]
    pub const fn to_le_bytes(self) -> [u8; 3] {
        let [a, b, c, _] = self.0.to_le_bytes();
        [a, b, c]
    }

    /// The number.
    #[must_use]
    pub const fn get(self) -> u32 {
        self.0
    }
}

impl From<u8> for MessageId {
    /// The id in a MAVLink 1 packet.
    fn from(id: u8) -> Self {
        Self(id.into())
    }
}

impl fmt::Display for MessageId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// What a sender says about a frame, apart from what the wire format decides itself: magic byte,
/// payload length and incompatibility flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Header {
    /// Flags that a receiver may ignore.
    pub compat_flags: u8,
    /// Counts the frames of a sender, modulo 256.
    pub sequence: u8,
    /// The sending vehicle or station.
    pub system_id: u8,
    /// The sending part of it.
    pub component_id: u8,
    /// Which message the payload holds.
    pub message_id: MessageId,
}

impl Header {
    /// The header in its 10 bytes on the wire.
    pub(crate) const fn from_wire(wire: &[u8; HEADER_SIZE]) -> Self {
        let [
            _,
            _,
            _,
            compat_flags,
            sequence,
            system_id,
            component_id,
            a,
            b,
            c,
        ] = *wire;
        Self {
            compat_flags,
            sequence,
            system_id,
            component_id,
            message_id: MessageId::from_le_bytes([a, b, c]),
        }
    }

    /// Its 10 bytes on the wire, in front of an unsigned payload of `payload_length` bytes.
    pub(crate) const fn to_wire(self, payload_length: u8) -> [u8; HEADER_SIZE] {
        let Self {
            compat_flags,
            sequence,
            system_id,
            component_id,
            message_id,
        } = self;
        let [a, b, c] = message_id.to_le_bytes();
        [
            MAGIC,
            payload_length,
            0,
            compat_flags,
            sequence,
            system_id,
            component_id,
            a,
            b,
            c,
        ]
    }
}
