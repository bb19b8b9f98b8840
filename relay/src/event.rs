//! What became of each packet, and how often.

use mavlink_signing::{DecodeError, MessageId, Packet, ParseError, SignError, VerifyError};
use strum::{Display, IntoStaticStr, VariantArray};

/// The way a packet was going.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Direction {
    /// Towards the radio: to be signed.
    Outbound,
    /// From the radio: to be verified.
    Inbound,
}

/// Why a packet was not passed on.
#[derive(Clone, Copy, Debug, Display, IntoStaticStr, VariantArray, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RejectReason {
    /// A MAVLink 1 packet: it has no place for a signature.
    #[strum(serialize = "MAVLink 1")]
    Mavlink1,
    /// SETUP_SIGNING: it carries a key.
    #[strum(serialize = "SETUP_SIGNING")]
    SetupSigning,
    /// SETUP_SIGNING for this end, but nobody has shown presence, and it is not signed with the key in use.
    #[strum(serialize = "no presence")]
    NoPresence,
    /// To be signed, but in the name of a system or component that is none of the local side's.
    #[strum(serialize = "foreign sender")]
    ForeignSender,
    /// Unknown incompatibility flags.
    #[strum(serialize = "unknown flags")]
    UnknownIncompatFlags,
    /// A message that the dialect does not define.
    #[strum(serialize = "unknown message")]
    UnknownMessage,
    /// Damaged on its way here.
    #[strum(serialize = "bad checksum")]
    BadChecksum,
    /// To be signed, but signed already.
    #[strum(serialize = "already signed")]
    AlreadySigned,
    /// To be signed, but the link's timestamps are used up.
    #[strum(serialize = "clock exhausted")]
    TimestampsExhausted,
    /// To be verified, but not signed.
    #[strum(serialize = "not signed")]
    NotSigned,
    /// Signed with another key, or forged.
    #[strum(serialize = "bad tag")]
    BadTag,
    /// Authentic, but made for another link; with [`ReplayGuard`](mavlink_signing::ReplayGuard) also one's own
    /// frames, reflected.
    #[strum(serialize = "wrong link")]
    WrongLink,
    /// Authentic, but stamped later than the window allows.
    #[strum(serialize = "from the future")]
    FromFuture,
    /// Authentic, but stamped earlier than the window allows.
    #[strum(serialize = "too old")]
    TooOld,
    /// Authentic, but not newer than the last accepted frame.
    #[strum(serialize = "replayed")]
    Replayed,
    /// Authentic, but sent by this end itself.
    #[strum(serialize = "reflected")]
    Reflected,
    /// To be signed, or authentic and in order, but no mark above its stamp can be stored.
    #[strum(serialize = "not stored")]
    NotStored,
    /// Passed on, but the line was closed before the whole frame had left.
    #[strum(serialize = "line closed")]
    LineClosed,
    /// An error that this version of the relay does not know.
    #[strum(serialize = "other")]
    Other,
}

impl RejectReason {
    /// Every reason, in the order of [`RejectReason`]'s definition.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// The reason in a few words, as in tables.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

impl From<DecodeError> for RejectReason {
    fn from(error: DecodeError) -> Self {
        match error {
            DecodeError::Parse(ParseError::UnknownIncompatFlags(_)) => Self::UnknownIncompatFlags,
            DecodeError::UnknownMessage(_) => Self::UnknownMessage,
            DecodeError::BadChecksum(_) => Self::BadChecksum,
            _ => Self::Other,
        }
    }
}

impl From<SignError> for RejectReason {
    fn from(error: SignError) -> Self {
        match error {
            SignError::UnknownMessage(_) => Self::UnknownMessage,
            SignError::BadChecksum => Self::BadChecksum,
            SignError::AlreadySigned => Self::AlreadySigned,
            SignError::TimestampsExhausted => Self::TimestampsExhausted,
            SignError::NotStored => Self::NotStored,
            _ => Self::Other,
        }
    }
}

impl From<VerifyError> for RejectReason {
    fn from(error: VerifyError) -> Self {
        match error {
            VerifyError::Parse(ParseError::UnknownIncompatFlags(_)) => Self::UnknownIncompatFlags,
            VerifyError::NotSigned => Self::NotSigned,
            VerifyError::UnknownMessage(_) => Self::UnknownMessage,
            VerifyError::BadChecksum => Self::BadChecksum,
            VerifyError::BadTag => Self::BadTag,
            VerifyError::WrongLink(_) => Self::WrongLink,
            VerifyError::FromFuture => Self::FromFuture,
            VerifyError::TooOld => Self::TooOld,
            VerifyError::Replayed => Self::Replayed,
            VerifyError::Reflected => Self::Reflected,
            VerifyError::NotStored => Self::NotStored,
            VerifyError::Signed => Self::AlreadySigned,
            _ => Self::Other,
        }
    }
}

/// What became of one packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Event {
    /// It goes on: signed, or verified.
    Passed(Direction),
    /// It goes on to the local side, not signed and accepted by a policy.
    Unsigned,
    /// It does not.
    Rejected(Direction, RejectReason),
}

