//! Campaigns: which trials, seeds and parameters; read from a file, as a list of runs in a fixed order.
//!
//! A parameter with `values`, or with `from`, `to` and `steps`, is part of the grid: every value meets every other one.
//! One with `from` and `to` alone is sampled by a Latin hypercube. See `config/sweeps`.

mod influence;
mod plan;
mod samples;

pub use influence::rank_correlation;
pub use plan::{Configuration, Plan, PlannedRun, Point};

use crate::config::{ConfigError, Library, Override, at, parse};
use crate::limits::Limits;
use crate::score::Scores;
use crate::trial::fits;
use schemars::{JsonSchema, Schema, schema_for};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::path::PathBuf;
use supertwin_core::Axes;
use supertwin_core::check::Finite;
use toml::{Spanned, Value};

/// More runs than this are a slip of the pen.
pub const MOST_RUNS: usize = 1_000_000;

/// A sweep file as it is written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SweepFile {
    /// The question, and where the numbers come from.
    description: String,
    /// Files in `trials/`, or paths.
    #[schemars(with = "Vec<String>")]
    trials: Spanned<Vec<Spanned<String>>>,
    /// Seeds of each configuration.
    #[schemars(with = "SeedsFile")]
    seeds: Spanned<SeedsFile>,
    /// What is varied.
    #[serde(default)]
    #[schemars(with = "Vec<ParameterFile>")]
    parameter: Vec<Spanned<ParameterFile>>,
    /// How parameters that have a range and no `steps` are sampled.
    #[schemars(with = "Option<LatinHypercubeFile>")]
    latin_hypercube: Option<Spanned<LatinHypercubeFile>>,
    /// Which recordings are kept; none unless told otherwise.
    recordings: Option<KeepRecordings>,
    /// File in `limits/`: a verdict for every run.
    #[schemars(with = "Option<String>")]
    limits: Option<Spanned<String>>,
    /// Controller that the report pairs the others with.
    baseline: Option<String>,
    /// Groups of controllers: the report counts in how many seeds each is best of its group.
    #[serde(default)]
    best_of: Vec<Vec<String>>,
}

/// Seeds as they are written: `count` from `start` on, or a `list`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SeedsFile {
    /// The first seed.
    start: Option<u64>,
    /// Number of seeds, one after the other from `start`.
    count: Option<u64>,
    /// These seeds, in the place of `start` and `count`.
    list: Option<Vec<u64>>,
}

/// A parameter as it is written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct ParameterFile {
    /// Column in the table; without it, the path.
    name: Option<String>,
    /// The value that it replaces, as in `--set`.
    #[schemars(with = "Option<String>")]
    path: Option<Spanned<String>>,
    /// Several values that it replaces at once.
    #[schemars(with = "Option<Vec<String>>")]
    paths: Option<Vec<Spanned<String>>>,
    /// What it takes; a parameter has either these or a range.
    #[schemars(with = "Option<Vec<serde_json::Value>>")]
    values: Option<Vec<Value>>,
    /// Lower end of a range.
    from: Option<Finite>,
    /// Upper end of a range.
    to: Option<Finite>,
    /// Values of the range; without them the Latin hypercube draws from it.
    steps: Option<usize>,
    /// How the range is divided.
    spacing: Option<Spacing>,
    /// Multiplies what the files say instead of replacing it.
    times: Option<bool>,
}

/// The Latin hypercube as it is written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LatinHypercubeFile {
    /// How many samples.
    samples: usize,
    /// Seed of the samples; not that of the runs.
    seed: u64,
    /// Each sample is run with a seed of its own.
    seed_per_sample: Option<bool>,
}

/// What a sweep's file may hold.
pub(crate) fn schema() -> Schema {
    schema_for!(SweepFile)
}

/// How a range is divided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
enum Spacing {
    /// Neighbouring values have equal differences.
    #[default]
    Linear,
    /// Neighbouring values have equal ratios.
    Logarithmic,
}

