//! Bytes of a serial line in, packets out.

use core::fmt;

use heapless::Vec;

use crate::crc::checksum;
use crate::error::ParseError;
use crate::field::{
    CHECKED, CHECKSUM_SIZE, HEADER_SIZE, HEADER_SIZE_V1, INCOMPAT_FLAGS, MAGIC, MAGIC_V1,
    MAX_FRAME_SIZE, SIGNATURE_SIZE, SIGNED_FLAG,
};
use crate::frame::FrameRef;
use crate::header::MessageId;

/// A MAVLink 1 packet with a right checksum. It cannot be signed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mavlink1<'a> {
    bytes: &'a [u8],
    header: &'a [u8; HEADER_SIZE_V1],
}

impl<'a> Mavlink1<'a> {
    /// The packet at the front of `bytes`, which begin with its magic byte.
    fn parse(bytes: &'a [u8]) -> Result<Self, ParseError> {
        let header = bytes.first_chunk().ok_or(ParseError::Truncated)?;
        let &[_, payload_length, ..]: &[u8; HEADER_SIZE_V1] = header;
        let size = HEADER_SIZE_V1 + usize::from(payload_length) + CHECKSUM_SIZE;
        let bytes = bytes.get(..size).ok_or(ParseError::Truncated)?;
        Ok(Self { bytes, header })
    }

    fn checksum_matches(&self, crc_extra: u8) -> bool {
        let Some((before, expected)) = self.bytes.split_last_chunk() else {
            return false;
        };
        let checked = before.get(CHECKED..).unwrap_or_default();
        u16::from_le_bytes(*expected) == checksum(checked, crc_extra)
    }

    /// Which message it carries: 0 to 255.
    #[must_use]
    pub fn message_id(&self) -> MessageId {
        let &[_, _, _, _, _, id] = self.header;
        id.into()
    }

    /// The sending vehicle or station.
    #[must_use]
    pub const fn system_id(&self) -> u8 {
        let &[_, _, _, system_id, _, _] = self.header;
        system_id
    }

    /// The sending part of it.
    #[must_use]
    pub const fn component_id(&self) -> u8 {
        let &[_, _, _, _, component_id, _] = self.header;
        component_id
    }

    /// The whole packet as received, 8 to 263 bytes.
    #[must_use]
    pub const fn as_bytes(&self) -> &'a [u8] {
        self.bytes
    }
}

/// A packet with a right checksum, as what it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packet<'a> {
    /// A MAVLink 2 frame, signed or not.
    Mavlink2(FrameRef<'a>),
    /// A MAVLink 1 packet.
    Mavlink1(Mavlink1<'a>),
}

impl<'a> Packet<'a> {
    /// The packet at the front of `bytes`, its checksum checked with `crc_extra`. What follows it is left
    /// alone. For a datagram, which holds whole packets; a stream needs a [`Decoder`].
    ///
    /// # Errors
    ///
    /// [`DecodeError`]: the bytes do not begin with a whole, undamaged packet of the dialect.
    pub fn parse(
        bytes: &'a [u8],
        crc_extra: impl FnOnce(MessageId) -> Option<u8>,
    ) -> Result<Self, DecodeError> {
        let packet = if bytes.first() == Some(&MAGIC_V1) {
            Self::Mavlink1(Mavlink1::parse(bytes)?)
        } else {
            Self::Mavlink2(FrameRef::parse(bytes)?)
        };
        let id = packet.message_id();
        let crc_extra = crc_extra(id).ok_or(DecodeError::UnknownMessage(id))?;
        let matches = match packet {
            Self::Mavlink2(frame) => frame.checksum_matches(crc_extra),
            Self::Mavlink1(packet) => packet.checksum_matches(crc_extra),
        };
        if matches {
            Ok(packet)
        } else {
            Err(DecodeError::BadChecksum(id))
        }
    }

    /// Which message it carries.
    #[must_use]
    pub fn message_id(&self) -> MessageId {
        match self {
            Self::Mavlink2(frame) => frame.header().message_id,
            Self::Mavlink1(packet) => packet.message_id(),
        }
    }

    /// The whole packet as received, 8 to 280 bytes.
    #[must_use]
    pub const fn as_bytes(&self) -> &'a [u8] {
        match self {
            Self::Mavlink2(frame) => frame.as_bytes(),
            Self::Mavlink1(packet) => packet.as_bytes(),
        }
    }
}

