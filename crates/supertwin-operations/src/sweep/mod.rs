//! A campaign of seeded runs over parameters, into one table and a report.
//!
//! The folder of a sweep has a journal with a line for every finished run, and, when all are finished, the table, the
//! report and its figures. The same call goes on where an earlier one was ended.

mod configuration_runs;
mod execute;
mod figures;
mod gather;
mod journal;
mod report;
mod run_row;

use crate::placement::provenance;
use crate::run::pool;
use crate::{OperationError, Progress};
pub use configuration_runs::Configured;
use execute::Campaign;
use journal::{Heading, Journal};
use rayon::prelude::*;
pub use run_row::{RunRow, RunVerdict};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use supertwin_core::Property;
use supertwin_lab::limits::{Judged, Limits, Outcome, worst};
use supertwin_lab::run::base_name;
use supertwin_lab::sweep::{KeepRecordings, Plan, Sweep};
use supertwin_lab::{ConfigError, Library, ResolvedTrial};
use supertwin_protocol::{Clock as _, SystemClock};

/// Which sweep, and what of it.
#[derive(Clone, Debug)]
pub struct SweepOptions {
    /// A name in `config/sweeps`, or a path.
    pub spec: String,
    /// Folder for table, report and recordings; `None`: `runs/sweeps/NAME`.
    pub folder: Option<PathBuf>,
    /// Which part of the runs.
    pub shard: Shard,
    /// Runs at the same time; 0: one per core.
    pub jobs: usize,
    /// Which recordings are kept; `None`: what the file says.
    pub recordings: Option<KeepRecordings>,
    /// Forget what is in the folder and begin anew.
    pub force: bool,
}

/// Part `k`, from 1, of `n`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    k: usize,
    n: usize,
}

impl Shard {
    /// The part that has all runs.
    pub const WHOLE: Self = Self { k: 1, n: 1 };

    /// Run after run to part after part: all parts have runs of every configuration, and take about as long.
    fn has(self, run: usize) -> bool {
        run % self.n == self.k - 1
    }

    /// `stem.extension`, or `stem.K-of-N.extension`.
    fn file(self, folder: &Path, stem: &str, extension: &str) -> PathBuf {
        folder.join(match self {
            Self::WHOLE => format!("{stem}.{extension}"),
            Self { k, n } => format!("{stem}.{k}-of-{n}.{extension}"),
        })
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.k, self.n)
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(k, n)| Some((k.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((k, n)) if 1 <= k && k <= n => Ok(Shard { k, n }),
            _ => Err("must be K/N with K from 1 to N, such as 2/8".to_owned()),
        }
    }
}

/// Stem of the file that holds the table.
const TABLE: &str = "table";

/// A sweep with its list of runs.
struct Prepared {
    sweep: Sweep,
    plan: Plan,
    keep_recordings: KeepRecordings,
    /// What a run must keep, and the text of the file.
    limits: Option<(Limits, String)>,
    /// Fingerprint of the plan.
    fingerprint: String,
}

/// What a call did.
#[derive(Clone, Copy, Debug)]
pub struct Work {
    /// Runs that an earlier call had finished.
    pub before: usize,
    /// Runs that this call has finished.
    pub done: usize,
    /// Simulated seconds of those.
    pub simulated_s: f64,
    /// Seconds that they took.
    pub wall_s: f64,
}

/// A sweep, or a part of one, as far as it has come.
pub struct Swept {
    prepared: Prepared,
    /// Which part of the runs.
    pub shard: Shard,
    /// Finished runs, in the order of the plan.
    pub rows: Vec<RunRow>,
    /// Runs that are to be finished.
    pub planned: usize,
    /// What was done for it; `None`: the tables of parts were joined.
    pub work: Option<Work>,
    /// Parquet table with a row per run.
    pub table: PathBuf,
    /// Its report; a part has none.
    pub report: Option<PathBuf>,
    /// The journal, and how many lines of it were unreadable: their runs were done again.
    pub dropped: Option<(PathBuf, usize)>,
}

impl Swept {
    /// Name of the sweep.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.prepared.sweep.name
    }

    /// Fingerprint of its runs.
    #[must_use]
    pub fn plan(&self) -> &str {
        &self.prepared.fingerprint
    }

    /// Whether all runs of the part are finished; if not, it was interrupted.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.rows.len() == self.planned
    }

    /// How many runs ended how; what did not happen is left out.
    #[must_use]
    pub fn verdicts(&self) -> BTreeMap<&'static str, usize> {
        verdicts(&self.rows).into_iter().collect()
    }

    /// Means and intervals of every configuration; resamples, so it takes a moment.
    #[must_use]
    pub fn summaries(&self) -> Vec<Configured> {
        configuration_runs::summaries(&self.prepared, &self.rows)
    }
}

/// How many rows have which verdict, in the order of the verdicts.
fn verdicts(rows: &[RunRow]) -> Vec<(&'static str, usize)> {
    let count = |verdict: RunVerdict| (verdict.name(), rows.iter().filter(|row| row.verdict == verdict).count());
    RunVerdict::ALL.into_iter().map(count).filter(|(_, count)| *count > 0).collect()
}

