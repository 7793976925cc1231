//! Replay: the recorded inputs of a block into it again.
//!
//! * Nothing changed, each block from its recorded inputs: [`Replay::verify`]. Every state and output must have the bits
//!   that were recorded.
//! * Something changed, the chain from one block on run anew on recorded inputs: [`Replay::what_if`]. Open loop: the
//!   vehicle does not react.
//! * The plant driven by the disturbance that the estimator found in the recording: `closed`. Closed loop.
//!
//! What a block did is taken from the recording: over a network the account of every step says which messages it used,
//! and commands with their ticks are recorded; a run of one process is repeated from its mission. Exact bytes of messages
//! are decoded by whoever knows the codec and handed over as [`Messages`].

mod block;
mod change;
pub mod closed;
mod messages;
mod plan;
mod track;
mod what_if;

pub use crate::ring::RING;
pub use change::{Changed, FromBlock};
pub use messages::Messages;
pub use what_if::WhatIf;

use crate::config::ConfigError;
use crate::ring::{Blocks, RingBlock, RingVisitor, around};
use crate::trial::ResolvedTrial;
use block::{How, Played, play};
use plan::{BlockHistory, Instance, Plan};
use serde::Serialize;
use std::collections::BTreeMap;
use supertwin_core::digest::RunDigest;
use supertwin_core::run::Properties;
use supertwin_core::{Property, RecordedRun, Tick, signal};

/// A recording that can't be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
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
    /// What was asked for has no effect on what is replayed.
    #[error("{0}")]
    Change(String),
    /// The result can't be written.
    #[error(transparent)]
    Sink(#[from] supertwin_core::SinkError),
    /// The run in a closed loop could not be done.
    #[error(transparent)]
    Run(#[from] crate::RunError),
}

/// A place where a replay is not what was recorded.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// Service whose signal or label differs.
    pub service: String,
    /// Tick, from 0 at the start of the run.
    pub tick: u64,
    /// Path of the signal or label, or what else differs.
    pub signal: String,
    /// Its component; empty for a scalar or for all of it.
    pub component: String,
    /// Value in the recording.
    pub recorded: String,
    /// Value that the replay computed.
    pub replayed: String,
}

impl core::fmt::Display for Difference {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "tick {}: {}", self.tick, self.signal)?;
        if !self.component.is_empty() {
            write!(f, " ({})", self.component)?;
        }
        write!(f, ": recorded {}, replayed {}", self.recorded, self.replayed)
    }
}

/// Steps whose inputs or state the recording does not have.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Inexact {
    /// From here …
    pub from_tick: u64,
    /// … to here.
    pub to_tick: u64,
    /// Input or state that the recording lacks.
    pub why: String,
}

/// What became of one block.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct BlockVerdict {
    /// Name of the service in the ring.
    pub service: &'static str,
    /// How many times it began: once, and once more for each restart.
    pub instances: u64,
    /// Steps that were replayed.
    pub steps: u64,
    /// Steps that were compared with the recording.
    pub compared: u64,
    /// Steps that could not be compared, and why.
    pub inexact: Vec<Inexact>,
    /// The first place where it is not as recorded.
    pub difference: Option<Difference>,
}

/// What became of a replay with nothing changed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Verification {
    /// Nothing differs, and something of every block was compared.
    pub equal: bool,
    /// The first place where a block is not as recorded; of one tick, that of the block that comes first in the ring.
    pub first: Option<Difference>,
    /// Block by block, in the order of the ring.
    pub blocks: Vec<BlockVerdict>,
    /// The hash over all blocks and ticks equals the one that the run left; `None` when there is none to compare.
    pub hash: Option<bool>,
    /// Messages without exact bytes that were rebuilt from signals, by wire; all of them in a run of one process.
    pub rebuilt: BTreeMap<&'static str, u64>,
}

/// A recording, ready to be replayed.
#[derive(Debug)]
pub struct Replay<'a> {
    source: &'a RecordedRun,
    /// The trial that was recorded.
    pub trial: ResolvedTrial,
    plan: Plan,
    messages: Messages,
    rebuilt: BTreeMap<&'static str, u64>,
}

