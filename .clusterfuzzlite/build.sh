#!/bin/bash -eu
# Builds every fuzz target with the address sanitizer, and puts it where ClusterFuzzLite looks, with its
# committed inputs and the dictionary. Run in the image of the Dockerfile beside this file.

cd "$SRC/mavseal"
# `cargo fuzz` knows no `--locked`: this fails where Cargo.lock does not fit.
cargo metadata --locked --format-version 1 --manifest-path fuzz/Cargo.toml > /dev/null
cargo fuzz build -O --debug-assertions

for target in $(cargo fuzz list); do
    cp "fuzz/target/x86_64-unknown-linux-gnu/release/$target" "$OUT/"
    cp fuzz/mavlink.dict "$OUT/$target.dict"
    zip -q -j -r "$OUT/${target}_seed_corpus.zip" "fuzz/corpus/$target"
done
