#![doc = include_str!("../README.md")]
#![no_std]
#![cfg_attr(
    not(test),
    deny(
        clippy::expect_used,
        clippy::indexing_slicing,
        clippy::panic,
        clippy::unreachable,
        clippy::unwrap_used
    )
)]

// `cargo kani` builds every crate of the workspace, and finds it in those with `no_std` only so.
#[cfg(kani)]
extern crate kani;

mod anti_replay;
mod clock;
pub mod crc;
mod decoder;
pub mod dialect;
mod error;
pub mod field;
mod frame;
mod header;
mod key;
mod key_ring;
mod link_clock;
mod profile;
mod setup;
mod sign;
mod state;
mod stream_table;
mod time;
mod unsigned;
mod verify;

pub use anti_replay::{AntiReplay, ReplayGuard};
pub use clock::{Clock, SYSTEM_TIME, SyncState, TimeSource, system_time};
pub use decoder::{DecodeError, Decoder, Mavlink1, Packet, Resync};
pub use error::{NotStored, ParseError, SignError, VerifyError};
pub use field::KEY_SIZE;
pub use frame::{Frame, FrameRef, Signature, Tag};
pub use header::{Header, MessageId};
pub use key::{Fingerprint, KeyError, SigningKey, is_published, passphrase_key};
pub use key_ring::{
    Authenticate, KeyChange, KeyChangeError, KeyRing, KeySlot, KeyStore, KeyUse, RolloverState,
};
pub use link_clock::LinkClock;
pub use profile::{Hmac, Profile, Standard};
pub use setup::{SETUP_SIGNING, SetupError, SetupSigning, redact_for_log, without_trailing_zeros};
pub use sign::sign_frame;
pub use state::{MavLinkState, verify_frame};
pub use stream_table::{Links, Stream, StreamTable};
pub use time::{RESERVATION, Stamp, Stamper, TICKS_PER_SECOND, Timestamp, Window};
pub use unsigned::{
    AllowLink, AllowRadioStatus, Claim, RejectUnsigned, Unsigned, UnsignedPolicy, accept_unsigned,
};
pub use verify::{Authentic, Verified, authenticate};
/// What a [`Profile`] promises: it wipes itself when it is dropped.
pub use zeroize::ZeroizeOnDrop;
