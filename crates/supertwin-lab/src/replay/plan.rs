//! Which block stepped when, on which messages, under which commands: as recorded over a network, or, for a run of one
//! process, as its mission and its wires say.

use super::{Messages, ReplayError};
use crate::ResolvedTrial;
use crate::mission::Mission;
use crate::ring::{RING, RingBlock, RingVisitor, around};
use crate::wires::RingWires;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use supertwin_core::command::Command;
use supertwin_core::source::Label;
use supertwin_core::{OperatorLink, RecordedRun, Signal, Tick, signal};

/// One step of one block.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Step {
    pub(crate) tick: u64,
    /// Number of the telemetry that told it; consecutive, where none is missing.
    pub(crate) seq: u64,
    /// Steps that the block has done in this run, this one included; `None` where the recording does not say.
    pub(crate) steps: Option<u64>,
    /// Ticks of the messages that it used, by key. A key that is not there: nothing has ever arrived.
    pub(crate) used: Vec<(String, Vec<u64>)>,
    pub(crate) operator: OperatorLink,
    /// Hash of the block's states and output; a run of one process records none.
    pub(crate) digest: Option<u64>,
}

/// A block from its beginning: a process that started anew is another one.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Instance {
    pub(crate) source: String,
    /// In the order of their ticks.
    pub(crate) steps: Vec<Step>,
}

/// Everything that happened to one block.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct BlockHistory {
    /// In the order of their first steps.
    pub(crate) instances: Vec<Instance>,
    /// In the order in which they applied.
    pub(crate) commands: Vec<(u64, Command)>,
}

/// A run taken apart.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Plan {
    /// In the order of the ring.
    pub(crate) parts: [BlockHistory; RING.len()],
    pub(crate) tick_s: f64,
    pub(crate) batch: bool,
}

impl Plan {
    /// Every step of the run; messages that a mission made are added to `messages`.
    pub(crate) fn of(
        source: &RecordedRun,
        trial: &ResolvedTrial,
        tick_s: f64,
        messages: &mut Messages,
    ) -> Result<Self, ReplayError> {
        let placement = source.property("run", "placement");
        let batch = placement.is_none_or(|placement| *placement == "batch".into());
        let parts = if batch {
            batch_parts(source, trial, tick_s, messages)
        } else {
            let mut parts: [BlockHistory; RING.len()] = Default::default();
            for (part, service) in parts.iter_mut().zip(RING) {
                *part = recorded_part(source, service)?;
            }
            parts
        };
        if parts.iter().all(|part| part.instances.is_empty()) {
            let cause = "no step of any block was recorded".to_owned();
            return Err(ReplayError::Recording { run: source.name.clone(), cause });
        }
        Ok(Self { parts, tick_s, batch })
    }

    /// The last tick of any block.
    pub(crate) fn last(&self) -> u64 {
        let steps = self.parts.iter().flat_map(|part| &part.instances).flat_map(|instance| instance.steps.last());
        steps.map(|step| step.tick).max().unwrap_or_default()
    }
}

/// The account of a step, as the recorder writes it.
#[derive(Debug, Deserialize)]
struct StepAccount {
    source: String,
    seq: u64,
    #[serde(default)]
    steps: Option<u64>,
    used: BTreeMap<String, Vec<u64>>,
    #[serde(default)]
    operator_lost: bool,
    #[serde(default)]
    digest: Option<String>,
}

