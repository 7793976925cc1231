//! Feeds `decode` from libFuzzer; see tests/fuzz-briefly.sh.
#![no_main]
#![allow(unsafe_code, reason = "libFuzzer calls C functions")]

#[path = "../decode.rs"]
mod decode;
#[path = "../../../../tests/support/limit.rs"]
mod limit;

use supertwin_protocol::envelope;

libfuzzer_sys::fuzz_target!(|payload: &[u8]| decode::check(payload));
