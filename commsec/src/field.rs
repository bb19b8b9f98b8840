//! Where the parts of a commsec package lie: every size, once.
//!
//! ```text
//! sender id | counter | sealed message | tag
//!     4     |    4    |       80       |  8
//! ```
//!
//! SMACCMPilot, "GCS Communication Security". Integers are big-endian, unlike MAVLink's.

/// Bytes of a sender's id.
pub const SENDER_ID_SIZE: usize = 4;
/// Bytes of a counter.
pub const COUNTER_SIZE: usize = 4;
/// Bytes of the message in a package, sealed or not: 80.
pub const PLAINTEXT_SIZE: usize = 80;
/// Bytes of the tag that ends a package: the first half of the cipher's.
pub const TAG_SIZE: usize = 8;

/// Bytes before the sealed message: 8.
pub const HEADER_SIZE: usize = SENDER_ID_SIZE + COUNTER_SIZE;
/// Bytes of a package: 96.
pub const PACKAGE_SIZE: usize = HEADER_SIZE + PLAINTEXT_SIZE + TAG_SIZE;

/// Bytes of a key: 16, for AES-128.
pub const KEY_SIZE: usize = 16;
/// Bytes of the part of a nonce that is never sent.
pub const SALT_SIZE: usize = 4;
/// Bytes of a nonce: the salt, then the header as it is sent.
pub const NONCE_SIZE: usize = SALT_SIZE + HEADER_SIZE;

const _: () = assert!(HEADER_SIZE == 8 && PACKAGE_SIZE == 96 && NONCE_SIZE == 12);
