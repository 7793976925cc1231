//! `supertwin check`: what a configuration file says, as it was understood.

use crate::terminal;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use supertwin_core::unit;
use supertwin_lab::Library;
use supertwin_operations::OperationError;
use supertwin_operations::configuration::{all, understand};
use toml::{Table, Value};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin check                                every file of the configuration folder
  supertwin check config/trials/fair.toml        one trial with all its files
  supertwin check config/vehicles/argus-mini.toml --json

Exit status: 0 all legal, 2 something is not.")]
pub(crate) struct CheckArguments {
    /// Configuration files; the folder a file is in says what it is [default: all]
    #[arg(value_name = "FILE")]
    files: Vec<PathBuf>,

    /// Print one JSON object instead of lines
    #[arg(long)]
    json: bool,
}

/// Validates the files and prints what was understood.
pub(crate) fn check(arguments: &CheckArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let files = if arguments.files.is_empty() { all(library) } else { arguments.files.clone() };
    if files.is_empty() {
        let cause = "no configuration files there; name them, or the folder with --config";
        return Err(OperationError::at(&library.root, &cause));
    }
    let mut understood = serde_json::Map::new();
    let mut wrong = 0;
    for file in &files {
        match understand(file, library) {
            Ok(table) if arguments.json => {
                understood.insert(file.display().to_string(), json!(table));
            }
            Ok(table) => {
                let said = if arguments.files.is_empty() { summary(&table) } else { lines(&table) };
                let gap = if arguments.files.is_empty() { ": " } else { "\n" };
                terminal::print(&format!("{}{gap}{said}", file.display()));
            }
            Err(error) => {
                wrong += 1;
                terminal::warn(&format!("error: {error}"));
            }
        }
    }
    if arguments.json {
        terminal::print(&format!("{:#}", serde_json::Value::Object(understood)));
    }
    Ok(if wrong == 0 { ExitCode::SUCCESS } else { ExitCode::from(2) })
}

fn summary(table: &Table) -> String {
    let description = table
        .get("description")
        .or_else(|| table.get("trial").and_then(|trial| trial.get("description")))
        .and_then(Value::as_str)
        .unwrap_or_default();
    description.split_whitespace().take(14).collect::<Vec<_>>().join(" ") + " …"
}

/// One value per line, with its unit.
fn lines(table: &Table) -> String {
    let mut rows = Vec::new();
    flatten("", &Value::Table(table.clone()), &mut rows);
    let width = rows.iter().map(|(path, _)| path.chars().count()).max().unwrap_or(0);
    rows.iter().map(|(path, value)| format!("  {path:width$}  {value}\n")).collect()
}

fn flatten(path: &str, value: &Value, rows: &mut Vec<(String, String)>) {
    let join = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match value {
        Value::Table(table) => table.iter().for_each(|(key, value)| flatten(&join(key), value, rows)),
        Value::Array(array) if array.iter().any(|item| item.is_table() || item.is_array()) => {
            array.iter().enumerate().for_each(|(i, value)| flatten(&join(&i.to_string()), value, rows));
        }
        Value::String(text) => rows.push((path.to_owned(), text.trim().replace('\n', " "))),
        other => rows.push((
            path.to_owned(),
            format!("{other} {}", unit::of_place(path).unwrap_or_default()).trim_end().to_owned(),
        )),
    }
}
