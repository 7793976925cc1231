//! `supertwin sweep`: a campaign of seeded runs over parameters, into one table and a report.

mod execute;
mod figures;
mod gather;
mod journal;
mod report;
mod row;

use crate::clock::Stopwatch;
use crate::failure::{Failure, INTERRUPTED};
use crate::output;
use crate::placement::provenance;
use clap::{Args, ValueEnum};
use execute::Campaign;
use journal::{Heading, Journal};
use rayon::prelude::*;
use row::{Row, Verdict};
use serde_json::json;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use supertwin_core::Property;
use supertwin_lab::limits::{Judged, Limits, Outcome, worst};
use supertwin_lab::run::base_name;
use supertwin_lab::sweep::{Keep, Plan, Sweep};
use supertwin_lab::{ConfigError, Library, ResolvedTrial};

/// Arguments of `sweep`.
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
    #[arg(long, value_name = "K/N", value_parser = shard, conflicts_with = "gather")]
    shard: Option<Shard>,

    /// Runs at the same time [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,

    /// Which recordings are kept [default: what the file says, else none]
    #[arg(long, value_enum)]
    recordings: Option<KeepArgument>,

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
enum KeepArgument {
    /// Those of all runs
    All,
    /// Those of runs that break a limit or are invalid
    OnFail,
    /// None
    None,
}

impl From<KeepArgument> for Keep {
    fn from(keep: KeepArgument) -> Self {
        match keep {
            KeepArgument::All => Self::All,
            KeepArgument::OnFail => Self::OnFail,
            KeepArgument::None => Self::None,
        }
    }
}

/// Part `k`, from 1, of `n`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shard {
    k: usize,
    n: usize,
}

impl Shard {
    const WHOLE: Self = Self { k: 1, n: 1 };

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

fn shard(text: &str) -> Result<Shard, String> {
    let numbers = text.split_once('/').and_then(|(k, n)| Some((k.parse().ok()?, n.parse().ok()?)));
    match numbers {
        Some((k, n)) if 1 <= k && k <= n => Ok(Shard { k, n }),
        _ => Err("must be K/N with K from 1 to N, such as 2/8".to_owned()),
    }
}

/// Stem of the file that holds the table.
const TABLE: &str = "table";

/// A sweep with its list of runs.
struct Prepared {
    sweep: Sweep,
    plan: Plan,
    keep: Keep,
    /// What a run must keep, and the text of the file.
    limits: Option<(Limits, String)>,
    /// Fingerprint of the plan.
    fingerprint: String,
}

/// Does it.
pub(crate) fn sweep(arguments: &SweepArguments, library: &Library) -> Result<ExitCode, Failure> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(usize::from(arguments.jobs.unwrap_or(0)))
        .build()
        .map_err(|cause| Failure::Call(format!("threads: {cause}")))?;
    let prepared = pool.install(|| Prepared::new(arguments, library))?;
    let folder = arguments.out.clone().unwrap_or_else(|| Path::new("runs/sweeps").join(&prepared.sweep.name));
    std::fs::create_dir_all(&folder).map_err(|cause| path_failure(&folder, &cause))?;
    if !arguments.gather.is_empty() {
        let rows = gather::gather(&prepared, &arguments.gather)?;
        write(&prepared, &folder, Shard::WHOLE, &rows, arguments.force)?;
        return say(&prepared, &folder, Shard::WHOLE, &rows, None, arguments.json);
    }

