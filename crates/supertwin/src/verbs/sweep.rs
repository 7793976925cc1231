//! `supertwin sweep`: a campaign of seeded runs over parameters, into one table and a report.

use crate::terminal::{self, Bar, INTERRUPTED, count};
use clap::{Args, ValueEnum};
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use supertwin_lab::Library;
use supertwin_lab::sweep::KeepRecordings;
use supertwin_operations::OperationError;
use supertwin_operations::sweep::{self, Shard, SweepOptions, Swept};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin sweep fair                           five controllers on equal terms: table and report in runs/sweeps/fair
  supertwin sweep monte-carlo --recordings on-fail
  supertwin sweep my-sweep.toml --out /data/mine --set trial.duration_s=60
  supertwin sweep fair --shard 1/8 --out part    one of eight machines; the others do 2/8 to 8/8
  supertwin sweep fair --gather part*            their tables into one, with the report

The same call goes on where a sweep was ended by Ctrl-C, kill -9 or a power cut; finished runs are not repeated.
Part K of N has the runs whose number leaves K - 1 when divided by N; all parts may share a folder.

Exit status: 0 done, 1 done and a run is invalid or breaks a limit, 2 the call or its input is wrong, 130 interrupted.")]
pub(crate) struct SweepArguments {
    /// Name in config/sweeps, or path to a sweep file
    #[arg(value_name = "SPEC")]
    spec: String,

    /// Folder for table, report and recordings [default: runs/sweeps/NAME]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// Only part K of N, for N machines
    #[arg(long, value_name = "K/N", conflicts_with = "gather")]
    shard: Option<Shard>,

    /// Runs at the same time [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,

    /// Which recordings are kept [default: what the file says, else none]
    #[arg(long, value_enum)]
    recordings: Option<KeepRecordingsArgument>,

    /// Join the tables of all parts; folders or files
    #[arg(long, value_name = "PART", num_args = 1..)]
    gather: Vec<PathBuf>,

    /// Forget what is there and begin anew
    #[arg(long)]
    force: bool,

    /// Print one JSON object instead of lines
    #[arg(long)]
    json: bool,
}

/// Which recordings are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum KeepRecordingsArgument {
    /// Those of all runs
    All,
    /// Those of runs that break a limit or are invalid
    OnFail,
    /// Those of no run
    None,
}

impl From<KeepRecordingsArgument> for KeepRecordings {
    fn from(keep: KeepRecordingsArgument) -> Self {
        match keep {
            KeepRecordingsArgument::All => Self::All,
            KeepRecordingsArgument::OnFail => Self::OnFail,
            KeepRecordingsArgument::None => Self::None,
        }
    }
}

/// Does the runs, or joins the tables of parts, and says what there is now.
pub(crate) fn sweep(arguments: &SweepArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let options = SweepOptions {
        spec: arguments.spec.clone(),
        folder: arguments.out.clone(),
        shard: arguments.shard.unwrap_or(Shard::WHOLE),
        jobs: usize::from(arguments.jobs.unwrap_or(0)),
        recordings: arguments.recordings.map(KeepRecordings::from),
        force: arguments.force,
    };
    if !arguments.gather.is_empty() {
        return Ok(print_outcome(&sweep::gather(&options, &arguments.gather, library)?, arguments.json));
    }
    let stop = terminal::stop_flag(|| {})?;
    let swept = sweep::sweep(&options, library, &stop, &Bar::new(arguments.json))?;
    if let Some((journal, lines)) = &swept.dropped {
        terminal::warn(&format!(
            "warning: {}: {} unreadable, as a kill leaves them; what they stood for is done again",
            journal.display(),
            count(*lines, "line is", "lines are")
        ));
    }
    if !swept.is_complete() {
        terminal::warn(&format!(
            "interrupted: {} of {} runs are finished and kept; the same call goes on from there",
            swept.rows.len(),
            swept.planned
        ));
        return Ok(ExitCode::from(INTERRUPTED));
    }
    Ok(print_outcome(&swept, arguments.json))
}

/// Says what there is now.
fn print_outcome(swept: &Swept, json: bool) -> ExitCode {
    let (rows, work) = (&swept.rows, swept.work.as_ref());
    let well = rows.iter().all(|row| row.verdict.is_well());
    if json {
        let summary = json!({
            "sweep": swept.name(),
            "plan": swept.plan(),
            "shard": swept.shard.to_string(),
            "runs": rows.len(),
            "done_before": work.map(|work| work.before),
            "verdicts": swept.verdicts(),
            "wall_s": work.map(|work| work.wall_s),
            "table": swept.table,
            "report": swept.report,
            "configurations": swept.summaries(),
        });
        terminal::print(&format!("{summary:#}"));
    } else {
        for row in rows.iter().filter(|row| !row.verdict.is_well()).take(10) {
            terminal::print(&format!(
                "{}: {}: {}",
                row.id,
                row.verdict.name(),
                row.error.as_deref().unwrap_or_default()
            ));
        }
        let verdicts: Vec<String> = swept.verdicts().iter().map(|(name, count)| format!("{count} {name}")).collect();
        terminal::print(&format!("{}: {}.", count(rows.len(), "run", "runs"), verdicts.join(", ")));
        if let Some(work) = work.filter(|work| work.done > 0) {
            let before =
                if work.before > 0 { format!(" ({} were finished before)", work.before) } else { String::new() };
            terminal::print(&format!(
                "{}{before}, {:.0} s simulated in {:.2} s: {:.0} times real time.",
                count(work.done, "run", "runs"),
                work.simulated_s,
                work.wall_s,
                work.simulated_s / work.wall_s
            ));
        }
        let report = swept.report.as_ref().map_or_else(String::new, |path| format!(", report in {}", path.display()));
        terminal::print(&format!("Table in {}{report}.", swept.table.display()));
    }
    if well { ExitCode::SUCCESS } else { ExitCode::from(1) }
}
