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
#[cfg(feature = "std")]
extern crate std;

pub mod adapter;
mod direction;
mod endpoint;
mod event;
mod key_store;
mod link_memory;
mod persistent_clock;
mod pump;
mod reader;
mod relay;
pub mod sealed;

pub use direction::{ForwardMode, Forwarded, Presence, Senders, Signer, Verifier};
pub use endpoint::{Endpoint, LineEvent, Side};
pub use event::{Counters, Direction, Event, RejectReason, RejectedPacket};
pub use key_store::{FlashKeyStore, KEYS_SIZE};
pub use link_memory::{FirstKey, LinkFlash, LinkMemory, LinkMemoryError};
pub use persistent_clock::{FIRST_RESERVATION, PersistentClock, TimeError};
pub use reader::{IDLE, LINE_RATE};
pub use relay::{Relay, SameLinkId};
