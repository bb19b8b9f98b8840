//! What mavseal claims, each property once, as a plain function that asserts.
//!
//! Three callers check the same function: a Kani harness with every input there is (`cargo kani`),
//! a test with edges and random values (`cargo test`), and a fuzz target. The table of
//! `verification.md` gives each property its id, its bound and its assumptions.

pub mod checksum;
pub mod cipher;
pub mod emit;
pub mod framing;
pub mod history;
pub mod hmac;
pub mod keeper;
pub mod key_step;
pub mod keys;
pub mod link;
pub mod mark;
pub mod model;
pub mod opening;
pub mod packet;
pub mod packing;
pub mod parse;
pub mod pipes;
pub mod relay;
pub mod replay;
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

/// One harness for each payload length, with a bound on its loops: what is copied has then a length
/// that the solver knows, or nearly.
#[cfg(kani)]
macro_rules! for_payload_lengths {
    ($check:ident: $($name:ident $length:literal unwind $unwind:literal,)*) => {
        $(
            #[kani::proof]
            #[kani::unwind($unwind)]
            #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
            fn $name() {
                $check::<$length>();
            }
        )*
    };
}
#[cfg(kani)]
pub(crate) use for_payload_lengths;
