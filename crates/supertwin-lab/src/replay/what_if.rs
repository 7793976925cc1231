//! An open-loop what-if: the chain from one block on anew on recorded inputs, as a run that can be written, scored and
//! compared like any other.

use super::block::Played;
use super::change::Changed;
use super::messages::At;
use super::plan::Plan;
use super::track::Track;
use super::{BlockVerdict, Replay, ReplayError};
use crate::mission::MissionStep;
use crate::rescore::{Rescored, rescore};
use crate::ring::{Blocks, RING};
use crate::run::{self, properties};
use crate::score::Tracking;
use crate::trial::ResolvedTrial;
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use supertwin_core::command::Command;
use supertwin_core::run::{Properties, Scene};
use supertwin_core::source::{Columns, Label};
use supertwin_core::{
    Event, EventKind, Observe, Property, RecordedRun, RunHeader, RunSink, Severity, Signal, Tick, signal,
};

/// The result of an open-loop what-if.
#[derive(Debug)]
pub struct WhatIf {
    run: RecordedRun,
    scene: Scene,
    known: BTreeMap<&'static str, &'static Signal>,
    tick_s: f64,
    /// What became of the blocks that were run anew.
    pub blocks: Vec<BlockVerdict>,
    /// Commands of the run that are refused now.
    pub refused: Vec<Event>,
    /// Its scores, or why there are none.
    pub scores: Result<Rescored, String>,
}

