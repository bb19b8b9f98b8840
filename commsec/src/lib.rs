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

pub use cipher::{AesGcm, Cipher, CipherError, Nonce, PackageTag, Plaintext};
pub use error::{
    DecodeError, EpochError, FrameError, OpenError, PackError, PermitError, RadioError, SealError,
    SealingKeyError, UnpackError,
};
pub use header::{
    EpochCounter, EpochHeader, EpochSenderId, HeaderFormat, PackageHeader, Sender, SenderId,
};
pub use key::{Credential, SealingKey};
pub use open::{INTEGRITY_LIMIT, Opened, Opener};
pub use pack::{LEGACY_SIZE, Packer, Packets, packets};
pub use package::Package;
pub use seal::{FIRST_COUNTER, Sealer};
/// What a [`Cipher`] promises: it wipes itself when it is dropped.
pub use zeroize::ZeroizeOnDrop;
