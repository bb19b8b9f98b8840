//! Whole MAVLink packets into messages of 80 bytes, and back.

use core::fmt;
use core::time::Duration;

use heapless::Vec;
use mavlink_signing::field::{CHECKSUM_SIZE, HEADER_SIZE_V1, MAGIC_V1};
use mavlink_signing::{FrameRef, MessageId, ParseError};
use zeroize::Zeroize as _;

use crate::cipher::Plaintext;
use crate::field::PLAINTEXT_SIZE;

/// Bytes that old SMACCMPilot vehicles look at: they lose the last 8 of a message.
pub const LEGACY_SIZE: usize = 72;

/// HEARTBEAT, which makes a message leave.
const HEARTBEAT: MessageId = MessageId::from_le_bytes([0, 0, 0]);

/// Collects packets until a message is full, a HEARTBEAT comes, or one has waited too long.
///
/// A packet is never split and never changed. Packets leave in the order in which they came. Their number
/// is not sent: after the last, the message is filled with zeros. A packet that does not fit into any
/// message is rejected and counted, never dropped in silence.
///
/// ```
/// use core::time::Duration;
/// use mavlink_commsec::{Packer, packets};
///
/// let heartbeat = [0xFE, 9, 0, 1, 0, 0, 0, 0, 0, 0, 2, 13, 1, 0, 3, 0xE7, 0x8F];
/// let mut packer = Packer::new(Duration::from_millis(50));
/// assert_eq!(packer.push(&heartbeat, Duration::ZERO)?, None);
/// let message = packer.poll(Duration::ZERO).ok_or("a heartbeat does not wait")?;
/// assert_eq!(packets(&message).collect::<Vec<_>>(), [Ok(&heartbeat[..])]);
/// # Ok::<(), Box<dyn core::error::Error>>(())
/// ```
pub struct Packer {
    pending: Vec<u8, PLAINTEXT_SIZE>,
    /// Bytes of a message that packets may lie in.
    size: usize,
    /// When the first pending packet came.
    since: Duration,
    max_delay: Duration,
    /// A HEARTBEAT is pending.
    due: bool,
    rejected: u32,
}

impl Packer {
    /// A packer that fills all 80 bytes. A message is due when its first packet has waited for `max_delay`:
    /// see [`poll`](Self::poll).
    #[must_use]
    pub const fn new(max_delay: Duration) -> Self {
        Self::of_size(PLAINTEXT_SIZE, max_delay)
    }

    /// The same for a vehicle with SMACCMPilot's own firmware. It loses what lies after the first
    /// [`LEGACY_SIZE`] bytes of a message: those bytes stay zero. It knows no MAVLink 2: such packets are
    /// rejected.
    #[must_use]
    pub const fn legacy(max_delay: Duration) -> Self {
        Self::of_size(LEGACY_SIZE, max_delay)
    }

    const fn of_size(size: usize, max_delay: Duration) -> Self {
        Self {
            pending: Vec::new(),
            size,
            since: Duration::ZERO,
            max_delay,
            due: false,
            rejected: 0,
        }
    }

    /// Takes one whole packet of MAVLink 1 or 2. Its checksum is not checked. Returns the message that had
    /// to make room for it, which must be sealed now: the packer no longer has it. A HEARTBEAT leaves with
    /// [`poll`](Self::poll).
    ///
    /// `now` is the time since any start, by a clock that never goes back.
    ///
    /// # Errors
    ///
    /// [`PackError::Parse`], [`PackError::Trailing`]: not one whole packet. [`PackError::TooLong`],
    /// [`PackError::LegacyVehicle`]: the packet goes into no message. Rejected packets are counted. What is
    /// pending stays.
    pub fn push(&mut self, packet: &[u8], now: Duration) -> Result<Option<Plaintext>, PackError> {
        let id = self.check(packet).inspect_err(|_| {
            self.rejected = self.rejected.saturating_add(1);
        })?;
        let full = packet.len() > self.size.saturating_sub(self.pending.len());
        let message = if full { self.flush() } else { None };
        if self.pending.is_empty() {
            self.since = now;
        }
        let appended = self.pending.extend_from_slice(packet);
        debug_assert!(appended.is_ok(), "it fits into an empty message");
        self.due |= id == HEARTBEAT;
        Ok(message)
    }

    fn check(&self, packet: &[u8]) -> Result<MessageId, PackError> {
        let (first, id) = first_packet(packet).map_err(PackError::Parse)?;
        if self.size == LEGACY_SIZE && first.first() != Some(&MAGIC_V1) {
            return Err(PackError::LegacyVehicle);
        }
        match packet.len() - first.len() {
            0 if first.len() > self.size => Err(PackError::TooLong(first.len())),
            0 => Ok(id),
            trailing => Err(PackError::Trailing(trailing)),
        }
    }

    /// When [`poll`](Self::poll) will give a message, by the clock of [`push`](Self::push); `None` while no packet is
    /// pending.
    #[must_use]
    pub fn poll_at(&self) -> Option<Duration> {
        let at = if self.due {
            self.since
        } else {
            self.since.saturating_add(self.max_delay)
        };
        (!self.pending.is_empty()).then_some(at)
    }

