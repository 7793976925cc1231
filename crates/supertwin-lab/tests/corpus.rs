//! What the fuzzer checks holds for its corpus and all shipped files: `fuzz/` searches further.
#![allow(unreachable_pub, reason = "shared with other tests")]

#[path = "../fuzz/configuration.rs"]
mod configuration;
#[path = "../../../tests/support/corpus.rs"]
mod corpus;

const HERE: &str = env!("CARGO_MANIFEST_DIR");

#[test]
fn configurations_are_refused_in_words_or_step() {
    corpus::replay(HERE, "configuration", 5, 60, configuration::check);
}
