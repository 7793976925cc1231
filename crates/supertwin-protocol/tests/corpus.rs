//! What the fuzzers check holds for their corpora: `fuzz/` searches further.
#![allow(unreachable_pub, reason = "shared with other tests")]

#[path = "../fuzz/commands.rs"]
mod commands;
#[path = "../../../tests/support/corpus.rs"]
mod corpus;
#[path = "../fuzz/decode.rs"]
mod decode;

use supertwin_protocol::{command_queue, envelope, keys, lease};

const HERE: &str = env!("CARGO_MANIFEST_DIR");

#[test]
fn wire_messages_come_back_bit_for_bit_or_not_at_all() {
    corpus::assert_for_corpus(HERE, "decode", 10, 300, decode::check);
}

#[test]
fn requests_in_any_order_keep_the_rules_of_authority() {
    corpus::assert_for_corpus(HERE, "commands", 5, 300, commands::check);
}
