//! What is done to a packet: signing towards the radio, verification from it.
//!
//! Two types that share nothing but the key: a packet from the secure side meets no function that
//! signs. They need no port, so that a shell with input and output of its own can use them alone.

use mavlink_signing::{
    Frame, FrameRef, MessageId, Packet, Profile, Replay, Resync, SigningKey, Stamper, Timestamp,
    authenticate, sign_frame,
};

use crate::event::{Direction, Refusal};

const SETUP_SIGNING: MessageId = MessageId::from_le_bytes([0, 1, 0]);

/// Plain to secure: signs what is undamaged and unsigned.
#[derive(Debug)]
pub struct Signer {
    stamper: Stamper,
}

impl Signer {
    /// Signs with the stamps of `stamper`.
    #[must_use]
    pub const fn new(stamper: Stamper) -> Self {
        Self { stamper }
    }

    /// The signed frame to send for `packet`.
    ///
    /// # Errors
    ///
    /// [`Refusal`]; no stamp has been used up then.
    pub fn sign<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        key: &SigningKey<P>,
        now: Timestamp,
    ) -> Result<Frame, Refusal> {
        let frame = passable(packet)?;
        if frame.is_signed() {
            return Err(Refusal::AlreadySigned);
        }
        let mut frame = Frame::try_from(frame)?;
        sign_frame(&mut frame, key, self.stamper.stamp(now)?)?;
        Ok(frame)
    }
}

/// How verified frames leave on the plain side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Forward {
    /// Signature removed, flag cleared, checksum computed anew: for equipment that does not know
    /// signatures.
    Stripped,
    /// As received.
    Whole,
}

/// Secure to plain: lets verified frames through.
#[derive(Debug)]
pub struct Verifier {
    replay: Replay,
    forward: Forward,
}

impl Verifier {
    /// Admits what `replay` admits and hands it on as `forward` says.
    #[must_use]
    pub const fn new(replay: Replay, forward: Forward) -> Self {
        Self { replay, forward }
    }

    /// The frame to hand on for `packet`.
    ///
    /// # Errors
    ///
    /// [`Refusal`]; nothing has changed then.
    pub fn verify<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        key: &SigningKey<P>,
        now: Timestamp,
    ) -> Result<Frame, Refusal> {
        let frame = passable(packet)?;
        let verified = self.replay.admit(authenticate(frame, key)?, now)?;
        Ok(match self.forward {
            Forward::Stripped => verified.to_unsigned(),
            Forward::Whole => verified.to_frame(),
        })
    }
}

/// The frame in a packet that may pass in any direction.
///
/// MAVLink 1 has no place for a signature. SETUP_SIGNING carries a key in plain text and is for the
/// one component that it is sent to (MAVLink guide, "Message Signing", Sharing Secret Keys).
fn passable(packet: Packet<'_>) -> Result<FrameRef<'_>, Refusal> {
    match packet {
        Packet::Mavlink1(_) => Err(Refusal::Mavlink1),
        Packet::Mavlink2(frame) if frame.header().message_id == SETUP_SIGNING => {
            Err(Refusal::SetupSigning)
        }
        Packet::Mavlink2(frame) => Ok(frame),
    }
}

/// What the packets of one direction go through.
pub(crate) trait Treat {
    const DIRECTION: Direction;
    const RESYNC: Resync;

    fn treat<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        key: &SigningKey<P>,
        now: Timestamp,
    ) -> Result<Frame, Refusal>;
}

impl Treat for Signer {
    const DIRECTION: Direction = Direction::PlainToSecure;
    const RESYNC: Resync = Resync::AnnouncedEnd;

    fn treat<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        key: &SigningKey<P>,
        now: Timestamp,
    ) -> Result<Frame, Refusal> {
        self.sign(packet, key, now)
    }
}

impl Treat for Verifier {
    const DIRECTION: Direction = Direction::SecureToPlain;
    const RESYNC: Resync = Resync::NextByte;

    fn treat<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        key: &SigningKey<P>,
        now: Timestamp,
    ) -> Result<Frame, Refusal> {
        self.verify(packet, key, now)
    }
}
