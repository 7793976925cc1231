//! `supertwin export`: a recording for other programs.

use crate::terminal;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use supertwin_operations::{OperationError, export};
use supertwin_rerun::Format;

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

/// Writes the recording in the format that was asked for.
pub(crate) fn export(arguments: &ExportArguments) -> Result<ExitCode, OperationError> {
    let format = match (arguments.parquet, arguments.csv) {
        (true, _) => Format::Parquet,
        (_, true) => Format::Csv,
        _ => Format::Mcap,
    };
    let out = arguments.out.clone().unwrap_or_else(|| arguments.file.with_extension(format.extension()));
    let written = export::export(&arguments.file, &arguments.signals, format, &out, arguments.force)?;
    for damage in &written.damage {
        terminal::warn(&format!("warning: {damage}"));
    }
    let (rows, columns) = (written.exported.rows, written.exported.columns);
    if arguments.json {
        let report = json!({
            "file": arguments.file, "out": out, "format": format.extension(), "rows": rows, "columns": columns,
            "complete": written.complete,
        });
        terminal::print(&format!("{report:#}"));
    } else if format == Format::Mcap {
        terminal::print(&format!("{}: {rows} messages on {columns} channels.", out.display()));
    } else {
        terminal::print(&format!("{}: {rows} ticks, {columns} columns.", out.display()));
    }
    Ok(ExitCode::SUCCESS)
}
