//! Fuzz targets: one plain function each, over the properties of `mavseal-proofs`.
//!
//! No check is bypassed: a target owns a key and makes checksums and tags right itself, see
//! [`repair`]. `fuzz_targets/` gives each function to libFuzzer; `tests/corpus.rs` gives it every
//! committed seed, on any stable compiler.

pub mod ends;
pub mod files;
pub mod flash;
pub mod frames;
pub mod input;
pub mod memory;
pub mod ports;
pub mod reached;
pub mod repair;
pub mod sealed;
pub mod seeds;
pub mod senders;
pub mod standard;
pub mod streams;
pub mod time;
pub mod unsigned;
pub mod values;

use arbitrary::Arbitrary;
use input::decode;

/// A fuzz target, to be run on files.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Its name: its function's, and its file's in `fuzz_targets/`.
    pub name: &'static str,
    /// Runs it on the bytes of a file, as libFuzzer does; whether they are an input of it.
    pub run: fn(&[u8]) -> bool,
}

/// Names targets, each with its function and how that comes by its input.
macro_rules! targets {
    ($($module:ident::$name:ident: $kind:ident,)*) => {
        $(pub use $module::$name;)*

        /// Every target.
        pub const TARGETS: &[Target] = &[
            $(Target { name: stringify!($name), run: |bytes| $kind(bytes, $name) },)*
        ];
    };
}

targets! {
    frames::verify_frame: bytes,
    frames::verify_repaired: input,
    frames::sign_verify: input,
    frames::tamper_one: input,
    frames::relay_packet: input,
    streams::decoder_chunks: input,
    streams::replay_model: input,
    senders::streams_model: input,
    streams::relay: input,
    ports::relay_ports: input,
    unsigned::unsigned_policy: input,
    unsigned::setup_signing: input,
    values::diff_hmac: input,
    standard::diff_standard: input,
    values::checksum_table: input,
    values::stamps: input,
    memory::store_crash: input,
    memory::key_change: input,
    time::kept_link: input,
    flash::key_slots: input,
    sealed::diff_gcm: input,
    sealed::hx_decoder: input,
    files::key_file: bytes,
    sealed::open_package: input,
    sealed::pack_packets: input,
    sealed::seal_open: input,
    sealed::sealed_link: input,
    ends::sealed_end: input,
}

fn bytes(bytes: &[u8], target: impl Fn(&[u8])) -> bool {
    target(bytes);
    true
}

fn input<'a, T: Arbitrary<'a>>(bytes: &'a [u8], target: impl Fn(&T)) -> bool {
    let input = decode(bytes);
    input.as_ref().is_some_and(|input| {
        target(input);
        true
    })
}
