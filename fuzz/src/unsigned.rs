//! Targets: frames without signature, the message that carries a key, and what is logged.

use arbitrary::Arbitrary;
use mavlink_signing::field::{CHECKSUM_SIZE, HEADER_SIZE};
use mavlink_signing::{
    AllowLink, AllowRadioStatus, Claim, Frame, FrameRef, KEY_SIZE, RejectUnsigned, SetupSigning,
    UnsignedPolicy, VerifyError, accept_unsigned, authenticate, redact_for_log, sign_frame,
    without_trailing_zeros,
};
use mavseal_proofs::{setup, unsigned};

use crate::frames::Packaged;
use crate::input::{Head, Moment, Stamped};
use crate::repair::KEY;

/// A packet, and who decides whether it is acted on.
#[derive(Arbitrary, Clone, Debug)]
pub struct Asked<'a> {
    /// The policy: none, RADIO_STATUS, a trusted port, or what `answers` says; modulo 4.
    pub policy: u8,
    /// The port that is trusted.
    pub trusted: u8,
    /// The port on which the packet came in.
    pub link_id: u8,
    /// The answers: one bit for each sum, modulo 16, of the ids that a frame names.
    pub answers: u16,
    /// The packet.
    pub packet: Packaged<'a>,
}

impl Asked<'_> {
    /// What the policy must say.
    fn answer(&self, claim: Claim) -> bool {
        match self.policy % 4 {
            0 => false,
            1 => claim.message_id.get() == 109,
            2 => claim.link_id == self.trusted,
            _ => self.answers(claim),
        }
    }

    fn answers(&self, claim: Claim) -> bool {
        let ids = [claim.link_id, claim.system_id, claim.component_id];
        let sum = claim.message_id.get() + ids.map(u32::from).iter().sum::<u32>();
        self.answers >> (sum % 16) & 1 == 1
    }
}

/// Any packet and any policy: it decides about undamaged frames without signature, which come out as they
/// came in, and is asked about nothing else, by the relay neither (U1).
pub fn unsigned_policy(input: Asked<'_>) {
    let (bytes, _) = input.packet.packet();
    let Ok(frame) = FrameRef::parse(&bytes) else {
        return;
    };
    let link_id = input.link_id;
    let header = frame.header();
    let answer = input.answer(Claim {
        link_id,
        system_id: header.system_id,
        component_id: header.component_id,
        message_id: header.message_id,
    });
    let verdict = unsigned::policy_decides(frame, link_id, answer);

    let trusted_port = AllowLink {
        link_id: input.trusted,
    };
    let answers = |claim| input.answers(claim);
    let policy: &dyn UnsignedPolicy = match input.policy % 4 {
        0 => &RejectUnsigned,
        1 => &AllowRadioStatus,
        2 => &trusted_port,
        _ => &answers,
    };
    let accepted = accept_unsigned(frame, link_id, &|claim| policy.accepts(claim));
    if let Ok(unsigned) = &accepted {
        assert_eq!(unsigned.to_frame().as_bytes(), frame.as_bytes());
        let verified = authenticate(frame, &KEY).map(drop);
        assert_eq!(verified, Err(VerifyError::NotSigned));
    }
    assert_eq!(accepted.map(drop), verdict);

    let (receiver, now) = (input.packet.receiver.into(), input.packet.now.timestamp());
    let index = input.packet.damage_at.into();
    let _ = unsigned::only_unsigned_is_asked_about(frame, &KEY, receiver, now, index);
}

/// A key on its way, and another packet.
#[derive(Arbitrary, Clone, Debug)]
pub struct Shared<'a> {
    /// Whom the key is for: system and component.
    pub target: [u8; 2],
    /// The timestamp to begin with.
    pub initial: Moment,
    /// The key.
    pub secret_key: [u8; 32],
    /// The header of the frame that carries it.
    pub head: Head,
    /// What it is signed with, to be logged.
    pub stamped: Stamped,
    /// The byte of a payload that is compared in the log.
    pub index: u8,
    /// The packet, whose bytes are also read as a payload.
    pub packet: Packaged<'a>,
}

/// A key comes out of SETUP_SIGNING as it went in, any bytes are read as they should be, and what is
/// logged, of that frame or any other, has neither signature nor key (M1).
pub fn setup_signing(input: Shared<'_>) {
    let payload = input.packet.bytes;
    setup::only_zeros_are_cut(payload);
    let _ = setup::read_field_by_field(payload);
    let index = input.index.into();
    logged(&input.packet.packet().0, index);

    let (shown, mut frame) = input.carried(input.secret_key);
    let (other_shown, other) = input.carried([0; KEY_SIZE]);
    assert_eq!(shown, other_shown);
    let log = logged(frame.as_bytes(), index);
    assert!(log.is_some() && log == logged(other.as_bytes(), index));
    sign_frame(&mut frame, &KEY, input.stamped.into()).expect("not signed yet");
    assert_eq!(log, logged(frame.as_bytes(), index));
}

impl Shared<'_> {
    /// How a key shows itself on its way, and the frame that carries it.
    fn carried(&self, secret_key: [u8; KEY_SIZE]) -> (String, Frame) {
        let [target_system, target_component] = self.target;
        let setup = SetupSigning {
            target_system,
            target_component,
            secret_key,
            initial_timestamp: self.initial.timestamp(),
        };
        let header = self.head.into();
        setup::built_field_by_field(&setup, header);
        let frame = setup.to_frame(header).expect("a known message");
        let bytes = frame.as_bytes();
        let payload = &bytes[HEADER_SIZE..bytes.len() - CHECKSUM_SIZE];
        assert_eq!(without_trailing_zeros(payload), payload);
        (format!("{setup:?}"), frame)
    }
}

/// What of the frame in `bytes` is logged, if anything. It is a whole frame, and fit for a log as it is.
fn logged(bytes: &[u8], index: usize) -> Option<Frame> {
    let log = setup::log_shows_no_secret(FrameRef::parse(bytes).ok()?, index).ok()?;
    let again = FrameRef::parse(log.as_bytes()).expect("a whole frame");
    assert_eq!(redact_for_log(again).as_ref(), Ok(&log));
    Some(log)
}
