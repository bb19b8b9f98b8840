//! Commsec against what is known of it: reference packages, an acceptance trace, conformance strings.

mod common;
mod epochs;
mod errors;
mod framing;
mod opening;
mod packing;
mod radio;
mod sealing;
mod vectors;
mod window;
