#!/usr/bin/env bash
# Runs every fuzzer for some seconds, from its committed corpus; needs a C++ compiler beside Rust.
#
#   tests/fuzz-briefly.sh [SECONDS [TARGET…]]      20 s of each, unless given
#   tests/fuzz-briefly.sh 3600 decode              an hour of one
#
# Our crates are built once more, with every branch marked; all others are those of the tests. What the search adds to a
# corpus, and an input that breaks something, is left in the folder `fuzz` of the build; such an input is named.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-20}
targets=("${@:2}")
[ "${#targets[@]}" -gt 0 ] || targets=(decode commands configuration recordings)
build="${CARGO_TARGET_DIR:-$PWD/target}"

home_of() {
    case "$1" in
        decode | commands) echo crates/supertwin-protocol ;;
        configuration) echo crates/supertwin-lab ;;
        recordings) echo crates/supertwin-rerun ;;
        *) echo "$1: is no fuzzer; there are decode, commands, configuration, recordings" >&2; return 2 ;;
    esac
}

features=() names=()
for target in "${targets[@]}"; do
    home=$(home_of "$target")
    features+=(--features "${home#crates/}/fuzz")
    names+=(--test "fuzz-$target")
done
# As the tests are built, so that their dependencies can be used; ours in between: soon built, and quick enough.
levels=()
for name in core model plant gnc lab protocol rerun; do
    levels+=(--config "profile.dev.package.supertwin-$name.opt-level=1")
done
said=$(RUSTC_WORKSPACE_WRAPPER="$PWD/tests/instrumented-rustc.sh" cargo test --quiet --workspace --no-run \
    "${levels[@]}" --message-format=json "${features[@]}" "${names[@]}")

for target in "${targets[@]}"; do
    fuzzer=$(sed -n "s/.*\"name\":\"fuzz-$target\".*\"executable\":\"\([^\"]*\)\".*/\1/p" <<<"$said")
    grown="$build/fuzz/$target" log="$build/fuzz/$target.log"
    mkdir -p "$grown"
    if ! "$fuzzer" "$grown" "$(home_of "$target")/fuzz/corpus/$target" -max_total_time="$seconds" -timeout=20 \
        -rss_limit_mb=2048 -max_len=16384 -print_final_stats=1 -artifact_prefix="$build/fuzz/$target-" \
        >"$log" 2>&1 </dev/null; then
        tail -n 40 "$log"
        echo "$target: FAILED; the input is the newest $build/fuzz/$target-*"
        exit 1
    fi
    executed=$(sed -n 's/^stat::number_of_executed_units: *//p' "$log")
    [ "$executed" -gt 0 ]
    echo "$target: $executed inputs in $seconds s, none breaks a rule"
done
