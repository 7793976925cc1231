//! Runs beside each other, with verdicts that are careful.

mod changes;
mod files;
mod gather;
mod merged;
mod metric_comparison;
mod run_group;
mod table;

use crate::{OperationError, Progress};
pub use changes::changes_text;
use gather::Gathered;
pub use metric_comparison::MetricComparison;
pub use run_group::Change;
use run_group::RunGroup;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use supertwin_lab::Library;
use supertwin_lab::align::{Alignment, Window, WindowArgument};
use supertwin_lab::limits::{Judged, Limits, Outcome, worst};
use supertwin_lab::metrics::Selection;
use supertwin_rerun::{Merged, merge};

/// What is compared, and how.
#[derive(Clone, Debug)]
pub struct CompareOptions {
    /// Recordings: files, folders, or patterns with *.
    pub runs: Vec<PathBuf>,
    /// What the others are compared with; `None`: the group of the first run.
    pub baseline: Option<PathBuf>,
    /// Moment of each run that is time zero.
    pub align: Alignment,
    /// Seconds from time zero; `None`: where each run is scored, or what all have in common.
    pub window: Option<WindowArgument>,
    /// Metrics, families or patterns with *, `usual`, `all`.
    pub metrics: Vec<String>,
    /// Every run for itself, instead of by configuration.
    pub each: bool,
    /// Limits that every run must keep: a name in `config/limits`, or a path.
    pub limits: Option<String>,
}

/// A run that was compared.
#[derive(Debug, Serialize)]
pub struct Run {
    /// Path of the recording as it was found.
    pub file: PathBuf,
    /// Name that is unique in the comparison.
    pub name: String,
    /// Of its group.
    pub group: String,
    /// Seed of the run; `None` when the recording states none.
    pub seed: Option<u64>,
    /// From its time zero on.
    pub window: Window,
    /// Moments of the window that were compared.
    pub moments: u64,
    /// Moments of the window that were not recorded.
    pub missing: u64,
    /// Time zero, from the start of the run.
    pub zero_s: f64,
    /// Metrics by name.
    pub values: BTreeMap<String, f64>,
    /// What the limits say of it.
    pub judged: Vec<Judged>,
    /// The worst of them.
    pub outcome: Option<Outcome>,
}

/// A run that could not be used.
#[derive(Debug, Serialize)]
pub struct Unusable {
    /// Path of the recording as it was found.
    pub file: PathBuf,
    /// What is wrong with it.
    pub reason: String,
}

/// The whole result, as `--json` prints it.
#[derive(Debug, Serialize)]
pub struct Comparison {
    /// Moment of each run that is time zero, as `--align` writes it.
    pub align: String,
    /// Distance of the compared moments in seconds.
    pub tick_s: f64,
    /// Group that the others are compared with.
    pub baseline: String,
    /// The first is the baseline.
    pub groups: Vec<GroupReport>,
    /// Runs that were compared.
    pub runs: Vec<Run>,
    /// Runs that could not be used.
    pub unusable: Vec<Unusable>,
    /// What should be known beside that.
    pub warnings: Vec<String>,
    /// Differences that a verdict was asked of.
    pub verdicts: usize,
    /// File of the limits.
    pub limits: Option<String>,
    /// The metrics that are shown.
    #[serde(skip)]
    pub shown: Selection,
    /// Those, and the ones that limits ask for.
    #[serde(skip)]
    selection: Selection,
}

/// One group against the baseline.
#[derive(Debug, Serialize)]
pub struct GroupReport {
    /// Name that is unique in the comparison.
    pub name: String,
    /// Trial that all runs of the group repeat.
    pub trial: String,
    /// Controller that all runs of the group have.
    pub controller: String,
    /// How it was run: batch, lockstep, realtime.
    pub placement: String,
    /// Seeds of its runs.
    pub seeds: Vec<u64>,
    /// Number of its runs.
    pub runs: usize,
    /// What is configured otherwise than in the baseline.
    pub changes: Vec<Change>,
    /// In the order of the metrics that are shown.
    pub metrics: Vec<MetricComparison>,
}

