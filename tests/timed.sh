#!/bin/sh
# Runs a program for cargo; one of tests says how long each of them took. The harness can do so, but to users of stable
# Rust it does not.
case $1 in */deps/*) set -- "$@" -Zunstable-options --report-time ;; esac
RUSTC_BOOTSTRAP=1 exec "$@"
