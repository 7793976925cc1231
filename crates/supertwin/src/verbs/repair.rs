//! `supertwin repair`: a damaged recording whole again, and what was lost.

use crate::terminal;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use supertwin_operations::OperationError;
use supertwin_rerun::repair::{self, RepairError};
use supertwin_rerun::{ReadError, Repair};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin repair run.rrd                       leaves run.repaired.rrd beside it, if there is something to repair
  supertwin repair run.rrd --out whole.rrd
  supertwin repair run.rrd --out run.rrd --force in its place

Everything that can be read is kept, also behind a damage. The result is read back before it gets its name.
Exit status: 0 repaired, or whole already, 1 nothing could be saved, 2 the call is wrong or the file can't be used.")]
pub(crate) struct RepairArguments {
    /// Recording, or one part of it
    #[arg(value_name = "FILE")]
    file: PathBuf,

    /// The repaired file [default: FILE with .repaired.rrd]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,

    /// Replace a file that exists
    #[arg(long)]
    force: bool,

    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

pub(crate) fn repair(arguments: &RepairArguments) -> Result<ExitCode, OperationError> {
    let out = arguments.out.clone().unwrap_or_else(|| arguments.file.with_extension("repaired.rrd"));
    let done = repair::repair(&arguments.file, &out, arguments.force).map_err(|error| match error {
        RepairError::Nothing { .. } | RepairError::Read(ReadError::Empty { .. }) => {
            OperationError::Unmet(error.to_string())
        }
        _ => OperationError::Option(error.to_string()),
    })?;
    let written = (!done.was_whole()).then_some(&out);
    if arguments.json {
        let report = json!({
            "file": arguments.file,
            "out": written,
            "whole": done.was_whole(),
            "bytes": done.bytes,
            "lost_bytes": done.lost_bytes,
            "rows": done.rows,
            "last_tick": done.last_tick,
            "signals_that_end_before": done.behind,
            "lost_ticks": done.lost_ticks,
            "damage": done.damage.iter().map(ToString::to_string).collect::<Vec<_>>(),
        });
        terminal::print(&format!("{report:#}"));
        return Ok(ExitCode::SUCCESS);
    }
    let Some(written) = written else {
        terminal::print(&format!("{}: whole; nothing to repair.", arguments.file.display()));
        return Ok(ExitCode::SUCCESS);
    };
    for damage in &done.damage {
        terminal::print(&damage.to_string());
    }
    terminal::print(&format!("{}: {}", written.display(), summary(&done)));
    Ok(ExitCode::SUCCESS)
}

fn summary(done: &Repair) -> String {
    let mut last = done.last_tick.map_or_else(|| "no tick".to_owned(), |tick| format!("the last of tick {tick}"));
    if done.behind > 0 {
        last += &format!(" ({} signals end before it)", done.behind);
    }
    let lost = match done.lost_ticks {
        None => "how many ticks should follow is not known",
        Some(0) => "no tick should follow",
        Some(ticks) if done.ended => &format!("{ticks} ticks of the run are missing after it"),
        Some(ticks) => &format!("{ticks} ticks are missing to the planned end of the run, or never happened"),
    };
    let share = 100.0 * done.lost_bytes as f64 / done.bytes.max(1) as f64;
    format!("{} rows saved, {last}; {lost}; {} bytes ({share:.2} %) could not be read.", done.rows, done.lost_bytes)
}
