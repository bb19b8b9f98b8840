#!/bin/bash -eu
# Builds every fuzz target with the address sanitizer, and puts it where ClusterFuzzLite looks, with its
# seeds and the dictionary. Run in the image of the Dockerfile beside this file.

cd "$SRC/mavseal"
cargo fuzz build -O --debug-assertions

for source in fuzz/fuzz_targets/*.rs; do
    target=$(basename "$source" .rs)
    if [ "$target" = empty ]; then
        continue
    fi
    cp "fuzz/target/x86_64-unknown-linux-gnu/release/$target" "$OUT/"
    cp fuzz/mavlink.dict "$OUT/$target.dict"
    inputs=()
    for folder in "fuzz/seeds/$target" "fuzz/found/$target"; do
        if [ -d "$folder" ]; then
            inputs+=("$folder")
        fi
    done
    find "${inputs[@]}" -type f | zip -q -j -@ "$OUT/${target}_seed_corpus.zip"
done
