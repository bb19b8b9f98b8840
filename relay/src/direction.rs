//! What is done to a packet: signing towards the radio, verification from it.
//!
//! Two types that share nothing but the key: a frame from the secure side meets no function that
//! signs.

use mavlink_signing::{
    Frame, FrameRef, Packet, Profile, Replay, SigningKey, Stamper, Timestamp, authenticate,
    sign_frame,
};

use crate::event::{Direction, Refusal};

/// What a packet on its way from the decoder to the other port goes through.
pub(crate) trait Treat {
    const DIRECTION: Direction;

    /// The frame to send for `frame`, or why there is none.
    fn treat<P: Profile>(
        &mut self,
        frame: FrameRef<'_>,
        key: &SigningKey<P>,
        now: Timestamp,
    ) -> Result<Frame, Refusal>;

    /// The same for a packet of any version.
    fn treat_packet<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        key: &SigningKey<P>,
        now: Timestamp,
    ) -> Result<Frame, Refusal> {
        match packet {
            Packet::Mavlink2(frame) => self.treat(frame, key, now),
            Packet::Mavlink1(_) => Err(Refusal::Mavlink1),
        }
    }
}

/// Plain to secure.
#[derive(Debug)]
pub(crate) struct Signer {
    stamper: Stamper,
}

impl Signer {
    pub(crate) const fn new(stamper: Stamper) -> Self {
        Self { stamper }
    }
}

impl Treat for Signer {
    const DIRECTION: Direction = Direction::PlainToSecure;

    fn treat<P: Profile>(
        &mut self,
        frame: FrameRef<'_>,
        key: &SigningKey<P>,
        now: Timestamp,
    ) -> Result<Frame, Refusal> {
        // Before a stamp is taken: what is refused uses none up.
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

/// Secure to plain.
#[derive(Debug)]
pub(crate) struct Verifier {
    replay: Replay,
    forward: Forward,
}

impl Verifier {
    pub(crate) const fn new(replay: Replay, forward: Forward) -> Self {
        Self { replay, forward }
    }
}

impl Treat for Verifier {
    const DIRECTION: Direction = Direction::SecureToPlain;

    fn treat<P: Profile>(
        &mut self,
        frame: FrameRef<'_>,
        key: &SigningKey<P>,
        now: Timestamp,
    ) -> Result<Frame, Refusal> {
        let verified = self.replay.admit(authenticate(frame, key)?, now)?;
        Ok(match self.forward {
            Forward::Stripped => verified.to_unsigned(),
            Forward::Whole => verified.to_frame(),
        })
    }
}
