//! Trials × controllers × seeds in this process, recorded and scored.

use crate::placement::provenance;
use crate::{OperationError, Progress};
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use supertwin_core::observe::Both;
use supertwin_core::{Event, NoSink, RunSink};
use supertwin_lab::run::run_name;
use supertwin_lab::{ResolvedTrial, RunError, RunOutcome, Scores};
use supertwin_protocol::{Clock as _, SystemClock};
use supertwin_rerun::{Live, Options, RerunSink};

/// What is run, and what is kept.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Seed instead of the trials' own.
    pub seed: Option<u64>,
    /// Runs of each trial, with seeds that count up.
    pub seeds: u64,
    /// Recordings are kept.
    pub record: bool,
    /// Folder for them; `None`: a new numbered folder in `runs`.
    pub folder: Option<PathBuf>,
    /// Recordings that exist are replaced.
    pub force: bool,
    /// Recordings are smaller, and take longer.
    pub compress: bool,
    /// Runs at the same time; 0: one per core.
    pub jobs: usize,
}

/// One run to be done.
struct Job {
    trial: ResolvedTrial,
    seed: u64,
    recording: Option<PathBuf>,
}

/// What runs of a trial with a controller are called; a trial's name may end with its controller's already.
#[must_use]
pub fn title(trial: &str, controller: &str) -> String {
    if trial.ends_with(controller) { trial.to_owned() } else { format!("{trial}/{controller}") }
}

/// One run that was done.
#[derive(Debug, Serialize)]
pub struct FinishedRun {
    /// Name of the trial.
    pub trial: String,
    /// Name of the controller.
    pub controller: String,
    /// Seed of the noise of sea, sensors and faults.
    pub seed: u64,
    /// Hash over the states and outputs of all blocks at all ticks, in hexadecimal.
    pub hash: String,
    /// Ticks that it took.
    pub ticks: u64,
    /// It came to its end.
    pub complete: bool,
    /// Warnings among its events.
    pub warnings: u64,
    /// Commands that were refused.
    pub refused: Vec<Event>,
    /// Seconds that it took.
    pub wall_s: f64,
    /// Simulated seconds per second.
    pub real_time_factor: f64,
    /// Path of the recording; `None` when none was asked for.
    pub recording: Option<PathBuf>,
    /// Scores at the end of the run.
    pub scores: Scores,
    /// Length of a tick in simulated seconds.
    #[serde(skip)]
    pub tick_s: f64,
    /// Column of the paper's table that it repeats.
    #[serde(skip)]
    pub paper: Option<supertwin_lab::paper::PaperColumn>,
}

/// What came of all runs.
#[derive(Debug)]
pub struct Finished {
    /// Those that were begun and did not fail.
    pub runs: Vec<FinishedRun>,
    /// Why others failed.
    pub failures: Vec<OperationError>,
    /// How many were to be done.
    pub planned: usize,
    /// Seconds that all of them took.
    pub wall_s: f64,
}

/// Does the runs on all cores, into recordings and a live view, if there is one. Ends early when `stop` is set.
///
/// # Errors
/// An option is wrong, or the folder can't be used; a run that fails is in the result.
pub fn run(
    trials: Vec<ResolvedTrial>,
    options: &RunOptions,
    live: Option<&Live>,
    stop: &AtomicBool,
    progress: &dyn Progress,
) -> Result<Finished, OperationError> {
    let mut jobs = jobs(options, trials)?;
    if options.record {
        let folder = create_folder(options.folder.as_deref())?;
        for job in &mut jobs {
            let path = folder.join(format!("{}.rrd", run_name(&job.trial, job.seed)));
            if path.exists() && !options.force {
                return Err(OperationError::at(&path, &"exists already; use --force to replace it, or another --out"));
            }
            job.recording = Some(path);
        }
    }
    let sink = Options { overwrite: options.force, compress: options.compress, ..Options::default() };
    progress.begin(&format!("{} runs", jobs.len()), jobs.iter().map(|job| job.trial.ticks()).sum());
    let clock = SystemClock::start();
    let pool = pool(options.jobs)?;
    let results: Vec<Result<Option<FinishedRun>, OperationError>> =
        pool.install(|| jobs.par_iter().map(|job| one(job, &sink, live, stop, progress)).collect());
    progress.end();
    let mut finished =
        Finished { runs: Vec::new(), failures: Vec::new(), planned: jobs.len(), wall_s: clock.now().as_secs_f64() };
    for result in results {
        match result {
            Ok(run) => finished.runs.extend(run),
            Err(failure) => finished.failures.push(failure),
        }
    }
    Ok(finished)
}

