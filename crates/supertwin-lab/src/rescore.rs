//! Scores of a run from its recording alone: the same scorer over the same numbers in the same order.

use crate::config::ConfigError;
use crate::mission::Mission;
use crate::ring::Blocks;
use crate::score::{self, OrNan, Scorer, Scores, Tracking};
use crate::trial::ResolvedTrial;
use supertwin_core::command::{Command, ControllerCommand};
use supertwin_core::message::{Nav, Reference, SignalValues, Thrust, Truth};
use supertwin_core::run::Properties;
use supertwin_core::source::{Columns, Label};
use supertwin_core::{Block, Property, RecordedRun, Signal, Tick, Wrench, signal};
use supertwin_gnc::Controller;
use supertwin_gnc::control::{Law, LawSample};

/// Signals that every tick must have to be scored, without and with truth: a run beside a real vehicle has none.
fn needed() -> [Vec<&'static Signal>; 2] {
    use signal::thrust::{ALLOCATED, LIMITED, REQUESTED};
    let mut known = score::MEASURED.to_vec();
    known.extend([&REQUESTED, &ALLOCATED, &LIMITED]);
    let mut truth = score::TRUE.to_vec();
    truth.push(&signal::truth::WRENCH);
    [known, truth]
}

/// Whether a signal, label or command is needed for scores: for reading no more than that.
#[must_use]
pub fn is_needed(path: &str) -> bool {
    let law = [&signal::controller::K1, &signal::controller::SIGMA, &signal::controller::LAW];
    let all = needed().into_iter().flatten().chain(law);
    all.into_iter().any(|signal| signal.path == path) || path == "command/controller"
}

/// Scores of what is there.
#[derive(Clone, Debug, PartialEq)]
pub struct Rescored {
    /// Root-mean-square errors, biases and activities, as a run states them at its end.
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
    /// The recording lacks something that is needed, or has something else in its place.
    #[error("{run}: {cause}")]
    Recording {
        /// Name of the run, as its recording states it.
        run: String,
        /// What is missing or wrong.
        cause: String,
    },
}

/// Scores a run from what was recorded of it.
///
/// Of a whole batch recording the result equals the run's own scores bit for bit.
///
/// # Errors
/// When the recording lacks a signal altogether, or its properties do not say what was run.
pub fn rescore(source: &RecordedRun) -> Result<Rescored, RescoreError> {
    let mut reader = SampleReader::new(source, true)?;
    let tick_s = reader.tick_s;
    let from = Tick::at_or_after(number(source, "score_from_s")?, tick_s);
    let last = reader.last();
    // A run without an agreed end is scored to where it ended.
    let to =
        number(source, "duration_s").map_or(last.max(0) as u64 + 1, |duration_s| Tick::at_or_after(duration_s, tick_s));
    let mut scorer = Scorer::new(from, to, tick_s);
    let mut ticks = 0;
    let mut before = -1;
    // Every tick that can be scored is one of these.
    for &k in source.signal(&signal::thrust::REQUESTED).map_or(&[][..], |columns| &columns.tick) {
        if k <= before {
            continue;
        }
        before = k;
        let Some(Sample { tick, tracking, thrust, made, law }) = reader.at(k)? else { continue };
        scorer.add(tick, &tracking, &thrust, &made, &law);
        ticks += u64::from(tick.k >= from);
    }
    let window = u64::try_from(last).map_or(0, |last| (last + 1).saturating_sub(from));
    Ok(Rescored { scores: scorer.scores(), ticks, missing: window.saturating_sub(ticks) })
}

fn wrong(source: &RecordedRun, cause: String) -> RescoreError {
    RescoreError::Recording { run: source.name.clone(), cause }
}

fn not_recorded(source: &RecordedRun, path: &str) -> RescoreError {
    wrong(source, format!("{path} was not recorded: scores need it"))
}

