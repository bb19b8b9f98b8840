//! What is done to a packet: signing towards the radio, verification from it.
//!
//! Two types that share nothing but the key: a packet from the secure side meets no function that
//! signs. They need no port, so that a shell with input and output of its own can use them alone.

use mavlink_signing::{
    Frame, Packet, Profile, Replay, SigningKey, Stamper, Timestamp, authenticate, sign_frame,
};

use crate::event::{Direction, Refusal};

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
        let Packet::Mavlink2(frame) = packet else {
            return Err(Refusal::Mavlink1);
        };
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
        let Packet::Mavlink2(frame) = packet else {
            return Err(Refusal::Mavlink1);
        };
        let verified = self.replay.admit(authenticate(frame, key)?, now)?;
        Ok(match self.forward {
            Forward::Stripped => verified.to_unsigned(),
            Forward::Whole => verified.to_frame(),
        })
    }
}

/// What the packets of one direction go through.
pub(crate) trait Treat {
    const DIRECTION: Direction;

    fn treat<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        key: &SigningKey<P>,
        now: Timestamp,
    ) -> Result<Frame, Refusal>;
}

impl Treat for Signer {
    const DIRECTION: Direction = Direction::PlainToSecure;

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

    fn treat<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        key: &SigningKey<P>,
        now: Timestamp,
    ) -> Result<Frame, Refusal> {
        self.verify(packet, key, now)
    }
}
