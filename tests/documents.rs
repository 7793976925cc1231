//! The documents: what they show happens, what they list is so, and their links lead somewhere.
#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use crate::support::page::{BOOK, check, head, row};
use crate::support::{Place, assert_says, console};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

const TOP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// Every Markdown file of the repository's own, from the top level.
fn pages() -> Vec<PathBuf> {
    let named = ["README.md", "ARCHITECTURE.md", "CHANGELOG.md", "config/zenoh/access.md"];
    let named = named.map(|name| Path::new(TOP).join(name)).into_iter();
    named.chain(glob::glob(&format!("{BOOK}/**/*.md")).unwrap().map(Result::unwrap)).collect()
}

/// Lines outside of code.
fn prose(text: &str) -> String {
    let mut code = false;
    let mut lines = Vec::new();
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            code = !code;
        } else if !code {
            lines.push(line);
        }
    }
    assert!(!code, "a block of code has no end");
    lines.join("\n")
}

/// The anchors of the headings, as GitHub and mdBook make them.
fn anchors(text: &str) -> BTreeSet<String> {
    let prose = prose(text);
    let headings = prose.lines().filter(|line| line.starts_with('#'));
    let titles = headings.filter_map(|line| line.trim_start_matches('#').strip_prefix(' '));
    let kept = |c: &char| c.is_alphanumeric() || matches!(c, '-' | '_' | ' ');
    let anchor = |title: &str| title.chars().filter(kept).collect::<String>().to_lowercase().replace(' ', "-");
    titles.map(anchor).collect()
}

/// Where the links of a page lead.
fn links(text: &str) -> Vec<String> {
    let prose = prose(text);
    let ends = prose.split("](").skip(1).filter_map(|rest| rest.split_once(')'));
    ends.map(|(link, _)| link.to_owned()).collect()
}

#[test]
fn every_link_leads_somewhere() {
    let mut followed = 0;
    for page in pages() {
        let text = fs::read_to_string(&page).unwrap();
        for link in links(&text).iter().filter(|link| !link.contains("://")) {
            let (file, anchor) =
                link.split_once('#').map_or((link.as_str(), None), |(file, anchor)| (file, Some(anchor)));
            let target = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            assert!(target.exists(), "{}: {link} leads nowhere", page.display());
            if let Some(anchor) = anchor {
                let there = anchors(&fs::read_to_string(&target).unwrap());
                assert!(there.contains(anchor), "{}: no heading for {link}; there are {there:?}", page.display());
            }
            followed += 1;
        }
    }
    assert!(followed > 40, "only {followed} links were found");
}

#[test]
fn every_page_of_the_book_is_in_its_summary() {
    let summary = fs::read_to_string(Path::new(BOOK).join("SUMMARY.md")).unwrap();
    let listed: BTreeSet<PathBuf> = links(&summary).iter().map(|link| Path::new(BOOK).join(link)).collect();
    let there = pages().into_iter().filter(|page| page.starts_with(BOOK) && !page.ends_with("SUMMARY.md"));
    assert_eq!(listed, there.collect::<BTreeSet<PathBuf>>());
}

#[test]
fn the_readme_fits_on_three_screens_and_the_map_on_a_table() {
    let length = |name: &str| fs::read_to_string(Path::new(TOP).join(name)).unwrap();
    assert!(length("README.md").lines().count() <= 150);
    assert!(length("ARCHITECTURE.md").len() <= 15_000);
}

#[test]
fn the_law_of_the_tutorial_is_the_one_that_tests_add() {
    let page = fs::read_to_string(Path::new(BOOK).join("tutorials/your-own-law.md")).unwrap();
    let law = fs::read_to_string(Path::new(TOP).join("crates/supertwin-gnc/src/control/boundary_layer.rs")).unwrap();
    assert!(page.contains(&format!("```rust\n{law}```")), "the tutorial shows another law");
}

/// What a verb says of itself, and each of its own verbs after it.
fn help(place: &Place, verbs: &[&str], text: &mut String) {
    let mut command = place.command(env!("CARGO_BIN_EXE_supertwin"));
    let output = command.env("COLUMNS", "100").args(verbs).arg("--help").output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    let title = [&["supertwin"][..], verbs].concat().join(" ");
    let _ = write!(text, "\n{} {title}\n\n```text\n{}\n```\n", "#".repeat(1 + verbs.len().max(1)), said.trim_end());
    let (_, listed) = said.split_once("\nCommands:\n").unwrap_or_default();
    if listed.is_empty() {
        assert_says(&said, &["Examples:", "Exit status", "--json"]);
    }
    // A line that is indented further goes on with the verb above it.
    let lines = listed.lines().take_while(|line| !line.is_empty()).filter(|line| !line.starts_with("   "));
    for name in lines.filter_map(|line| line.split_whitespace().next()).filter(|name| *name != "help") {
        help(place, &[verbs, &[name][..]].concat(), text);
    }
}

#[test]
fn the_reference_of_the_command_line_is_what_the_program_says() {
    let mut text = "# Command line\n\n\
        Every verb that prints a result also has `--json`. Exit status: 0 done, 1 the verdict is no, 2 the call or its input\n\
        is wrong, 130 interrupted.\n"
        .to_owned();
    help(&Place::new(), &[], &mut text);
    assert!(text.matches("\n## supertwin ").count() > 15, "the verbs were not found");
    check("command-line.md", &text);
}

#[test]
fn the_reference_of_keys_is_what_the_program_says() {
    let place = Place::new();
    let mut text = "# Keys and messages\n\n\
        Keys are below `supertwin/<vehicle>/`; `*` stands for one word, `**` for several. Payloads are JSON.\n\
        `supertwin schema NAME` prints the JSON Schema of a message: its fields with units and meaning.\n\
        What they are for is told in [The ring over a network](../concepts/network.md).\n\n"
        .to_owned();
    text += &head(&["message", "key", "what it is"]);
    let listed: Value = place.call(&["schema", "--json"]).well().json();
    for one in listed.as_array().unwrap() {
        let word = |name: &str| one[name].as_str().unwrap().to_owned();
        text += &row(&[&format!("`{}`", word("name")), &format!("`{}`", word("key")), &word("about")]);
    }
    assert!(text.lines().count() > 20, "the messages were not listed");
    let matrix = fs::read_to_string(Path::new(TOP).join("config/zenoh/access.md")).unwrap();
    text += &matrix.replacen("# ", "\n## ", 1);
    check("keys.md", &text);
}

/// Types the commands of pages, each page in a fresh folder with the shipped configuration. Their services find each other
/// in a network of their own.
fn assert_go_as_told(pages: &[&str]) {
    for page in pages {
        assert!(console::follow(page) > 0, "{page} shows no answers");
    }
}

#[test]
fn the_tutorials_go_as_told() {
    assert_go_as_told(&["tutorials/first-dive.md", "tutorials/compare-two-laws.md", "tutorials/your-own-vehicle.md"]);
}

#[test]
fn a_network_is_used_as_told() {
    assert_go_as_told(&["tutorials/network.md"]);
}

#[test]
fn campaigns_and_replays_go_as_told() {
    assert_go_as_told(&["how-to/campaigns.md", "how-to/replay.md"]);
}
