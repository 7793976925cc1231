//! From files to evaluated runs: what each is, where its window lies, its metrics; all cores read.

use super::files::Files;
use super::run_group::{self, Facts, RunGroup};
use super::{CompareOptions, Run, Unusable};
use crate::error::without_prefix;
use crate::{OperationError, Progress};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use supertwin_core::Property;
use supertwin_core::run::{FORMAT, Properties};
use supertwin_lab::align::{Alignment, Grid, Window, WindowArgument};
use supertwin_lab::metrics::{Evaluated, Selection, evaluate};
use supertwin_rerun::{ReadError, Recording, read_selected};

/// A run of which less than this share of the window was recorded is not compared.
const LEAST_COVERAGE: f64 = 0.9;
/// Shows where a recording ends that does not say how long its run was to be.
const SHORT_SIGNAL: &str = supertwin_core::signal::reference::SETPOINT.path;

/// What was found.
pub(super) struct Gathered {
    /// The first is the baseline.
    pub(super) groups: Vec<RunGroup>,
    pub(super) unusable: Vec<Unusable>,
    pub(super) warnings: Vec<String>,
    pub(super) tick_s: f64,
}

/// A recording before its signals are read.
struct Found {
    file: PathBuf,
    name: String,
    facts: Facts,
    seed: Option<u64>,
    hash: Option<String>,
    tick_s: f64,
    /// Tick that is time zero of this run.
    origin: i64,
    /// What it would be compared over if it were alone.
    window: Window,
    warnings: Vec<String>,
}

/// Reads and evaluates all of them.
pub(super) fn gather(
    files: &Files,
    options: &CompareOptions,
    selection: &Selection,
    progress: &dyn Progress,
) -> Result<Gathered, OperationError> {
    progress.begin("recordings", 2 * files.paths.len() as u64);
    let mut warnings = Vec::new();
    let (found, mut unusable) = look_at_all(files, &options.align, progress, &mut warnings);
    if let Some(baseline) = &files.baseline
        && !found.iter().any(|run| files.is_baseline(&run.file))
    {
        let reason = unusable.iter().find(|unusable| baseline.contains(&unusable.file));
        return Err(OperationError::Path {
            path: baseline.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", "),
            cause: format!("can't be the baseline: {}", reason.map_or("no such run", |unusable| &unusable.reason)),
        });
    }
    let found = of_one_vehicle(found, files, &mut unusable);
    let found = without_doubles(found, &mut warnings);
    let common = common(&found, options.window.unwrap_or_default());
    let (Some(tick_s), Some(common)) = (coarsest(&found), common) else {
        unusable.extend(found.into_iter().map(|run| Unusable {
            reason: format!("nothing of it is in the window: it ends {:.2} s from time zero", run.window.to_s),
            file: run.file,
        }));
        return Err(nothing("none of these runs can be compared", &unusable));
    };
    let evaluated = evaluate_all(found, common, tick_s, options, selection, progress, &mut unusable);
    progress.end();
    warnings.extend(evaluated.iter().flat_map(|(run, evaluated)| restrictions(run, evaluated, tick_s)));
    let groups = grouped(evaluated, files, options.each, &unusable)?;
    Ok(Gathered { groups, unusable, warnings, tick_s })
}

/// What every recording is, and what can't be used.
fn look_at_all(
    files: &Files,
    align: &Alignment,
    progress: &dyn Progress,
    warnings: &mut Vec<String>,
) -> (Vec<Found>, Vec<Unusable>) {
    let look = |path: &PathBuf| {
        let found = look(path, align);
        progress.advance(1);
        found.map_err(|reason| Unusable { file: path.clone(), reason })
    };
    let looked: Vec<Result<Option<Found>, Unusable>> = files.paths.par_iter().map(look).collect();
    let (mut found, mut unusable) = (Vec::new(), Vec::new());
    for (result, path) in looked.into_iter().zip(&files.paths) {
        match result {
            Ok(Some(run)) => found.push(run),
            // Made by an earlier call, perhaps in the same folder.
            Ok(None) => warnings.push(format!("{}: a comparison, not a recording of a run; left out", path.display())),
            Err(reason) => unusable.push(reason),
        }
    }
    (found, unusable)
}

