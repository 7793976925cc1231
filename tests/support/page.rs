//! A page of the reference: written anew when that is asked for, else compared with what stands there.
#![allow(unreachable_pub, dead_code, reason = "two programs of tests use their part")]

use std::path::Path;

/// Where the book's pages stand.
pub const BOOK: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/src");

/// What a generated page begins with.
const GENERATED: &str = "<!-- Generated: SUPERTWIN_WRITE_DOCS=1 cargo test the_reference -->\n\n";

/// Checks a generated page, or writes it with `SUPERTWIN_WRITE_DOCS=1`.
pub fn check(name: &str, text: &str) {
    let path = Path::new(BOOK).join("reference").join(name);
    let text = format!("{GENERATED}{}\n", text.trim_end());
    if std::env::var_os("SUPERTWIN_WRITE_DOCS").is_some() {
        std::fs::write(&path, &text).expect("is written");
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    let mut lines = found.lines().zip(text.lines());
    let differs = lines.position(|(found, wanted)| found != wanted).map_or(0, |line| line + 1);
    assert!(
        found == text,
        "{} is stale (line {differs}): SUPERTWIN_WRITE_DOCS=1 cargo test the_reference",
        path.display()
    );
}

/// A row of a Markdown table.
pub fn row(cells: &[&str]) -> String {
    let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|").replace('\n', " ")).collect();
    format!("| {} |\n", cells.join(" | "))
}

/// The head of a Markdown table.
pub fn head(titles: &[&str]) -> String {
    format!("{}{}", row(titles), row(&vec!["---"; titles.len()]))
}
