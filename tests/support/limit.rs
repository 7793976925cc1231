//! The memory of a fuzzer: whoever asks for half a gigabyte because of some kilobytes is a finding.

use cap::Cap;
use std::alloc::System;

#[global_allocator]
static MEMORY: Cap<System> = Cap::new(System, 512 << 20);
