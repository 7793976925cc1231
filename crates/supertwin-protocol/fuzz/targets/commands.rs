//! Feeds `commands` from libFuzzer; see tests/fuzz-briefly.sh.
#![no_main]
#![allow(unsafe_code, reason = "libFuzzer calls C functions")]

#[path = "../commands.rs"]
mod commands;
#[path = "../../../../tests/support/limit.rs"]
mod limit;

use supertwin_protocol::{command_queue, keys, lease};

libfuzzer_sys::fuzz_target!(|payload: &[u8]| commands::check(payload));