/// Reads and compares the runs.
///
/// # Errors
/// An option is wrong, or there is nothing to compare; a single run that can't be used is in the result.
pub fn compare(
    options: &CompareOptions,
    library: &Library,
    progress: &dyn Progress,
) -> Result<Comparison, OperationError> {
    let (limits, mut selection) = asked(options, library)?;
    let mut shown = selection.clone();
    if let Some((_, limits)) = &limits {
        limits.select(&mut selection);
        if options.metrics == ["usual"] {
            shown.clone_from(&selection);
        }
    }
    let files = files::find(&options.runs, options.baseline.as_deref())?;
    let gathered = gather::gather(&files, options, &selection, progress)?;
    Ok(compared(gathered, &options.align, shown, selection, limits.as_ref()))
}

impl Comparison {
    /// Writes a table: a row per run, a column per metric.
    ///
    /// # Errors
    /// The file can't be written, or is there and `force` is not given.
    pub fn write_table(&self, path: &Path, force: bool) -> Result<(), OperationError> {
        let table = table::table(self, &self.selection).and_then(|table| table.write(path, force));
        table.map_err(|error| OperationError::at(path, &error))
    }

    /// Writes the runs side by side into one recording.
    ///
    /// # Errors
    /// A recording can't be read, or the file can't be written, or is there and `force` is not given.
    pub fn write_recording(&mut self, path: &Path, force: bool) -> Result<Merged, OperationError> {
        let merged = merged::plan(self, &self.shown).and_then(|plan| merge(&plan, path, force));
        let merged = merged.map_err(|error| OperationError::at(path, &error))?;
        let empty = merged.empty.iter().map(|name| format!("{name}: nothing of it is in the merged recording"));
        self.warnings.extend(empty);
        Ok(merged)
    }
}

/// The limits with their name, and the metrics that are wanted.
fn asked(options: &CompareOptions, library: &Library) -> Result<(Option<(String, Limits)>, Selection), OperationError> {
    let selection = Selection::parse(options.metrics.iter().map(String::as_str))
        .map_err(|cause| OperationError::Option(format!("--metrics: {cause}; `--metrics help` lists them")))?;
    let Some(name) = &options.limits else { return Ok((None, selection)) };
    let loaded = library.load::<Limits>("limits", "limits", name)?;
    supertwin_lab::trial::fits(&loaded.path, loaded.value.check())?;
    Ok((Some((loaded.path.display().to_string(), loaded.value)), selection))
}

fn compared(
    gathered: Gathered,
    align: &Alignment,
    shown: Selection,
    selection: Selection,
    limits: Option<&(String, Limits)>,
) -> Comparison {
    let Gathered { groups, unusable, mut warnings, tick_s } = gathered;
    let reference = &groups[0];
    let reports =
        metric_comparison::rows(&groups, &shown).into_iter().zip(&groups).map(|(metrics, group)| GroupReport {
            name: group.name.clone(),
            trial: group.facts.trial.clone(),
            controller: group.facts.controller.clone(),
            placement: group.facts.placement.clone(),
            seeds: group.runs.iter().filter_map(|run| run.seed).collect(),
            runs: group.runs.len(),
            changes: run_group::changes(&reference.facts, &group.facts),
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
    let mut runs = Vec::new();
    for RunGroup { name, runs: members, .. } in groups {
        for mut run in members {
            if let Some((_, limits)) = limits {
                run.judged = limits.judge(&name, &run.values);
                // A run that no limit concerns has not passed.
                run.outcome = Some(if run.judged.is_empty() { Outcome::Invalid } else { worst(&run.judged) });
            }
            run.group.clone_from(&name);
            runs.push(run);
        }
    }
    Comparison {
        align: align.to_string(),
        tick_s,
        baseline,
        groups: reports,
        runs,
        unusable,
        warnings,
        verdicts,
        limits: limits.map(|(name, _)| name.clone()),
        shown,
        selection,
    }
}
