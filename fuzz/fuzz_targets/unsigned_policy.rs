//! Unsigned frames are let through as a policy says, which is asked about nothing else.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::unsigned::Asked<'_>| {
    mavseal_fuzz::unsigned_policy(&input)
});
