//! What is done to a packet: signing towards the radio, verification from it.
//!
//! Two types that share nothing but the key: a packet from the link side meets no function that
//! signs. They need no port, so that a shell with input and output of its own can use them alone.

use mavlink_signing::{
    AllowLink, AntiReplay, Authenticate, Frame, FrameRef, Header, KeyRing, KeySlot, LinkClock,
    MessageId, Packet, Profile, RejectUnsigned, ReplayGuard, Resync, SETUP_SIGNING, SetupSigning,
    Stamp, Stamper, Timestamp, UnsignedPolicy, Verified, VerifyError, Window, accept_unsigned,
    sign_frame,
};

use crate::event::{Direction, Event, RejectReason};

/// HEARTBEAT, message 0.
const HEARTBEAT: MessageId = MessageId::from_le_bytes([0, 0, 0]);

/// In whose name this end signs: the system and component ids that packets of the local side may have.
///
/// Everybody who has the key believes what is signed here. So a vehicle must not sign as the station.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Senders {
    /// Every component of one system: the one whose HEARTBEAT comes first. Until then nothing else is signed.
    #[default]
    FirstHeartbeat,
    /// Every component of this system.
    System(u8),
    /// These alone: system and component id.
    Listed(&'static [(u8, u8)]),
    /// Everybody: where the local side is a network of stations, and all on it may command.
    Any,
}

/// Whether somebody is at the device who may give it a key: a jumper, a button, or a mode of the firmware.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Presence {
    /// Nobody. SETUP_SIGNING is taken only if it is signed with the key in use.
    #[default]
    Absent,
    /// The device has just been switched on: until anything else comes in on the local side.
    AtStart,
    /// Somebody.
    Shown,
}

/// Local to link: signs what is undamaged and unsigned.
#[derive(Debug)]
pub struct Signer {
    /// For the key in each slot.
    stampers: [Stamper; 2],
    senders: Senders,
    /// The system whose HEARTBEAT came first.
    learnt: Option<u8>,
    presence: Presence,
    setup: Option<Setup>,
}

/// Whose SETUP_SIGNING is kept, and the last that came.
#[derive(Debug)]
struct Setup {
    system_id: u8,
    component_id: u8,
    came: Option<SetupSigning>,
    /// The stamp of the last that was signed.
    last: Option<Timestamp>,
}

impl Setup {
    /// A SETUP_SIGNING that is signed with the key in use, as any frame that is accepted: in the window, with a mark above
    /// it stored, and later than any before.
    fn signed<'a, P: Profile>(
        &mut self,
        frame: FrameRef<'a>,
        keys: &KeyRing<P>,
        time: &mut impl LinkClock,
    ) -> Result<Verified<'a>, VerifyError> {
        let authentic = keys.authenticate(frame)?;
        if authentic.key().slot != keys.signing_slot() {
            return Err(VerifyError::BadTag);
        }
        let Stamp { link_id, timestamp } = authentic.stamp();
        if self.last.is_some_and(|last| timestamp <= last) {
            return Err(VerifyError::Replayed);
        }
        let mut once = ReplayGuard::new(link_id, Window::ONE_MINUTE);
        let verified = time.admit(&mut once, authentic)?;
        self.last = Some(timestamp);
        Ok(verified)
    }
}

impl Signer {
    /// Signs with the stamps of `stamper`, in the name of the system that is [heard
    /// first](Senders::FirstHeartbeat).
    #[must_use]
    pub const fn new(stamper: Stamper) -> Self {
        let other = Stamper::new(stamper.link_id()).in_slot(stamper.slot().other());
        Self {
            stampers: match stamper.slot() {
                KeySlot::A => [stamper, other],
                KeySlot::B => [other, stamper],
            },
            senders: Senders::FirstHeartbeat,
            learnt: None,
            presence: Presence::Absent,
            setup: None,
        }
    }

    /// The same, in the name of `senders`.
    #[must_use]
    pub const fn for_senders(mut self, senders: Senders) -> Self {
        self.senders = senders;
        self
    }

    pub(crate) const fn link_id(&self) -> u8 {
        let [stamper, _] = &self.stampers;
        stamper.link_id()
    }

    pub(crate) const fn set_presence(&mut self, presence: Presence) {
        self.presence = presence;
    }

    /// A new key is in `slot`: its stamps begin with `first`.
    pub(crate) fn begin_key(&mut self, slot: KeySlot, first: Timestamp) {
        let stamper = Stamper::resume(self.link_id(), first).in_slot(slot);
        *slot.of_mut(&mut self.stampers) = stamper;
        // What the old key has proved says nothing of the new one.
        if let Some(setup) = &mut self.setup {
            setup.last = None;
        }
    }

    pub(crate) fn keep_setup(&mut self, system_id: u8, component_id: u8) {
        self.setup = Some(Setup {
            system_id,
            component_id,
            came: None,
            last: None,
        });
    }

    pub(crate) fn take_setup(&mut self) -> Option<SetupSigning> {
        self.setup.as_mut()?.came.take()
    }

