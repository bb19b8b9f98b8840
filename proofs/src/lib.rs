//! What mavseal claims, each property once, as a plain function that asserts.
//!
//! Three callers check the same function: a Kani harness with every input there is (`cargo kani`),
//! a test with edges and random values (`cargo test`), and a fuzz target. The table of
//! `verification.md` gives each property its id, its bound and its assumptions.

pub mod checksum;
pub mod model;
pub mod parse;
pub mod replay;
pub mod verify;
