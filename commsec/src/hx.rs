//! The framing between a radio and what is plugged into it: `hx`, named after hxstream.
//!
//! ```text
//! 0x7E | kind| payload, 0x7E and 0x7C in it escaped | 0x7E
//!   1  |  1  |              1 to 200                |   1
//! ```
//!
//! SMACCMPilot, "GCS Communication Security", framing protocol. An escaped byte is 0x7C and the byte with
//! bit 0x20 inverted. The kind is never escaped.
//!
//! **What it does not do.** It marks where frames begin and end, and nothing else. It has no checksum,
//! length, sequence number, acknowledgement or flow control. A damaged byte is delivered damaged, and a
//! lost byte is missing without notice. A lost flag makes two frames one. Anybody on the line can make
//! frames of any kind. Only the contents can show that a frame means anything: a package does with its tag.
//! Several byte strings decode to one frame, since any byte may come escaped.

use core::{fmt, slice};

use heapless::Vec;
#[cfg(not(kani))]
use zeroize::Zeroize as _;

use crate::field::PACKAGE_SIZE;
use crate::package::Package;

/// The byte that ends a frame, begins one, or does both.
pub const FLAG: u8 = 0x7E;
/// The byte in front of an escaped one. Not HDLC's, which is 0x7D.
pub const ESCAPE: u8 = 0x7C;
/// The bit that is inverted in an escaped byte.
pub const ESCAPE_BIT: u8 = 0x20;
/// Most bytes of payload: 100, which is what SMACCMPilot's radio takes. A package has 96.
pub const MAX_PAYLOAD_SIZE: usize = 100;
/// Most bytes of a frame on the line, flags included: 203. A package takes 99 to 195.
pub const MAX_ENCODED_SIZE: usize = 2 * MAX_PAYLOAD_SIZE + 3;

const _: () = assert!(PACKAGE_SIZE <= MAX_PAYLOAD_SIZE);

/// What a frame carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FrameKind {
    /// 0, "air data": a package, which the radio sends on through the air.
    AirData,
    /// 1, "radio data": plain bytes between a host and its own radio, which never cross the air.
    Radio,
}

impl FrameKind {
    /// Its byte on the line.
    #[must_use]
    pub const fn to_wire(self) -> u8 {
        match self {
            Self::AirData => 0,
            Self::Radio => 1,
        }
    }

    const fn from_wire(byte: u8) -> Option<Self> {
        match byte {
            0 => Some(Self::AirData),
            1 => Some(Self::Radio),
            _ => None,
        }
    }
}

/// A frame: its kind, and 1 to 100 bytes. It is never empty: after an empty frame of air data,
/// SMACCMPilot's radio never sends anything again.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    kind: FrameKind,
    payload: &'a [u8],
}

impl<'a> Frame<'a> {
    /// A frame of any content. Nothing checks that air data is sealed: to send a package, make the frame
    /// [`from`](Self::from) it.
    ///
    /// # Errors
    ///
    /// [`FrameError::Empty`], [`FrameError::TooLong`].
    pub const fn new(kind: FrameKind, payload: &'a [u8]) -> Result<Self, FrameError> {
        match payload.len() {
            0 => Err(FrameError::Empty),
            1..=MAX_PAYLOAD_SIZE => Ok(Self { kind, payload }),
            length => Err(FrameError::TooLong(length)),
        }
    }

    /// What it carries.
    #[must_use]
    pub const fn kind(&self) -> FrameKind {
        self.kind
    }

    /// Its 1 to 100 bytes, not escaped. As received, air data need not be a package.
    #[must_use]
    pub const fn payload(&self) -> &'a [u8] {
        self.payload
    }

    /// Its bytes on the line, with a flag at both ends.
    #[must_use]
    pub fn encode(&self) -> Encode<'a> {
        Encode {
            next: Next::Begin(self.kind),
            payload: self.payload.iter(),
        }
    }
}

impl<'a> From<&'a Package> for Frame<'a> {
    /// The package as air data.
    fn from(package: &'a Package) -> Self {
        Self {
            kind: FrameKind::AirData,
            payload: package.as_bytes(),
        }
    }
}

/// Shows how many bytes there are, not which.
impl fmt::Debug for Frame<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Frame")
            .field("kind", &self.kind)
            .field("payload", &self.payload.len())
            .finish()
    }
}

/// The bytes of a frame on the line, 4 to 203.
#[derive(Clone)]
pub struct Encode<'a> {
    next: Next,
    payload: slice::Iter<'a, u8>,
}

/// Shows how many bytes of payload are left, not which.
impl fmt::Debug for Encode<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Encode")
            .field("payload", &self.payload.len())
            .finish_non_exhaustive()
    }
}

/// What comes next out of [`Encode`].
#[derive(Clone, Copy)]
enum Next {
    Begin(FrameKind),
    FrameKind(FrameKind),
    Payload,
    /// This byte, behind its escape.
    Escaped(u8),
    Nothing,
}

impl Iterator for Encode<'_> {
    type Item = u8;

    fn next(&mut self) -> Option<u8> {
        let (byte, next) = match self.next {
            Next::Begin(kind) => (FLAG, Next::FrameKind(kind)),
            Next::FrameKind(kind) => (kind.to_wire(), Next::Payload),
            Next::Payload => match self.payload.next() {
                Some(byte @ (&FLAG | &ESCAPE)) => (ESCAPE, Next::Escaped(byte ^ ESCAPE_BIT)),
                Some(byte) => (*byte, Next::Payload),
                None => (FLAG, Next::Nothing),
            },
            Next::Escaped(byte) => (byte, Next::Payload),
            Next::Nothing => return None,
        };
        self.next = next;
        Some(byte)
    }
}

impl core::iter::FusedIterator for Encode<'_> {}

