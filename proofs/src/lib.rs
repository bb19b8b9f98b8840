//! What mavseal claims, each property once, as a plain function that asserts.
//!
//! Three callers check the same function. A Kani harness has every input within its bound (`cargo
//! kani`), a test edges and random values (`cargo test`). The third is a fuzz target. The table of
//! `verification.md` gives each property its id, its bound and its assumptions.

pub mod adversary;
pub mod checksum;
pub mod cipher;
pub mod emit;
#[cfg(test)]
mod explore;
pub mod framing;
pub mod history;
pub mod hmac;
pub mod keeper;
pub mod key_memory;
pub mod key_step;
pub mod keys;
pub mod leap;
pub mod link;
pub mod mark;
pub mod model;
pub mod opening;
pub mod packet;
pub mod packing;
pub mod parse;
pub mod payload;
pub mod pipes;
pub mod presence;
pub mod relay;
pub mod replay;
pub mod sealed_end;
pub mod sealing;
pub mod setup;
pub mod sign;
pub mod stamp;
pub mod streams;
pub mod table;
pub mod tamper;
pub mod unforgeable;
pub mod unsigned;
pub mod verify;
mod wire;
