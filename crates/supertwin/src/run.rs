//! `supertwin run`: trials × controllers × seeds in one process, recorded and scored.

use crate::cli::{LiveArguments, TrialsArguments};
use crate::clock::Stopwatch;
use crate::failure::{Failure, INTERRUPTED};
use crate::placement::provenance;
use crate::recorder;
use crate::{output, tables};
use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rayon::prelude::*;
use serde::Serialize;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use supertwin_core::observe::Both;
use supertwin_core::{Event, NoSink, RunSink};
use supertwin_lab::run::run_name;
use supertwin_lab::{Library, ResolvedTrial, RunError, RunOutcome, Scores};
use supertwin_rerun::{Live, Options, RerunSink};

/// Arguments of `run`.
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

/// One run to be done.
struct Job {
    trial: ResolvedTrial,
    seed: u64,
    recording: Option<PathBuf>,
}

/// One run that was done.
#[derive(Debug, Serialize)]
pub(crate) struct Done {
    pub(crate) trial: String,
    pub(crate) controller: String,
    pub(crate) seed: u64,
    pub(crate) hash: String,
    pub(crate) ticks: u64,
    pub(crate) complete: bool,
    pub(crate) warnings: u64,
    pub(crate) refused: Vec<Event>,
    pub(crate) wall_s: f64,
    pub(crate) real_time_factor: f64,
    pub(crate) recording: Option<PathBuf>,
    pub(crate) scores: Scores,
    #[serde(skip)]
    pub(crate) tick_s: f64,
    #[serde(skip)]
    pub(crate) paper: Option<supertwin_lab::paper::PaperColumn>,
}

/// The JSON object of `--json`.
#[derive(Debug, Serialize)]
struct Report<'a> {
    runs: &'a [Done],
}

/// Does it.
pub(crate) fn run(arguments: &RunArguments, library: &Library) -> Result<ExitCode, Failure> {
    let trials = arguments.trials.load(library)?;
    let mut jobs = jobs(arguments, trials)?;
    if !arguments.no_record {
        let folder = create_folder(arguments.out.as_deref())?;
        for job in &mut jobs {
            let path = folder.join(format!("{}.rrd", run_name(&job.trial, job.seed)));
            if path.exists() && !arguments.force {
                return Err(Failure::Path {
                    path: path.display().to_string(),
                    cause: "exists already; use --force to replace it, or another --out".to_owned(),
                });
            }
            job.recording = Some(path);
        }
    }

    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let waiting = std::thread::current();
    ctrlc::set_handler(move || {
        flag.store(true, Ordering::Relaxed);
        waiting.unpark();
    })
    .map_err(|cause| Failure::Call(format!("Ctrl-C can't be caught: {cause}")))?;

    let options = Options { overwrite: arguments.force, compress: arguments.compress, ..Options::default() };
    let live = recorder::live(&arguments.live, arguments.json)?;
    let progress = progress(&jobs, arguments.json);
    let clock = Stopwatch::start();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(usize::from(arguments.jobs.unwrap_or(0)))
        .build()
        .map_err(|cause| Failure::Call(format!("threads: {cause}")))?;
    let results: Vec<Result<Option<Done>, Failure>> =
        pool.install(|| jobs.par_iter().map(|job| one(job, &options, live.as_ref(), &stop, &progress)).collect());
    progress.finish_and_clear();
    let wall_s = clock.elapsed_s();

    let mut done = Vec::with_capacity(results.len());
    let mut failures = Vec::new();
    for result in results {
        match result {
            Ok(Some(run)) => done.push(run),
            Ok(None) => {}
            Err(failure) => failures.push(failure),
        }
    }
    let interrupted = stop.load(Ordering::Relaxed);
    report(&done, arguments.json, wall_s)?;
    for run in &done {
        for event in &run.refused {
            let t_s = event.tick as f64 * run.tick_s;
            output::warn(&format!("warning: {} seed {} at {t_s:.2} s: {}", run.trial, run.seed, event.text));
        }
    }
    if interrupted {
        let complete = done.iter().filter(|run| run.complete).count();
        let closed = if arguments.no_record { "" } else { "; the recordings are closed and readable" };
        output::warn(&format!("interrupted: {complete} of {} runs complete{closed}", jobs.len()));
    }
    if let Some(live) = &live
        && !interrupted
    {
        if live.dropped() > 0 {
            output::warn(&format!("warning: {} batches did not fit into the live view", live.dropped()));
        }
        output::warn("the live view stays until Ctrl-C");
        while !stop.load(Ordering::Relaxed) {
            std::thread::park();
        }
    }
    let mut failures = failures.into_iter();
    if let Some(first) = failures.next() {
        for failure in failures {
            output::warn(&format!("error: {failure}"));
        }
        return Err(first);
    }
    Ok(if interrupted { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS })
}

fn jobs(arguments: &RunArguments, trials: Vec<ResolvedTrial>) -> Result<Vec<Job>, Failure> {
    let mut jobs: Vec<Job> = Vec::new();
    for trial in trials {
        let first = arguments.seed.unwrap_or(trial.trial.seed);
        let last = first.checked_add(arguments.seeds.unwrap_or(1) - 1);
        let last = last.ok_or_else(|| Failure::Call(format!("seeds from {first} on: there are not that many")))?;
        for seed in first..=last {
            let name = run_name(&trial, seed);
            if jobs.iter().any(|job| job.seed == seed && run_name(&job.trial, job.seed) == name) {
                return Err(Failure::Call(format!("run {name} is asked for twice: name every trial once")));
            }
            jobs.push(Job { trial: trial.clone(), seed, recording: None });
        }
    }
    Ok(jobs)
}

