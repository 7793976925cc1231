//! `supertwin compare`: runs beside each other, with verdicts that are careful.

mod report;

use crate::terminal::{self, Bar};
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use supertwin_lab::Library;
use supertwin_lab::align::{Alignment, WindowArgument};
use supertwin_lab::limits::Outcome;
use supertwin_lab::metrics::FAMILIES;
use supertwin_operations::OperationError;
use supertwin_operations::compare::{self, CompareOptions, Comparison};

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

/// Compares the runs, writes what is asked for, and prints the result.
pub(crate) fn compare(arguments: &CompareArguments, library: &Library) -> Result<ExitCode, OperationError> {
    if arguments.metrics.iter().any(|word| word == "help") {
        terminal::print(&help());
        return Ok(ExitCode::SUCCESS);
    }
    // Said before the work, not after it.
    let mut written = arguments.parquet.iter().chain(&arguments.out);
    if let Some(path) = written.find(|path| path.exists() && !arguments.force) {
        return Err(OperationError::at(path, &"exists already; use --force to replace it"));
    }
    let options = CompareOptions {
        runs: arguments.runs.clone(),
        baseline: arguments.baseline.clone(),
        align: arguments.align.clone(),
        window: arguments.window,
        metrics: arguments.metrics.clone(),
        each: arguments.each,
        limits: arguments.limits.clone(),
    };
    let mut comparison = compare::compare(&options, library, &Bar::new(arguments.json))?;
    if let Some(path) = &arguments.parquet {
        comparison.write_table(path, arguments.force)?;
    }
    let merged = arguments.out.as_ref().map(|path| comparison.write_recording(path, arguments.force)).transpose()?;
    if arguments.json {
        terminal::print_json(&comparison)?;
    } else {
        terminal::print(&report::text(&comparison, arguments.markdown));
    }
    if let (Some(path), Some(merged)) = (&arguments.out, &merged) {
        let every = match merged.every_ticks {
            1 => String::new(),
            n => format!(", curves at every {n}th tick"),
        };
        let megabytes = merged.bytes as f64 / 1e6;
        terminal::warn(&format!(
            "{0}: {1} runs, {megabytes:.1} MB{every}; look at it with: rerun {0}",
            path.display(),
            merged.runs
        ));
    }
    for warning in &comparison.warnings {
        terminal::warn(&format!("warning: {warning}"));
    }
    for unusable in &comparison.unusable {
        terminal::warn(&format!("error: {}: {}", unusable.file.display(), unusable.reason));
    }
    Ok(status(&comparison))
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
