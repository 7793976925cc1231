//! Scores of a run from its recording alone: the same scorer over the same numbers in the same order.

use crate::config::ConfigError;
use crate::mission::Mission;
use crate::score::{LawSample, Scorer, Scores, Tracking};
use crate::trial::ResolvedTrial;
use crate::twin::Blocks;
use supertwin_core::command::{Command, ControllerCommand};
use supertwin_core::message::{Nav, Reference, Thrust, Truth};
use supertwin_core::run::Properties;
use supertwin_core::source::{Columns, Label};
use supertwin_core::{Axes, Block, BodyVelocity, Property, RunSource, Tick, Wrench};
use supertwin_gnc::Controller;

/// Signals that every tick must have to be scored: path and number of components. Truth stands at the end: a run beside
/// a real vehicle has none.
const NEEDED: [(&str, usize); 14] = [
    ("estimator/nav/pose", 2),
    ("estimator/nav/velocity", 4),
    ("estimator/nav/net", 4),
    ("guidance/reference/velocity", 4),
    ("guidance/reference/depth", 3),
    ("guidance/reference/heading", 3),
    ("guidance/reference/setpoint", 2),
    (REQUESTED, 4),
    ("controller/thrust/allocated", 4),
    ("controller/thrust/limited", 4),
    ("plant/truth/pose", 4),
    ("plant/truth/velocity", 4),
    ("plant/truth/net", 2),
    ("plant/truth/wrench", 4),
];
/// So many of them are not truth.
const KNOWN: usize = 10;
const REQUESTED: &str = "controller/thrust/requested";
const K1: &str = "controller/k1";
const SIGMA: &str = "controller/sigma";
const LAW: &str = "controller/law";

/// Whether a signal, label or command is needed for scores: for reading no more than that.
#[must_use]
pub fn is_needed(path: &str) -> bool {
    NEEDED.iter().any(|(needed, _)| *needed == path) || [K1, SIGMA, LAW].contains(&path) || path == "command/controller"
}

/// Scores of what is there.
#[derive(Clone, Debug, PartialEq)]
pub struct Rescored {
    /// The scores.
    pub scores: Scores,
    /// Ticks of the window that were scored.
    pub ticks: u64,
    /// Ticks from the first of the window to the last recorded one that could not be scored, because a signal is not
    /// there.
    pub missing: u64,
}

/// A recording that can't be scored.
#[derive(Debug, thiserror::Error)]
pub enum RescoreError {
    /// The configuration in its properties can't be used.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A property is missing or is no number.
    #[error("{run}: property {name} is not there or not a number: the window of the scores is not known")]
    Property {
        /// The run.
        run: String,
        /// The property.
        name: &'static str,
    },
    /// Something was not recorded.
    #[error("{run}: {path} was not recorded: scores need it")]
    Signal {
        /// The run.
        run: String,
        /// Which signal or label.
        path: &'static str,
    },
    /// A signal has another number of components.
    #[error("{run}: {path} has {width} components: must have {expected}")]
    Width {
        /// The run.
        run: String,
        /// Which signal.
        path: &'static str,
        /// As recorded.
        width: usize,
        /// As needed.
        expected: usize,
    },
    /// A command of the recording is none.
    #[error("{run}: command/controller at tick {tick}: {cause}")]
    Command {
        /// The run.
        run: String,
        /// When.
        tick: i64,
        /// What is wrong.
        cause: String,
    },
}

/// Scores a run from what was recorded of it.
///
/// Of a whole batch recording the result equals the run's own scores bit for bit.
///
/// # Errors
/// When the recording lacks a signal altogether, or its properties do not say what was run.
pub fn rescore(source: &impl RunSource) -> Result<Rescored, RescoreError> {
    let mut walk = Walk::new(source, true)?;
    let tick_s = walk.tick_s;
    let from = Tick::at_or_after(number(source, "score_from_s")?, tick_s);
    let last = walk.last();
    // A run without an agreed end is scored to where it ended.
    let to =
        number(source, "duration_s").map_or(last.max(0) as u64 + 1, |duration_s| Tick::at_or_after(duration_s, tick_s));
    let mut scorer = Scorer::new(from, to, tick_s);
    let mut ticks = 0;
    let mut before = -1;
    // Every tick that can be scored is one of these.
    for &k in &source.signals()[REQUESTED].tick {
        if k <= before {
            continue;
        }
        before = k;
        let Some(Sample { tick, tracking, thrust, made, law }) = walk.at(k)? else { continue };
        scorer.add(tick, &tracking, &thrust, &made, &law);
        ticks += u64::from(tick.k >= from);
    }
    let window = u64::try_from(last).map_or(0, |last| (last + 1).saturating_sub(from));
    Ok(Rescored { scores: scorer.scores(), ticks, missing: window.saturating_sub(ticks) })
}