impl Spacing {
    /// The value at a `share` of the way.
    fn between(self, from: f64, to: f64, share: f64) -> f64 {
        match self {
            Self::Linear => from + (to - from) * share,
            Self::Logarithmic => from * libm::exp(libm::log(to / from) * share),
        }
    }
}

/// Which recordings are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum KeepRecordings {
    /// Those of all runs.
    All,
    /// Those of runs that break a limit or end in NaN.
    OnFail,
    /// No recording is kept.
    #[default]
    None,
}

/// A parameter with the values it takes.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its column in the table.
    pub name: String,
    /// The values that it replaces, as in `--set`.
    pub places: Vec<String>,
    /// It multiplies what the files say.
    pub times: bool,
    /// Drawn by the Latin hypercube, a value per sample; else part of the grid.
    pub sampled: bool,
    /// What it takes, in order.
    pub values: Vec<Value>,
    /// Where it stands in the file.
    offset: usize,
}

impl Parameter {
    fn overrides(&self, choice: usize) -> Result<Vec<Override>, String> {
        let value = &self.values[choice];
        self.places.iter().map(|place| Override::new(place, value.clone(), self.times)).collect()
    }

    /// Whether it has a place in the file of one of these laws.
    fn concerns(&self, laws: &[&str]) -> bool {
        let of = |place: &String| Override::new(place, Value::Boolean(true), false).ok();
        let mut overrides = self.places.iter().filter_map(of);
        overrides.any(|over| over.law().is_none_or(|law| laws.contains(&law)))
    }
}

/// A campaign as it was understood.
#[derive(Clone, Debug)]
pub struct Sweep {
    /// The file's stem.
    pub name: String,
    /// Path of the file as it was given.
    pub path: PathBuf,
    /// What it is for.
    pub description: String,
    /// Names or paths of trials.
    pub trials: Vec<String>,
    /// Seeds of every configuration; with `seed_per_sample`, of the first sample alone.
    pub seeds: Vec<u64>,
    /// Parameters that change from run to run, in the order of the file.
    pub parameters: Vec<Parameter>,
    /// Samples of the Latin hypercube; 1 without.
    pub samples: usize,
    /// Each sample has one seed of its own, counted up.
    pub seed_per_sample: bool,
    /// Which recordings are kept.
    pub keep_recordings: KeepRecordings,
    /// File in `limits/` that says which scores pass, with its place for errors.
    limits: Option<Spanned<String>>,
    /// The controller that the others are compared with.
    pub baseline: Option<String>,
    /// Groups of controllers of which the best is counted, seed by seed.
    pub best_of: Vec<Vec<String>>,
    /// The file's text.
    pub text: String,
}

impl Sweep {
    /// Reads a sweep: a name in `sweeps/`, or a path. Trials are not read yet.
    ///
    /// # Errors
    /// Names the file, the line and column, the value and the rule.
    pub fn load(library: &Library, name: &str) -> Result<Self, ConfigError> {
        let (path, text) = library.read("sweep", "sweeps", name)?;
        Self::parse(path, text)
    }

