//! Packets go into messages and come out again whole.
//! Properties: P1.
//!
//! Compares packets that went through messages with themselves; any message with what is neither packet nor
//! zero.
#![no_main]

use mavseal_fuzz::sealed::Packets;

libfuzzer_sys::fuzz_target!(|input: Packets| mavseal_fuzz::pack_packets(input));
