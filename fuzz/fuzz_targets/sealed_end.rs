//! An end of a sealed link uses no counter and opens no package twice, wherever its power fails.
//! Properties: O1, N1, P1.
//!
//! Compares one end of a sealed link, over restarts, with ports and flashes that fail: what leaves it and
//! what it counts with what came in and was sealed.
#![no_main]

use mavseal_fuzz::ends::Ends;

libfuzzer_sys::fuzz_target!(|input: Ends<'_>| mavseal_fuzz::sealed_end(input));