/// Why bytes are not a packet. A damaged line, noise, or another dialect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum DecodeError {
    /// They do not have the shape of a packet.
    Parse(ParseError),
    /// Not in the dialect, so the checksum cannot be checked.
    UnknownMessage(MessageId),
    /// Not the checksum of a message with this id.
    BadChecksum(MessageId),
}

impl From<ParseError> for DecodeError {
    fn from(error: ParseError) -> Self {
        Self::Parse(error)
    }
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parse(error) => error.fmt(f),
            Self::UnknownMessage(id) => write!(f, "message {id} is not in the dialect"),
            Self::BadChecksum(id) => write!(f, "bad checksum for message {id}"),
        }
    }
}

impl core::error::Error for DecodeError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Parse(error) => Some(error),
            _ => None,
        }
    }
}

/// Where to search on after what began like a packet and is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Resync {
    /// At its second byte: the magic byte may have been noise, and what follows a real packet. For
    /// packets that are verified afterwards.
    ///
    /// A packet inside the payload of a damaged or unknown one comes out too. A sender can cause a checksum
    /// over up to 259 bytes with every byte that it sends: one magic byte after the other does.
    NextByte,
    /// After the end that it announces: the payload of a packet that was damaged, but came with all its
    /// bytes, is never taken for packets. For packets that are trusted because of where they come from.
    ///
    /// Where bytes were lost or came in between, that end may lie inside a packet behind it, whose payload
    /// is then searched. Noise that begins like a packet may cost the packets behind it, 280 bytes at most.
    /// It costs as much again where another magic byte comes before a packet begins.
    AnnouncedEnd,
}

/// Finds the packets in a stream of bytes.
///
/// Holds at most the 280 bytes of one frame. What it finds does not depend on how the stream is
/// cut into calls of [`write`](Self::write).
///
/// ```
/// use mavlink_signing::{Decoder, Packet, Resync, dialect::crc_extra};
///
/// let heartbeat = [
///     0xFD, 9, 0, 0, 78, 1, 1, 0, 0, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xC9, 0x78,
/// ];
/// let mut decoder = Decoder::new(Resync::NextByte, crc_extra);
/// decoder.write(b"noise");
/// decoder.write(&heartbeat);
/// let Some(Ok(Packet::Mavlink2(frame))) = decoder.read() else { panic!() };
/// assert_eq!(frame.header().sequence, 78);
/// assert!(decoder.read().is_none());
/// assert_eq!(decoder.dropped(), 5);
/// ```
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: Vec<u8, MAX_FRAME_SIZE>,
    /// Bytes of `buffer` that are done with.
    done: usize,
    /// Bytes after them that the last packet read holds.
    lent: usize,
    /// No byte has come for so long that no packet begun will be finished.
    idle: bool,
    dropped: u32,
    resync: Resync,
    crc_extra: fn(MessageId) -> Option<u8>,
}

impl Decoder {
    /// An empty decoder that checks checksums with `crc_extra`:
    /// [`dialect::crc_extra`](crate::dialect::crc_extra), or a table of your own.
    #[must_use]
    pub const fn new(resync: Resync, crc_extra: fn(MessageId) -> Option<u8>) -> Self {
        Self {
            resync,
            buffer: Vec::new(),
            done: 0,
            lent: 0,
            idle: false,
            dropped: 0,
            crc_extra,
        }
    }

    /// Takes bytes from the front of `bytes`, as many as there is room for. Returns how many.
    ///
    /// There is room for at least one whenever [`read`](Self::read) has returned `None`.
    pub fn write(&mut self, bytes: &[u8]) -> usize {
        self.take_back();
        let done = self.done.min(self.buffer.len());
        if done > 0 {
            self.buffer.copy_within(done.., 0);
            self.buffer.truncate(self.buffer.len() - done);
            self.done = 0;
        }
        let room = self.room();
        let taken = bytes.get(..room).unwrap_or(bytes);
        let appended = self.buffer.extend_from_slice(taken);
        debug_assert!(appended.is_ok(), "only as many as there is room for");
        if !taken.is_empty() {
            self.idle = false;
        }
        taken.len()
    }

    /// Bytes that [`write`](Self::write) would take now: 0 to 280.
    #[must_use]
    pub fn room(&self) -> usize {
        let kept = self.buffer.len() - (self.done + self.lent).min(self.buffer.len());
        MAX_FRAME_SIZE - kept
    }

