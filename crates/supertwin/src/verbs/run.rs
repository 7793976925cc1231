//! `supertwin run`: trials × controllers × seeds in one process, recorded and scored.

use super::{record, tables};
use crate::arguments::{LiveArguments, TrialsArguments};
use crate::terminal::{self, Bar, INTERRUPTED, count};
use clap::Args;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use supertwin_lab::Library;
use supertwin_operations::OperationError;
use supertwin_operations::run::{self, Finished, FinishedRun, RunOptions};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin run                                  the paper's three trials, table IV beside ours
  supertwin run --seeds 20 --no-record           mean and standard deviation over 20 seeds
  supertwin run fair --seeds 20 --json           five controllers on equal terms
  supertwin run paper-agsta --set controller.law.agsta.beta.surge=4 --out runs/softer
  supertwin run my-trial.toml                    a trial of your own
  supertwin run paper-agsta --live               and look at it in a viewer at once

Exit status: 0 done, 1 a run ended in NaN, 2 the call or its input is wrong, 130 interrupted (recordings are closed).")]
pub(crate) struct RunArguments {
    #[command(flatten)]
    trials: TrialsArguments,

    /// Seed instead of the trial's own
    #[arg(long, value_name = "N", conflicts_with = "seeds")]
    seed: Option<u64>,

    /// Run this many seeds, counting up from the trial's own
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    seeds: Option<u64>,

    /// Folder for the recordings [default: a new numbered folder in runs/]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// Replace recordings that exist
    #[arg(long)]
    force: bool,

    /// Smaller recordings, about 40 per cent, that take twice as long
    #[arg(long)]
    compress: bool,

    /// Score only, write nothing
    #[arg(long, conflicts_with_all = ["out", "force", "compress"])]
    no_record: bool,

    #[command(flatten)]
    live: LiveArguments,

    /// Runs at the same time [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,

    /// Print one JSON object instead of tables
    #[arg(long)]
    json: bool,
}

/// Does the runs, and prints their scores.
pub(crate) fn run(arguments: &RunArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let trials = arguments.trials.load(library)?;
    let options = RunOptions {
        seed: arguments.seed,
        seeds: arguments.seeds.unwrap_or(1),
        record: !arguments.no_record,
        folder: arguments.out.clone(),
        force: arguments.force,
        compress: arguments.compress,
        jobs: usize::from(arguments.jobs.unwrap_or(0)),
    };
    let waiting = std::thread::current();
    let stop = terminal::stop_flag(move || waiting.unpark())?;
    let live = record::live(&arguments.live, arguments.json)?;
    let Finished { runs: done, failures, planned, wall_s } =
        run::run(trials, &options, live.as_ref(), &stop, &Bar::new(arguments.json))?;
    let interrupted = stop.load(Ordering::Relaxed);
    report(&done, arguments.json, wall_s)?;
    for run in &done {
        for event in &run.refused {
            let t_s = event.tick as f64 * run.tick_s;
            terminal::warn(&format!("warning: {} seed {} at {t_s:.2} s: {}", run.trial, run.seed, event.what));
        }
    }
    if interrupted {
        let complete = done.iter().filter(|run| run.complete).count();
        let closed = if arguments.no_record { "" } else { "; the recordings are closed and readable" };
        terminal::warn(&format!("interrupted: {complete} of {planned} runs complete{closed}"));
    }
    if let Some(live) = &live
        && !interrupted
    {
        if live.dropped() > 0 {
            terminal::warn(&format!("warning: {} batches did not fit into the live view", live.dropped()));
        }
        terminal::warn("the live view stays until Ctrl-C");
        while !stop.load(Ordering::Relaxed) {
            std::thread::park();
        }
    }
    let mut failures = failures.into_iter();
    if let Some(first) = failures.next() {
        for failure in failures {
            terminal::warn(&format!("error: {failure}"));
        }
        return Err(first);
    }
    Ok(if interrupted { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS })
}

fn report(done: &[FinishedRun], json: bool, wall_s: f64) -> Result<(), OperationError> {
    if json {
        return terminal::print_json(&BTreeMap::from([("runs", done)]));
    }
    // A run that was interrupted has no scores to compare.
    let complete: Vec<&FinishedRun> = done.iter().filter(|run| run.complete).collect();
    if complete.is_empty() {
        return Ok(());
    }
    terminal::print(&tables::scores(&complete));
    let simulated_s: f64 = done.iter().map(|run| run.wall_s * run.real_time_factor).sum();
    let warnings: u64 = done.iter().map(|run| run.warnings).sum();
    terminal::print(&format!(
        "{}, {simulated_s:.0} s simulated in {wall_s:.2} s: {:.0} times real time; {} in the events.",
        count(done.len(), "run", "runs"),
        simulated_s / wall_s,
        count(warnings as usize, "warning", "warnings")
    ));
    if let [only] = done {
        terminal::print(&format!("State hash {}.", only.hash));
    }
    if let Some(path) = done.iter().find_map(|run| run.recording.as_ref()) {
        let folder = path.parent().unwrap_or(Path::new("."));
        terminal::print(&format!(
            "Recordings in {}; open one with: rerun {} (pip install rerun-sdk==0.36.3)",
            folder.display(),
            path.display()
        ));
    }
    Ok(())
}
