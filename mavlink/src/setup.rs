//! SETUP_SIGNING, which carries a key, and what of a frame may be written to a log.

use core::{fmt, iter};

use zeroize::{Zeroize, ZeroizeOnDrop};

use crate::dialect::crc_extra;
use crate::error::SignError;
use crate::field::{KEY_SIZE, TIMESTAMP_SIZE};
use crate::frame::{Frame, FrameRef};
use crate::header::{Header, MessageId};
use crate::time::Timestamp;

/// SETUP_SIGNING, message 256.
pub const SETUP_SIGNING: MessageId = MessageId::from_le_bytes([0, 1, 0]);

/// Bytes of a timestamp in the payload: a whole 64-bit word.
const INITIAL_TIMESTAMP_SIZE: usize = 8;
/// Where the key begins: after the timestamp, the target system and the target component.
const SECRET_KEY: usize = INITIAL_TIMESTAMP_SIZE + 2;
/// Bytes of the payload: 42.
const PAYLOAD_SIZE: usize = SECRET_KEY + KEY_SIZE;

/// Why a payload does not carry a key. Its sender is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SetupError {
    /// More than the 42 bytes of SETUP_SIGNING: this many.
    TooLong(usize),
    /// A timestamp of more than 48 bits: this one.
    TimestampTooLong(u64),
}

impl fmt::Display for SetupError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong(length) => {
                write!(
                    f,
                    "SETUP_SIGNING has 42 bytes of payload, this has {length}"
                )
            }
            Self::TimestampTooLong(ticks) => {
                write!(
                    f,
                    "a timestamp has {TIMESTAMP_SIZE} bytes, {ticks:#X} has more"
                )
            }
        }
    }
}

impl core::error::Error for SetupError {}

/// A key on its way to one component, and the timestamp to begin with (MAVLink guide, "Message
/// Signing", Secret Key Management).
///
/// It is sent in clear. Send it over a cable, or a link that nobody else can read. [`Debug`] does not show
/// the key, and it is wiped when this is dropped.
pub struct SetupSigning {
    /// Whom the key is for.
    pub target_system: u8,
    /// Which part of it.
    pub target_component: u8,
    /// The key.
    pub secret_key: [u8; KEY_SIZE],
    /// The timestamp to begin with, in ticks of 10 microseconds since 2015.
    pub initial_timestamp: Timestamp,
}

impl SetupSigning {
    /// Reads the payload of a SETUP_SIGNING frame. Its trailing zeros may be cut.
    ///
    /// The caller checks that the frame is SETUP_SIGNING, and for whom. A key of zeros only is returned as
    /// it is; with a timestamp of zero, it asks the receiver to stop signing.
    /// [`SigningKey::new`](crate::SigningKey::new) rejects it.
    ///
    /// # Errors
    ///
    /// [`SetupError::TooLong`] above 42 bytes; [`SetupError::TimestampTooLong`] above 48 bits.
    pub fn from_payload(payload: &[u8]) -> Result<Self, SetupError> {
        let mut setup = Self {
            target_system: 0,
            target_component: 0,
            secret_key: [0; KEY_SIZE],
            initial_timestamp: Timestamp::ZERO,
        };
        if payload.len() > PAYLOAD_SIZE {
            return Err(SetupError::TooLong(payload.len()));
        }
        let mut ticks = [0; INITIAL_TIMESTAMP_SIZE];
        let targets = [&mut setup.target_system, &mut setup.target_component];
        let slots = ticks.iter_mut().chain(targets).chain(&mut setup.secret_key);
        for (slot, byte) in slots.zip(payload) {
            *slot = *byte;
        }
        let ticks = u64::from_le_bytes(ticks);
        setup.initial_timestamp =
            Timestamp::from_ticks(ticks).ok_or(SetupError::TimestampTooLong(ticks))?;
        Ok(setup)
    }

    /// The frame that carries it: unsigned, with the fields of `header` except the message id. It holds the
    /// key, and is not wiped when it is dropped. Target 0 means everybody, who should not have the key.
    ///
    /// # Errors
    ///
    /// [`SignError::UnknownMessage`] if the dialect has no such message: `minimal`, `standard`, `csairlink`,
    /// `icarous` and `loweheiser` have none.
    pub fn to_frame(&self, header: Header) -> Result<Frame, SignError> {
        let mut payload = [0; PAYLOAD_SIZE];
        let ticks = self.initial_timestamp.ticks().to_le_bytes();
        let targets = [self.target_system, self.target_component];
        let parts = ticks.iter().chain(&targets).chain(&self.secret_key);
        for (slot, byte) in payload.iter_mut().zip(parts) {
            *slot = *byte;
        }
        let header = Header {
            message_id: SETUP_SIGNING,
            ..header
        };
        let frame = Frame::new(header, without_trailing_zeros(&payload));
        payload.zeroize();
        frame
    }
}

impl fmt::Debug for SetupSigning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SetupSigning")
            .field("target_system", &self.target_system)
            .field("target_component", &self.target_component)
            .field("initial_timestamp", &self.initial_timestamp)
            .finish_non_exhaustive()
    }
}

impl Drop for SetupSigning {
    fn drop(&mut self) {
        self.secret_key.zeroize();
    }
}

impl ZeroizeOnDrop for SetupSigning {}

/// A payload as it is sent: zeros at its end are cut, its first byte stays (MAVLink guide, "Packet
/// Serialization", Payload Truncation).
#[must_use]
pub fn without_trailing_zeros(payload: &[u8]) -> &[u8] {
    let last = payload.iter().rposition(|byte| *byte != 0).unwrap_or(0);
    payload.get(..=last).unwrap_or(payload)
}

/// The frame as it may be written to a log. The signature is removed and the flag cleared. The key of
/// SETUP_SIGNING is overwritten with 0xFF (MAVLink guide, "Message Signing", Logging).
///
/// # Errors
///
/// [`SignError::UnknownMessage`], [`SignError::BadChecksum`]: its bytes may hold anything, so log their
/// number instead.
pub fn redact_for_log(frame: FrameRef<'_>) -> Result<Frame, SignError> {
    let header = frame.header();
    let id = header.message_id;
    let crc_extra = crc_extra(id).ok_or(SignError::UnknownMessage(id))?;
    if !frame.checksum_matches(crc_extra) {
        return Err(SignError::BadChecksum);
    }
    if header.message_id != SETUP_SIGNING {
        return Frame::new(header, frame.payload());
    }
    let mut masked = [0xFF; PAYLOAD_SIZE];
    let shown = frame.payload().iter().copied().chain(iter::repeat(0));
    for (slot, byte) in masked.iter_mut().zip(shown).take(SECRET_KEY) {
        *slot = byte;
    }
    Frame::new(header, &masked)
}
