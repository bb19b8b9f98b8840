//! The standard's signature is the one of the crate `mavlink`.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::standard::Foreign<'_>| {
    mavseal_fuzz::diff_standard(&input)
});
