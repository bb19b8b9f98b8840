//! A package: 96 bytes, of which the first 8 say who sealed it and where in the sender's order.

use crate::cipher::{PackageTag, Plaintext};
use crate::error::OpenError;
use crate::field::PACKAGE_SIZE;
use crate::header::HeaderFormat;

/// A sealed package, ready to be sent. Made by [`Sealer::seal`](crate::Sealer::seal) alone.
///
/// It may be sent again, and a radio may do so by itself. The receiver accepts it once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Package([u8; PACKAGE_SIZE]);

impl Package {
    pub(crate) fn new(header: impl HeaderFormat, sealed: &Plaintext, tag: &PackageTag) -> Self {
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
pub(crate) struct Parts<'a, H> {
    pub(crate) header: H,
    pub(crate) sealed: &'a Plaintext,
    pub(crate) tag: &'a PackageTag,
}

impl<'a, H: HeaderFormat> Parts<'a, H> {
    pub(crate) fn parse(bytes: &'a [u8]) -> Result<Self, OpenError> {
        let parts = || {
            let (header, rest) = bytes.split_first_chunk()?;
            let (sealed, tag) = rest.split_first_chunk()?;
            Some(Self {
                header: H::from_wire(header),
                sealed,
                tag: tag.try_into().ok()?,
            })
        };
        parts().ok_or(OpenError::WrongLength(bytes.len()))
    }
}