/// How often each thing happened in one direction. Every count stays at the top of its range.
///
/// From the link side, a rejection for flags, message or checksum is counted for each place at which
/// bytes began like a packet and were none, so that one damaged packet may count more than once.
///
/// Anybody who can send bytes can raise the counts of rejections: show them, do not act on them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    passed: u32,
    unsigned: u32,
    rejected: [u32; RejectReason::ALL.len()],
    last_rejected: Option<RejectedPacket>,
    dropped: u32,
}

/// Who a rejected packet says that it is from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RejectedPacket {
    /// The vehicle or station.
    pub system_id: u8,
    /// The part of it.
    pub component_id: u8,
    /// The link that it was signed for, if it was signed.
    pub link_id: Option<u8>,
    /// Which message it carries.
    pub message_id: MessageId,
    /// Why it was rejected.
    pub rejection: RejectReason,
}

impl RejectedPacket {
    pub(crate) fn new(packet: &Packet<'_>, rejection: RejectReason) -> Self {
        let (system_id, component_id, link_id) = match packet {
            Packet::Mavlink2(frame) => {
                let header = frame.header();
                let link_id = frame.signature().map(|signature| signature.stamp.link_id);
                (header.system_id, header.component_id, link_id)
            }
            Packet::Mavlink1(packet) => (packet.system_id(), packet.component_id(), None),
        };
        Self {
            system_id,
            component_id,
            link_id,
            message_id: packet.message_id(),
            rejection,
        }
    }
}

impl Counters {
    /// Packets passed on, signed or verified.
    #[must_use]
    pub const fn passed(&self) -> u32 {
        self.passed
    }

    /// Packets passed on unsigned, as a policy accepted them; always 0 towards the link side.
    #[must_use]
    pub const fn unsigned(&self) -> u32 {
        self.unsigned
    }

    /// The sender that the last rejected packet named: whoever sent it may have named another. What was
    /// no whole packet, damaged or of an unknown message, names nobody and is left out.
    #[must_use]
    pub const fn last_rejected(&self) -> Option<RejectedPacket> {
        self.last_rejected
    }

    /// Bytes that belonged to no packet: noise, and packets that were damaged, cut short or unknown.
    #[must_use]
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Packets rejected for `reason`.
    #[must_use]
    pub fn rejected(&self, reason: RejectReason) -> u32 {
        self.rejected.get(reason as usize).copied().unwrap_or(0)
    }

    /// Every reason and how often it was given.
    pub fn rejections(&self) -> impl Iterator<Item = (RejectReason, u32)> {
        RejectReason::ALL.iter().copied().zip(self.rejected)
    }

    pub(crate) const fn set_dropped(&mut self, dropped: u32) {
        self.dropped = dropped;
    }

    pub(crate) const fn count_passed(&mut self, event: Event) {
        let count = match event {
            Event::Unsigned => &mut self.unsigned,
            _ => &mut self.passed,
        };
        *count = count.saturating_add(1);
    }

    /// `rejected packet` is unknown where no packet could be read.
    pub(crate) fn count_rejected(&mut self, reason: RejectReason, packet: Option<RejectedPacket>) {
        self.last_rejected = packet.or(self.last_rejected);
        if let Some(count) = self.rejected.get_mut(reason as usize) {
            *count = count.saturating_add(1);
        }
    }
}
