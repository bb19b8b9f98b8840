//! ST's NUCLEO-C092RC board: the clock, the serial port behind USB, a light.
//!
//! Everything about security is in `mavlink-signing`; here is only what another board has in
//! another way. No interrupt is used.

#![no_std]

mod board;
#[cfg(not(feature = "logging"))]
mod panic;
mod vectors;

// Linked for what they define: the critical section, where defmt's log goes, what a panic does.
use cortex_m as _;
#[cfg(feature = "logging")]
use defmt_rtt as _;
#[cfg(feature = "logging")]
use panic_probe as _;

pub use board::{Board, Light, Serial};