/// Where a [`Decoder`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum State {
    /// Before a flag: nothing is known.
    Idle,
    /// After a flag.
    FrameKind,
    /// Within a payload.
    Payload(FrameKind),
    /// Within a payload, behind an escape.
    Escape(FrameKind),
}

/// Finds frames in a stream of bytes, one byte at a time.
///
/// Holds at most the 100 bytes of one payload, and wipes them when it is dropped. A flag ends whatever there was, so that from any state,
/// after any bytes, the next whole frame is found. Two frames may share a flag, and there may be several
/// between them. A frame without a flag after it waits for the next byte that is one.
///
/// ```
/// use mavlink_commsec::hx::{Decoder, Frame, FrameKind};
///
/// let mut decoder = Decoder::new();
/// let frame = Frame::new(FrameKind::Radio, b"B\r")?;
/// let mut received = 0;
/// for byte in frame.encode() {
///     if let Some(decoded) = decoder.push(byte) {
///         assert_eq!(decoded?, frame);
///         received += 1;
///     }
/// }
/// assert_eq!(received, 1);
/// # Ok::<(), Box<dyn core::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct Decoder {
    state: State,
    payload: Vec<u8, MAX_PAYLOAD_SIZE>,
}

impl Decoder {
    /// A decoder that waits for a flag.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            state: State::Idle,
            payload: Vec::new(),
        }
    }

    /// Takes the next byte. Returns the frame that it ends, or why that is dropped.
    ///
    /// # Errors
    ///
    /// [`DecodeError::Empty`] and [`DecodeError::TruncatedEscape`] with the flag that ends such a frame.
    /// [`DecodeError::UnknownKind`] and [`DecodeError::TooLong`] with the byte that is wrong, once. What
    /// follows up to the next flag is passed over.
    pub fn push(&mut self, byte: u8) -> Option<Result<Frame<'_>, DecodeError>> {
        match (self.state, byte) {
            (State::Idle | State::FrameKind, FLAG) => {
                self.state = State::FrameKind;
                None
            }
            (State::Idle, _) => None,
            (State::FrameKind, _) => match FrameKind::from_wire(byte) {
                Some(kind) => {
                    self.payload.clear();
                    self.state = State::Payload(kind);
                    None
                }
                None => {
                    self.state = State::Idle;
                    Some(Err(DecodeError::UnknownKind(byte)))
                }
            },
            (State::Payload(kind), FLAG) => {
                self.state = State::FrameKind;
                let frame = Frame::new(kind, &self.payload);
                Some(frame.map_err(|_| DecodeError::Empty))
            }
            (State::Escape(_), FLAG) => {
                self.state = State::FrameKind;
                Some(Err(DecodeError::TruncatedEscape))
            }
            (State::Payload(kind), ESCAPE) => {
                self.state = State::Escape(kind);
                None
            }
            (State::Payload(kind), _) => self.append(kind, byte),
            (State::Escape(kind), _) => self.append(kind, byte ^ ESCAPE_BIT),
        }
    }

    fn append(&mut self, kind: FrameKind, byte: u8) -> Option<Result<Frame<'_>, DecodeError>> {
        if self.payload.push(byte).is_ok() {
            self.state = State::Payload(kind);
            return None;
        }
        self.state = State::Idle;
        Some(Err(DecodeError::TooLong))
    }

    /// For proofs: in any state, with any payload so far.
    #[cfg(kani)]
    #[must_use]
    pub fn any() -> Self {
        let kind = if kani::any() {
            FrameKind::AirData
        } else {
            FrameKind::Radio
        };
        let state = match kani::any() {
            0_u8 => State::Idle,
            1 => State::FrameKind,
            2 => State::Payload(kind),
            _ => State::Escape(kind),
        };
        let mut payload = Vec::from_array(kani::any::<[u8; MAX_PAYLOAD_SIZE]>());
        let length = kani::any();
        kani::assume(length <= MAX_PAYLOAD_SIZE);
        payload.truncate(length);
        Self { state, payload }
    }
}

/// Shows how many bytes of payload it holds, not which.
impl fmt::Debug for Decoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Decoder")
            .field("state", &self.state)
            .field("payload", &self.payload.len())
            .finish()
    }
}

// For proofs, what is wiped is no part of them, and a loop over it would be unwound.
#[cfg(not(kani))]
impl Drop for Decoder {
    fn drop(&mut self) {
        // With what is left of longer frames before.
        let _ = self.payload.resize(MAX_PAYLOAD_SIZE, 0);
        self.payload.as_mut_slice().zeroize();
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

/// Why bytes cannot be framed. The caller is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum FrameError {
    /// There are none. SMACCMPilot's radio never recovers from an empty frame.
    Empty,
    /// More than 100: this many.
    TooLong(usize),
}

impl fmt::Display for FrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("an empty frame"),
            Self::TooLong(length) => write!(
                f,
                "a frame has at most {} bytes, this one has {length}",
                MAX_PAYLOAD_SIZE
            ),
        }
    }
}

impl core::error::Error for FrameError {}

/// Why a received frame is dropped. A damaged line, or a sender that speaks something else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum DecodeError {
    /// It has a kind and nothing after it.
    Empty,
    /// More than 100 bytes.
    TooLong,
    /// It ends between an escape and the byte that was escaped.
    TruncatedEscape,
    /// Neither air data nor radio data, but this.
    UnknownKind(u8),
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("an empty frame"),
            Self::TooLong => write!(f, "a frame of more than {MAX_PAYLOAD_SIZE} bytes"),
            Self::TruncatedEscape => f.write_str("a frame that ends in an escape"),
            Self::UnknownKind(kind) => write!(f, "a frame of the unknown kind {kind:#04X}"),
        }
    }
}

impl core::error::Error for DecodeError {}
