//! The crate `mavio`. It remembers no timestamps: a replayed frame is its caller's affair.

use mavio::{
    Frame, Receiver,
    io::StdIoReader,
    protocol::{IncompatFlags, SecretKey, SigningConf, V2},
    utils::MavSha256,
};
use mavlink_signing::{MessageId, dialect};

use crate::messages::{KEY, LINK, Message, stamp};

/// The key, and the hash that is used again for each frame.
pub struct Endpoint {
    conf: SigningConf,
    hash: MavSha256,
}

/// A sender and receiver.
#[must_use]
pub fn endpoint() -> Endpoint {
    Endpoint {
        conf: SigningConf {
            link_id: LINK,
            timestamp: stamp(0).timestamp.ticks().into(),
            secret: SecretKey::from(KEY),
        },
        hash: MavSha256::default(),
    }
}

/// From header and payload to the frame on the wire, in `buffer`: how many bytes.
///
/// The flag is set first: mavio's own way sets it when the checksum has been made.
///
/// # Panics
///
/// If it does not sign.
pub fn sign(
    message: &Message,
    payload: &[u8],
    endpoint: &mut Endpoint,
    buffer: &mut [u8],
) -> usize {
    let mut frame = Frame::builder()
        .version(V2)
        .sequence(0)
        .system_id(1)
        .component_id(1)
        .message_id(message.id)
        .payload(payload)
        .incompat_flags(IncompatFlags::MAVLINK_IFLAG_SIGNED)
        .crc_extra(crc_extra(message.id))
        .build();
    frame.add_signature(&mut endpoint.hash, &endpoint.conf);
    frame.serialize(buffer).expect("room for it")
}

/// From received bytes to the frame.
///
/// # Panics
///
/// If it does not accept the frame.
#[must_use]
pub fn verify(bytes: &[u8], endpoint: &mut Endpoint) -> Frame<V2> {
    let mut receiver = Receiver::versioned(StdIoReader::new(bytes), V2);
    let frame = receiver.recv().expect("a frame");
    let crc_extra = crc_extra(frame.message_id());
    assert!(frame.validate_checksum_with_crc_extra(crc_extra).is_ok());
    let signature = frame.validate_signature(&mut endpoint.hash, &endpoint.conf.secret);
    assert!(signature.is_ok());
    frame
}

fn crc_extra(id: u32) -> u8 {
    let id = MessageId::new(id).expect("24 bits");
    dialect::crc_extra(id).expect("a message")
}