/// The metrics of all runs, each over the window that is asked for.
fn evaluate_all(
    found: Vec<Found>,
    common: Window,
    tick_s: f64,
    options: &CompareOptions,
    selection: &Selection,
    progress: &dyn Progress,
    unusable: &mut Vec<Unusable>,
) -> Vec<(Found, Evaluated)> {
    let own = options.window.is_none() && options.align == Alignment::Start;
    let evaluate = |run: Found| {
        let window = if own { run.window } else { common };
        let evaluated = look_closer(&run, window, tick_s, selection);
        progress.advance(1);
        match evaluated {
            Ok(evaluated) => Ok((Found { window, ..run }, evaluated)),
            Err(reason) => Err(Unusable { file: run.file, reason }),
        }
    };
    let evaluated: Vec<Result<(Found, Evaluated), Unusable>> = found.into_par_iter().map(evaluate).collect();
    evaluated.into_iter().filter_map(|result| result.map_err(|reason| unusable.push(reason)).ok()).collect()
}

/// What should be known of a run that was evaluated.
fn restrictions(run: &Found, evaluated: &Evaluated, tick_s: f64) -> Vec<String> {
    let mut restrictions = run.warnings.clone();
    let Evaluated { moments, missing, .. } = evaluated;
    if *missing > 0 {
        restrictions.push(format!("{missing} of {} moments of the window were not recorded", moments + missing));
    }
    if (run.tick_s / tick_s - 1.0).abs() > 1e-9 {
        let own = run.tick_s;
        restrictions.push(format!("its ticks of {own} s are looked at every {tick_s} s (zero-order hold)"));
    }
    restrictions.into_iter().map(|text| format!("{}: {text}", run.file.display())).collect()
}

/// Groups of runs that differ in their seeds only; the baseline comes first.
fn grouped(
    evaluated: Vec<(Found, Evaluated)>,
    files: &Files,
    each: bool,
    unusable: &[Unusable],
) -> Result<Vec<RunGroup>, OperationError> {
    let mut groups: Vec<RunGroup> = Vec::new();
    let mut baseline = None;
    for (run, Evaluated { values, moments, missing }) in evaluated {
        let is_baseline = files.is_baseline(&run.file);
        let zero_s = run.origin as f64 * run.tick_s;
        let Found { file, name, facts, seed, window, .. } = run;
        // Its group is named, and limits are put to it, when all are known.
        let (group, judged, outcome) = (String::new(), Vec::new(), None);
        let run = Run { file, name, group, seed, window, moments, missing, zero_s, values, judged, outcome };
        let at = groups.iter().position(|group| !each && group.facts == facts).unwrap_or_else(|| {
            groups.push(RunGroup { name: String::new(), facts, runs: Vec::new() });
            groups.len() - 1
        });
        if is_baseline && baseline.is_none() {
            baseline = Some(at);
        }
        groups[at].runs.push(run);
    }
    if groups.is_empty() {
        return Err(nothing("none of these runs can be compared", unusable));
    }
    if baseline.is_none() && files.baseline.is_some() {
        return Err(nothing("nothing of the baseline can be compared", unusable));
    }
    for group in &mut groups {
        group.runs.sort_by_key(|run| run.seed);
    }
    groups[..=baseline.unwrap_or(0)].rotate_right(1);
    run_group::name(&mut groups, each);
    Ok(groups)
}

/// There is nothing to compare: every reason.
fn nothing(what: &str, unusable: &[Unusable]) -> OperationError {
    let reasons = unusable.iter().map(|unusable| format!("\n  {}: {}", unusable.file.display(), unusable.reason));
    OperationError::Option(format!("{what}{}", reasons.collect::<String>()))
}

