#!/bin/sh
# Let libFuzzer damage programs and setpoints of the C corrector: usage fuzz_c.sh [MINUTES]. Needs clang with its runtime.
set -eu
folder=build/fuzz-c
mkdir -p "$folder"
.venv/bin/python -m tests.core.correct.fuzz_seeds "$folder/inputs"
clang -std=c99 -Wall -Wextra -g -O1 -fsanitize=fuzzer,address,undefined,float-cast-overflow -fno-sanitize-recover=all \
    -Iclients/c -o "$folder/fuzz" tests/core/correct/fuzz.c clients/c/kilter_corrector.c -lm
"$folder/fuzz" -max_total_time=$((60 * ${1:-30})) -timeout=30 -max_len=20000 -artifact_prefix="$folder/" "$folder/inputs"