    /// Keeps what `frame`, a SETUP_SIGNING, says if it is for this end, and either presence is shown or it is signed
    /// with the key in use, later than any before. Returns why it goes no further.
    fn take_in_setup<P: Profile>(
        &mut self,
        frame: FrameRef<'_>,
        keys: &KeyRing<P>,
        time: &mut impl LinkClock,
    ) -> RejectReason {
        let link_id = self.link_id();
        let Some(setup) = &mut self.setup else {
            return RejectReason::SetupSigning;
        };
        let unsigned = accept_unsigned(frame, link_id, &AllowLink { link_id });
        let (came, allowed) = match &unsigned {
            Ok(unsigned) => {
                let present = self.presence != Presence::Absent;
                (SetupSigning::from_payload(unsigned.payload()), present)
            }
            Err(VerifyError::Signed) => match setup.signed(frame, keys, time) {
                Ok(verified) => (SetupSigning::from_payload(verified.payload()), true),
                Err(error) => return error.into(),
            },
            Err(error) => return (*error).into(),
        };
        let ours = |came: &SetupSigning| {
            came.target_system == setup.system_id && came.target_component == setup.component_id
        };
        match came.ok().filter(ours) {
            Some(_) if !allowed => return RejectReason::NoPresence,
            Some(ours) => setup.came = Some(ours),
            None => {}
        }
        RejectReason::SetupSigning
    }

    /// Whether `header` names one of the local side's own.
    fn knows(&self, header: Header) -> bool {
        let sender = (header.system_id, header.component_id);
        match self.senders {
            Senders::Any => true,
            Senders::System(system_id) => sender.0 == system_id,
            Senders::Listed(all) => all.contains(&sender),
            Senders::FirstHeartbeat => match self.learnt {
                Some(system_id) => sender.0 == system_id,
                None => header.message_id == HEARTBEAT,
            },
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
        keys: &KeyRing<P>,
        time: &mut impl LinkClock,
    ) -> Result<Frame, RejectReason> {
        if let Packet::Mavlink2(frame) = packet
            && frame.header().message_id == SETUP_SIGNING
        {
            return Err(self.take_in_setup(frame, keys, time));
        }
        self.other_traffic();
        let frame = passable(packet)?;
        if frame.is_signed() {
            return Err(RejectReason::AlreadySigned);
        }
        if !self.knows(frame.header()) {
            return Err(RejectReason::ForeignSender);
        }
        let sender = frame.header().system_id;
        let mut frame = Frame::try_from(frame)?;
        let stamper = keys.signing_slot().of_mut(&mut self.stampers);
        sign_frame(&mut frame, keys.signing(), time.stamp(stamper)?)?;
        // What is signed is undamaged.
        self.learnt = self.learnt.or(Some(sender));
        Ok(frame)
    }

    /// Something else than SETUP_SIGNING has come in.
    fn other_traffic(&mut self) {
        if self.presence == Presence::AtStart {
            self.presence = Presence::Absent;
        }
    }
}

#[cfg(kani)]
#[cfg_attr(test, mutants::skip)]
impl Signer {
    /// For proofs: a HEARTBEAT of this system came first.
    #[must_use]
    pub const fn having_learnt(mut self, system_id: Option<u8>) -> Self {
        self.learnt = system_id;
        self
    }

    /// For proofs: keeps SETUP_SIGNING for this end, after one that was signed at `last`.
    #[must_use]
    pub fn keeping(mut self, end: [u8; 2], presence: Presence, last: Option<Timestamp>) -> Self {
        let [system_id, component_id] = end;
        self.presence = presence;
        self.setup = Some(Setup {
            system_id,
            component_id,
            came: None,
            last,
        });
        self
    }

    /// For proofs: what came since it was last asked for.
    pub fn kept(&mut self) -> Option<SetupSigning> {
        self.take_setup()
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
    /// For the key in each slot.
    receivers: [R; 2],
    forward: ForwardMode,
    link_id: u8,
    unsigned: U,
}

impl<R: AntiReplay> Verifier<R> {
    /// Admits what `receiver` admits and hands it on as `forward` says; nothing that is unsigned. `receiver` is for the
    /// key in `slot`, a new one like it for another.
    #[must_use]
    pub fn new(slot: KeySlot, receiver: R, forward: ForwardMode) -> Self {
        let other = receiver.renewed(Timestamp::ZERO);
        Self {
            receivers: match slot {
                KeySlot::A => [receiver, other],
                KeySlot::B => [other, receiver],
            },
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
            receivers: self.receivers,
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
    /// Tells the receiver of a frame that was signed here with the key in `slot`, before it is sent: see
    /// [`AntiReplay::record_sent`].
    pub fn record_sent(&mut self, slot: KeySlot, frame: FrameRef<'_>) {
        slot.of_mut(&mut self.receivers).record_sent(frame);
    }

    /// A new key is in `slot`: nothing was accepted with it yet, and nothing is that was stamped before `first`.
    pub(crate) fn begin_key(&mut self, slot: KeySlot, first: Timestamp) {
        let receiver = slot.of_mut(&mut self.receivers);
        *receiver = receiver.renewed(first);
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
        let authentic = keys.authenticate(frame)?;
        let receiver = authentic.key().slot.of_mut(&mut self.receivers);
        let verified = time.admit(receiver, authentic)?;
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

    /// Something came that is no packet.
    fn no_packet(&mut self) {}
}

impl PacketHandler for Signer {
    const DIRECTION: Direction = Direction::Outbound;
    const RESYNC: Resync = Resync::Silence;

    fn process<P: Profile>(
        &mut self,
        packet: Packet<'_>,
        keys: &mut KeyRing<P>,
        time: &mut impl LinkClock,
    ) -> Result<(Frame, Event), RejectReason> {
        let frame = self.sign(packet, keys, time)?;
        Ok((frame, Event::Passed(Self::DIRECTION)))
    }

    fn no_packet(&mut self) {
        self.other_traffic();
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