    /// The next packet, or why something that began like one is none; `None` when more bytes are
    /// needed.
    ///
    /// # Errors
    ///
    /// [`DecodeError::UnknownMessage`], [`DecodeError::BadChecksum`], and of [`DecodeError::Parse`] only
    /// unknown incompatibility flags. What has no magic byte is skipped, what is cut short is waited for.
    /// The search goes on as [`Resync`] says.
    pub fn read(&mut self) -> Option<Result<Packet<'_>, DecodeError>> {
        self.take_back();
        let Self {
            buffer,
            done,
            lent,
            idle,
            dropped,
            resync,
            crc_extra,
        } = self;
        loop {
            let pending = buffer.get(*done..).unwrap_or_default();
            let mut drop = |count: usize| {
                *done += count;
                *dropped = dropped.saturating_add(count as u32);
            };
            match Packet::parse(pending, *crc_extra) {
                Ok(packet) => {
                    *lent = packet.as_bytes().len();
                    return Some(Ok(packet));
                }
                Err(DecodeError::Parse(ParseError::BadMagic(_))) => drop(noise(pending)),
                Err(DecodeError::Parse(ParseError::Truncated)) => {
                    if pending.is_empty() || !*idle {
                        return None;
                    }
                    drop(resync.skip(pending).min(pending.len()));
                }
                Err(fault) => {
                    let skip = resync.skip(pending);
                    // What it announces may not have come yet; it is waited for like a packet.
                    if skip > pending.len() && !*idle {
                        return None;
                    }
                    drop(skip.min(pending.len()));
                    return Some(Err(fault));
                }
            }
        }
    }

    /// Tells the decoder that the line has been silent for longer than any sender pauses within a packet.
    ///
    /// What has begun like a packet is given up. So noise that announces 255 bytes no longer holds back
    /// what follows. With [`Resync::NextByte`] the next [`read`](Self::read) finds the packet behind such
    /// noise.
    pub const fn idle(&mut self) {
        self.idle = true;
    }

    /// Bytes that belonged to no packet, since the start; stays at the top of its range.
    #[must_use]
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }

    /// The last packet has been looked at: its bytes are done with.
    const fn take_back(&mut self) {
        self.done += self.lent;
        self.lent = 0;
    }
}

#[cfg(kani)]
#[cfg_attr(test, mutants::skip)]
impl Decoder {
    /// For proofs: the first `length` bytes of `bytes` in the buffer, `done` and `lent` of them done
    /// with and lent out; nothing dropped so far.
    #[must_use]
    pub fn holding(
        self,
        bytes: [u8; MAX_FRAME_SIZE],
        length: usize,
        [done, lent]: [usize; 2],
    ) -> Self {
        let mut buffer = Vec::from_array(bytes);
        buffer.truncate(length);
        Self {
            buffer,
            done,
            lent,
            ..self
        }
    }

    /// For proofs: what is done with and what is lent out lie in the buffer.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.done <= self.buffer.len() && self.lent <= self.buffer.len() - self.done
    }

    /// For proofs: the bytes that are neither done with nor lent out.
    #[must_use]
    pub fn pending(&self) -> &[u8] {
        self.buffer.get(self.done + self.lent..).unwrap_or_default()
    }

    /// For proofs: [`noise`].
    #[must_use]
    pub fn noise(pending: &[u8]) -> usize {
        noise(pending)
    }
}

impl Resync {
    /// How many bytes of `pending`, which begins like a packet and is none, to give up. More than there are
    /// if its end has not come yet.
    fn skip(self, pending: &[u8]) -> usize {
        match self {
            Self::NextByte => 1,
            Self::AnnouncedEnd => announced_size(pending).unwrap_or(pending.len()),
        }
    }
}

/// Bytes of the packet that `pending` begins like, which may not have come yet; `None` if not even
/// its length has come.
fn announced_size(pending: &[u8]) -> Option<usize> {
    let (magic, length) = (*pending.first()?, usize::from(*pending.get(1)?));
    if magic == MAGIC_V1 {
        return Some(HEADER_SIZE_V1 + length + CHECKSUM_SIZE);
    }
    let signed = pending.get(INCOMPAT_FLAGS)? & SIGNED_FLAG != 0;
    let signature = if signed { SIGNATURE_SIZE } else { 0 };
    Some(HEADER_SIZE + length + CHECKSUM_SIZE + signature)
}

/// Bytes before the next magic byte.
fn noise(pending: &[u8]) -> usize {
    pending
        .iter()
        .position(|byte| matches!(*byte, MAGIC | MAGIC_V1))
        .unwrap_or(pending.len())
}
