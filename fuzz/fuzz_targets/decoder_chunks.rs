//! How a stream is cut makes no difference.
#![no_main]

libfuzzer_sys::fuzz_target!(|input: mavseal_fuzz::streams::Stream<'_>| {
    mavseal_fuzz::decoder_chunks(&input)
});
