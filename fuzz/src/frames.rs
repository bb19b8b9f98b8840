//! Targets about one packet.

use std::error::Error;

use arbitrary::Arbitrary;
use mavlink_signing::dialect::crc_extra;
use mavlink_signing::{
    DecodeError, Frame, FrameRef, Header, KeySlot, MavLinkState, Packet, SignError, Tag, Timestamp,
    VerifyError, sign_frame, verify_frame as verify_shared,
};
use mavseal_proofs::model::Resumed;
use mavseal_proofs::relay::LocalSide;
use mavseal_proofs::tamper::{self, Change};
use mavseal_proofs::{emit, packet, parse, relay, sign, unforgeable, verify};
use mavseal_relay::{ForwardMode, RejectReason, Senders};

use crate::input::{Head, Message, Moment, NOW, Receiver, Stamped};
use crate::repair::{self, KEY, KEYS};

/// Any bytes: parsing (W1), the front of a decoder's buffer (W3), and the verdict on them (V1, V2).
pub fn verify_frame(bytes: &[u8]) {
    let crc_extra_byte = bytes.last().copied().unwrap_or_default();
    let _ = parse::parse_any(bytes, crc_extra_byte);
    if let Err(error) = packet::front(bytes, crc_extra) {
        let parsed = matches!(error, DecodeError::Parse(_));
        assert_eq!(error.source().is_some(), parsed);
    }
    let now = Timestamp::from_ticks(NOW).expect("48 bits");
    let receiver = Receiver {
        window: [u16::MAX, 0],
        ..Receiver::default()
    };
    every_verdict(bytes, receiver.into(), now);
}

/// The verdict is as specified (V1).
fn verdict(
    bytes: &[u8],
    receiver: Resumed,
    now: Timestamp,
    tag: impl Fn(&[u8]) -> Tag,
) -> Result<(), VerifyError> {
    let checksum = repair::checksum;
    verify::accepted_iff(bytes, &KEY, receiver, now, checksum, tag).map(drop)
}

/// The same verdict whoever asks: once more, when it leaves no trace (V2); with the state that interrupts
/// and threads share; and as the relay calls it. What is sent on was undamaged, and is not signed again.
fn every_verdict(bytes: &[u8], receiver: Resumed, now: Timestamp) {
    let verdict = verdict(bytes, receiver, now, repair::tag);
    let traceless = unforgeable::rejection_leaves_no_trace(bytes, &KEY, receiver, now);
    assert_eq!(traceless, verdict);
    if let Err(error) = verdict {
        let parsed = matches!(error, VerifyError::Parse(_));
        assert_eq!(error.source().is_some(), parsed);
        assert!(parsed || RejectReason::from(error) != RejectReason::Other);
    }

    let Ok(frame) = FrameRef::parse(bytes) else {
        return;
    };
    let state = MavLinkState::new(receiver.replay());
    let before = state.last();
    let shared = verify_shared(frame, &KEY, now, &state);
    assert_eq!(shared.is_ok(), state.last() != before);
    if let Ok(verified) = &shared {
        assert_eq!(verified.as_bytes(), frame.as_bytes());
    }
    assert_eq!(shared.map(drop), verdict);

    let id = frame.header().message_id;
    let undamaged = crc_extra(id).map(|extra| frame.checksum_matches(extra));
    let copy = Frame::try_from(frame);
    let reason = copy.as_ref().err().map(|error| RejectReason::from(*error));
    assert_ne!(reason, Some(RejectReason::Other));
    match undamaged {
        None => assert_eq!(copy, Err(SignError::UnknownMessage(id))),
        Some(false) => assert_eq!(copy, Err(SignError::BadChecksum)),
        Some(true) => {
            let copy = copy.expect("undamaged");
            assert_eq!(copy.as_bytes(), frame.as_bytes());
            assert_eq!(copy.is_signed(), frame.is_signed());
            // One that is signed is not signed once more.
            let mut again = copy.clone();
            let signed = sign_frame(&mut again, &KEY, Stamped::default().into());
            assert_eq!(signed.is_err(), copy.is_signed());
            assert!(signed.is_ok() || again == copy);
            let reason = signed.err().map(RejectReason::from);
            assert_ne!(reason, Some(RejectReason::Other));
        }
    }
}

/// A packet that is made whole as far as `repairs` says, then damaged, and who looks at it when.
#[derive(Arbitrary, Clone, Debug)]
pub struct Packaged<'a> {
    /// Bits 0 and 1: what is made of the bytes, none, MAVLink 1, unsigned, signed. Bits 2 to 6,
    /// made right: message, link, timestamp, checksum, tag.
    pub repairs: u8,
    /// The message, where it is made right.
    pub message: Message,
    /// The timestamp, where it is made right.
    pub stamped: Moment,
    /// When it is looked at.
    pub now: Moment,
    /// By whom.
    pub receiver: Receiver,
    /// Which byte is damaged at the end, modulo their number.
    pub damage_at: u16,
    /// The bits of it that are flipped; mostly none.
    pub damage: u8,
    /// The bytes.
    pub bytes: &'a [u8],
}

