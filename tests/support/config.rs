//! Shipped configuration files: as tables that a test may change, and as what they hold.
#![allow(dead_code, unreachable_pub, reason = "each program of tests uses its part")]

use serde::de::DeserializeOwned;

/// A file under `config/`.
pub fn file(path: &str) -> toml::Table {
    let path = format!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/{}.toml"), path);
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    text.parse().unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// What a table, or a value in it, holds.
pub fn read<T: DeserializeOwned>(value: impl Into<toml::Value>) -> T {
    value.into().try_into().unwrap_or_else(|error| panic!("no legal configuration: {error}"))
}

/// Sets `a.b.c` of a table.
pub fn put(table: &mut toml::Table, path: &str, value: impl Into<toml::Value>) {
    let mut parts: Vec<&str> = path.split('.').collect();
    let last = parts.pop().expect("a path has a last part");
    let below = |place, part| toml::Table::get_mut(place, part).and_then(toml::Value::as_table_mut);
    let place = parts.into_iter().try_fold(table, below).unwrap_or_else(|| panic!("no table on the way of {path}"));
    place.insert(last.to_owned(), value.into());
}
