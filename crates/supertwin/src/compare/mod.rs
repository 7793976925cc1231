//! `supertwin compare`: runs beside each other, with verdicts that are careful.

mod files;
mod gather;
mod groups;
mod merged;
mod report;
mod table;
mod verdicts;

use crate::failure::Failure;
use crate::output;
use clap::Args;
use gather::Gathered;
use groups::{Change, Group};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use supertwin_lab::Library;
use supertwin_lab::align::{Alignment, Window, WindowArgument};
use supertwin_lab::limits::{Judged, Limits, Outcome, worst};
use supertwin_lab::metrics::{FAMILIES, Selection};
use verdicts::Row;

/// Arguments of `compare`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin run --seeds 20 --out runs/paper && supertwin compare runs/paper
                                                 the paper's table with intervals and verdicts
  supertwin compare a.rrd b.rrd --baseline a.rrd
  supertwin compare 'runs/*/paper-*.rrd' --align reversed --window 0:20
                                                 the twenty seconds after the direction is reversed
  supertwin compare runs/0007 --align 'event:net lost' --window -5:30
  supertwin compare runs/0007 --metrics measured,nis,'*_settling.*'
  supertwin compare --metrics help               every metric with unit and definition
  supertwin compare runs/0007 --limits paper     a gate: which runs pass
  supertwin compare runs/0007 --out all.rrd      and a picture: rerun all.rrd

Runs of one configuration form a group; several seeds are paired with the same seeds of the baseline's group. A verdict
needs 5 seeds, an interval of the mean difference without zero (95 %, bootstrap by percentiles, 10,000 resamples), and
more seeds for it than against it. Runs with shorter ticks are looked at where the longer ticks are (zero-order hold).

Exit status: 0 every run was compared (and passed), 1 a limit failed, 2 the call is wrong, or a run could not be used or
judged; the others are compared nevertheless.")]
pub(crate) struct CompareArguments {
    /// Recordings: files, folders, or patterns with *; the parts of a recording count once
    #[arg(value_name = "RUN")]
    runs: Vec<PathBuf>,

    /// What the others are held against [default: the group of the first run]
    #[arg(long, value_name = "RUN")]
    baseline: Option<PathBuf>,

    /// Time zero: start, following (the net), reversed (direction), fault, or event:TEXT (of `service: text`, * for anything)
    #[arg(long, value_name = "EVENT", default_value = "start")]
    align: Alignment,

    /// Seconds from time zero; either may be left out [default: where each run is scored; with --align: what all have]
    #[arg(long, value_name = "FROM:TO", allow_hyphen_values = true)]
    window: Option<WindowArgument>,

    /// Metrics, families or patterns with *, `usual`, `all`; `help` lists them
    #[arg(long, value_name = "A,B,...", value_delimiter = ',', default_value = "usual")]
    metrics: Vec<String>,

    /// Every run for itself, instead of by configuration
    #[arg(long)]
    each: bool,

    /// Limits that every run must keep: a name in config/limits, or a path
    #[arg(long, value_name = "FILE")]
    limits: Option<String>,

    /// Write the runs side by side into one recording, with a dashboard that compares them
    #[arg(long, value_name = "FILE.rrd")]
    out: Option<PathBuf>,

    /// Print one JSON object
    #[arg(long, conflicts_with = "markdown")]
    json: bool,

    /// Print Markdown
    #[arg(long)]
    markdown: bool,