/// The folder asked for, or the first free `runs/NNNN`.
fn create_folder(out: Option<&Path>) -> Result<PathBuf, Failure> {
    let wrong = |path: &Path, cause: &std::io::Error| Failure::Path {
        path: path.display().to_string(),
        cause: format!("can't create the folder for recordings: {cause}"),
    };
    if let Some(out) = out {
        std::fs::create_dir_all(out).map_err(|cause| wrong(out, &cause))?;
        return Ok(out.to_owned());
    }
    let root = Path::new("runs");
    std::fs::create_dir_all(root).map_err(|cause| wrong(root, &cause))?;
    for number in 1..=9999 {
        let folder = root.join(format!("{number:04}"));
        match std::fs::create_dir(&folder) {
            Ok(()) => return Ok(folder),
            Err(cause) if cause.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(cause) => return Err(wrong(&folder, &cause)),
        }
    }
    Err(Failure::Path { path: "runs".to_owned(), cause: "9999 folders are there already; use --out".to_owned() })
}

fn progress(jobs: &[Job], json: bool) -> ProgressBar {
    let total = jobs.iter().map(|job| job.trial.ticks()).sum();
    let target = if std::io::stderr().is_terminal() && !json {
        ProgressDrawTarget::stderr()
    } else {
        ProgressDrawTarget::hidden()
    };
    let bar = ProgressBar::with_draw_target(Some(total), target);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {percent:>3} %  {msg}  {eta} left") {
        bar.set_style(style);
    }
    bar.set_message(format!("{} runs", jobs.len()));
    bar
}

/// Ticks in a batch of the live view: runs are much faster than real time.
const LIVE_BATCH: usize = 1000;

fn one(
    job: &Job,
    options: &Options,
    live: Option<&Live>,
    stop: &AtomicBool,
    progress: &ProgressBar,
) -> Result<Option<Done>, Failure> {
    if stop.load(Ordering::Relaxed) {
        return Ok(None);
    }
    let name = run_name(&job.trial, job.seed);
    let clock = Stopwatch::start();
    let outcome = match &job.recording {
        Some(path) => {
            RerunSink::create(path, options.clone()).map_err(RunError::from).and_then(|mut sink| match live {
                None => watched(job, &mut sink, true, stop, progress),
                Some(live) => {
                    let mut view = RerunSink::live(live, LIVE_BATCH);
                    watched(job, &mut Both(&mut sink, &mut view), true, stop, progress)
                }
            })
        }
        None => match live {
            None => watched(job, &mut NoSink, false, stop, progress),
            Some(live) => watched(job, &mut RerunSink::live(live, LIVE_BATCH), true, stop, progress),
        },
    };
    let outcome = outcome.map_err(|cause| Failure::Run { name, cause })?;
    let wall_s = clock.elapsed_s();
    let simulated_s = outcome.ticks as f64 * job.trial.trial.tick_s.get();
    Ok(Some(Done {
        trial: job.trial.name.clone(),
        controller: job.trial.controller_name.clone(),
        seed: job.seed,
        hash: outcome.digest.to_string(),
        ticks: outcome.ticks,
        complete: outcome.complete,
        warnings: outcome.warnings,
        refused: outcome.refused,
        wall_s,
        real_time_factor: simulated_s / wall_s,
        recording: job.recording.clone(),
        scores: outcome.scores,
        tick_s: job.trial.trial.tick_s.get(),
        paper: job.trial.trial.paper_column,
    }))
}

fn watched<S: RunSink>(
    job: &Job,
    sink: &mut S,
    recording: bool,
    stop: &AtomicBool,
    progress: &ProgressBar,
) -> Result<RunOutcome, RunError> {
    let provenance = provenance();
    let mut shown = 0;
    let outcome = supertwin_lab::run(&job.trial, job.seed, sink, recording.then_some(&provenance), |ticks| {
        progress.inc(ticks - shown);
        shown = ticks;
        !stop.load(Ordering::Relaxed)
    });
    progress.inc(job.trial.ticks() - shown);
    outcome
}

fn report(done: &[Done], json: bool, wall_s: f64) -> Result<(), Failure> {
    if json {
        let text = serde_json::to_string_pretty(&Report { runs: done })
            .map_err(|cause| Failure::Call(format!("the report can't be written as JSON: {cause}")))?;
        output::print(&text);
        return Ok(());
    }
    // A run that was interrupted has no scores to compare.
    let complete: Vec<&Done> = done.iter().filter(|run| run.complete).collect();
    if complete.is_empty() {
        return Ok(());
    }
    output::print(&tables::scores(&complete));
    let simulated_s: f64 = done.iter().map(|run| run.wall_s * run.real_time_factor).sum();
    let warnings: u64 = done.iter().map(|run| run.warnings).sum();
    output::print(&format!(
        "{}, {simulated_s:.0} s simulated in {wall_s:.2} s: {:.0} times real time; {} in the events.",
        count(done.len() as u64, "run"),
        simulated_s / wall_s,
        count(warnings, "warning")
    ));
    if let [only] = done {
        output::print(&format!("State hash {}.", only.hash));
    }
    if let Some(path) = done.iter().find_map(|run| run.recording.as_ref()) {
        let folder = path.parent().unwrap_or(Path::new("."));
        output::print(&format!(
            "Recordings in {}; open one with: rerun {} (pip install rerun-sdk==0.36.3)",
            folder.display(),
            path.display()
        ));
    }
    Ok(())
}

/// `1 run`, `2 runs`.
fn count(n: u64, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}
