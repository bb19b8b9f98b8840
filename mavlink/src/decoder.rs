//! Bytes of a serial line in, packets out.

use core::fmt;

use heapless::Vec;
use zeroize::Zeroize;

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
    /// A packet inside the payload of a damaged or unknown one comes out too. A sender can cause a checksum over about
    /// 64 bytes with every byte that it sends: 8 of MAVLink 1, and 56 of MAVLink 2, whose beginning takes 5 bytes.
    NextByte,
    /// After a silence. For packets that are trusted because of where they come from: what lies inside a payload never
    /// becomes a packet, as long as the decoder is told of each [`fault`](Decoder::fault) of the line.
    ///
    /// Each byte is part of a packet, or the place in the stream is lost: a byte between packets that is no magic
    /// byte, a bad checksum, an unknown message, unknown flags. Then all is dropped until the line has been silent for
    /// longer than its sender ever pauses within a packet. A packet that has begun is never given up at a pause: the
    /// bytes that it announces are waited for.
    ///
    /// Bytes that were lost without notice are found by the checksum, but for one packet in 2^16, or one that somebody
    /// made fit who knew what was lost.
    Silence,
}

/// What becomes of bytes that come in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Intake {
    /// They go into the buffer.
    Open,
    /// They wait: what has begun in the buffer goes no further, and has not been read to its end yet.
    Ended,
    /// They wait: the line was silent behind what is in the buffer, which has not been read to its end yet.
    Paused,
    /// They are dropped: they may be the rest of a payload.
    Deaf,
}

/// What may be spent on checksums of MAVLink 1 with [`Resync::NextByte`], so that a flood of magic bytes costs little: 8
/// bytes under a checksum for each byte of the stream. A packet takes one for each byte of its own.
///
/// It depends on the place in the stream alone, not on how the stream was cut.
struct Credit {
    bytes: u32,
    /// Up to which place of the stream it was counted, modulo 2^32.
    place: u32,
}

impl Credit {
    /// Enough for any packet, and the most that is saved up.
    const FULL: Self = Self {
        bytes: 8 * MAX_FRAME_SIZE as u32,
        place: 0,
    };

