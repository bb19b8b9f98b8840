//! The relay between ports that fail and lines that fall silent.
#![no_main]

libfuzzer_sys::fuzz_target!(
    |input: mavseal_fuzz::ports::Faulty<'_>| mavseal_fuzz::relay_ports(&input)
);