/// A recording with what is wanted of it.
fn read(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<Recording, String> {
    read_selected(path, wanted).map_err(|error| without_prefix(&path.display().to_string(), &error))
}

/// What a recording is; `None` when it is several runs side by side.
fn look(path: &Path, align: &Alignment) -> Result<Option<Found>, String> {
    let recording = match read_selected(path, &|path| align.is_needed(path)) {
        Err(ReadError::Comparison { .. }) => return Ok(None),
        other => other.map_err(|error| without_prefix(&path.display().to_string(), &error))?,
    };
    let empty = Properties::new();
    let run = recording.properties.get("run").unwrap_or(&empty);
    let result = recording.properties.get("result").unwrap_or(&empty);
    let number = |name: &str| match run.get(name) {
        Some(Property::Number(number)) => Some(*number),
        _ => None,
    };
    if let Some(Property::Integer(format)) = run.get("format")
        && *format < FORMAT
    {
        return Err(format!("format = {format}: must be {FORMAT}; an older supertwin wrote this"));
    }
    if let Some(Property::Text(error)) = result.get("error") {
        return Err(format!("the run ended with an error: {error}"));
    }
    let facts = Facts::new(run)?;
    let tick_s = number("tick_s").filter(|tick_s| *tick_s > 0.0).ok_or("property tick_s is not there")?;
    let origin = align.find(&recording)?;
    let zero_s = origin as f64 * tick_s;
    let ends_s = match number("duration_s") {
        Some(duration_s) => duration_s,
        None => {
            let signal = read(path, &|path| path == SHORT_SIGNAL)?;
            signal.last_tick().map_or(0.0, |last| (last + 1) as f64 * tick_s)
        }
    };
    let from_s = if *align == Alignment::Start { number("score_from_s").unwrap_or(0.0) } else { 0.0 };
    let mut warnings: Vec<String> = recording.damage.iter().take(2).map(|damage| damage.problem.clone()).collect();
    if result.get("complete") == Some(&Property::Integer(0)) {
        warnings.push("the run was stopped before its end".to_owned());
    }
    let seed = match run.get("seed") {
        Some(Property::Integer(seed)) => Some(*seed),
        _ => None,
    };
    let hash = match result.get("hash") {
        Some(Property::Text(hash)) => Some(hash.clone()),
        _ => None,
    };
    Ok(Some(Found {
        file: path.to_owned(),
        name: recording.name.clone(),
        facts,
        seed,
        hash,
        tick_s,
        origin,
        window: Window { from_s, to_s: ends_s - zero_s },
        warnings,
    }))
}

fn look_closer(run: &Found, window: Window, tick_s: f64, selection: &Selection) -> Result<Evaluated, String> {
    let recording = read(&run.file, &|path| selection.is_needed(path))?;
    let grid = Grid::new(run.origin, run.tick_s, window, tick_s);
    let evaluated = evaluate(&recording, &grid, selection).map_err(|error| without_prefix(&recording.name, &error))?;
    if evaluated.coverage() < LEAST_COVERAGE {
        return Err(format!(
            "only {:.2} of {:.2} s of the window were recorded; name a shorter one with --window",
            evaluated.moments as f64 * tick_s,
            grid.len() as f64 * tick_s
        ));
    }
    Ok(evaluated)
}

/// Errors of different vehicles have nothing to do with each other: the baseline's vehicle counts, or the one that most
/// runs have.
fn of_one_vehicle(found: Vec<Found>, files: &Files, unusable: &mut Vec<Unusable>) -> Vec<Found> {
    let mut counts = BTreeMap::<&str, usize>::new();
    found.iter().for_each(|run| *counts.entry(run.facts.vehicle.as_str()).or_default() += 1);
    let most = found.iter().map(|run| run.facts.vehicle.as_str()).rev().max_by_key(|vehicle| counts[vehicle]);
    let baseline = found.iter().find(|run| files.is_baseline(&run.file));
    let Some(vehicle) = baseline.map(|run| run.facts.vehicle.as_str()).or(most).map(str::to_owned) else {
        return found;
    };
    let (same, other): (Vec<Found>, Vec<Found>) = found.into_iter().partition(|run| run.facts.vehicle == vehicle);
    unusable.extend(other.into_iter().map(|run| Unusable {
        reason: format!("vehicle = {:?}: the others have {vehicle:?}", run.facts.vehicle),
        file: run.file,
    }));
    same
}

/// Two recordings with the same configuration, seed and state hash are the same run.
fn without_doubles(found: Vec<Found>, warnings: &mut Vec<String>) -> Vec<Found> {
    let mut kept: Vec<Found> = Vec::with_capacity(found.len());
    let mut first = BTreeMap::<(u64, String), PathBuf>::new();
    for run in found {
        if let (Some(seed), Some(hash)) = (run.seed, &run.hash) {
            // The hash covers every signal at every tick; only equal configurations are one group anyway.
            let key = (seed, format!("{hash} {}", run.facts.provenance()));
            if let Some(same) = first.get(&key) {
                warnings.push(format!("{}: the same run as {}; counted once", run.file.display(), same.display()));
                continue;
            }
            first.insert(key, run.file.clone());
        }
        kept.push(run);
    }
    kept
}

fn coarsest(found: &[Found]) -> Option<f64> {
    found.iter().map(|run| run.tick_s).reduce(f64::max)
}

/// As asked for, the rest as the runs have it in common.
fn common(found: &[Found], asked: WindowArgument) -> Option<Window> {
    let own = |run: &Found| Window {
        from_s: asked.from_s.unwrap_or(run.window.from_s),
        to_s: asked.to_s.unwrap_or(run.window.to_s),
    };
    Window::common(found.iter().map(own))
}
