//! Frames without signature that a policy lets through: never by default, and never as verified.

use crate::dialect::crc_extra;
use crate::error::VerifyError;
use crate::frame::{Frame, FrameRef};
use crate::header::{Header, MessageId};

/// RADIO_STATUS, which a radio adds to the stream and cannot sign.
const RADIO_STATUS: MessageId = MessageId::from_le_bytes([109, 0, 0]);

/// What an unsigned frame says of itself; nothing of it is known to be true but the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Claim {
    /// The link that the frame came in on, as the receiver numbers it.
    pub link_id: u8,
    /// The vehicle or station that it names as its sender.
    pub system_id: u8,
    /// The part of it.
    pub component_id: u8,
    /// Which message it carries.
    pub message_id: MessageId,
}

/// Which unsigned frames may be acted on (MAVLink guide, "Message Signing", Accepting Unsigned Packets).
///
/// It is asked only about undamaged frames without signature. A frame with a wrong signature, or one seen
/// before, is rejected without asking. Any `Fn(Claim) -> bool` is a policy.
pub trait UnsignedPolicy {
    /// Whether a frame that says this of itself may be acted on.
    fn accepts(&self, claim: Claim) -> bool;
}

impl<F: Fn(Claim) -> bool> UnsignedPolicy for F {
    fn accepts(&self, claim: Claim) -> bool {
        self(claim)
    }
}

/// No unsigned frame. The default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RejectUnsigned;

impl UnsignedPolicy for RejectUnsigned {
    fn accepts(&self, _claim: Claim) -> bool {
        false
    }
}

/// RADIO_STATUS (message 109) alone, which radios put into a stream that they cannot sign for.
///
/// Anybody on the link can send one, and with it slow down a sender that adapts to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AllowRadioStatus;

impl UnsignedPolicy for AllowRadioStatus {
    fn accepts(&self, claim: Claim) -> bool {
        claim.message_id == RADIO_STATUS
    }
}

/// Every unsigned frame of one link, which must be one that nobody else can reach: a cable. In a relay the
/// link is its whole link side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AllowLink {
    /// The link, as the receiver numbers it.
    pub link_id: u8,
}

impl UnsignedPolicy for AllowLink {
    fn accepts(&self, claim: Claim) -> bool {
        claim.link_id == self.link_id
    }
}

/// A frame without signature that a policy let through. Nobody knows who sent it.
///
/// Made by [`accept_unsigned`] alone.
#[derive(Debug)]
pub struct Unsigned<'a> {
    frame: FrameRef<'a>,
    crc_extra: u8,
}

impl<'a> Unsigned<'a> {
    /// The header.
    #[must_use]
    pub const fn header(&self) -> Header {
        self.frame.header()
    }

    /// The payload, 0 to 255 bytes, its trailing zeros cut by the sender.
    #[must_use]
    pub const fn payload(&self) -> &'a [u8] {
        self.frame.payload()
    }

    /// The whole frame as received.
    #[must_use]
    pub const fn as_bytes(&self) -> &'a [u8] {
        self.frame.as_bytes()
    }

    /// The same frame, to be sent on later.
    #[must_use]
    pub fn to_frame(&self) -> Frame {
        Frame::copy_of(self.frame, self.crc_extra)
    }
}

/// Accepts a frame without signature if it is undamaged and `policy` accepts it. `link_id` is that of the
/// link on which it came in.
///
/// # Errors
///
/// [`VerifyError::Signed`]: the frame carries a signature, so it must be authenticated instead.
/// [`VerifyError::UnknownMessage`], [`VerifyError::BadChecksum`]. [`VerifyError::NotSigned`]: the policy
/// does not accept it.
pub fn accept_unsigned<'a>(
    frame: FrameRef<'a>,
    link_id: u8,
    policy: &impl UnsignedPolicy,
) -> Result<Unsigned<'a>, VerifyError> {
    if frame.is_signed() {
        return Err(VerifyError::Signed);
    }
    let Header {
        system_id,
        component_id,
        message_id,
        ..
    } = frame.header();
    let crc_extra = crc_extra(message_id).ok_or(VerifyError::UnknownMessage(message_id))?;
    if !frame.checksum_matches(crc_extra) {
        return Err(VerifyError::BadChecksum);
    }
    let claim = Claim {
        link_id,
        system_id,
        component_id,
        message_id,
    };
    if policy.accepts(claim) {
        Ok(Unsigned { frame, crc_extra })
    } else {
        Err(VerifyError::NotSigned)
    }
}
