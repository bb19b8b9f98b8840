//! An end of a link uses nothing twice, and believes nobody more than it may, over restarts.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::time::End| mavseal_fuzz::kept_link(&input));
