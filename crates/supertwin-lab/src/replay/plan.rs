//! Which block stepped when, on which messages, under which commands: as recorded over a network, or, for a run of one
//! process, as its mission and its wires say.

use super::{Messages, ReplayError};
use crate::ResolvedTrial;
use crate::mission::Mission;
use crate::wire::Wire;
use serde::Deserialize;
use std::collections::BTreeMap;
use supertwin_core::command::{Command, LinkCommand, Wire as WireName};
use supertwin_core::message::{Measurements, Nav, Reference, Thrust, WrenchRequest};
use supertwin_core::source::Label;
use supertwin_core::{Message, OperatorLink, RunSource, Signal, Tick, signal};

/// The services in the order of the ring.
pub const RING: [&str; 4] = ["plant", "estimator", "guidance", "controller"];

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
pub(crate) struct Part {
    /// In the order of their first steps.
    pub(crate) instances: Vec<Instance>,
    /// In the order in which they applied.
    pub(crate) commands: Vec<(u64, Command)>,
}

/// A run taken apart.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Plan {
    /// In the order of the ring.
    pub(crate) parts: [Part; RING.len()],
    pub(crate) tick_s: f64,
    pub(crate) batch: bool,
}

impl Plan {
    /// Every step of the run; messages that a mission made are added to `messages`.
    pub(crate) fn of(
        source: &impl RunSource,
        trial: &ResolvedTrial,
        tick_s: f64,
        messages: &mut Messages,
    ) -> Result<Self, ReplayError> {
        let run = source.properties().get("run");
        let placement = run.and_then(|run| run.get("placement"));
        let batch = placement.is_none_or(|placement| *placement == "batch".into());
        let parts = if batch {
            batch_parts(source, trial, tick_s, messages)
        } else {
            let mut parts: [Part; RING.len()] = Default::default();
            for (part, service) in parts.iter_mut().zip(RING) {
                *part = recorded_part(source, service)?;
            }
            parts
        };
        if parts.iter().all(|part| part.instances.is_empty()) {
            return Err(ReplayError::Nothing { run: source.name().to_owned() });
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
struct Account {
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

fn recorded_part(source: &impl RunSource, service: &str) -> Result<Part, ReplayError> {
    let wrong = |label: &Label, what: &str, cause: String| ReplayError::Account {
        run: source.name().to_owned(),
        path: format!("{what}/{service}"),
        tick: label.tick,
        cause,
    };
    let mut part = Part::default();
    for label in source.words(&format!("step/{service}")) {
        let account: Account =
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
    for label in source.commands().get(service).map_or(&[][..], Vec::as_slice) {
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
    Ok(match service {
        "plant" => Command::Plant(serde_json::from_str(text)?),
        "estimator" => Command::Estimator(serde_json::from_str(text)?),
        "guidance" => Command::Guidance(serde_json::from_str(text)?),
        _ => Command::Controller(serde_json::from_str(text)?),
    })
}

/// The wires of a run in one process, without the messages: what was cut, and who was in command.
#[derive(Debug, Default)]
struct Links {
    measurements: Wire<()>,
    nav: Wire<()>,
    reference: Wire<()>,
    thrust: Wire<()>,
    wrench_request: Wire<()>,
    requesting: Option<(u64, WrenchRequest)>,
    operator_lost_until: u64,
}

impl Links {
    fn apply(&mut self, tick: Tick, command: &LinkCommand) {
        // What the twin refused has no effect here either.
        let Ok(until) = command.until(tick) else { return };
        match command {
            LinkCommand::Withhold { wire, .. } => match wire {
                WireName::Measurements => self.measurements.cut_until(until),
                WireName::Nav => self.nav.cut_until(until),
                WireName::Reference => self.reference.cut_until(until),
                WireName::Thrust => self.thrust.cut_until(until),
            },
            LinkCommand::OperatorLostForS(_) => self.operator_lost_until = until,
            LinkCommand::WrenchRequest { request, .. } => self.requesting = Some((until, request.clone())),
        }
    }
}

/// Tick of the message that a wire holds.
fn held<M: Message>(wire: &Wire<()>) -> Option<(String, Vec<u64>)> {
    wire.made_at().map(|tick| (M::KEY.to_owned(), vec![tick]))
}

/// A signal of every block at every tick.
static SHOWN: [&Signal; RING.len()] =
    [&signal::truth::POSE, &signal::nav::POSE, &signal::reference::DEPTH, &signal::thrust::REQUESTED];

/// The same lap as [`crate::Twin::step`], of ticks instead of messages.
fn batch_parts(
    source: &impl RunSource,
    trial: &ResolvedTrial,
    tick_s: f64,
    messages: &mut Messages,
) -> [Part; RING.len()] {
    let mut parts: [Part; RING.len()] = Default::default();
    // As far as every block was recorded: what was cut off in the middle of a batch is not there of all of them.
    let last = |signal: &&Signal| source.signal(signal).and_then(|columns| columns.tick.last());
    let last = SHOWN.iter().filter_map(last).min();
    let Some(last) = last.and_then(|&last| u64::try_from(last).ok()) else { return parts };
    let mut mission = Mission::new(&trial.trial.mission, tick_s);
    let mut links = Links::default();
    for part in &mut parts {
        part.instances.push(Instance { source: String::new(), steps: Vec::new() });
    }
    for k in 0..=last {
        let tick = Tick { k, dt_s: tick_s };
        while let Some(command) = mission.due(tick) {
            let at = match command {
                Command::Plant(_) => 0,
                Command::Estimator(_) => 1,
                Command::Guidance(_) => 2,
                Command::Controller(_) => 3,
                Command::Link(command) => {
                    links.apply(tick, command);
                    continue;
                }
            };
            parts[at].commands.push((k, command.clone()));
        }
        if let Some((_, request)) = links.requesting.as_ref().filter(|(until, _)| k < *until) {
            messages.add(k, "", request.clone());
            links.wrench_request.send(k, ());
        }
        let operator = if k < links.operator_lost_until { OperatorLink::Lost } else { OperatorLink::Present };
        let before = held::<Thrust>(&links.thrust);
        links.measurements.send(k, ());
        let measured = held::<Measurements>(&links.measurements).map(|(key, ticks)| {
            // Every one counts once.
            let new = if links.measurements.fresh(k).is_some() { ticks } else { Vec::new() };
            (key, new)
        });
        links.nav.send(k, ());
        let nav = held::<Nav>(&links.nav);
        links.reference.send(k, ());
        let reference = held::<Reference>(&links.reference);
        let wrench_request = held::<WrenchRequest>(&links.wrench_request);
        links.thrust.send(k, ());
        let used = [
            vec![before.clone()],
            vec![measured, before.clone()],
            vec![nav.clone()],
            vec![nav, reference, before, wrench_request],
        ];
        for (part, used) in parts.iter_mut().zip(used) {
            part.instances[0].steps.push(Step {
                tick: k,
                seq: k + 1,
                steps: Some(k + 1),
                used: used.into_iter().flatten().collect(),
                operator,
                digest: None,
            });
        }
    }
    parts
}
