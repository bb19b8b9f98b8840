//! How a stream is cut makes no difference.
//! Properties: W3.
//!
//! Compares a stream in pieces with the stream as a whole; every byte is in a packet or counted.
#![no_main]

use mavseal_fuzz::streams::Stream;

libfuzzer_sys::fuzz_target!(|input: Stream<'_>| mavseal_fuzz::decoder_chunks(input));