impl<'a> Replay<'a> {
    /// Takes a recording apart. `messages` are those whose exact bytes it has, decoded.
    ///
    /// # Errors
    /// When the recording does not say what was run, or how.
    pub fn new(source: &'a RecordedRun, mut messages: Messages) -> Result<Self, ReplayError> {
        let run = &source.name;
        let refuse = |cause: String| Err(ReplayError::Recording { run: run.clone(), cause });
        let empty = Properties::new();
        let properties = source.properties.get("run").unwrap_or(&empty);
        if let Some(Property::Text(of)) = properties.get("replay_of") {
            let why = "is a replay itself, in which not every block had the inputs that are recorded";
            return refuse(format!("{why}; replay {of} instead"));
        }
        let trial = ResolvedTrial::from_properties(properties, &format!("{run}: property config"))?;
        let Some(&Property::Number(tick_s)) = properties.get("tick_s") else {
            return refuse(no_number("tick_s"));
        };
        if !matches!(properties.get("seed"), Some(Property::Integer(_))) {
            return refuse(no_number("seed"));
        }
        let (signal, expected) = (&signal::thrust::FORCE, trial.vehicle.thruster.len());
        let force = source.signal(signal).filter(|columns| !columns.tick.is_empty());
        let width = force.map_or(expected, |columns| columns.width);
        if width != expected {
            let path = signal.path;
            return refuse(format!(
                "recorded of another vehicle: {path} has {width} components, its configuration has {expected} thrusters"
            ));
        }
        let plan = Plan::of(source, &trial, tick_s, &mut messages)?;
        for (part, service) in plan.parts.iter().zip(RING) {
            let shown = source.signals.keys().any(|path| path.starts_with(&format!("{service}/")));
            if part.instances.is_empty() && shown {
                let why = "recorded without telemetry, or by an older program";
                return refuse(format!("nothing says which messages {service} used (step/{service}): {why}"));
            }
        }
        let rebuilt = messages.rebuild(source);
        Ok(Self { source, trial, plan, messages, rebuilt })
    }

    /// The blocks with which an instance began: of the recorded configuration, or of its own.
    fn blocks(&self, service: &str, instance: &Instance) -> Result<Blocks, ReplayError> {
        let (trial, seed) = self.trial_of(service, instance)?;
        Ok(Blocks::new(&trial, seed)?)
    }

    fn trial_of(&self, service: &str, instance: &Instance) -> Result<(ResolvedTrial, u64), ReplayError> {
        let mut properties = self.source.properties.get("run").cloned().unwrap_or_default();
        // Services may have been started with other files than the plant.
        for name in ["config", "controller", "seed"] {
            if let Some(own) = properties.get(&format!("{name}_of_{service}")).cloned() {
                properties.insert(name.to_owned(), own);
            }
        }
        let first = instance.steps.first().map_or(0, |step| step.tick);
        let told = self.source.words(&format!("state/{service}/run"));
        // One that is started anew says with which.
        if let Some(words) = told.iter().rfind(|words| words.tick <= first.cast_signed()) {
            let told = serde_json::from_str::<Properties>(&words.value).map_err(|cause| ReplayError::Recording {
                run: self.source.name.clone(),
                cause: format!("state/{service}/run at tick {}: {cause}", words.tick),
            })?;
            properties.extend(told);
        }
        let Some(&Property::Integer(seed)) = properties.get("seed") else {
            return Err(ReplayError::Recording { run: self.source.name.clone(), cause: no_number("seed") });
        };
        let place = format!("{}: configuration of {service}", self.source.name);
        Ok((ResolvedTrial::from_properties(&properties, &place)?, seed))
    }