impl Replay<'_> {
    /// The chain from `changed.from` on with the changes, on recorded inputs. The vehicle does not react.
    ///
    /// The estimator's thrust is the recorded one, because that is what moved the vehicle that was measured; the
    /// controller's own thrust of the tick before is its new one.
    ///
    /// # Errors
    /// When a change breaks a rule.
    pub fn what_if(&self, changed: &Changed, provenance: &Properties) -> Result<WhatIf, ReplayError> {
        let trial = changed.apply(&self.trial)?;
        let mut messages = self.messages.clone();
        let mut played: Vec<Played> = Vec::new();
        for place in changed.from.position()..RING.len() {
            played.extend(self.play(place, &mut messages, true, &|service, instance| {
                let (trial, seed) = self.trial_of(service, instance)?;
                Ok(Blocks::new(&changed.apply(&trial)?, seed)?)
            })?);
        }
        let anew = |service: &str| RING[changed.from.position()..].contains(&service);
        let is_new = |path: &str| path.split('/').next().is_some_and(anew);
        // What follows from others is computed again.
        let follows = |path: &str| path.starts_with("tracking/") || path.starts_with("derived/");

        let mut signals: BTreeMap<String, Columns> = BTreeMap::new();
        let mut labels: BTreeMap<String, Vec<Label>> = BTreeMap::new();
        for (path, columns) in self.source.signals.iter().filter(|(path, _)| !is_new(path) && !follows(path)) {
            signals.insert(path.clone(), Columns { clocks: BTreeMap::new(), ..columns.clone() });
        }
        for (path, changes) in self.source.labels.iter().filter(|(path, _)| !is_new(path) && !follows(path)) {
            labels.insert(path.clone(), changes.clone());
        }
        let mut known = self.known_signals(changed.from.position())?;
        for played in &played {
            signals.extend(played.track.columns());
            labels.extend(played.track.changes());
            known.extend(played.track.signals().map(|signal| (signal.path, signal)));
        }
        for (path, columns) in &signals {
            if !known.contains_key(path.as_str()) {
                let signal = described(path, columns);
                known.insert(signal.path, signal);
            }
        }

        let run = RecordedRun {
            name: format!("{}-replay", self.source.name),
            properties: BTreeMap::from([("run".to_owned(), self.about(&trial, changed, "open loop", provenance)?)]),
            signals,
            labels,
            events: self.events(&trial, changed, &played),
            ..RecordedRun::default()
        };
        Ok(WhatIf {
            scores: rescore(&run).map_err(|why| why.to_string()),
            run,
            scene: run::scene(&trial, self.seed())?,
            known,
            tick_s: self.plan.tick_s,
            blocks: played.iter().map(Played::without_comparison).collect(),
            refused: played.iter().flat_map(|played| played.refused.iter().cloned()).collect(),
        })
    }

    pub(super) fn seed(&self) -> u64 {
        match self.source.property("run", "seed") {
            Some(Property::Integer(seed)) => *seed,
            // Looked at when the recording was taken apart.
            _ => 0,
        }
    }

    /// Signals of the blocks before `end` as they describe themselves.
    fn known_signals(&self, end: usize) -> Result<BTreeMap<&'static str, &'static Signal>, ReplayError> {
        let mut messages = self.messages.clone();
        let mut known = BTreeMap::new();
        for place in 0..end {
            let played = self.play(place, &mut messages, false, &|service, instance| self.blocks(service, instance))?;
            let tracks = played.iter().map(|played| &played.track);
            known.extend(tracks.flat_map(Track::signals).map(|signal| (signal.path, signal)));
        }
        Ok(known)
    }

    /// Properties of the result: everything of the original that still holds, and what was done to it.
    pub(super) fn about(
        &self,
        trial: &ResolvedTrial,
        changed: &Changed,
        how: &str,
        provenance: &Properties,
    ) -> Result<Properties, ReplayError> {
        let original = self.source.properties.get("run").cloned().unwrap_or_default();
        let trial = with_commands(trial, &self.plan)?;
        let mut about = properties(&trial, self.seed(), "replay", provenance);
        if let Some(duration_s) = original.get("duration_s") {
            about.insert("duration_s".to_owned(), duration_s.clone());
        } else {
            about.remove("duration_s");
        }
        about.insert("replay".to_owned(), how.into());
        about.insert("replay_of".to_owned(), self.source.name.as_str().into());
        about.insert("replay_from".to_owned(), if how == "open loop" { changed.from.name() } else { "plant" }.into());
        let words = if changed.is_nothing() { "nothing".to_owned() } else { changed.words.join("; ") };
        about.insert("replay_changed".to_owned(), words.into());
        for name in ["git_commit", "version", "placement", "run"] {
            if let Some(value) = original.get(name) {
                about.insert(format!("original_{name}"), value.clone());
            }
        }
        Ok(about)
    }

    fn events(&self, trial: &ResolvedTrial, changed: &Changed, played: &[Played]) -> Vec<Event> {
        let first =
            self.plan.parts.iter().flat_map(|part| &part.instances).filter_map(|instance| instance.steps.first());
        let begin = first.map(|step| step.tick).min().unwrap_or_default();
        let what = EventKind::ReplayedOpenLoop {
            recording: self.source.name.clone(),
            from: Cow::Borrowed(changed.from.name()),
            controller: trial.controller_name.clone(),
            changed: changed.words.clone(),
        };
        let mut events = vec![Event::new(begin, "replay", Severity::Info, what)];
        let new = &RING[changed.from.position()..];
        // A service that was run anew says anew what it does; what was said about commands and links still holds.
        let holds =
            |event: &&Event| !new.contains(&&*event.service) || matches!(event.what, EventKind::CommandApplied { .. });
        events.extend(self.source.events.iter().filter(holds).cloned());
        events.extend(played.iter().flat_map(|played| played.track.events.iter().cloned()));
        for gap in played.iter().flat_map(|played| played.inexact.iter().map(move |gap| (played.track.service, gap))) {
            let (service, gap) = gap;
            let (from_tick, to_tick, reason) = (gap.from_tick, gap.to_tick, gap.why.clone());
            let what = EventKind::ReplayInexact { service: Cow::Borrowed(service), from_tick, to_tick, reason };
            events.push(Event::new(from_tick, "replay", Severity::Warning, what));
        }
        events.sort_by_key(|event| event.tick);
        events
    }
}