fn jobs(options: &RunOptions, trials: Vec<ResolvedTrial>) -> Result<Vec<Job>, OperationError> {
    let mut jobs: Vec<Job> = Vec::new();
    for trial in trials {
        let first = options.seed.unwrap_or(trial.trial.seed);
        let last = first.checked_add(options.seeds.max(1) - 1);
        let last =
            last.ok_or_else(|| OperationError::Option(format!("seeds from {first} on: there are not that many")))?;
        for seed in first..=last {
            let name = run_name(&trial, seed);
            if jobs.iter().any(|job| job.seed == seed && run_name(&job.trial, job.seed) == name) {
                return Err(OperationError::Option(format!("run {name} is asked for twice: name every trial once")));
            }
            jobs.push(Job { trial: trial.clone(), seed, recording: None });
        }
    }
    Ok(jobs)
}

/// The folder asked for, or the first free `runs/NNNN`.
fn create_folder(out: Option<&Path>) -> Result<PathBuf, OperationError> {
    let wrong = |path: &Path, cause: &std::io::Error| {
        OperationError::at(path, &format!("can't create the folder for recordings: {cause}"))
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
    Err(OperationError::at(root, &"9999 folders are there already; use --out"))
}

/// Ticks in a batch of the live view: runs are much faster than real time.
const LIVE_BATCH: usize = 1000;

fn one(
    job: &Job,
    options: &Options,
    live: Option<&Live>,
    stop: &AtomicBool,
    progress: &dyn Progress,
) -> Result<Option<FinishedRun>, OperationError> {
    if stop.load(Ordering::Relaxed) {
        return Ok(None);
    }
    let name = run_name(&job.trial, job.seed);
    let clock = SystemClock::start();
    let run = || {
        let mut file = job.recording.as_ref().map(|path| RerunSink::create(path, options.clone())).transpose()?;
        let mut view = live.map(|live| RerunSink::live(live, LIVE_BATCH));
        match (&mut file, &mut view) {
            (None, None) => watched(&job.trial, job.seed, &mut NoSink, false, stop, progress),
            (Some(sink), None) | (None, Some(sink)) => watched(&job.trial, job.seed, sink, true, stop, progress),
            (Some(file), Some(view)) => watched(&job.trial, job.seed, &mut Both(file, view), true, stop, progress),
        }
    };
    let outcome = run().map_err(|cause| OperationError::Run { name, cause })?;
    let wall_s = clock.now().as_secs_f64();
    let simulated_s = outcome.ticks as f64 * job.trial.trial.tick_s.get();
    Ok(Some(FinishedRun {
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

/// One run into `sink`, with its ticks as progress; ends early when `stop` is set.
pub(crate) fn watched<S: RunSink>(
    trial: &ResolvedTrial,
    seed: u64,
    sink: &mut S,
    recording: bool,
    stop: &AtomicBool,
    progress: &dyn Progress,
) -> Result<RunOutcome, RunError> {
    let provenance = provenance();
    let mut shown = 0;
    let outcome = supertwin_lab::run(trial, seed, sink, recording.then_some(&provenance), |ticks| {
        progress.advance(ticks - shown);
        shown = ticks;
        !stop.load(Ordering::Relaxed)
    });
    progress.advance(trial.ticks() - shown);
    outcome
}

/// Threads for so many runs at the same time; 0: one per core.
pub(crate) fn pool(jobs: usize) -> Result<rayon::ThreadPool, OperationError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build();
    pool.map_err(|cause| OperationError::Option(format!("threads: {cause}")))
}
