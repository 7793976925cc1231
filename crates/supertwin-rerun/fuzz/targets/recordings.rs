//! Feeds `recordings` from libFuzzer; see tests/fuzz-briefly.sh.
#![no_main]
#![allow(unsafe_code, reason = "libFuzzer calls C functions")]

#[path = "../../../../tests/support/limit.rs"]
mod limit;
#[path = "../recordings.rs"]
mod recordings;

use supertwin_rerun::{read, repair};

libfuzzer_sys::fuzz_target!(|payload: &[u8]| recordings::check(payload));
