//! `supertwin export`: a recording for other programs.

use crate::failure::Failure;
use crate::output;
use clap::Args;
use glob::{MatchOptions, Pattern};
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use supertwin_rerun::{Format, ReadError, Recording, read_selected};

/// Arguments of `export`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin export run.rrd --parquet             run.parquet: a column per component, a row per tick
  supertwin export run.rrd --csv --signals 'tracking/*' --signals controller/sigma
  supertwin export run.rrd --mcap --out /tmp/run.mcap        a channel per signal, events as foxglove.Log

Columns are named path:component, beside tick and sim_time_s; empty where a signal has no row. Labels keep their value
until the next one. Every number reads back as the same bits.
Exit status: 0 written, 2 the call is wrong or a file can't be used.")]
#[command(group = clap::ArgGroup::new("format").required(true).args(["parquet", "csv", "mcap"]))]
pub(crate) struct ExportArguments {
    /// Recording; parts beside it (FILE.part2.rrd, ...) belong to it
    #[arg(value_name = "FILE")]
    file: PathBuf,

    /// For data frames
    #[arg(long)]
    parquet: bool,

    /// For spreadsheets
    #[arg(long)]
    csv: bool,

    /// For Foxglove
    #[arg(long)]
    mcap: bool,

    /// Which signals and labels, e.g. 'controller/**'; * is one part, ** any number; may be repeated [default: all]
    #[arg(long, value_name = "PATTERN", num_args = 1..)]
    signals: Vec<glob::Pattern>,

    /// The written file [default: FILE with another extension]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,

    /// Replace a file that exists
    #[arg(long)]
    force: bool,

    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// `*` is one part of a path, as in the keys of the network.
const OPTIONS: MatchOptions =
    MatchOptions { case_sensitive: true, require_literal_separator: true, require_literal_leading_dot: false };

/// Does it.
pub(crate) fn export(arguments: &ExportArguments) -> Result<ExitCode, Failure> {
    let format = match (arguments.parquet, arguments.csv) {
        (true, _) => Format::Parquet,
        (_, true) => Format::Csv,
        _ => Format::Mcap,
    };
    let patterns = &arguments.signals;
    let wanted = |path: &str| {
        let event = path.starts_with("event/");
        let drawn = path == "world" || path.starts_with("world/");
        event || !drawn && (patterns.is_empty() || patterns.iter().any(|pattern| fits(pattern, path)))
    };
    let call = |error: ReadError| Failure::Call(error.to_string());
    let recording = read_selected(&arguments.file, &wanted).map_err(call)?;
    let idle = patterns.iter().find(|pattern| !paths(&recording).any(|path| fits(pattern, path)));
    if let Some(pattern) = idle {
        let all = read_selected(&arguments.file, &|_| true).map_err(call)?;
        let known: Vec<&str> = paths(&all).collect();
        let file = arguments.file.display();
        return Err(Failure::Call(format!(
            "{file}: --signals {pattern}: nothing recorded fits; there are {}",
            known.join(", ")
        )));
    }
    for damage in &recording.damage {
        output::warn(&format!("warning: {damage}"));
    }
    let out = arguments.out.clone().unwrap_or_else(|| arguments.file.with_extension(format.extension()));
    let done = supertwin_rerun::export(&recording, format, &out, arguments.force)
        .map_err(|error| Failure::Call(error.to_string()))?;
    let (rows, columns) = (done.rows, done.columns);
    if arguments.json {
        let report = json!({
            "file": arguments.file, "out": out, "format": format.extension(), "rows": rows, "columns": columns,
            "complete": recording.complete,
        });
        output::print(&format!("{report:#}"));
    } else if format == Format::Mcap {
        output::print(&format!("{}: {rows} messages on {columns} channels.", out.display()));
    } else {
        output::print(&format!("{}: {rows} ticks, {columns} columns.", out.display()));
    }
    Ok(ExitCode::SUCCESS)
}

/// Signals and labels that have any rows.
fn paths(recording: &Recording) -> impl Iterator<Item = &str> {
    let signals = recording.signals.iter().filter(|(_, columns)| !columns.tick.is_empty()).map(|(path, _)| path);
    signals.chain(recording.labels.keys()).map(String::as_str)
}

fn fits(pattern: &Pattern, path: &str) -> bool {
    pattern.matches_with(path, OPTIONS)
}
