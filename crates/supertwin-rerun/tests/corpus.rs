//! What the fuzzer checks holds for its corpus: `fuzz/` searches further.
#![allow(unreachable_pub, reason = "shared with other tests")]

#[path = "../fuzz/recordings.rs"]
mod recordings;
#[path = "../../../tests/support/corpus.rs"]
pub(crate) mod support;

use supertwin_rerun::{read, repair};

#[test]
fn recordings_are_read_as_far_as_they_go() {
    support::assert_for_corpus(env!("CARGO_MANIFEST_DIR"), "recordings", 3, 40, recordings::check);
}