impl Packaged<'_> {
    /// The packet, and its tag where it was made right and nothing under it was damaged after.
    #[must_use]
    pub fn packet(&self) -> (Vec<u8>, Option<Tag>) {
        let repaired = |bit: u32| self.repairs >> bit & 1 == 1;
        let mut bytes = self.bytes.to_vec();
        let mut tag = None;
        repair::shape(&mut bytes, self.repairs & 3);
        if let Some(mut parts) = repair::parts(&bytes) {
            if repaired(2) {
                parts.set_id(&mut bytes, self.message.id());
            }
            let link_id = repaired(3).then_some(self.receiver.link_id);
            let timestamp = repaired(4).then(|| self.stamped.timestamp());
            parts.restamp(&mut bytes, link_id, timestamp);
            if repaired(5) {
                parts.repair_checksum(&mut bytes);
            }
            if repaired(6) {
                tag = parts.repair_tag(&mut bytes);
            }
        }
        if self.damage != 0 && !bytes.is_empty() {
            let at = usize::from(self.damage_at) % bytes.len();
            bytes[at] ^= self.damage;
            tag = None;
        }
        (bytes, tag)
    }
}

/// A packet with a right tag, or one that is wrong in one way: the verdict on it (V1). Fast, and no more;
/// [`relay_packet`] looks at the same inputs from every side.
pub fn verify_repaired(input: Packaged<'_>) {
    let (bytes, known) = input.packet();
    let (receiver, now) = (input.receiver.into(), input.now.timestamp());
    let tag = |covered: &[u8]| known.unwrap_or_else(|| repair::tag(covered));
    let _ = verdict(&bytes, receiver, now, tag);
}

/// The same, whoever asks for the verdict (V1, V2), and given to the relay: from the link side only what
/// is verified goes on, from the local side only what is unsigned (L1).
pub fn relay_packet(input: Packaged<'_>) {
    let (bytes, _) = input.packet();
    let (now, receiver) = (input.now.timestamp(), input.receiver.into());
    every_verdict(&bytes, receiver, now);
    let Ok(packet) = Packet::parse(&bytes, crc_extra) else {
        return;
    };
    // Where something is damaged, that is the byte to look at.
    let index = usize::from(input.damage_at);
    for forward in [ForwardMode::KeepSignature, ForwardMode::StripSignature] {
        let _ = relay::only_verified_leaves(packet, &KEY, receiver, forward, now, index);
    }
    let (link_id, first) = (!input.receiver.link_id, input.stamped.timestamp());
    // Twice, so that a first HEARTBEAT counts.
    for senders in [Senders::Any, Senders::System(1), Senders::FirstHeartbeat] {
        let mut local = LocalSide::new(link_id, KeySlot::A, first, senders);
        for _ in 0..2 {
            let _ = relay::only_unsigned_is_signed(&mut local, packet, &KEYS, now, index);
        }
    }
}

/// A frame to sign.
#[derive(Arbitrary, Clone, Debug)]
pub struct ToSign<'a> {
    /// Its header.
    pub head: Head,
    /// Its stamp.
    pub stamped: Stamped,
    /// The byte that is compared.
    pub index: u16,
    /// Its payload.
    pub payload: &'a [u8],
}

/// A frame that is emitted, parsed (W2), signed (S1, S2) and verified (V3).
pub fn sign_verify(input: ToSign<'_>) {
    let header = Header::from(input.head);
    let (payload, stamp, index) = (input.payload, input.stamped.into(), input.index.into());
    match emit::round_trip(header, payload, index) {
        Ok(()) => {
            let (checksum, tag) = (repair::checksum, repair::tag);
            sign::signs_in_place(header, payload, &KEY, stamp, index, checksum, tag);
            sign::signed_verifies(header, payload, &KEY, stamp, index);
        }
        Err(SignError::PayloadTooLong(length)) => assert!(length == payload.len() && length > 255),
        Err(error) => assert_eq!(error, SignError::UnknownMessage(header.message_id)),
    }
}

/// A signed frame and what is changed in it.
#[derive(Arbitrary, Clone, Debug)]
pub struct Tampered<'a> {
    /// Its header.
    pub head: Head,
    /// Its stamp.
    pub stamped: Stamped,
    /// The changes, one after another.
    pub changes: Vec<Change>,
    /// Its payload.
    pub payload: &'a [u8],
}

/// Any change of a signed frame is rejected.
pub fn tamper_one(input: Tampered<'_>) {
    let (header, stamp) = (input.head.into(), input.stamped.into());
    let _ = tamper::change_is_rejected(header, input.payload, &KEY, stamp, &input.changes);
}
