//! The tests of the signing core that need more than one module of it.

mod common;
mod decoder;
mod dialect;
mod frames;
mod seed;
mod standard;
mod time;
mod vectors;