/// Joins the tables of all parts into one, with the report.
///
/// # Errors
/// A part is not of this sweep, or not there, or the folder can't be written.
pub fn gather(options: &SweepOptions, parts: &[PathBuf], library: &Library) -> Result<Swept, OperationError> {
    let prepared = pool(options.jobs)?.install(|| Prepared::new(options, library))?;
    let folder = prepared.folder(options)?;
    let rows = gather::gather(&prepared, parts)?;
    write(&prepared, &folder, Shard::WHOLE, &rows, options.force)?;
    Ok(prepared.swept(&folder, Shard::WHOLE, rows, None))
}

/// Does the runs that are not finished, and writes table and report when all are. Ends early when `stop` is set.
///
/// # Errors
/// An option or the sweep's file is wrong, or the folder holds something else or can't be written.
pub fn sweep(
    options: &SweepOptions,
    library: &Library,
    stop: &AtomicBool,
    progress: &dyn Progress,
) -> Result<Swept, OperationError> {
    let pool = pool(options.jobs)?;
    let prepared = pool.install(|| Prepared::new(options, library))?;
    let folder = prepared.folder(options)?;
    let shard = options.shard;
    let heading = Heading {
        sweep: prepared.sweep.name.clone(),
        plan: prepared.fingerprint.clone(),
        program: program(),
        shard: shard.to_string(),
    };
    let table = shard.file(&folder, TABLE, "parquet");
    let journal = shard.file(&folder, "journal", "jsonl");
    if table.exists() && !journal.exists() && !options.force {
        return Err(OperationError::at(&table, &"exists already; use --force to replace it, or another --out"));
    }
    let mut opened = Journal::open(&journal, &heading, &prepared.plan, options.force)?;
    let mine: Vec<usize> = (0..prepared.plan.runs.len()).filter(|run| shard.has(*run)).collect();
    let todo: Vec<usize> = mine.iter().copied().filter(|run| !opened.rows.contains_key(run)).collect();
    let before = mine.len() - todo.len();

    let trial = |run: &usize| &prepared.plan.configurations[prepared.plan.runs[*run].configuration].trial;
    let stage = format!("{}: {} of {} runs", prepared.sweep.name, todo.len(), mine.len());
    progress.begin(&stage, todo.iter().map(|run| trial(run).ticks()).sum());
    let clock = SystemClock::start();
    let campaign = Campaign {
        plan: &prepared.plan,
        keep_recordings: prepared.keep_recordings,
        folder: &folder,
        judge: &|row: &mut RunRow| prepared.judge(row),
        stop,
        progress,
    };
    let done = pool.install(|| campaign.execute(&todo, &mut opened.journal));
    progress.end();
    let done = done?;
    let simulated_s: f64 = done.iter().map(|row| row.ticks as f64 * trial(&row.run).trial.tick_s.get()).sum();
    let work = Work { before, done: done.len(), simulated_s, wall_s: clock.now().as_secs_f64() };
    opened.rows.extend(done.into_iter().map(|row| (row.run, row)));
    let rows: Vec<RunRow> = opened.rows.into_values().collect();
    let is_there = table.exists() && (shard != Shard::WHOLE || folder.join(report::FILE).exists());
    // Table and report follow from the journal. When they are there and nothing was added, they stay.
    if rows.len() == mine.len() && !(todo.is_empty() && is_there) {
        write(&prepared, &folder, shard, &rows, true)?;
    }
    let dropped = (opened.dropped > 0).then_some((journal, opened.dropped));
    Ok(Swept { planned: mine.len(), dropped, ..prepared.swept(&folder, shard, rows, Some(work)) })
}

impl Prepared {
    fn new(options: &SweepOptions, library: &Library) -> Result<Self, OperationError> {
        let sweep = Sweep::load(library, &options.spec)?;
        if let Some(name) = run_row::taken(&sweep) {
            let message = format!("parameter {name}: the table has a column of this name; give it another `name`");
            return Err(ConfigError::Combination { path: sweep.path.display().to_string(), message }.into());
        }
        let points = sweep.points()?;
        let resolve = |trial: &String| points.par_iter().map(|point| sweep.resolve(library, trial, point)).collect();
        let resolved: Vec<Vec<Result<Vec<ResolvedTrial>, ConfigError>>> =
            sweep.trials.par_iter().map(resolve).collect();
        // Of several errors the first in order, whoever was first to find one.
        let of_trials: Vec<Vec<Vec<ResolvedTrial>>> =
            resolved.into_iter().map(|points| points.into_iter().collect()).collect::<Result<_, ConfigError>>()?;
        let first: Vec<ResolvedTrial> =
            of_trials.iter().filter_map(|points| points.first()).flatten().cloned().collect();
        library.all_used(&first)?;
        let plan = sweep.plan(of_trials, &points)?;
        let keep_recordings = options.recordings.unwrap_or(sweep.keep_recordings);
        let limits = sweep.limits(library)?;
        let fingerprint = fingerprint(&plan, keep_recordings, limits.as_ref().map(|(_, text)| text.as_str()));
        Ok(Self { sweep, plan, keep_recordings, limits, fingerprint })
    }

