//! MAVLink 2 frames as their wire bytes: received ones borrowed, ones to send owned.

use core::fmt;

use heapless::Vec;

use crate::crc::checksum;
use crate::dialect::crc_extra;
use crate::error::{ParseError, SignError};
use crate::field::{
    CHECKED, CHECKSUM_SIZE, HEADER_SIZE, INCOMPAT_FLAGS, LINK_ID_SIZE, MAGIC, MAX_FRAME_SIZE,
    SIGNATURE_SIZE, SIGNED_FLAG, TAG_SIZE, TIMESTAMP_SIZE,
};
use crate::header::{Header, MessageId};
use crate::time::{Stamp, Timestamp};

/// The cut tag of a signature, 6 bytes.
pub type Tag = [u8; TAG_SIZE];

/// The last 13 bytes of a signed frame (MAVLink guide, "Message Signing", Frame Format).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Signature {
    /// The link and the moment that the sender signed for.
    pub stamp: Stamp,
    /// The cut tag.
    pub tag: Tag,
}

impl Signature {
    const fn from_wire(wire: &[u8; SIGNATURE_SIZE]) -> Self {
        let [link_id, a, b, c, d, e, f, t, u, v, w, x, y] = *wire;
        Self {
            stamp: Stamp {
                link_id,
                timestamp: Timestamp::from_wire([a, b, c, d, e, f]),
            },
            tag: [t, u, v, w, x, y],
        }
    }
}

/// A received frame: a view of bytes that are not authenticated yet.
///
/// The header can be read, for logs and routing, and the bytes as a whole, to be passed on. There is
/// no accessor for the payload: [`Verified`](crate::Verified) has one, and [`Unsigned`](crate::Unsigned).
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct FrameRef<'a> {
    bytes: &'a [u8],
    header: &'a [u8; HEADER_SIZE],
    payload: &'a [u8],
    checksum: [u8; CHECKSUM_SIZE],
    signature: Option<&'a [u8; SIGNATURE_SIZE]>,
}

impl<'a> FrameRef<'a> {
    /// The frame at the front of `bytes`; what follows it is left alone.
    ///
    /// Looks at magic byte, incompatibility flags and length, and copies nothing. It does not look at
    /// checksum or tag.
    ///
    /// # Errors
    ///
    /// [`ParseError`]: the bytes do not begin with a whole MAVLink 2 frame that this library
    /// understands. A receiver must drop a frame with an incompatibility flag that it does not
    /// know (MAVLink guide, "Packet Serialization", incompatibility flags).
    pub fn parse(bytes: &'a [u8]) -> Result<Self, ParseError> {
        match bytes.first() {
            None => return Err(ParseError::Truncated),
            Some(&MAGIC) => {}
            Some(&other) => return Err(ParseError::BadMagic(other)),
        }
        let (header, rest) = bytes.split_first_chunk().ok_or(ParseError::Truncated)?;
        let &[_, payload_length, incompat_flags, ..]: &[u8; HEADER_SIZE] = header;
        if incompat_flags & !SIGNED_FLAG != 0 {
            return Err(ParseError::UnknownIncompatFlags(incompat_flags));
        }
        let (payload, rest) = rest
            .split_at_checked(payload_length.into())
            .ok_or(ParseError::Truncated)?;
        let (&checksum, rest) = rest.split_first_chunk().ok_or(ParseError::Truncated)?;
        let (signature, rest) = if incompat_flags & SIGNED_FLAG == 0 {
            (None, rest)
        } else {
            let (signature, rest) = rest.split_first_chunk().ok_or(ParseError::Truncated)?;
            (Some(signature), rest)
        };
        let bytes = bytes
            .get(..bytes.len() - rest.len())
            .ok_or(ParseError::Truncated)?;
        Ok(Self {
            bytes,
            header,
            payload,
            checksum,
            signature,
        })
    }

    /// The header.
    #[must_use]
    pub const fn header(&self) -> Header {
        Header::from_wire(self.header)
    }

    /// The whole frame as received, 12 to 280 bytes: to forward it untouched.
    #[must_use]
    pub const fn as_bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Whether the frame carries a signature. It may be anybody's.
    #[must_use]
    pub const fn is_signed(&self) -> bool {
        self.signature.is_some()
    }

    /// The frame's signature, if it carries one. It may be forged.
    #[must_use]
    pub fn signature(&self) -> Option<Signature> {
        self.signature.map(Signature::from_wire)
    }

    /// Whether the frame's checksum is right for a message with this `crc_extra`.
    #[must_use]
    pub fn checksum_matches(&self, crc_extra: u8) -> bool {
        u16::from_le_bytes(self.checksum) == checksum(self.checked(), crc_extra)
    }

    /// What lies under the checksum: header without magic byte, and payload.
    fn checked(&self) -> &'a [u8] {
        let end = HEADER_SIZE + self.payload.len();
        self.bytes.get(CHECKED..end).unwrap_or_default()
    }

    /// What lies under the tag, and the tag; `None` without signature.
    pub(crate) fn split_tag(&self) -> Option<(&'a [u8], &'a Tag)> {
        self.signature.and(self.bytes.split_last_chunk())
    }

    pub(crate) const fn payload(&self) -> &'a [u8] {
        self.payload
    }
}

