//! Attacks without the key that worked on an earlier state of the device, turned round.

#![allow(clippy::pedantic)]

mod common;
mod keys;
mod memory;
mod output;
mod time;