    /// Write a table: a row per run, a column per metric
    #[arg(long, value_name = "FILE")]
    parquet: Option<PathBuf>,

    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

/// A run that was compared.
#[derive(Debug, Serialize)]
struct Run {
    file: PathBuf,
    name: String,
    /// Of its group.
    group: String,
    seed: Option<u64>,
    /// From its time zero on.
    window: Window,
    /// Moments of the window that were compared, and those that were not recorded.
    moments: u64,
    missing: u64,
    /// Time zero, from the start of the run.
    zero_s: f64,
    values: BTreeMap<String, f64>,
    judged: Vec<Judged>,
    outcome: Option<Outcome>,
}

/// A run that could not be used.
#[derive(Debug, Serialize)]
struct Unusable {
    file: PathBuf,
    reason: String,
}

/// The whole result, as `--json` prints it.
#[derive(Debug, Serialize)]
struct Comparison {
    align: String,
    tick_s: f64,
    baseline: String,
    groups: Vec<GroupReport>,
    runs: Vec<Run>,
    unusable: Vec<Unusable>,
    warnings: Vec<String>,
    /// Differences that a verdict was asked of.
    verdicts: usize,
    limits: Option<String>,
}

/// One group against the baseline.
#[derive(Debug, Serialize)]
struct GroupReport {
    name: String,
    trial: String,
    controller: String,
    placement: String,
    seeds: Vec<u64>,
    runs: usize,
    /// What is configured otherwise than in the baseline.
    changes: Vec<Change>,
    metrics: Vec<Row>,
}

/// Does it.
pub(crate) fn compare(arguments: &CompareArguments, library: &Library) -> Result<ExitCode, Failure> {
    if arguments.metrics.iter().any(|word| word == "help") {
        output::print(&help());
        return Ok(ExitCode::SUCCESS);
    }
    let (limits, mut selection) = asked(arguments, library)?;
    let mut shown = selection.clone();
    if let Some((_, limits)) = &limits {
        limits.select(&mut selection);
        if arguments.metrics == ["usual"] {
            shown.clone_from(&selection);
        }
    }
    // Said before the work, not after it.
    let mut written = arguments.parquet.iter().chain(&arguments.out);
    if let Some(path) = written.find(|path| path.exists() && !arguments.force) {
        return Err(Failure::Path {
            path: path.display().to_string(),
            cause: "exists already; use --force to replace it".to_owned(),
        });
    }
    let files = files::find(&arguments.runs, arguments.baseline.as_deref())?;
    let ask = gather::Ask {
        align: &arguments.align,
        window: arguments.window,
        selection: &selection,
        each: arguments.each,
        quiet: arguments.json,
    };
    let gathered = gather::gather(&files, &ask)?;
    let mut comparison = compared(gathered, &arguments.align, &shown, limits.as_ref());

    if let Some(path) = &arguments.parquet {
        table::write(&comparison, &selection, path, arguments.force)?;
    }
    let merged = arguments.out.as_ref().map(|path| merged::write(&comparison, &shown, path, arguments.force));
    let merged = merged.transpose()?;
    if let Some(merged) = &merged {
        let empty = merged.empty.iter().map(|name| format!("{name}: nothing of it is in the merged recording"));
        comparison.warnings.extend(empty);
    }
    if arguments.json {
        let text = serde_json::to_string_pretty(&comparison)
            .map_err(|cause| Failure::Call(format!("the report can't be written as JSON: {cause}")))?;
        output::print(&text);
    } else {
        output::print(&report::text(&comparison, &shown, arguments.markdown));
    }
    if let (Some(path), Some(merged)) = (&arguments.out, &merged) {
        let every = match merged.every_ticks {
            1 => String::new(),
            n => format!(", curves at every {n}th tick"),
        };
        let megabytes = merged.bytes as f64 / 1e6;
        output::warn(&format!(
            "{0}: {1} runs, {megabytes:.1} MB{every}; look at it with: rerun {0}",
            path.display(),
            merged.runs
        ));
    }
    for warning in &comparison.warnings {
        output::warn(&format!("warning: {warning}"));
    }
    for unusable in &comparison.unusable {
        output::warn(&format!("error: {}: {}", unusable.file.display(), unusable.reason));
    }
    Ok(status(&comparison))
}

/// The limits with their name, and the metrics that are wanted.
fn asked(arguments: &CompareArguments, library: &Library) -> Result<(Option<(String, Limits)>, Selection), Failure> {
    let selection = Selection::parse(arguments.metrics.iter().map(String::as_str))
        .map_err(|cause| Failure::Call(format!("--metrics: {cause}; `--metrics help` lists them")))?;
    let Some(name) = &arguments.limits else { return Ok((None, selection)) };
    let loaded = library.load::<Limits>("limits", "limits", name)?;
    supertwin_lab::trial::fits(&loaded.path, loaded.value.check())?;
    Ok((Some((loaded.path.display().to_string(), loaded.value)), selection))
}

fn compared(gathered: Gathered, align: &Alignment, shown: &Selection, limits: Option<&(String, Limits)>) -> Comparison {
    let Gathered { groups, unusable, mut warnings, tick_s } = gathered;
    let reference = &groups[0];
    let reports = verdicts::rows(&groups, shown).into_iter().zip(&groups).map(|(metrics, group)| GroupReport {
        name: group.name.clone(),
        trial: group.facts.trial.clone(),
        controller: group.facts.controller.clone(),
        placement: group.facts.placement.clone(),
        seeds: group.runs.iter().filter_map(|run| run.seed).collect(),
        runs: group.runs.len(),
        changes: groups::changes(&reference.facts, &group.facts),
        metrics,
    });
    let reports: Vec<GroupReport> = reports.collect();
    let verdicts = reports.iter().flat_map(|report| &report.metrics).filter(|row| row.difference.is_some()).count();
    let baseline = reference.name.clone();

    if let Some((name, limits)) = limits {
        let named = limits.limit.iter().filter_map(|limit| limit.group.as_ref());
        let unknown = named.filter(|name| groups.iter().all(|group| group.name != **name));
        warnings.extend(unknown.map(|group| format!("{name}: group {group:?} is not among these runs")));
    }
    let runs = groups.into_iter().flat_map(|Group { name, runs, .. }| {
        runs.into_iter().map(move |run| {
            let judged = limits.map(|(_, limits)| limits.judge(&name, &run.values)).unwrap_or_default();
            // A run that no limit concerns has not passed.
            let outcome = limits.map(|_| if judged.is_empty() { Outcome::Invalid } else { worst(&judged) });
            Run {
                file: run.file,
                name: run.name,
                group: name.clone(),
                seed: run.seed,
                window: run.window,
                moments: run.moments,
                missing: run.missing,
                zero_s: run.zero_s,
                values: run.values,
                judged,
                outcome,
            }
        })
    });
    Comparison {
        align: align.to_string(),
        tick_s,
        baseline,
        groups: reports,
        runs: runs.collect(),
        unusable,
        warnings,
        verdicts,
        limits: limits.map(|(name, _)| name.clone()),
    }
}

fn status(comparison: &Comparison) -> ExitCode {
    let outcomes = comparison.runs.iter().filter_map(|run| run.outcome);
    match outcomes.max() {
        Some(Outcome::Fail) => ExitCode::from(1),
        Some(Outcome::Invalid) => ExitCode::from(2),
        _ if !comparison.unusable.is_empty() => ExitCode::from(2),
        _ => ExitCode::SUCCESS,
    }
}

/// Every family with its names, unit, formula and definition.
fn help() -> String {
    let mut text =
        "Metrics: NAME [unit] formula: definition. e is value minus reference (the heading the short way round) at\n\
                    the moments i = 1...n of the window, Δt apart; `measured` as the estimator says, `true` as it is.\n"
            .to_owned();
    for family in FAMILIES {
        let names: Vec<String> = family
            .items
            .iter()
            .map(|(item, unit)| if item.is_empty() { format!("[{unit}]") } else { format!("{item} [{unit}]") })
            .collect();
        let dot = if family.items[0].0.is_empty() { " " } else { "." };
        text += &format!("\n{}{dot}{}\n    {}: {}\n", family.name, names.join(", "), family.formula, family.about);
    }
    text
}
