//! The relay between ports that fail and lines that fall silent.
//! Properties: L1.
//!
//! Compares the relay between ports that fail with the same between ports that do not; what it signed with
//! the verdict on it.
#![no_main]

use mavseal_fuzz::ports::Faulty;

libfuzzer_sys::fuzz_target!(|input: Faulty<'_>| mavseal_fuzz::relay_ports(input));
