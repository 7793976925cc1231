//! What the fuzzer checks holds for its corpus and all shipped files: `fuzz/` searches further.
#![allow(unreachable_pub, reason = "shared with other tests")]

#[path = "../fuzz/configuration.rs"]
mod configuration;
#[path = "../../../tests/support/corpus.rs"]
mod support;

const HERE: &str = env!("CARGO_MANIFEST_DIR");

#[test]
fn configurations_are_refused_in_words_or_step() {
    support::assert_for_corpus(HERE, "configuration", 5, 60, configuration::check);
}
