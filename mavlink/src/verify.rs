//! Authenticity first, then order: what turns a received frame into one to act on.

use subtle::ConstantTimeEq;

use crate::dialect::crc_extra;
use crate::error::VerifyError;
use crate::frame::{Frame, FrameRef, Tag};
use crate::header::Header;
use crate::key::SigningKey;
use crate::key_ring::KeyUse;
use crate::profile::Profile;
use crate::time::Stamp;

/// A frame that was signed with the key, at some time: it may be a replay.
///
/// Made by [`authenticate`] alone.
#[derive(Debug)]
pub struct Authentic<'a> {
    frame: FrameRef<'a>,
    stamp: Stamp,
    crc_extra: u8,
    key: KeyUse,
}

impl Authentic<'_> {
    /// Which key it was signed with.
    #[must_use]
    pub const fn key(&self) -> KeyUse {
        self.key
    }

    pub(crate) const fn with_key(self, key: KeyUse) -> Self {
        Self { key, ..self }
    }

    /// The header, as the sender made it.
    #[must_use]
    pub const fn header(&self) -> Header {
        self.frame.header()
    }

    /// The link and the moment that the sender signed for.
    #[must_use]
    pub const fn stamp(&self) -> Stamp {
        self.stamp
    }
}

/// A frame to act on: signed with the key, for this link, inside the window, and newer than every
/// frame accepted before.
///
/// Made by [`ReplayGuard::admit`](crate::ReplayGuard::admit) and
/// [`StreamTable::admit`](crate::StreamTable::admit) alone. It is not copied, so that it is acted on once.
#[derive(Debug)]
pub struct Verified<'a>(Authentic<'a>);

impl<'a> Verified<'a> {
    /// Only for code that admits a frame.
    pub(crate) const fn new(frame: Authentic<'a>) -> Self {
        Self(frame)
    }

    /// The header.
    #[must_use]
    pub const fn header(&self) -> Header {
        self.0.header()
    }

    /// The link and the moment that the sender signed for.
    #[must_use]
    pub const fn stamp(&self) -> Stamp {
        self.0.stamp()
    }

    /// Which key it was signed with.
    #[must_use]
    pub const fn key(&self) -> KeyUse {
        self.0.key()
    }

    /// The payload, 0 to 255 bytes, its trailing zeros cut by the sender.
    #[must_use]
    pub const fn payload(&self) -> &'a [u8] {
        self.0.frame.payload()
    }

    /// The whole frame as received, signature included: to forward it untouched.
    #[must_use]
    pub const fn as_bytes(&self) -> &'a [u8] {
        self.0.frame.as_bytes()
    }

    /// The same frame as received, signature included, to be sent on later.
    #[must_use]
    pub fn to_frame(&self) -> Frame {
        Frame::copy_of(self.0.frame, self.0.crc_extra)
    }

    /// The same frame for a link without signing: signature removed, flag cleared, checksum recomputed.
    #[must_use]
    pub fn to_unsigned(&self) -> Frame {
        let payload = self.payload();
        // A view's payload length is one byte on the wire.
        let length = u8::try_from(payload.len()).unwrap_or(u8::MAX);
        Frame::unsigned(&self.header().to_wire(length), payload, self.0.crc_extra)
    }
}

/// Whether `frame` was signed with `key`: signed flag, known message, checksum, tag, in this
/// order.
///
/// A pure function: it says nothing about when the frame was signed, and for which link. The tag
/// is compared in constant time.
///
/// # Errors
///
/// [`VerifyError::NotSigned`], [`VerifyError::UnknownMessage`], [`VerifyError::BadChecksum`],
/// [`VerifyError::BadTag`].
pub fn authenticate<'a, P: Profile>(
    frame: FrameRef<'a>,
    key: &SigningKey<P>,
) -> Result<Authentic<'a>, VerifyError> {
    let signature = frame.signature().ok_or(VerifyError::NotSigned)?;
    let (covered, tag) = frame.split_tag().ok_or(VerifyError::NotSigned)?;
    let id = frame.header().message_id;
    let crc_extra = crc_extra(id).ok_or(VerifyError::UnknownMessage(id))?;
    if !frame.checksum_matches(crc_extra) {
        return Err(VerifyError::BadChecksum);
    }
    if !same(key.tag(covered), *tag) {
        return Err(VerifyError::BadTag);
    }
    Ok(Authentic {
        frame,
        stamp: signature.stamp,
        crc_extra,
        key: KeyUse::ONLY,
    })
}

/// Compares in constant time: as one word, which is less work than byte by byte.
fn same(one: Tag, other: Tag) -> bool {
    let word = |[a, b, c, d, e, f]: Tag| u64::from_le_bytes([a, b, c, d, e, f, 0, 0]);
    word(one).ct_eq(&word(other)).into()
}
