//! An end of a link uses nothing twice, and believes nobody more than it may, over restarts.
//! Properties: T1, T2, R3, D3.
//!
//! Compares an end of a link over its restarts and changes of key: what it stamps and accepts with all before
//! under the same key; its clock with who may move it.
#![no_main]

use mavseal_fuzz::time::End;

libfuzzer_sys::fuzz_target!(|input: End| mavseal_fuzz::kept_link(input));