fn recorded_part(source: &RecordedRun, service: &str) -> Result<BlockHistory, ReplayError> {
    let wrong = |label: &Label, what: &str, cause: String| ReplayError::Recording {
        run: source.name.clone(),
        cause: format!("{what}/{service} at tick {}: {cause}", label.tick),
    };
    let mut part = BlockHistory::default();
    for label in source.words(&format!("step/{service}")) {
        let account: StepAccount =
            serde_json::from_str(&label.value).map_err(|cause| wrong(label, "step", cause.to_string()))?;
        let tick = u64::try_from(label.tick).map_err(|cause| wrong(label, "step", cause.to_string()))?;
        let step = Step {
            tick,
            seq: account.seq,
            steps: account.steps.filter(|steps| *steps > 0),
            used: account.used.into_iter().collect(),
            operator: if account.operator_lost { OperatorLink::Lost } else { OperatorLink::Present },
            digest: account.digest.and_then(|digest| u64::from_str_radix(&digest, 16).ok()),
        };
        match part.instances.iter_mut().rfind(|instance| instance.source == account.source) {
            // Told twice, as by two recorders one after the other.
            Some(instance) if instance.steps.last().is_some_and(|last| last.tick >= tick) => {}
            Some(instance) => instance.steps.push(step),
            None => part.instances.push(Instance { source: account.source, steps: vec![step] }),
        }
    }
    let mut before: Option<&Label> = None;
    for label in source.commands_of(service) {
        // Two recorders one after the other may have told it twice; a block is not asked the same twice in a tick.
        if before.is_some_and(|before| before == label) {
            continue;
        }
        before = Some(label);
        let command = command(service, &label.value).map_err(|cause| wrong(label, "command", cause.to_string()))?;
        part.commands.push((u64::try_from(label.tick).unwrap_or_default(), command));
    }
    Ok(part)
}

/// A service's command with the service's name: as a mission has it.
fn command(service: &str, text: &str) -> Result<Command, serde_json::Error> {
    let own: Value = serde_json::from_str(text)?;
    serde_json::from_value(json!({ service: own }))
}

/// A signal of every block at every tick.
static SHOWN: [&Signal; RING.len()] =
    [&signal::truth::POSE, &signal::nav::POSE, &signal::reference::DEPTH, &signal::thrust::REQUESTED];

/// Which messages each block used in a run of one process: its mission and its laps, with empty messages on the wires.
fn batch_parts(
    source: &RecordedRun,
    trial: &ResolvedTrial,
    tick_s: f64,
    messages: &mut Messages,
) -> [BlockHistory; RING.len()] {
    // As far as every block was recorded: what was cut off in the middle of a batch is not there of all of them.
    let last = |signal: &&Signal| source.signal(signal).and_then(|columns| columns.tick.last());
    let last = SHOWN.iter().filter_map(last).min();
    let Some(last) = last.and_then(|&last| u64::try_from(last).ok()) else { return Default::default() };
    let mut mission = Mission::new(&trial.trial.mission, tick_s);
    let mut lap = Lap {
        parts: core::array::from_fn(|_| BlockHistory { instances: vec![Instance::default()], commands: Vec::new() }),
        wires: RingWires::default(),
        tick: Tick { k: 0, dt_s: tick_s },
        due: Vec::new(),
    };
    for k in 0..=last {
        lap.tick.k = k;
        lap.due.clear();
        while let Some(command) = mission.due(lap.tick) {
            match command {
                // What the twin refused has no effect here either.
                Command::Link(command) => {
                    let _ = lap.wires.command(lap.tick, command);
                }
                command => lap.due.push(command.clone()),
            }
        }
        if let Some(request) = lap.wires.begin(lap.tick) {
            messages.add(k, "", request.clone());
        }
        around(&mut lap);
    }
    lap.parts
}

/// A lap of ticks instead of messages.
struct Lap {
    parts: [BlockHistory; RING.len()],
    wires: RingWires,
    tick: Tick,
    /// Commands that apply now.
    due: Vec<Command>,
}

impl RingVisitor for Lap {
    fn block<B: RingBlock>(&mut self) {
        let k = self.tick.k;
        let part = &mut self.parts[B::PLACE];
        part.commands.extend(self.due.iter().filter(|due| B::own(due).is_some()).map(|due| (k, due.clone())));
        part.instances[0].steps.push(Step {
            tick: k,
            seq: k + 1,
            steps: Some(k + 1),
            used: self.wires.used::<B>(self.tick),
            operator: self.wires.operator(self.tick),
            digest: None,
        });
        self.wires.send(k, B::Out::default());
    }
}
