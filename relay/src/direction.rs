//! What is done to a packet: signing towards the radio, verification from it.
//!
//! Two types that share nothing but the key: a packet from the link side meets no function that
//! signs. They need no port, so that a shell with input and output of its own can use them alone.

use mavlink_signing::{
    AllowLink, AntiReplay, Authenticate, Frame, FrameRef, KeyRing, LinkClock, Packet, Profile,
    RejectUnsigned, ReplayGuard, Resync, SETUP_SIGNING, SetupSigning, SigningKey, Stamper,
    UnsignedPolicy, accept_unsigned, sign_frame,
};

use crate::event::{Direction, Event, RejectReason};

/// Local to link: signs what is undamaged and unsigned.
#[derive(Debug)]
pub struct Signer {
    stamper: Stamper,
    setup: Option<Setup>,
}

/// Whose SETUP_SIGNING is kept, and the last that came.
#[derive(Debug)]
struct Setup {
    system_id: u8,
    component_id: u8,
    came: Option<SetupSigning>,
}

impl Signer {
    /// Signs with the stamps of `stamper`.
    #[must_use]
    pub const fn new(stamper: Stamper) -> Self {
        Self {
            stamper,
            setup: None,
        }
    }

    pub(crate) fn keep_setup(&mut self, system_id: u8, component_id: u8) {
        self.setup = Some(Setup {
            system_id,
            component_id,
            came: None,
        });
    }

    pub(crate) fn take_setup(&mut self) -> Option<SetupSigning> {
        self.setup.as_mut()?.came.take()
    }

    /// Keeps what `packet` says if it is a SETUP_SIGNING for this end. It came in on the local side, a
    /// cable, where nobody has a signature.
    fn look_for_setup(&mut self, packet: Packet<'_>) {
        let (Some(setup), Packet::Mavlink2(frame)) = (&mut self.setup, packet) else {
            return;
        };
        if frame.header().message_id != SETUP_SIGNING {
            return;
        }
        let link_id = self.stamper.link_id();
        let Ok(accepted) = accept_unsigned(frame, link_id, &AllowLink { link_id }) else {
            return;
        };
        let came = SetupSigning::from_payload(accepted.payload());
        let ours = |came: &SetupSigning| {
            came.target_system == setup.system_id && came.target_component == setup.component_id
        };
        if let Some(came) = came.ok().filter(ours) {
            setup.came = Some(came);
        }
    }

    /// The signed frame to send for `packet`.
    ///
    /// # Errors
    ///
    /// [`RejectReason`]; no stamp has been used up then.
    pub fn sign<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        key: &SigningKey<P>,
        time: &mut impl LinkClock,
    ) -> Result<Frame, RejectReason> {
        self.look_for_setup(packet);
        let frame = passable(packet)?;
        if frame.is_signed() {
            return Err(RejectReason::AlreadySigned);
        }
        let mut frame = Frame::try_from(frame)?;
        sign_frame(&mut frame, key, time.stamp(&mut self.stamper)?)?;
        Ok(frame)
    }
}

/// How verified frames leave on the local side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForwardMode {
    /// Signature removed, flag cleared, checksum computed anew: for equipment that does not know
    /// signatures.
    StripSignature,
    /// As received.
    KeepSignature,
}

/// Link to local: lets verified frames through, and unsigned ones if a policy accepts them.
#[derive(Debug)]
pub struct Verifier<R = ReplayGuard, U = RejectUnsigned> {
    receiver: R,
    forward: ForwardMode,
    link_id: u8,
    unsigned: U,
}

impl<R: AntiReplay> Verifier<R> {
    /// Admits what `receiver` admits and hands it on as `forward` says; nothing that is unsigned.
    #[must_use]
    pub const fn new(receiver: R, forward: ForwardMode) -> Self {
        Self {
            receiver,
            forward,
            link_id: 0,
            unsigned: RejectUnsigned,
        }
    }

