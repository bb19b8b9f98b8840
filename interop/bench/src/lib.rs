//! What is measured: signing and verifying the same messages, here, by peers, and the floor.

pub mod checksums;
pub mod floor;
pub mod here;
pub mod messages;
pub mod pass;
pub mod peers;