/// A property of the run that is a number.
pub(crate) fn number(source: &RecordedRun, name: &'static str) -> Result<f64, RescoreError> {
    match source.property("run", name) {
        Some(Property::Number(number)) => Ok(*number),
        _ => Err(wrong(
            source,
            format!("property {name} is not there or not a number: the window of the scores is not known"),
        )),
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
pub(crate) struct SampleReader<'a> {
    source: &'a RecordedRun,
    pub(crate) tick_s: f64,
    needed: Vec<(&'static Signal, &'a Columns)>,
    pub(crate) has_truth: bool,
    gains: [Option<&'a Columns>; 2],
    law: LawAtWork<'a>,
}

impl<'a> SampleReader<'a> {
    /// From the beginning. Without `truth`, a run that has none can be walked along as well.
    pub(crate) fn new(source: &'a RecordedRun, truth: bool) -> Result<Self, RescoreError> {
        let tick_s = number(source, "tick_s")?;
        let empty = Properties::new();
        let properties = source.properties.get("run").unwrap_or(&empty);
        let place = format!("{}: property config", source.name);
        let law = LawAtWork::new(source, &ResolvedTrial::from_properties(properties, &place)?)?;
        let recorded = |signal| source.signal(signal).filter(|columns| !columns.tick.is_empty());
        let [mut needed, of_truth] = needed();
        let has_truth = of_truth.iter().any(|signal| recorded(signal).is_some());
        if truth || has_truth {
            needed.extend(of_truth);
        }
        let mut found = Vec::with_capacity(needed.len());
        for signal in needed {
            let (path, expected) = (signal.path, signal.width());
            let columns = recorded(signal).ok_or_else(|| not_recorded(source, path))?;
            if columns.width != expected {
                return Err(wrong(source, format!("{path} has {} components: must have {expected}", columns.width)));
            }
            found.push((signal, columns));
        }
        let gains = [&signal::controller::K1, &signal::controller::SIGMA]
            .map(|signal| recorded(signal).filter(|columns| columns.width == signal.width()));
        Ok(Self { source, tick_s, needed: found, has_truth: truth || has_truth, gains, law })
    }

    /// The last tick of any signal that is needed.
    pub(crate) fn last(&self) -> i64 {
        self.needed.iter().filter_map(|(_, columns)| columns.tick.last()).max().copied().unwrap_or(-1)
    }

    /// At tick `k`, which must not be smaller than the one before; `None` when something is not there.
    pub(crate) fn at(&mut self, k: i64) -> Result<Option<Sample>, RescoreError> {
        let tick = Tick { k: k as u64, dt_s: self.tick_s };
        self.law.apply_until(self.source, tick)?;
        let Some(law) = self.law.sample(k, self.gains) else { return Ok(None) };
        let rows: Option<Vec<_>> =
            self.needed.iter().map(|(signal, columns)| Some((*signal, columns.at(k)?))).collect();
        let Some(rows) = rows.map(Rows) else { return Ok(None) };
        let rows = OrNan(&rows);
        let (nav, reference, truth) = (rows.message::<Nav>(), rows.message::<Reference>(), rows.message::<Truth>());
        let (Some(nav), Some(reference), Some(truth)) = (nav, reference, truth) else { return Ok(None) };
        let Some(thrust) = rows.message() else { return Ok(None) };
        let tracking = Tracking::new(&nav, &reference, &truth);
        Ok(Some(Sample { tick, tracking, thrust, made: truth.wrench, law }))
    }

    /// The first number that is none in the ticks `from..to`: path and tick.
    pub(crate) fn not_finite(&self, from: i64, to: i64) -> Option<(&'static str, i64)> {
        let found = self.needed.iter().filter_map(|(signal, columns)| {
            let ticks = &columns.tick;
            let first = ticks.partition_point(|tick| *tick < from);
            let last = ticks.partition_point(|tick| *tick < to).max(first);
            let values = columns.values.get(first * columns.width..last * columns.width)?;
            let at = values.iter().position(|value| !value.is_finite())?;
            Some((signal.path, ticks[first + at / columns.width]))
        });
        found.min_by_key(|(_, tick)| *tick)
    }
}

/// What was recorded of one tick.
struct Rows<'a>(Vec<(&'static Signal, &'a [f64])>);

impl SignalValues for Rows<'_> {
    fn numbers(&self, signal: &'static Signal) -> Option<&[f64]> {
        self.0.iter().find(|(other, _)| core::ptr::eq(*other, signal)).map(|(_, values)| *values)
    }
    fn label(&self, _: &'static Signal) -> Option<&str> {
        None
    }
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
    fn new(source: &'a RecordedRun, trial: &ResolvedTrial) -> Result<Self, RescoreError> {
        let law = &signal::controller::LAW;
        let names = source.label(law);
        if names.is_empty() {
            return Err(not_recorded(source, law.path));
        }
        // What a controller's parameters are does not depend on the seed.
        let controller = Blocks::new(trial, trial.trial.seed)?.controller;
        // Over a network the mission may have been left out; whatever applied was recorded. A replay has it as its mission.
        let placement = source.property("run", "placement");
        let batch = placement.is_none_or(|placement| ["batch", "replay"].map(Property::from).contains(placement));
        let mission = batch.then(|| Mission::new(&trial.trial.mission, trial.trial.tick_s.get()));
        Ok(Self { names, named: 0, controller, mission, command: 0 })
    }

    fn apply_until(&mut self, source: &RecordedRun, tick: Tick) -> Result<(), RescoreError> {
        // What the controller refuses it refused in the run as well: its reasons are parameters only.
        while let Some(command) = self.mission.as_mut().and_then(|mission| mission.due(tick)) {
            if let Command::Controller(command) = command {
                drop(self.controller.command(tick, command));
            }
        }
        let commands = source.commands_of(Controller::NAME);
        while let Some(label) = commands.get(self.command).filter(|label| label.tick <= tick.k as i64) {
            self.command += 1;
            let command: ControllerCommand = serde_json::from_str(&label.value)
                .map_err(|cause| wrong(source, format!("command/controller at tick {}: {cause}", label.tick)))?;
            drop(self.controller.command(tick, &command));
        }
        Ok(())
    }

    /// `None` where the recording has no gains although the law has.
    fn sample(&mut self, tick: i64, gains: [Option<&Columns>; 2]) -> Option<LawSample> {
        while self.names.get(self.named + 1).is_some_and(|next| next.tick <= tick) {
            self.named += 1;
        }
        // What a law has to be scored by does not change while it works. One that shows what its substitute has is not
        // scored by it.
        let name = self.names[self.named].value.as_str();
        let law = self.controller.laws().find(|law| law.name() == name);
        let has = law.map(Law::sample).unwrap_or_default();
        let [k1, sigma] = gains.map(|gain| gain?.at(tick)?.try_into().ok());
        Some(LawSample {
            k1: if has.k1.is_some() { Some(k1?) } else { None },
            sigma: if has.sigma.is_some() { Some(sigma?) } else { None },
            alpha_tol: has.alpha_tol.and(self.controller.law().sample().alpha_tol),
        })
    }
}
