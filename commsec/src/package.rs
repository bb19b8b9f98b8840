//! A package: 96 bytes, of which the first 8 say who sealed it and when in his order.

use crate::cipher::{Message, Tag};
use crate::error::OpenError;
use crate::field::{HEADER_SIZE, PACKAGE_SIZE};
use crate::key::SenderId;

/// What a package says of itself, unsealed but under the tag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Header {
    /// Who sealed it.
    pub sender: SenderId,
    /// Its place among everything that this sender seals: 1 to 2^32 - 2.
    pub counter: u32,
}

impl Header {
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

/// A sealed package, ready to be sent. Made by [`Sealer::seal`](crate::Sealer::seal) alone.
///
/// It may be sent again, and a radio may do so by itself: the receiver takes it once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Package([u8; PACKAGE_SIZE]);

impl Package {
    pub(crate) fn new(header: Header, sealed: &Message, tag: &Tag) -> Self {
        let mut bytes = [0; PACKAGE_SIZE];
        let header = header.to_wire();
        let parts = header.iter().chain(sealed).chain(tag);
        for (slot, byte) in bytes.iter_mut().zip(parts) {
            *slot = *byte;
        }
        Self(bytes)
    }

    /// Its 96 bytes on the wire.
    #[must_use]
    pub const fn as_bytes(&self) -> &[u8; PACKAGE_SIZE] {
        &self.0
    }
}

/// The parts of 96 received bytes.
#[derive(Clone, Copy)]
pub(crate) struct Parts<'a> {
    pub(crate) header: Header,
    pub(crate) sealed: &'a Message,
    pub(crate) tag: &'a Tag,
}

impl<'a> Parts<'a> {
    pub(crate) fn of(bytes: &'a [u8]) -> Result<Self, OpenError> {
        let parts = || {
            let (header, rest) = bytes.split_first_chunk()?;
            let (sealed, tag) = rest.split_first_chunk()?;
            Some(Self {
                header: Header::from_wire(header),
                sealed,
                tag: tag.try_into().ok()?,
            })
        };
        parts().ok_or(OpenError::WrongLength(bytes.len()))
    }
}