    fn parse(path: PathBuf, text: String) -> Result<Self, ConfigError> {
        let shown = path.display().to_string();
        let file: SweepFile = parse(&shown, &text)?;
        let wrong = |offset: usize, message: String| at(&shown, &text, offset, message);
        if file.trials.get_ref().is_empty() {
            return Err(wrong(file.trials.span().start, "trials = []: must name at least one trial".to_owned()));
        }
        let mut trials: Vec<String> = Vec::new();
        for trial in file.trials.into_inner() {
            if trials.contains(trial.get_ref()) {
                return Err(wrong(trial.span().start, format!("trials: `{}` is named twice", trial.get_ref())));
            }
            trials.push(trial.into_inner());
        }

        let hypercube = file.latin_hypercube.as_ref().map(|written| (written.span().start, written.get_ref()));
        let seed_per_sample = hypercube.is_some_and(|(_, hypercube)| hypercube.seed_per_sample.unwrap_or(false));
        let seeds = seeds(file.seeds.get_ref(), seed_per_sample)
            .map_err(|message| wrong(file.seeds.span().start, format!("seeds: {message}")))?;
        let samples = hypercube.map_or(1, |(_, hypercube)| hypercube.samples);
        if let Some((offset, _)) = hypercube
            && !(1..=MOST_RUNS).contains(&samples)
        {
            return Err(wrong(offset, format!("latin_hypercube: samples = {samples}: must be 1 to {MOST_RUNS}")));
        }
        let drawn = hypercube.map(|(_, hypercube)| (hypercube.seed, hypercube.samples));
        let mut parameters: Vec<Parameter> = Vec::new();
        for written in file.parameter {
            let offset = written.span().start;
            let parameter = parameter(written.into_inner(), offset, drawn)
                .map_err(|(place, message)| wrong(place, format!("parameter: {message}")))?;
            if parameters.iter().any(|other| other.name == parameter.name) {
                return Err(wrong(offset, format!("parameter {}: is there already", parameter.name)));
            }
            for place in &parameter.places {
                if let Some(other) = parameters.iter().find(|other| other.places.contains(place)) {
                    return Err(wrong(offset, format!("parameter {}: {} has {place}", parameter.name, other.name)));
                }
            }
            parameters.push(parameter);
        }
        if let Some((offset, _)) = hypercube
            && !parameters.iter().any(|parameter| parameter.sampled)
        {
            let message = "latin_hypercube: no parameter has a range without `steps` to be sampled".to_owned();
            return Err(wrong(offset, message));
        }

        let name = path.file_stem().map_or_else(|| "sweep".to_owned(), |stem| stem.to_string_lossy().into_owned());
        Ok(Self {
            name,
            path,
            description: file.description,
            trials,
            seeds,
            parameters,
            samples,
            seed_per_sample,
            keep_recordings: file.recordings.unwrap_or_default(),
            limits: file.limits,
            baseline: file.baseline,
            best_of: file.best_of,
            text,
        })
    }

    /// Reads the limits, with the text of their file.
    ///
    /// # Errors
    /// When there are no such limits, they are wrong, or they limit what the score of a run does not have.
    pub fn limits(&self, library: &Library) -> Result<Option<(Limits, String)>, ConfigError> {
        let Some(name) = &self.limits else { return Ok(None) };
        let loaded = library.load::<Limits>("limits", "limits", name.get_ref())?;
        fits(&loaded.path, loaded.value.check())?;
        // Every score that there can be.
        let scores = Scores { outside_alpha_tol_share: Some(Axes::default()), ..Scores::default() }.properties();
        if let Some(limit) = loaded.value.limit.iter().find(|limit| !scores.contains_key(limit.metric.as_str())) {
            let metric = limit.metric.as_str();
            let message = format!("limits: {metric} is no score of a run: `compare` knows it, a sweep does not");
            return Err(at(&self.path.display().to_string(), &self.text, name.span().start, message));
        }
        let text = loaded.table.to_string();
        Ok(Some((loaded.value, text)))
    }

    /// An error at a parameter.
    fn wrong(&self, parameter: &Parameter, message: &str) -> ConfigError {
        let message = format!("parameter {}: {message}", parameter.name);
        at(&self.path.display().to_string(), &self.text, parameter.offset, message)
    }

    /// Which controllers are named must be among those that run.
    fn check_names(&self, known: &BTreeSet<&str>) -> Result<(), ConfigError> {
        let named = self.baseline.iter().map(|name| ("baseline", name));
        let named = named.chain(self.best_of.iter().flatten().map(|name| ("best_of", name)));
        for (key, name) in named {
            if !known.contains(name.as_str()) {
                let hint = crate::config::suggestion(name, known.iter().copied());
                let known: Vec<&str> = known.iter().copied().collect();
                let message = format!("{key}: `{name}` is no controller here; there are {}{hint}", known.join(", "));
                return fits(&self.path, Err(message));
            }
        }
        Ok(())
    }
}