/// A property of the run that is a number.
pub(crate) fn number(source: &impl RunSource, name: &'static str) -> Result<f64, RescoreError> {
    match source.properties().get("run").and_then(|properties| properties.get(name)) {
        Some(Property::Number(number)) => Ok(*number),
        _ => Err(RescoreError::Property { run: source.name().to_owned(), name }),
    }
}

/// What one tick is scored by.
#[derive(Clone, Debug)]
pub(crate) struct Sample {
    pub(crate) tick: Tick,
    /// Without truth, its part is NaN.
    pub(crate) tracking: Tracking,
    pub(crate) thrust: Thrust,
    /// By the thrusters; NaN without truth.
    pub(crate) made: Wrench,
    pub(crate) law: LawSample,
}

/// A recording tick by tick, forwards.
pub(crate) struct Walk<'a, S> {
    source: &'a S,
    pub(crate) tick_s: f64,
    /// In the order of [`NEEDED`].
    cursors: Vec<Cursor<'a>>,
    gains: [Option<Cursor<'a>>; 2],
    law: LawAtWork<'a>,
}

impl<'a, S: RunSource> Walk<'a, S> {
    /// From the beginning. Without `truth`, a run that has none can be walked along as well.
    pub(crate) fn new(source: &'a S, truth: bool) -> Result<Self, RescoreError> {
        let run = || source.name().to_owned();
        let tick_s = number(source, "tick_s")?;
        let empty = Properties::new();
        let properties = source.properties().get("run").unwrap_or(&empty);
        let place = format!("{}: property config", source.name());
        let law = LawAtWork::new(source, &ResolvedTrial::from_properties(properties, &place)?)?;
        let recorded = |path: &str| source.signals().get(path).filter(|columns| !columns.tick.is_empty());
        let has_truth = NEEDED[KNOWN..].iter().any(|(path, _)| recorded(path).is_some());
        let mut cursors = Vec::with_capacity(NEEDED.len());
        for &(path, expected) in &NEEDED[..if truth || has_truth { NEEDED.len() } else { KNOWN }] {
            let columns = recorded(path).ok_or_else(|| RescoreError::Signal { run: run(), path })?;
            if columns.width != expected {
                return Err(RescoreError::Width { run: run(), path, width: columns.width, expected });
            }
            cursors.push(Cursor::new(columns));
        }
        let gains = [K1, SIGMA].map(|path| recorded(path).filter(|columns| columns.width == 4).map(Cursor::new));
        Ok(Self { source, tick_s, cursors, gains, law })
    }

    /// The last tick of any signal that is needed.
    pub(crate) fn last(&self) -> i64 {
        self.cursors.iter().filter_map(|cursor| cursor.columns.tick.last()).max().copied().unwrap_or(-1)
    }

    pub(crate) fn has_truth(&self) -> bool {
        self.cursors.len() > KNOWN
    }

    /// At tick `k`, which must not be smaller than the one before; `None` when something is not there.
    pub(crate) fn at(&mut self, k: i64) -> Result<Option<Sample>, RescoreError> {
        let tick = Tick { k: k as u64, dt_s: self.tick_s };
        self.law.apply_until(self.source, tick)?;
        let Some(law) = self.law.sample(k, &mut self.gains) else { return Ok(None) };
        let mut rows: [&[f64]; NEEDED.len()] = [&[f64::NAN; 4]; NEEDED.len()];
        for (row, cursor) in rows.iter_mut().zip(&mut self.cursors) {
            let Some(values) = cursor.at(k) else { return Ok(None) };
            *row = values;
        }
        Ok(Some(sample(tick, &rows, law)))
    }

    /// The first number that is none in the ticks `from..to`: path and tick.
    pub(crate) fn not_finite(&self, from: i64, to: i64) -> Option<(&'static str, i64)> {
        let found = NEEDED.iter().zip(&self.cursors).filter_map(|((path, _), cursor)| {
            let ticks = &cursor.columns.tick;
            let first = ticks.partition_point(|tick| *tick < from);
            let last = ticks.partition_point(|tick| *tick < to).max(first);
            let values = cursor.columns.values.get(first * cursor.columns.width..last * cursor.columns.width)?;
            let at = values.iter().position(|value| !value.is_finite())?;
            Some((*path, ticks[first + at / cursor.columns.width]))
        });
        found.min_by_key(|(_, tick)| *tick)
    }
}

/// Walks along a signal with ticks that only grow.
struct Cursor<'a> {
    columns: &'a Columns,
    row: usize,
}

impl<'a> Cursor<'a> {
    fn new(columns: &'a Columns) -> Self {
        Self { columns, row: 0 }
    }

    fn at(&mut self, tick: i64) -> Option<&'a [f64]> {
        while self.columns.tick.get(self.row).is_some_and(|at| *at < tick) {
            self.row += 1;
        }
        (self.columns.tick.get(self.row) == Some(&tick)).then(|| self.columns.row(self.row)).flatten()
    }

    fn four(&mut self, tick: i64) -> Option<[f64; 4]> {
        self.at(tick)?.try_into().ok()
    }
}