    /// The message that must be sealed now, if there is one: it holds a HEARTBEAT, or its first packet has
    /// waited long enough.
    ///
    /// If it is called at least once in each span of the maximum delay, no packet waits longer than two
    /// such spans.
    pub fn poll(&mut self, now: Duration) -> Option<Plaintext> {
        if self.due || now.saturating_sub(self.since) >= self.max_delay {
            self.flush()
        } else {
            None
        }
    }

    /// What is pending; `None` if that is nothing.
    pub fn flush(&mut self) -> Option<Plaintext> {
        if self.pending.is_empty() {
            return None;
        }
        let mut message = [0; PLAINTEXT_SIZE];
        for (slot, byte) in message.iter_mut().zip(&self.pending) {
            *slot = *byte;
        }
        self.pending.as_mut_slice().zeroize();
        self.pending.clear();
        self.due = false;
        Some(message)
    }

    /// How many packets were rejected, since the start; stays at the top of its range.
    #[must_use]
    pub const fn rejected(&self) -> u32 {
        self.rejected
    }
}

/// Shows how much is pending, not what.
impl fmt::Debug for Packer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Packer")
            .field("pending", &self.pending.len())
            .field("rejected", &self.rejected)
            .finish_non_exhaustive()
    }
}

impl Drop for Packer {
    fn drop(&mut self) {
        self.pending.as_mut_slice().zeroize();
    }
}

/// The packets in a message, in order.
#[must_use]
pub const fn packets(message: &Plaintext) -> Packets<'_> {
    Packets::new(message)
}

/// The packets in a message, in order. Zeros between and after them are passed over.
///
/// By their shape alone, without checksums: the message is authentic, and the program that reads a packet
/// knows its dialect. After the first error there is nothing more.
#[derive(Clone)]
pub struct Packets<'a> {
    rest: &'a [u8],
}

/// Shows how many bytes are left, not which.
impl fmt::Debug for Packets<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Packets")
            .field("rest", &self.rest.len())
            .finish()
    }
}

impl<'a> Packets<'a> {
    pub(crate) const fn new(message: &'a Plaintext) -> Self {
        Self { rest: message }
    }
}

impl<'a> Iterator for Packets<'a> {
    type Item = Result<&'a [u8], UnpackError>;

    fn next(&mut self) -> Option<Self::Item> {
        let zeros = self.rest.iter().take_while(|byte| **byte == 0).count();
        let rest = self.rest.get(zeros..).unwrap_or_default();
        self.rest = &[];
        if rest.is_empty() {
            return None;
        }
        let found = first_packet(rest).map(|(packet, _)| packet);
        if let Ok(packet) = found {
            self.rest = rest.get(packet.len()..).unwrap_or_default();
        }
        Some(found.map_err(|fault| UnpackError {
            offset: PLAINTEXT_SIZE - rest.len(),
            fault,
        }))
    }
}

impl core::iter::FusedIterator for Packets<'_> {}

/// The packet at the front of `bytes`, and which message it carries.
fn first_packet(bytes: &[u8]) -> Result<(&[u8], MessageId), ParseError> {
    if bytes.first() != Some(&MAGIC_V1) {
        let frame = FrameRef::parse(bytes)?;
        return Ok((frame.as_bytes(), frame.header().message_id));
    }
    let header = bytes.first_chunk().ok_or(ParseError::Truncated)?;
    let &[_, payload_length, _, _, _, id]: &[u8; HEADER_SIZE_V1] = header;
    let size = HEADER_SIZE_V1 + usize::from(payload_length) + CHECKSUM_SIZE;
    let packet = bytes.get(..size).ok_or(ParseError::Truncated)?;
    Ok((packet, id.into()))
}

/// Why a packet is not packed. The caller is at fault. Nothing has changed but the count of rejections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PackError {
    /// The packet has more bytes than fit into a message: this many. It cannot be sent sealed.
    TooLong(usize),
    /// The bytes do not begin with a whole packet of MAVLink 1 or 2.
    Parse(ParseError),
    /// A packet of MAVLink 2, for a vehicle that does not know it and would lose what comes after it.
    LegacyVehicle,
    /// Bytes after the packet: this many.
    Trailing(usize),
}

impl fmt::Display for PackError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong(length) => {
                write!(f, "a packet of {length} bytes does not fit into a message")
            }
            Self::Parse(error) => error.fmt(f),
            Self::LegacyVehicle => f.write_str("a MAVLink 2 packet for a vehicle of MAVLink 1"),
            Self::Trailing(length) => write!(f, "{length} bytes behind the packet"),
        }
    }
}

impl core::error::Error for PackError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Parse(error) => Some(error),
            _ => None,
        }
    }
}

/// Why a message that was opened does not hold whole packets to its end. Its sender, who has the key, is at
/// fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct UnpackError {
    /// How many bytes of the message, from its front, are packets and zeros between them.
    pub offset: usize,
    /// Why what follows is no packet.
    pub fault: ParseError,
}

impl fmt::Display for UnpackError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { offset, fault } = self;
        write!(f, "no packet at byte {offset} of the message: {fault}")
    }
}

impl core::error::Error for UnpackError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        Some(&self.fault)
    }
}