    let shard = arguments.shard.unwrap_or(Shard::WHOLE);
    let heading = Heading {
        sweep: prepared.sweep.name.clone(),
        plan: prepared.fingerprint.clone(),
        program: program(),
        shard: shard.to_string(),
    };
    let table = shard.file(&folder, TABLE, "parquet");
    let journal = shard.file(&folder, "journal", "jsonl");
    if table.exists() && !journal.exists() && !arguments.force {
        return Err(Failure::Path {
            path: table.display().to_string(),
            cause: "exists already; use --force to replace it, or another --out".to_owned(),
        });
    }
    let mut opened = Journal::open(&journal, &heading, &prepared.plan, arguments.force)?;
    if opened.dropped > 0 {
        output::warn(&format!(
            "warning: {}: {} unreadable, as a kill leaves them; what they stood for is done again",
            journal.display(),
            count(opened.dropped, "line is", "lines are")
        ));
    }
    let mine: Vec<usize> = (0..prepared.plan.runs.len()).filter(|run| shard.has(*run)).collect();
    let todo: Vec<usize> = mine.iter().copied().filter(|run| !opened.rows.contains_key(run)).collect();
    let before = mine.len() - todo.len();

    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))
        .map_err(|cause| Failure::Call(format!("Ctrl-C can't be caught: {cause}")))?;
    let trial = |run: &usize| &prepared.plan.configurations[prepared.plan.runs[*run].configuration].trial;
    let progress = output::progress(
        &format!("{}: {} of {} runs", prepared.sweep.name, todo.len(), mine.len()),
        todo.iter().map(|run| trial(run).ticks()).sum(),
        arguments.json,
    );
    let clock = Stopwatch::start();
    let campaign = Campaign {
        plan: &prepared.plan,
        keep: prepared.keep,
        folder: &folder,
        judge: &|row: &mut Row| prepared.judge(row),
        stop: &stop,
        progress: &progress,
    };
    let done = pool.install(|| campaign.execute(&todo, &mut opened.journal));
    progress.finish_and_clear();
    let done = done?;
    let wall_s = clock.elapsed_s();
    let simulated_s: f64 = done.iter().map(|row| row.ticks as f64 * trial(&row.run).trial.tick_s.get()).sum();
    let work = Work { before, done: done.len(), simulated_s, wall_s };
    opened.rows.extend(done.into_iter().map(|row| (row.run, row)));
    if opened.rows.len() < mine.len() {
        let finished = opened.rows.len();
        output::warn(&format!(
            "interrupted: {finished} of {} runs are finished and kept; the same call goes on from there",
            mine.len()
        ));
        return Ok(ExitCode::from(INTERRUPTED));
    }
    let rows: Vec<Row> = opened.rows.into_values().collect();
    let report = folder.join(report::FILE);
    let is_there = table.exists() && (shard != Shard::WHOLE || report.exists());
    // Table and report follow from the journal. When they are there and nothing was added, they stay.
    if !(todo.is_empty() && is_there) {
        write(&prepared, &folder, shard, &rows, true)?;
    }
    say(&prepared, &folder, shard, &rows, Some(&work), arguments.json)
}

impl Prepared {
    fn new(arguments: &SweepArguments, library: &Library) -> Result<Self, Failure> {
        let sweep = Sweep::load(library, &arguments.spec)?;
        if let Some(name) = row::taken(&sweep) {
            let message = format!("parameter {name}: the table has a column of this name; give it another `name`");
            return Err(ConfigError::Combination { path: sweep.path.display().to_string(), message }.into());
        }
        let points = sweep.points()?;
        let places: Vec<(usize, usize)> =
            (0..sweep.trials.len()).flat_map(|trial| (0..points.len()).map(move |point| (trial, point))).collect();
        let resolved: Vec<Result<Vec<ResolvedTrial>, ConfigError>> = places
            .par_iter()
            .map(|(trial, point)| sweep.resolve(library, &sweep.trials[*trial], &points[*point]))
            .collect();
        let mut of_trials: Vec<Vec<Vec<ResolvedTrial>>> = vec![Vec::new(); sweep.trials.len()];
        for ((trial, _), resolved) in places.iter().zip(resolved) {
            of_trials[*trial].push(resolved?);
        }
        let first: Vec<ResolvedTrial> =
            of_trials.iter().filter_map(|points| points.first()).flatten().cloned().collect();
        library.all_used(&first)?;
        let plan = sweep.plan(of_trials, &points)?;
        let keep = arguments.recordings.map_or(sweep.keep, Keep::from);
        let limits = sweep.limits(library)?;
        let fingerprint = fingerprint(&plan, keep, limits.as_ref().map(|(_, text)| text.as_str()));
        Ok(Self { sweep, plan, keep, limits, fingerprint })
    }

    /// Puts the verdict of the limits to a complete run.
    fn judge(&self, row: &mut Row) {
        let Some((limits, _)) = &self.limits else { return };
        let trial = &self.plan.configurations[self.plan.runs[row.run].configuration].trial;
        let judged = limits.judge(&base_name(trial), &row.scores);
        let broken: Vec<String> = judged.iter().filter_map(said).collect();
        row.verdict = match worst(&judged) {
            _ if judged.is_empty() => Verdict::Invalid,
            Outcome::Pass => Verdict::Pass,
            Outcome::Fail => Verdict::Fail,
            Outcome::Invalid => Verdict::Invalid,
        };
        row.error = match (judged.is_empty(), broken.is_empty()) {
            (true, _) => Some("no limit concerns it".to_owned()),
            (_, true) => None,
            _ => Some(broken.join("; ")),
        };
    }
}

