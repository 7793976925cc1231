//! Feeds `configuration` from libFuzzer; see tests/fuzz-briefly.sh.
#![no_main]
#![allow(unsafe_code, reason = "libFuzzer calls C functions")]

#[path = "../configuration.rs"]
mod configuration;
#[path = "../../../../tests/support/limit.rs"]
mod limit;

libfuzzer_sys::fuzz_target!(|payload: &[u8]| configuration::check(payload));
