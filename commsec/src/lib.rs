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

mod cipher;
mod error;
pub mod field;
mod header;
pub mod hx;
mod key;
mod open;
mod pack;
mod package;
pub mod radio;
mod seal;
mod seen;
mod sender;

pub use cipher::{AesGcm, Cipher, CipherError, Nonce, PackageTag, Plaintext};
pub use error::OpenError;
pub use header::{EpochHeader, HeaderFormat, PackageHeader, Sender};
pub use key::{Credential, FINGERPRINT_SIZE, SealingKey, SealingKeyError};
pub use open::{INTEGRITY_LIMIT, Opened, Opener, PermitError};
pub use pack::{LEGACY_SIZE, PackError, Packer, Packets, UnpackError, packets};
pub use package::Package;
pub use seal::{EpochError, FIRST_COUNTER, SealError, Sealer};
pub use seen::{MAX_PASSED_OVER, REORDER_WINDOW};
pub use sender::{EpochCounter, EpochSenderId, SenderId};
/// What a [`Cipher`] promises: it wipes itself when it is dropped.
pub use zeroize::ZeroizeOnDrop;
