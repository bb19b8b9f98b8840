// The example takes the flash of `model`.
#![cfg_attr(any(feature = "model", not(doctest)), doc = include_str!("../README.md"))]
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

mod error;
mod high_water_mark;
mod journal;
#[cfg(feature = "model")]
pub mod model;
mod pages;
mod record;

pub use error::{OpenError, StoreError};
pub use high_water_mark::{HighWaterMark, MARK_SIZE, MarkError, ProvisionError, ReserveError};
pub use journal::{Contents, Journal, Region};
pub use record::Binding;