    /// Whether there is enough for what `pending` begins like, at this `place` of the stream, which never goes back. If
    /// so, it is spent.
    fn affords(&mut self, pending: &[u8], place: u32) -> bool {
        let come = place.wrapping_sub(self.place);
        let earned = self.bytes.saturating_add(come.saturating_mul(8));
        self.bytes = earned.min(Self::FULL.bytes);
        self.place = place;
        let size = announced_size(pending).filter(|size| *size <= pending.len());
        let (Some(&MAGIC_V1), Some(size)) = (pending.first(), size) else {
            return true;
        };
        match self.bytes.checked_sub(size as u32) {
            Some(left) => {
                self.bytes = left;
                true
            }
            None => false,
        }
    }
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
pub struct Decoder {
    buffer: Vec<u8, MAX_FRAME_SIZE>,
    /// Bytes of `buffer` that are done with.
    done: usize,
    /// Bytes after them that the last packet read holds.
    lent: usize,
    intake: Intake,
    credit: Credit,
    /// Bytes that are no longer in the buffer, modulo 2^32.
    passed: u32,
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
            intake: Intake::Open,
            credit: Credit::FULL,
            passed: 0,
            dropped: 0,
            crc_extra,
        }
    }

    /// Takes bytes from the front of `bytes`, as many as there is room for. Returns how many.
    ///
    /// There is room for at least one whenever [`read`](Self::read) has returned `None`.
    pub fn write(&mut self, bytes: &[u8]) -> usize {
        match self.intake {
            Intake::Open => self.append(bytes),
            Intake::Ended | Intake::Paused => 0,
            Intake::Deaf => {
                self.dropped = self.dropped.saturating_add(bytes.len() as u32);
                bytes.len()
            }
        }
    }

    fn append(&mut self, bytes: &[u8]) -> usize {
        self.take_back();
        let (done, end) = (self.done.min(self.buffer.len()), self.buffer.len());
        if done > 0 {
            self.buffer.copy_within(done.., 0);
            // What was done with may have been a key.
            self.buffer
                .get_mut(end - done..)
                .unwrap_or_default()
                .fill(0);
            self.buffer.truncate(end - done);
            self.done = 0;
            self.passed = self.passed.wrapping_add(done as u32);
        }
        let room = MAX_FRAME_SIZE - self.buffer.len();
        let taken = bytes.get(..room).unwrap_or(bytes);
        let appended = self.buffer.extend_from_slice(taken);
        debug_assert!(appended.is_ok(), "only as many as there is room for");
        taken.len()
    }

    /// Bytes that [`write`](Self::write) would take now for certain: 0 to 280.
    #[must_use]
    pub fn room(&self) -> usize {
        let kept = self.buffer.len() - (self.done + self.lent).min(self.buffer.len());
        match self.intake {
            Intake::Open => MAX_FRAME_SIZE - kept,
            Intake::Ended | Intake::Paused => 0,
            Intake::Deaf => MAX_FRAME_SIZE,
        }
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
            intake,
            credit,
            passed,
            dropped,
            resync,
            crc_extra,
        } = self;
        loop {
            let pending = buffer.get(*done..).unwrap_or_default();
            if pending.is_empty() {
                if *intake != Intake::Deaf {
                    *intake = Intake::Open;
                }
                return None;
            }
            let place = passed.wrapping_add(*done as u32);
            let mut drop = |count: usize| {
                *done += count;
                *dropped = dropped.saturating_add(count as u32);
            };
            let searches = *resync == Resync::NextByte;
            if searches && !credit.affords(pending, place) {
                drop(1);
                continue;
            }
            let found = Packet::parse(pending, *crc_extra);
            let cut_short = matches!(found, Err(DecodeError::Parse(ParseError::Truncated)));
            if cut_short && matches!(*intake, Intake::Open | Intake::Paused) {
                *intake = Intake::Open;
                return None;
            }
            match found {
                Ok(packet) => {
                    *lent = packet.as_bytes().len();
                    return Some(Ok(packet));
                }
                Err(DecodeError::Parse(ParseError::BadMagic(_))) if searches => {
                    drop(noise(pending));
                }
                Err(fault) => {
                    drop(if searches { 1 } else { pending.len() });
                    // Where the next packet begins is no longer known.
                    if !searches && *intake == Intake::Open {
                        *intake = Intake::Deaf;
                    }
                    let no_packet = matches!(fault, DecodeError::Parse(ParseError::BadMagic(_)));
                    if !cut_short && !no_packet {
                        return Some(Err(fault));
                    }
                }
            }
        }
    }

    /// Tells the decoder that the line has been silent for longer than its sender ever pauses within a packet.
    ///
    /// With [`Resync::NextByte`], what has begun like a packet is given up, and the next [`read`](Self::read) finds the
    /// packet behind it. With [`Resync::Silence`], the next byte begins a packet, if the place was lost; a packet that
    /// has begun is still waited for.
    pub fn idle(&mut self) {
        match (self.resync, self.intake) {
            (Resync::Silence, Intake::Open | Intake::Paused) => self.end(Intake::Paused),
            _ => self.end(Intake::Ended),
        }
    }

    /// Tells the decoder that bytes of the line were lost, came in between, or were changed, behind those written so
    /// far. What has begun is given up. With [`Resync::Silence`] all is dropped until [`idle`](Self::idle).
    pub fn fault(&mut self) {
        match self.resync {
            Resync::NextByte => self.end(Intake::Ended),
            Resync::Silence => self.intake = Intake::Deaf,
        }
    }

    /// What is in the buffer is to be read to its end before more is taken.
    fn end(&mut self, intake: Intake) {
        let (left, _) = self.begun();
        self.intake = if left == 0 { Intake::Open } else { intake };
    }

    /// Whether bytes are dropped until the line is silent: with [`Resync::Silence`] alone.
    #[must_use]
    pub fn is_deaf(&self) -> bool {
        self.intake == Intake::Deaf
    }

    /// What has begun like a packet, once [`read`](Self::read) has returned `None`: how many bytes of it have come, 0 to
    /// 279, and how many there will be, 8 to 280; 280 as long as its length has not come.
    #[must_use]
    pub fn begun(&self) -> (usize, usize) {
        let pending = self.buffer.get(self.done + self.lent..).unwrap_or_default();
        let announced = announced_size(pending).unwrap_or(MAX_FRAME_SIZE);
        (pending.len(), announced)
    }

    /// Gives up the first byte of what has begun like a packet, since its end has not come in time: the next
    /// [`read`](Self::read) looks for a packet behind it. Once `read` has returned `None`.
    pub fn give_up(&mut self) {
        self.take_back();
        if self.done < self.buffer.len() {
            self.done += 1;
            self.dropped = self.dropped.saturating_add(1);
        }
    }

    /// Bytes that belonged to no packet, since the start; stays at the top of its range.
    #[must_use]
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }

    /// The last packet has been looked at: its bytes are done with, and wiped, as it may have carried a key.
    fn take_back(&mut self) {
        let end = self.done + self.lent;
        let lent = self.buffer.get_mut(self.done..end).unwrap_or_default();
        lent.fill(0);
        self.done = end;
        self.lent = 0;
    }
}

/// Without the bytes: they may be a key.
impl fmt::Debug for Decoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Decoder")
            .field(
                "held",
                &(self.buffer.len() - self.done.min(self.buffer.len())),
            )
            .field("intake", &self.intake)
            .field("dropped", &self.dropped)
            .field("resync", &self.resync)
            .finish_non_exhaustive()
    }
}

impl Drop for Decoder {
    fn drop(&mut self) {
        self.buffer.zeroize();
    }
}

#[cfg(kani)]
#[cfg_attr(test, mutants::skip)]
impl Decoder {
    /// For proofs: the first `length` bytes of `bytes` in the buffer, `done` and `lent` of them done
    /// with and lent out; nothing dropped so far.
    #[must_use]
    pub fn holding(
        mut self,
        bytes: [u8; MAX_FRAME_SIZE],
        length: usize,
        [done, lent]: [usize; 2],
    ) -> Self {
        self.buffer = Vec::from_array(bytes);
        self.buffer.truncate(length);
        (self.done, self.lent) = (done, lent);
        self
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