    /// The same, which also hands on what is unsigned and `policy` accepts. `link_id` is what the
    /// policy is told of the link.
    #[must_use]
    pub fn accepting<U: UnsignedPolicy>(self, link_id: u8, policy: U) -> Verifier<R, U> {
        Verifier {
            receiver: self.receiver,
            forward: self.forward,
            link_id,
            unsigned: policy,
        }
    }
}

/// A frame that goes on to the local side, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Forwarded {
    /// It was verified.
    Verified(Frame),
    /// It is not signed, nobody knows who sent it, and a policy accepts it.
    Unsigned(Frame),
}

impl<R: AntiReplay, U: UnsignedPolicy> Verifier<R, U> {
    /// Tells the receiver of a frame that was signed here, before it is sent: see [`AntiReplay::record_sent`].
    pub fn record_sent(&mut self, frame: FrameRef<'_>) {
        self.receiver.record_sent(frame);
    }

    /// The frame to hand on for `packet`.
    ///
    /// # Errors
    ///
    /// [`RejectReason`]; nothing has changed then.
    pub fn verify(
        &mut self,
        packet: Packet<'_>,
        keys: &mut impl Authenticate,
        time: &mut impl LinkClock,
    ) -> Result<Forwarded, RejectReason> {
        let frame = passable(packet)?;
        if !frame.is_signed() {
            let accepted = accept_unsigned(frame, self.link_id, &self.unsigned)?;
            return Ok(Forwarded::Unsigned(accepted.to_frame()));
        }
        let verified = time.admit(&mut self.receiver, keys.authenticate(frame)?)?;
        keys.on_accepted(&verified);
        Ok(Forwarded::Verified(match self.forward {
            ForwardMode::StripSignature => verified.to_unsigned(),
            ForwardMode::KeepSignature => verified.to_frame(),
        }))
    }
}

/// The frame in a packet that may pass in any direction.
///
/// MAVLink 1 has no place for a signature. SETUP_SIGNING carries a key in plain text and is for the
/// one component that it is sent to (MAVLink guide, "Message Signing", Secret Key Management).
fn passable(packet: Packet<'_>) -> Result<FrameRef<'_>, RejectReason> {
    match packet {
        Packet::Mavlink1(_) => Err(RejectReason::Mavlink1),
        Packet::Mavlink2(frame) if frame.header().message_id == SETUP_SIGNING => {
            Err(RejectReason::SetupSigning)
        }
        Packet::Mavlink2(frame) => Ok(frame),
    }
}

/// What the packets of one direction go through.
pub(crate) trait PacketHandler {
    const DIRECTION: Direction;
    const RESYNC: Resync;

    /// The frame that goes on, and the news of it.
    fn process<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        keys: &mut KeyRing<P>,
        time: &mut impl LinkClock,
    ) -> Result<(Frame, Event), RejectReason>;
}

impl PacketHandler for Signer {
    const DIRECTION: Direction = Direction::Outbound;
    const RESYNC: Resync = Resync::AnnouncedEnd;

    fn process<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        keys: &mut KeyRing<P>,
        time: &mut impl LinkClock,
    ) -> Result<(Frame, Event), RejectReason> {
        let frame = self.sign(packet, keys.signing(), time)?;
        Ok((frame, Event::Passed(Self::DIRECTION)))
    }
}

impl<R: AntiReplay, U: UnsignedPolicy> PacketHandler for Verifier<R, U> {
    const DIRECTION: Direction = Direction::Inbound;
    const RESYNC: Resync = Resync::NextByte;

    fn process<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        keys: &mut KeyRing<P>,
        time: &mut impl LinkClock,
    ) -> Result<(Frame, Event), RejectReason> {
        Ok(match self.verify(packet, keys, time)? {
            Forwarded::Verified(frame) => (frame, Event::Passed(Self::DIRECTION)),
            Forwarded::Unsigned(frame) => (frame, Event::Unsigned),
        })
    }
}