    /// The folder that the options name, made if it is not there.
    fn folder(&self, options: &SweepOptions) -> Result<PathBuf, OperationError> {
        let folder = options.folder.clone().unwrap_or_else(|| Path::new("runs/sweeps").join(&self.sweep.name));
        std::fs::create_dir_all(&folder).map_err(|cause| OperationError::at(&folder, &cause))?;
        Ok(folder)
    }

    fn swept(self, folder: &Path, shard: Shard, rows: Vec<RunRow>, work: Option<Work>) -> Swept {
        Swept {
            prepared: self,
            shard,
            planned: rows.len(),
            rows,
            work,
            table: shard.file(folder, TABLE, "parquet"),
            report: (shard == Shard::WHOLE).then(|| folder.join(report::FILE)),
            dropped: None,
        }
    }

    /// Puts the verdict of the limits to a complete run.
    fn judge(&self, row: &mut RunRow) {
        let Some((limits, _)) = &self.limits else { return };
        let trial = &self.plan.configurations[self.plan.runs[row.run].configuration].trial;
        let judged = limits.judge(&base_name(trial), &row.scores);
        let broken: Vec<String> = judged.iter().filter_map(broken_limit_text).collect();
        row.verdict = match worst(&judged) {
            _ if judged.is_empty() => RunVerdict::Invalid,
            Outcome::Pass => RunVerdict::Pass,
            Outcome::Fail => RunVerdict::Fail,
            Outcome::Invalid => RunVerdict::Invalid,
        };
        row.error = match (judged.is_empty(), broken.is_empty()) {
            (true, _) => Some("no limit concerns it".to_owned()),
            (_, true) => None,
            _ => Some(broken.join("; ")),
        };
    }
}

/// Which limit is not kept, and how.
fn broken_limit_text(judged: &Judged) -> Option<String> {
    let metric = &judged.metric;
    match (judged.value, judged.min, judged.max) {
        _ if judged.outcome == Outcome::Pass => None,
        (None, _, _) => Some(format!("{metric} has no value")),
        (Some(value), Some(min), _) if value < min => Some(format!("{metric} = {value:.4}: must be at least {min}")),
        (Some(value), _, Some(max)) => Some(format!("{metric} = {value:.4}: must be at most {max}")),
        (Some(value), _, None) => Some(format!("{metric} = {value}")),
    }
}

/// SHA-256 of everything that the rows of a sweep follow from, but for the program.
fn fingerprint(plan: &Plan, keep_recordings: KeepRecordings, limits: Option<&str>) -> String {
    let mut hash = Sha256::new();
    let mut add = |text: &str| {
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text);
    };
    add(match keep_recordings {
        KeepRecordings::All => "all",
        KeepRecordings::OnFail => "on-fail",
        KeepRecordings::None => "none",
    });
    for one in &plan.configurations {
        add(&one.trial.name);
        add(&one.trial.controller_name);
        add(&one.trial.text);
        add(&format!("{} {} {:?}", one.grid, one.sample, one.values));
    }
    for run in &plan.runs {
        add(&format!("{} {} {}", run.id, run.configuration, run.seed));
    }
    add(limits.unwrap_or_default());
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Version and commit of this program.
fn program() -> String {
    let commit = match provenance().get("git_commit") {
        Some(Property::Text(commit)) => format!(" ({commit})"),
        _ => String::new(),
    };
    format!("{}{commit}", env!("CARGO_PKG_VERSION"))
}

/// Writes table and report.
fn write(
    prepared: &Prepared,
    folder: &Path,
    shard: Shard,
    rows: &[RunRow],
    overwrite: bool,
) -> Result<(), OperationError> {
    let path = shard.file(folder, TABLE, "parquet");
    let call = |error: supertwin_rerun::TableError| OperationError::Option(error.to_string());
    let mut table = run_row::table(&prepared.sweep, &prepared.plan, rows).map_err(call)?;
    table.about = BTreeMap::from([
        ("supertwin.sweep".to_owned(), prepared.sweep.name.clone()),
        ("supertwin.plan".to_owned(), prepared.fingerprint.clone()),
        ("supertwin.program".to_owned(), program()),
        ("supertwin.spec".to_owned(), prepared.sweep.text.to_owned()),
    ]);
    if shard != Shard::WHOLE {
        table.about.insert("supertwin.shard".to_owned(), shard.to_string());
    }
    if shard == Shard::WHOLE && !overwrite {
        let report = folder.join(report::FILE);
        if report.exists() {
            return Err(OperationError::at(&report, &"exists already; use --force to replace it, or another --out"));
        }
    }
    table.write(&path, overwrite).map_err(call)?;
    if shard == Shard::WHOLE {
        report::write(prepared, rows, folder)?;
    }
    Ok(())
}
