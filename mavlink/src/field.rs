//! Where the parts of a MAVLink 2 packet lie: every size, once.
//!
//! ```text
//! magic | length | incompat | compat | seq | sysid | compid | msgid | payload | checksum | link id | timestamp | tag
//!   1   |   1    |    1     |   1    |  1  |   1   |   1    |   3   | 0..=255 |    2     |    1    |     6     |  6
//! ```
//!
//! MAVLink guide, "Packet Serialization" and "Message Signing". All integers are little-endian.

/// First byte of a MAVLink 2 packet.
pub const MAGIC: u8 = 0xFD;
/// First byte of a MAVLink 1 packet.
pub const MAGIC_V1: u8 = 0xFE;
/// Incompatibility flag: the packet is signed (`MAVLINK_IFLAG_SIGNED`).
pub const SIGNED_FLAG: u8 = 0x01;

const MAGIC_SIZE: usize = 1;
const LENGTH_SIZE: usize = 1;
const INCOMPAT_FLAGS_SIZE: usize = 1;
const COMPAT_FLAGS_SIZE: usize = 1;
const SEQUENCE_SIZE: usize = 1;
const SYSTEM_ID_SIZE: usize = 1;
const COMPONENT_ID_SIZE: usize = 1;
const MESSAGE_ID_SIZE: usize = 3;
const MESSAGE_ID_SIZE_V1: usize = 1;

/// Bytes of checksum.
pub const CHECKSUM_SIZE: usize = 2;
/// Bytes of link id in a signature.
pub const LINK_ID_SIZE: usize = 1;
/// Bytes of timestamp in a signature.
pub const TIMESTAMP_SIZE: usize = 6;
/// Bytes of the cut tag that ends a signature.
pub const TAG_SIZE: usize = 6;

/// Bytes of a key: 32.
pub const KEY_SIZE: usize = 32;

/// Offset of the incompatibility flags.
pub(crate) const INCOMPAT_FLAGS: usize = MAGIC_SIZE + LENGTH_SIZE;
/// Offset of the first byte under the checksum: the magic byte is not.
pub(crate) const CHECKED: usize = MAGIC_SIZE;

/// Bytes before the payload of a MAVLink 2 packet: 10.
pub const HEADER_SIZE: usize = MAGIC_SIZE
    + LENGTH_SIZE
    + INCOMPAT_FLAGS_SIZE
    + COMPAT_FLAGS_SIZE
    + SEQUENCE_SIZE
    + SYSTEM_ID_SIZE
    + COMPONENT_ID_SIZE
    + MESSAGE_ID_SIZE;
/// Bytes before the payload of a MAVLink 1 packet: 6.
pub const HEADER_SIZE_V1: usize = MAGIC_SIZE
    + LENGTH_SIZE
    + SEQUENCE_SIZE
    + SYSTEM_ID_SIZE
    + COMPONENT_ID_SIZE
    + MESSAGE_ID_SIZE_V1;
/// Bytes of link id, timestamp and tag together: 13.
pub const SIGNATURE_SIZE: usize = LINK_ID_SIZE + TIMESTAMP_SIZE + TAG_SIZE;
/// Most bytes of payload: 255.
pub const MAX_PAYLOAD_SIZE: usize = u8::MAX as usize;
/// Most bytes of a frame, signature included: 280.
pub const MAX_FRAME_SIZE: usize = HEADER_SIZE + MAX_PAYLOAD_SIZE + CHECKSUM_SIZE + SIGNATURE_SIZE;

const _: () = assert!(HEADER_SIZE == 10 && SIGNATURE_SIZE == 13 && MAX_FRAME_SIZE == 280);
