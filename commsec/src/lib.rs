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

pub use cipher::{AesGcm, Cipher, CipherError, Message, Nonce, Tag};
pub use error::{
    DecodeError, EpochError, FrameError, KeyError, OpenError, PackError, PermitError, RadioError,
    SealError, UnpackError,
};
pub use header::{
    EpochCounter, EpochHeader, EpochSenderId, Header, HeaderFormat, Sender, SenderId,
};
pub use key::{Credential, Key};
pub use open::{FAILED_OPENS_LIMIT, Opened, Opener};
pub use pack::{OLD_VEHICLE_SIZE, Packer, Packets, packets};
pub use package::Package;
pub use seal::{FIRST_COUNTER, Sealer};
/// What a [`Cipher`] promises: it wipes itself when it is dropped.
pub use zeroize::ZeroizeOnDrop;
