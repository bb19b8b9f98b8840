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

mod journal;
mod mark;
#[cfg(feature = "model")]
pub mod model;

pub use journal::{Journal, OpenError, Region, StoreError};
pub use mark::{MARK_SIZE, Mark, ReserveError};