/// The seeds in order.
fn seeds(file: &SeedsFile, per_sample: bool) -> Result<Vec<u64>, String> {
    let most = MOST_RUNS as u64;
    let seeds = match (file.start, file.count, &file.list) {
        (Some(start), None, None) if per_sample => vec![start],
        _ if per_sample => {
            return Err("seed_per_sample takes `start` alone: sample i has the seed start + i".to_owned());
        }
        (Some(start), Some(count), None) if (1..=most).contains(&count) => {
            let end = start.checked_add(count).ok_or_else(|| format!("from {start} on there are not that many"))?;
            (start..end).collect()
        }
        (Some(_), Some(count), None) => return Err(format!("count = {count}: must be 1 to {most}")),
        (None, None, Some(list)) if !list.is_empty() => list.clone(),
        _ => return Err("must be `start` and `count`, or a `list`".to_owned()),
    };
    let mut seen = BTreeSet::new();
    match seeds.iter().find(|seed| !seen.insert(**seed)) {
        Some(twice) => Err(format!("{twice} is there twice")),
        None => Ok(seeds),
    }
}

/// A parameter with its values; errors come with their place. `drawn`: seed and samples of the Latin hypercube.
fn parameter(file: ParameterFile, offset: usize, drawn: Option<(u64, usize)>) -> Result<Parameter, (usize, String)> {
    let here = |message: &str| (offset, message.to_owned());
    let places = match (file.path, file.paths) {
        (Some(path), None) => vec![path],
        (None, Some(paths)) if !paths.is_empty() => paths,
        _ => return Err(here("must have a `path` such as environment.waves.significant_height_m, or `paths`")),
    };
    for place in &places {
        Override::new(place.get_ref(), Value::Boolean(true), false).map_err(|message| (place.span().start, message))?;
    }
    let places: Vec<String> = places.into_iter().map(Spanned::into_inner).collect();
    let name = match file.name {
        Some(name) if name.trim().is_empty() => return Err(here("name: must not be empty")),
        Some(name) => name,
        None if places.len() == 1 => places[0].clone(),
        None => return Err(here("several `paths` need a `name`")),
    };
    let named = |message: String| (offset, format!("{name}: {message}"));
    let times = file.times.unwrap_or(false);
    let spacing = file.spacing.unwrap_or_default();
    let (sampled, values) = match (file.values, file.from, file.to, file.steps) {
        (Some(_), _, _, _) if file.spacing.is_some() => {
            return Err(named("`spacing` belongs to a range, not to `values`".to_owned()));
        }
        (Some(values), None, None, None) if !values.is_empty() => (false, values),
        (None, Some(from), Some(to), steps) => {
            let (from, to) = (from.get(), to.get());
            if from >= to {
                return Err(named(format!("from = {from}: must be less than to = {to}")));
            }
            if spacing == Spacing::Logarithmic && from <= 0.0 {
                return Err(named(format!("from = {from}: must be positive where the spacing is logarithmic")));
            }
            let value = |share: f64| Value::Float(spacing.between(from, to, share));
            match (steps, drawn) {
                (Some(steps), _) if !(2..=MOST_RUNS).contains(&steps) => {
                    return Err(named(format!("steps = {steps}: must be 2 to {MOST_RUNS}")));
                }
                // The last one is `to` itself, to the last bit.
                (Some(steps), _) => {
                    let last = steps - 1;
                    let inner = (0..last).map(|i| value(i as f64 / last as f64));
                    (false, inner.chain([Value::Float(to)]).collect())
                }
                (None, Some((seed, samples))) => (true, samples::strata(seed, &name, samples).map(value).collect()),
                (None, None) => {
                    return Err(named("a range needs `steps`, or a [latin_hypercube] that samples it".to_owned()));
                }
            }
        }
        _ => return Err(named("must have `values`, or `from` and `to`, with or without `steps`".to_owned())),
    };
    if times && values.iter().any(|value| !value.is_float() && !value.is_integer()) {
        return Err(named("`times` multiplies: all values must be numbers".to_owned()));
    }
    for (i, value) in values.iter().enumerate().filter(|_| !sampled) {
        if values[..i].contains(value) {
            return Err(named(format!("values: {value} is there twice")));
        }
    }
    Ok(Parameter { name, places, times, sampled, values, offset })
}
