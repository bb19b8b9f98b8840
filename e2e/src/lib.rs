//! Plays over the firmware in QEMU, from end to end.
//!
//! A play is a list of [`Phase`]s: what is sent into each side of a [`Device`], and what must become of it.
//! [`run`] boots the machine, plays, compares and prints. The tests and the demonstration
//! (`cargo run -p mavseal-e2e --example demo`) run the same plays: [`relay::signer`], [`relay::restart`] and
//! [`sealed::sealed`].

pub mod machine;
pub mod relay;
pub mod runner;
pub mod scenario;
pub mod sealed;
pub mod wire;

pub use machine::Machine;
pub use runner::run;
pub use scenario::{Device, Phase, Side};