impl WhatIf {
    /// Writes it, with its scores.
    ///
    /// # Errors
    /// When the sink can't keep it.
    pub fn write(&self, sink: &mut impl RunSink) -> Result<(), ReplayError> {
        let properties = self.run.properties.get("run").cloned().unwrap_or_default();
        sink.begin(&RunHeader { name: self.run.name.clone(), properties, scene: self.scene.clone() })?;
        let ticks: BTreeSet<i64> = self
            .run
            .signals
            .values()
            .flat_map(|columns| columns.tick.iter())
            .chain(self.run.labels.values().flatten().map(|label| &label.tick))
            .copied()
            .collect();
        let known = |(path, columns)| Some((*self.known.get(String::as_str(path))?, columns));
        let rows: Vec<(&'static Signal, &Columns)> = self.run.signals.iter().filter_map(known).collect();
        let mut words: BTreeMap<&str, &'static str> = BTreeMap::new();
        let mut labels: Vec<(&'static Signal, &[Label], usize)> = Vec::new();
        for (path, changes) in &self.run.labels {
            for label in changes {
                words.entry(&label.value).or_insert_with(|| String::leak(label.value.clone()));
            }
            let signal = self.known.get(path.as_str()).copied().unwrap_or_else(|| described(path, &Columns::default()));
            labels.push((signal, changes, 0));
        }
        let mut events = self.run.events.iter().peekable();
        for &k in &ticks {
            let tick = Tick { k: u64::try_from(k).unwrap_or_default(), dt_s: self.tick_s };
            sink.tick(tick)?;
            while let Some(event) = events.next_if(|event| event.tick <= tick.k) {
                sink.event(event)?;
            }
            for (signal, columns) in &rows {
                if let Some(values) = columns.at(k) {
                    sink.vector(signal, values);
                }
            }
            for (signal, changes, row) in &mut labels {
                while changes.get(*row).is_some_and(|label| label.tick <= k) {
                    if let Some(value) = words.get(changes[*row].value.as_str()) {
                        sink.label(signal, value);
                    }
                    *row += 1;
                }
            }
            if let Some(tracking) = Tracking::from_signals(&At { source: &self.run, tick: k }) {
                tracking.observe(sink);
            }
        }
        for event in events {
            sink.event(event)?;
        }
        let warnings = self.run.events.iter().filter(|event| event.severity > Severity::Info).count();
        let mut results = Properties::from([
            ("ticks".to_owned(), (ticks.len() as u64).into()),
            ("complete".to_owned(), 1_u64.into()),
            ("warnings".to_owned(), (warnings as u64).into()),
        ]);
        match &self.scores {
            Ok(rescored) => results.extend(rescored.scores.properties()),
            Err(why) => {
                results.insert("not_scored".to_owned(), why.as_str().into());
            }
        }
        sink.finish(&results)?;
        Ok(())
    }

    /// Largest difference of each axis of the requested wrench to `original`, in N and N m, over ticks that both have.
    #[must_use]
    pub fn wrench_difference(&self, original: &RecordedRun) -> [f64; 4] {
        let signal = &signal::thrust::REQUESTED;
        let mut most = [0.0_f64; 4];
        let (Some(new), Some(old)) = (self.run.signal(signal), original.signal(signal)) else { return most };
        for (row, tick) in new.tick.iter().enumerate() {
            let (Some(new), Some(old)) = (new.row(row), old.at(*tick)) else { continue };
            for ((most, new), old) in most.iter_mut().zip(new).zip(old) {
                *most = most.max((new - old).abs());
            }
        }
        most
    }
}

/// A signal that no block here shows, such as a counter of a link; listeners expect it to live for ever.
fn described(path: &str, columns: &Columns) -> &'static Signal {
    let components: Vec<&'static str> =
        columns.names.iter().filter(|_| columns.width > 1).map(|name| &*String::leak(name.clone())).collect();
    Box::leak(Box::new(Signal {
        path: String::leak(path.to_owned()),
        components: Vec::leak(components),
        units: &[],
        about: "",
    }))
}

/// `trial` with the commands that applied in the place of its mission: over a network they came from clients.
pub(super) fn with_commands(trial: &ResolvedTrial, plan: &Plan) -> Result<ResolvedTrial, ReplayError> {
    if plan.batch {
        return Ok(trial.clone());
    }
    let wrong = |cause: &dyn core::fmt::Display| ReplayError::Change(format!("commands of the run: {cause}"));
    let mut all: Vec<(u64, &Command)> =
        plan.parts.iter().flat_map(|part| part.commands.iter().map(|(tick, command)| (*tick, command))).collect();
    all.sort_by_key(|(tick, _)| *tick);
    let mut mission = Vec::with_capacity(all.len());
    for (tick, command) in all {
        let at_s: toml::Table =
            format!("at_s = {:?}", tick as f64 * plan.tick_s).parse().map_err(|cause| wrong(&cause))?;
        let mut step = at_s;
        step.insert("command".to_owned(), toml::Value::try_from(command).map_err(|cause| wrong(&cause))?);
        mission.push(toml::Value::Table(step));
    }
    let place = trial.path.display().to_string();
    let mut table: toml::Table = crate::config::parse(&place, &trial.text)?;
    let mut trial = trial.clone();
    let steps: Result<Vec<MissionStep>, _> = mission.iter().cloned().map(toml::Value::try_into).collect();
    trial.trial.mission = steps.map_err(|cause| wrong(&cause))?;
    if let Some(toml::Value::Table(section)) = table.get_mut("trial") {
        section.insert("mission".to_owned(), toml::Value::Array(mission));
    }
    trial.text = table.to_string();
    Ok(trial)
}
