//! Fuzz targets: one plain function each, over the properties of `mavseal-proofs`.
//!
//! No check is bypassed: a target owns a key and makes checksums and tags right itself, see
//! [`repair`]. `fuzz_targets/` gives each function to libFuzzer; `tests/corpus.rs` gives it every
//! committed input, on any stable compiler.

pub mod devices;
pub mod ends;
pub mod files;
pub mod flash;
pub mod frames;
pub mod input;
pub mod memory;
pub mod ports;
pub mod repair;
pub mod sealed;
pub mod senders;
pub mod standard;
pub mod streams;
pub mod time;
pub mod unsigned;
pub mod values;

use arbitrary::{Arbitrary, Unstructured};

/// Names targets, each with its module.
macro_rules! targets {
    ($($module:ident: $($name:ident)*;)*) => {
        $($(pub use $module::$name;)*)*

        /// Every target: its name, and how it is run on the bytes of a file; whether they are an input of it.
        pub const TARGETS: &[(&str, fn(&[u8]) -> bool)] = &[
            $($((stringify!($name), |bytes| input(bytes, $name)),)*)*
        ];
    };
}

targets! {
    devices: adversary;
    ends: sealed_end;
    files: key_file;
    flash: key_slots;
    frames: relay_packet sign_verify tamper_one verify_frame verify_repaired;
    memory: key_change store_crash;
    ports: relay_ports;
    sealed: diff_gcm hx_decoder open_package pack_packets seal_open sealed_link;
    senders: streams_model;
    standard: diff_standard;
    streams: decoder_chunks relay replay_model trusted_line;
    time: kept_link;
    unsigned: setup_signing unsigned_policy;
    values: checksum_table diff_hmac stamps;
}

/// As `libfuzzer_sys::fuzz_target`.
fn input<'a, T: Arbitrary<'a>>(bytes: &'a [u8], target: fn(T)) -> bool {
    let long_enough = bytes.len() >= T::size_hint(0).0;
    let input = T::arbitrary_take_rest(Unstructured::new(bytes)).ok();
    input.filter(|_| long_enough).map(target).is_some()
}
