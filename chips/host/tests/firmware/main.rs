//! The shipped images of `chips/`: built, measured, held to their budgets, and run on emulated chips.
//!
//! `cargo test -p mavseal-chips-host -- --nocapture shipped` prints what they take.

mod budgets;
mod constant_time;
mod controls;
mod demo;
mod elf;
mod emulator;
mod instructions;
mod lines;
mod log;
mod mps2;
mod relay;
mod stm32c0;
mod vehicle;
mod wire;
