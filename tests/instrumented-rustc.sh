#!/bin/sh
# A compiler that marks every branch for libFuzzer; for RUSTC_WORKSPACE_WRAPPER, so that dependencies stay as they are.
exec "$@" --cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
    -Cllvm-args=-sanitizer-coverage-trace-compares
