//! Any bytes on a line are taken, and a frame behind them comes out.
//! Properties: F1, F2.
//!
//! Compares any stream with a decoder that cuts it at its boundaries first; a frame behind it with itself.
#![no_main]

use mavseal_fuzz::sealed::Line;

libfuzzer_sys::fuzz_target!(|input: Line<'_>| mavseal_fuzz::hx_decoder(input));