impl fmt::Debug for FrameRef<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FrameRef")
            .field("header", &self.header())
            .field("payload_length", &self.payload.len())
            .field("stamp", &self.signature().map(|signature| signature.stamp))
            .finish()
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for FrameRef<'_> {
    fn format(&self, f: defmt::Formatter<'_>) {
        let length = self.payload.len();
        let stamp = self.signature().map(|signature| signature.stamp);
        defmt::write!(
            f,
            "{} payload of {=usize}, {}",
            self.header(),
            length,
            stamp
        );
    }
}

/// A frame to send, in a buffer of its own: 280 bytes and two lengths.
///
/// Its bytes are a whole frame with a right checksum at all times, signed or not.
#[derive(Clone, PartialEq, Eq)]
pub struct Frame {
    bytes: Vec<u8, MAX_FRAME_SIZE>,
    crc_extra: u8,
}

impl Frame {
    /// An unsigned frame of `header` and `payload`.
    ///
    /// The payload is taken as it is. The guide tells senders to cut its trailing zeros first (MAVLink
    /// guide, "Packet Serialization", Payload Truncation): see
    /// [`without_trailing_zeros`](crate::without_trailing_zeros).
    ///
    /// # Errors
    ///
    /// [`SignError::PayloadTooLong`] above 255 bytes; [`SignError::UnknownMessage`], since
    /// without the message's CRC_EXTRA there is no right checksum.
    pub fn new(header: Header, payload: &[u8]) -> Result<Self, SignError> {
        let payload_length =
            u8::try_from(payload.len()).map_err(|_| SignError::PayloadTooLong(payload.len()))?;
        let id = header.message_id;
        let crc_extra = crc_extra(id).ok_or(SignError::UnknownMessage(id))?;
        Ok(Self::unsigned(
            &header.to_wire(payload_length),
            payload,
            crc_extra,
        ))
    }

    /// The whole frame, 12 to 280 bytes: what is sent.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Whether the frame is signed.
    #[must_use]
    pub fn is_signed(&self) -> bool {
        self.bytes
            .get(INCOMPAT_FLAGS)
            .is_some_and(|flags| flags & SIGNED_FLAG != 0)
    }

    /// A frame without signature; `header` says so already.
    pub(crate) fn unsigned(header: &[u8; HEADER_SIZE], payload: &[u8], crc_extra: u8) -> Self {
        let mut frame = Self {
            bytes: Vec::new(),
            crc_extra,
        };
        frame.append(header);
        frame.append(payload);
        frame.append(&[0; CHECKSUM_SIZE]);
        frame.write_checksum();
        frame
    }

    /// A frame that was received with a right checksum.
    pub(crate) fn copy_of(frame: FrameRef<'_>, crc_extra: u8) -> Self {
        let mut copy = Self {
            bytes: Vec::new(),
            crc_extra,
        };
        copy.append(frame.as_bytes());
        copy
    }

    /// Flag, checksum, link id and timestamp, in this order, then the tag that `tag` makes of all
    /// bytes before it. The frame must not be signed yet.
    pub(crate) fn sign(&mut self, stamp: Stamp, tag: impl FnOnce(&[u8]) -> Tag) {
        if let Some(flags) = self.bytes.get_mut(INCOMPAT_FLAGS) {
            *flags |= SIGNED_FLAG;
        }
        self.write_checksum();
        let link_id: [u8; LINK_ID_SIZE] = [stamp.link_id];
        let timestamp: [u8; TIMESTAMP_SIZE] = stamp.timestamp.to_wire();
        self.append(&link_id);
        self.append(&timestamp);
        let tag = tag(&self.bytes);
        self.append(&tag);
    }

    /// Sets the last 2 bytes of an unsigned frame to the checksum of what stands before them.
    fn write_checksum(&mut self) {
        if let Some((before, end)) = self.bytes.split_last_chunk_mut() {
            let checked = before.get(CHECKED..).unwrap_or_default();
            *end = checksum(checked, self.crc_extra).to_le_bytes();
        }
    }

    /// Never full: the buffer has room for the longest of every part, and each is appended once.
    fn append(&mut self, part: &[u8]) {
        let appended = self.bytes.extend_from_slice(part);
        debug_assert!(appended.is_ok(), "a frame of more than 280 bytes");
    }
}

impl TryFrom<FrameRef<'_>> for Frame {
    type Error = SignError;

    /// A copy of a received frame, signed or not, to be sent on. Its checksum must be right, so
    /// that a damaged frame is never given a fresh one.
    fn try_from(frame: FrameRef<'_>) -> Result<Self, SignError> {
        let id: MessageId = frame.header().message_id;
        let crc_extra = crc_extra(id).ok_or(SignError::UnknownMessage(id))?;
        if !frame.checksum_matches(crc_extra) {
            return Err(SignError::BadChecksum);
        }
        Ok(Self::copy_of(frame, crc_extra))
    }
}

impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match FrameRef::parse(&self.bytes) {
            Ok(frame) => frame.fmt(f),
            Err(_) => f.write_str("Frame"),
        }
    }
}