/// The messages of one tick, as far as scores look at them; rows in the order of [`NEEDED`].
fn sample(tick: Tick, rows: &[&[f64]; NEEDED.len()], law: LawSample) -> Sample {
    let [pose, velocity, net, reference, depth, heading, setpoint, ..] = rows;
    let mut nav = Nav { depth_m: pose[0], heading_rad: pose[1], velocity: body(velocity), ..Nav::default() };
    nav.net.distance_m = net[0];
    let reference = Reference {
        surge_m_per_s: reference[0],
        sway_m_per_s: reference[1],
        depth_m: depth[0],
        heading_rad: heading[0],
        net_distance_m: setpoint[0],
        speed_m_per_s: setpoint[1],
        ..Reference::default()
    };
    let [.., requested, allocated, limited, pose, velocity, net, made] = rows;
    let made = wrench(made);
    let truth = Truth {
        depth_m: pose[2],
        heading_rad: pose[3],
        velocity: body(velocity),
        net_distance_m: net[0],
        wrench: made,
        ..Truth::default()
    };
    let thrust = Thrust {
        requested: wrench(requested),
        allocated: wrench(allocated),
        limited: Axes::from(core::array::from_fn(|i| limited[i] != 0.0)),
        ..Thrust::default()
    };
    Sample { tick, tracking: Tracking::new(&nav, &reference, &truth), thrust, made, law }
}

/// The widths are checked before.
fn body(v: &[f64]) -> BodyVelocity {
    BodyVelocity::from([v[0], v[1], v[2], v[3]])
}

fn wrench(v: &[f64]) -> Wrench {
    Wrench::from([v[0], v[1], v[2], v[3]])
}

/// The law in command at each tick: by name from the recording, its parameters from the configuration and from the
/// commands, which are given to a controller that takes no step.
struct LawAtWork<'a> {
    names: &'a [Label],
    named: usize,
    controller: Controller,
    /// Of a batch run.
    mission: Option<Mission>,
    /// Of a run over a network: the next one.
    command: usize,
}

impl<'a> LawAtWork<'a> {
    fn new(source: &'a impl RunSource, trial: &ResolvedTrial) -> Result<Self, RescoreError> {
        let names = source.labels().get(LAW).filter(|names| !names.is_empty());
        let names = names.ok_or_else(|| RescoreError::Signal { run: source.name().to_owned(), path: LAW })?;
        // What a controller's parameters are does not depend on the seed.
        let controller = Blocks::new(trial, trial.trial.seed)?.controller;
        // Over a network the mission may have been left out; whatever applied was recorded. A replay has it as its mission.
        let placement = source.properties().get("run").and_then(|run| run.get("placement"));
        let batch = placement.is_none_or(|placement| ["batch", "replay"].map(Property::from).contains(placement));
        let mission = batch.then(|| Mission::new(&trial.trial.mission, trial.trial.tick_s.get()));
        Ok(Self { names, named: 0, controller, mission, command: 0 })
    }

    fn apply_until(&mut self, source: &impl RunSource, tick: Tick) -> Result<(), RescoreError> {
        // What the controller refuses it refused in the run as well: its reasons are parameters only.
        while let Some(command) = self.mission.as_mut().and_then(|mission| mission.due(tick)) {
            if let Command::Controller(command) = command {
                drop(self.controller.command(tick, command));
            }
        }
        let commands = source.commands().get(Controller::NAME).map_or(&[][..], Vec::as_slice);
        while let Some(label) = commands.get(self.command).filter(|label| label.tick <= tick.k as i64) {
            self.command += 1;
            let command: ControllerCommand = serde_json::from_str(&label.value).map_err(|cause| {
                RescoreError::Command { run: source.name().to_owned(), tick: label.tick, cause: cause.to_string() }
            })?;
            drop(self.controller.command(tick, &command));
        }
        Ok(())
    }

    /// `None` where the recording has no gains although the law has.
    fn sample(&mut self, tick: i64, gains: &mut [Option<Cursor<'_>>; 2]) -> Option<LawSample> {
        while self.names.get(self.named + 1).is_some_and(|next| next.tick <= tick) {
            self.named += 1;
        }
        // A law that is not of this family may show the gains of its substitute: they are not scored.
        if !matches!(self.names[self.named].value.as_str(), "gsta" | "agsta") {
            return Some(LawSample::default());
        }
        let [k1, sigma] = gains.each_mut().map(|gain| gain.as_mut().and_then(|cursor| cursor.four(tick)));
        Some(LawSample { k1: k1?, sigma: Some(sigma?), alpha_tol: self.controller.law().alpha_tol() })
    }
}
