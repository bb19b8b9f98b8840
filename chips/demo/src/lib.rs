//! What the firmware of every chip shares: the signing demonstration, and log lines.

#![no_std]

#[cfg(feature = "leaky")]
mod leaky;
mod log;
mod run;

#[cfg(feature = "logging")]
#[doc(hidden)]
pub use defmt;

pub use run::{Failed, Memory, run};

/// The key of the demonstrations. It is public: never use it.
pub const DEMO_KEY: [u8; 32] = *include_bytes!("../demo.key");
/// What the key of demonstrations with others' ground stations is made of. It is public: never use it.
pub const DEMO_PASSPHRASE: &str = include_str!("../demo.passphrase");