    /// Every block again, each from its recorded inputs; with `chain`, that block and those behind it from each other's
    /// new outputs, and nothing else.
    ///
    /// # Errors
    /// When a block can't be built.
    pub fn verify(&self, chain: Option<FromBlock>) -> Result<Verification, ReplayError> {
        let mut messages = self.messages.clone();
        let mut played: Vec<Played> = Vec::new();
        for place in 0..RING.len() {
            let anew = chain.is_some_and(|from| place >= from.position());
            if chain.is_none() || anew {
                played.extend(
                    self.play(place, &mut messages, anew, &|service, instance| self.blocks(service, instance))?,
                );
            }
        }
        let blocks: Vec<BlockVerdict> = played.iter().map(|played| self.verdict(played)).collect();
        let differences = blocks.iter().filter_map(|block| block.difference.as_ref());
        let mut first = differences.min_by_key(|difference| difference.tick).cloned();
        let hash = if chain.is_none() { self.hash(&played) } else { None };
        if first.is_none() && hash == Some(false) {
            first = Some(Difference {
                service: "run".to_owned(),
                tick: self.plan.last(),
                signal: "result: hash".to_owned(),
                component: String::new(),
                recorded: "another".to_owned(),
                replayed: "that of these signals".to_owned(),
            });
        }
        let equal = first.is_none() && !blocks.is_empty() && blocks.iter().all(|block| block.compared > 0);
        Ok(Verification { equal, first, blocks, hash, rebuilt: self.rebuilt.clone() })
    }

    /// Replays the block at `place`; `None` when nobody did what it does.
    fn play(
        &self,
        place: usize,
        messages: &mut Messages,
        anew: bool,
        build: &dyn Fn(&str, &Instance) -> Result<Blocks, ReplayError>,
    ) -> Result<Option<Played>, ReplayError> {
        let part = &self.plan.parts[place];
        if part.instances.is_empty() {
            return Ok(None);
        }
        let how = How { tick_s: self.plan.tick_s, anew };
        let mut at = PlayAt { place, part, messages, how, build, played: None };
        around(&mut at);
        at.played.transpose()
    }

    fn verdict(&self, played: &Played) -> BlockVerdict {
        let service = played.track.service;
        let by_signal = played.track.first_difference(self.source, &played.compared);
        let by_hash = played.digest_differs.map(|tick| Difference {
            service: service.to_owned(),
            tick,
            signal: format!("step/{service}"),
            component: "digest".to_owned(),
            recorded: "another hash".to_owned(),
            replayed: "that of the signals that are recorded".to_owned(),
        });
        // A hash says that something differs, the signals say what.
        let difference = match (by_signal, by_hash) {
            (Some(signal), Some(hash)) if hash.tick < signal.tick => Some(hash),
            (signal, hash) => signal.or(hash),
        };
        BlockVerdict { compared: played.compared.len() as u64, difference, ..played.without_comparison() }
    }

    /// The hash of the whole run against the one in its results.
    fn hash(&self, played: &[Played]) -> Option<bool> {
        let Property::Text(recorded) = self.source.property("result", "hash")? else { return None };
        let [plant, estimator, guidance, controller] = played else { return None };
        let whole = |played: &Played| played.digests.iter().enumerate().all(|(k, (tick, _))| k as u64 == *tick);
        let ticks = plant.digests.len();
        if !played.iter().all(|played| whole(played) && played.digests.len() == ticks) {
            return None;
        }
        let mut digest = RunDigest::default();
        for k in 0..ticks {
            let of_blocks = [plant, estimator, guidance, controller].map(|played| played.digests[k].1);
            digest.fold(Tick { k: k as u64, dt_s: self.plan.tick_s }, of_blocks);
        }
        Some(digest.to_string() == *recorded)
    }
}

fn no_number(property: &str) -> String {
    format!("property {property} is not there or not a number: the run can't be repeated without")
}

/// Plays the block at one place of the ring.
struct PlayAt<'a> {
    place: usize,
    part: &'a BlockHistory,
    messages: &'a mut Messages,
    how: How,
    build: &'a dyn Fn(&str, &Instance) -> Result<Blocks, ReplayError>,
    played: Option<Result<Played, ReplayError>>,
}

impl RingVisitor for PlayAt<'_> {
    fn block<B: RingBlock>(&mut self) {
        if B::PLACE == self.place {
            let build = |instance: &Instance| Ok(B::of(&(self.build)(B::NAME, instance)?).clone());
            self.played = Some(play(self.part, self.messages, self.how, build));
        }
    }
}
