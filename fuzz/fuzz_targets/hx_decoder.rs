//! Any bytes on a line are taken, and a frame behind them comes out.
#![no_main]

libfuzzer_sys::fuzz_target!(
    |input: mavseal_fuzz::sealed::Line<'_>| mavseal_fuzz::hx_decoder(&input)
);