/// Which limit is not kept, and how.
fn said(judged: &Judged) -> Option<String> {
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
fn fingerprint(plan: &Plan, keep: Keep, limits: Option<&str>) -> String {
    let mut hash = Sha256::new();
    let mut add = |text: &str| {
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text);
    };
    add(match keep {
        Keep::All => "all",
        Keep::OnFail => "on-fail",
        Keep::None => "none",
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

/// What a call did, for people.
struct Work {
    before: usize,
    done: usize,
    simulated_s: f64,
    wall_s: f64,
}

/// Writes table and report.
fn write(prepared: &Prepared, folder: &Path, shard: Shard, rows: &[Row], overwrite: bool) -> Result<(), Failure> {
    let path = shard.file(folder, TABLE, "parquet");
    let call = |error: supertwin_rerun::TableError| Failure::Call(error.to_string());
    let mut table = row::table(&prepared.sweep, &prepared.plan, rows).map_err(call)?;
    let mut about = BTreeMap::from([
        ("supertwin.sweep", prepared.sweep.name.clone()),
        ("supertwin.plan", prepared.fingerprint.clone()),
        ("supertwin.program", program()),
        ("supertwin.spec", prepared.sweep.text().to_owned()),
    ]);
    if shard != Shard::WHOLE {
        about.insert("supertwin.shard", shard.to_string());
    }
    table.about = about.into_iter().map(|(name, text)| (name.to_owned(), text)).collect();
    if shard == Shard::WHOLE && !overwrite {
        let report = folder.join(report::FILE);
        if report.exists() {
            return Err(path_failure(&report, &"exists already; use --force to replace it, or another --out"));
        }
    }
    table.write(&path, overwrite).map_err(call)?;
    if shard == Shard::WHOLE {
        report::write(prepared, rows, folder)?;
    }
    Ok(())
}

/// Says what there is now.
fn say(
    prepared: &Prepared,
    folder: &Path,
    shard: Shard,
    rows: &[Row],
    work: Option<&Work>,
    json: bool,
) -> Result<ExitCode, Failure> {
    let table = shard.file(folder, TABLE, "parquet");
    let report = (shard == Shard::WHOLE).then(|| folder.join(report::FILE));
    let verdicts: BTreeMap<&str, usize> = Verdict::ALL
        .into_iter()
        .map(|verdict| (verdict.name(), rows.iter().filter(|row| row.verdict == verdict).count()))
        .filter(|(_, count)| *count > 0)
        .collect();
    let well = rows.iter().all(|row| row.verdict.is_well());
    if json {
        let said = json!({
            "sweep": prepared.sweep.name,
            "plan": prepared.fingerprint,
            "shard": shard.to_string(),
            "runs": rows.len(),
            "done_before": work.map(|work| work.before),
            "verdicts": verdicts,
            "wall_s": work.map(|work| work.wall_s),
            "table": table,
            "report": report,
            "configurations": report::summaries(prepared, rows),
        });
        output::print(&format!("{said:#}"));
    } else {
        for row in rows.iter().filter(|row| !row.verdict.is_well()).take(10) {
            output::print(&format!("{}: {}: {}", row.id, row.verdict.name(), row.error.as_deref().unwrap_or_default()));
        }
        let verdicts: Vec<String> = verdicts.iter().map(|(name, count)| format!("{count} {name}")).collect();
        output::print(&format!("{}: {}.", count(rows.len(), "run", "runs"), verdicts.join(", ")));
        if let Some(work) = work.filter(|work| work.done > 0) {
            let before =
                if work.before > 0 { format!(" ({} were finished before)", work.before) } else { String::new() };
            output::print(&format!(
                "{}{before}, {:.0} s simulated in {:.2} s: {:.0} times real time.",
                count(work.done, "run", "runs"),
                work.simulated_s,
                work.wall_s,
                work.simulated_s / work.wall_s
            ));
        }
        let report = report.map_or_else(String::new, |path| format!(", report in {}", path.display()));
        output::print(&format!("Table in {}{report}.", table.display()));
    }
    Ok(if well { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// `1 run`, `2 runs`.
fn count(n: usize, one: &str, several: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { several })
}

fn path_failure(path: &Path, cause: &impl std::fmt::Display) -> Failure {
    Failure::Path { path: path.display().to_string(), cause: cause.to_string() }
}
