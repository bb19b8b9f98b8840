//! The crate `mavlink`, with its feature `mav2-message-signing`. It asks the machine's clock.

use mavlink::{
    MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, Message as _, SigningConfig, SigningData,
    dialects::common::MavMessage,
};

use crate::messages::{KEY, LINK, Message};

/// A sender and receiver that has seen nothing yet.
#[must_use]
pub fn endpoint() -> SigningData {
    SigningData::from_config(SigningConfig::new(KEY, LINK, true, false))
}

/// The message as it wants it.
#[must_use]
pub fn message(message: &Message) -> MavMessage {
    MavMessage::parse(MavlinkVersion::V2, message.id, &message.payload()).expect("a message")
}

/// From the message to the frame on the wire.
#[must_use]
pub fn sign(message: &MavMessage, endpoint: &SigningData) -> MAVLinkV2MessageRaw {
    let header = MavHeader {
        sequence: 0,
        system_id: 1,
        component_id: 1,
    };
    let mut frame = MAVLinkV2MessageRaw::new();
    frame.serialize_message_for_signing(header, message);
    endpoint.sign_message(&mut frame);
    frame
}

/// From received bytes to the frame, without its reader, which looks for where a frame begins.
///
/// # Panics
///
/// If it does not accept the frame.
#[must_use]
pub fn verify(bytes: &[u8], endpoint: &SigningData) -> MAVLinkV2MessageRaw {
    let mut frame = MAVLinkV2MessageRaw::new();
    frame.as_mut_slice()[..bytes.len()].copy_from_slice(bytes);
    assert!(frame.has_valid_crc::<MavMessage>());
    assert!(endpoint.verify_signature(&frame));
    frame
}
