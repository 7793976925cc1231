//! A seeded run from start to scores, into any sink.

use crate::config::ConfigError;
use crate::mission::Mission;
use crate::score::{Scorer, Scores, Tracking};
use crate::trial::ResolvedTrial;
use crate::twin::{NonFinite, Twin};
use std::collections::BTreeSet;
use supertwin_core::check::Finite;
use supertwin_core::command::Command;
use supertwin_core::digest::{DigestProbe, RunDigest};
use supertwin_core::event::EventCommand;
use supertwin_core::run::{FORMAT, Limits, Properties, Property, Scene, ThrusterPlace};
use supertwin_core::signal::estimator;
use supertwin_core::{Capability, Event, EventKind, Observe, RunHeader, RunSink, Severity, SinkError, Tick};
use supertwin_gnc::control::Law;
use supertwin_model::{SonarArray, ThrusterConfig};
use supertwin_plant::cage::Cage;

/// Result of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunOutcome {
    /// Scores over the trial's window.
    pub scores: Scores,
    /// Hash over the states and outputs of all blocks at all ticks.
    pub digest: RunDigest,
    /// Ticks that were simulated.
    pub ticks: u64,
    /// False when it was stopped before its end.
    pub complete: bool,
    /// Warnings among the events.
    pub warnings: u64,
    /// Commands that were refused, and why.
    pub refused: Vec<Event>,
}

/// A run that could not be done.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The pieces do not fit together.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The recording can't be written.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// A quantity is no number.
    #[error(transparent)]
    NonFinite(#[from] NonFinite),
}

/// Ticks between two looks at whether to go on.
const BREATH_TICKS: u64 = 256;

/// Runs `trial` with `seed` into `sink`.
///
/// `recording` says that the sink is one, and where the program comes from (for the recording's properties).
/// `go_on` is called now and then with the ticks done; the run ends early, properly, when it returns false.
///
/// # Errors
/// When the trial can't be built, the sink can't keep it, or a quantity is no number.
pub fn run<S: RunSink>(
    trial: &ResolvedTrial,
    seed: u64,
    sink: &mut S,
    recording: Option<&Properties>,
    go_on: impl FnMut(u64) -> bool,
) -> Result<RunOutcome, RunError> {
    let twin = Twin::new(trial, seed)?;
    let header = match recording {
        Some(provenance) => Some(RunHeader {
            name: run_name(trial, seed),
            properties: properties(trial, seed, "batch", provenance),
            scene: scene(trial, seed)?,
        }),
        None => None,
    };
    play(trial, twin, trial.ticks(), header.as_ref(), sink, |_, _, _| Ok(()), go_on)
}

/// Runs `twin` for `ticks` under the mission of `trial`; `before` is called at the beginning of each tick.
pub(crate) fn play<S: RunSink>(
    trial: &ResolvedTrial,
    mut twin: Twin,
    last: u64,
    header: Option<&RunHeader>,
    sink: &mut S,
    mut before: impl FnMut(&mut Twin, Tick, &mut S) -> Result<(), SinkError>,
    mut go_on: impl FnMut(u64) -> bool,
) -> Result<RunOutcome, RunError> {
    let dt_s = trial.trial.tick_s.get();
    let mut mission = Mission::new(&trial.trial.mission, dt_s);
    let mut scorer = Scorer::new(trial.score_from_tick(), last, dt_s);
    let mut probe = DigestProbe::default();
    let (mut warnings, mut ticks) = (0, 0);
    let mut refused = Vec::new();
    if let Some(header) = header {
        sink.begin(header)?;
    }
    let recording = header.is_some();
    for k in 0..last {
        if k.is_multiple_of(BREATH_TICKS) && !go_on(k) {
            break;
        }
        let tick = Tick { k, dt_s };
        if recording {
            sink.tick(tick)?;
        }
        before(&mut twin, tick, sink)?;
        while let Some(command) = mission.due(tick) {
            let refusal = twin.command(tick, command).err();
            if recording || refusal.is_some() {
                let event = command_event(k, command, refusal.as_ref());
                warnings += u64::from(event.severity > Severity::Info);
                sink.event(&event)?;
                if refusal.is_some() {
                    refused.push(event);
                }
            }
        }
        twin.step(tick);
        if let Err(error) = twin.digest(tick, &mut probe) {
            if recording {
                // The recording ends with the tick that went wrong and says what did.
                twin.observe(sink);
                let what = EventKind::NotFinite { at_tick: error.k, signal: error.path.into(), so_far: None };
                sink.event(&Event::new(k, "run", Severity::Error, what))?;
                let failed = Properties::from([
                    ("complete".to_owned(), 0u64.into()),
                    ("error".to_owned(), error.to_string().into()),
                    ("ticks".to_owned(), (k + 1).into()),
                ]);
                sink.finish(&failed)?;
            }
            return Err(error.into());
        }
        let Some(now) = twin.outputs() else { continue };
        let tracking = Tracking::new(now.nav, now.reference, twin.truth());
        let law = twin.blocks.controller.law().sample();
        scorer.add(tick, &tracking, now.thrust, &twin.truth().wrench, &law);
        warnings += twin.events.iter().filter(|event| event.severity > Severity::Info).count() as u64;
        if recording {
            twin.observe(sink);
            tracking.observe(sink);
            for event in &twin.events {
                sink.event(event)?;
            }
        }
        ticks = k + 1;
    }
    if ticks == last {
        for (at, command) in mission.rest() {
            warnings += 1;
            let command = EventCommand::of_mission(command);
            let what = EventKind::CommandNeverApplied { command, at_s: *at as f64 * dt_s };
            sink.event(&Event::new(ticks.saturating_sub(1), "mission", Severity::Warning, what))?;
        }
    }
    let outcome = RunOutcome {
        scores: scorer.scores(),
        digest: twin.run_digest,
        ticks,
        complete: ticks == last,
        warnings,
        refused,
    };
    if recording {
        sink.finish(&results(&outcome))?;
    }
    Ok(outcome)
}

fn command_event(k: u64, command: &Command, refusal: Option<&supertwin_core::Refusal>) -> Event {
    let command = EventCommand::of_mission(command);
    let (severity, what) = match refusal {
        None => (Severity::Info, EventKind::CommandApplied { command }),
        Some(refusal) => {
            let reason = refusal.to_string();
            (Severity::Error, EventKind::CommandRefused { command, session: None, reason, so_far: None })
        }
    };
    Event::new(k, "mission", severity, what)
}

/// Name of a run: trial, controller, seed.
#[must_use]
pub fn run_name(trial: &ResolvedTrial, seed: u64) -> String {
    format!("{}-seed{seed}", base_name(trial))
}

/// Name of a trial with its controller.
#[must_use]
pub fn base_name(trial: &ResolvedTrial) -> String {
    if trial.name == trial.controller_name || trial.name.ends_with(&format!("-{}", trial.controller_name)) {
        trial.name.clone()
    } else {
        format!("{}-{}", trial.name, trial.controller_name)
    }
}

/// Everything that is needed to repeat the run. `placement` says how its services are distributed.
#[must_use]
pub fn properties(trial: &ResolvedTrial, seed: u64, placement: &str, provenance: &Properties) -> Properties {
    let mut properties = provenance.clone();
    let mut set = |name: &str, value: Property| properties.insert(name.to_owned(), value);
    set("trial", trial.name.as_str().into());
    set("controller", trial.controller_name.as_str().into());
    set("law", trial.controller.law.name().into());
    let laws = laws(trial);
    let names: BTreeSet<&str> = laws.iter().map(Law::name).collect();
    set("laws", Vec::from_iter(names).join(" ").into());
    let capabilities: BTreeSet<Capability> = laws.iter().flat_map(|law| law.capabilities()).copied().collect();
    set("capabilities", Vec::from_iter(capabilities.into_iter().map(Capability::name)).join(" ").into());
    set("vehicle", trial.trial.vehicle.as_str().into());
    set("environment", trial.trial.environment.as_str().into());
    set("placement", placement.into());
    set("format", FORMAT.into());
    set("seed", seed.into());
    set("tick_s", trial.trial.tick_s.get().into());
    set("duration_s", trial.trial.duration_s.get().into());
    set("score_from_s", trial.trial.score.from_s.get().into());
    set("version", env!("CARGO_PKG_VERSION").into());
    set("config", trial.text.as_str().into());
    properties
}

/// Scores, hash and counts of a run, as its recording keeps them.
#[must_use]
pub fn results(outcome: &RunOutcome) -> Properties {
    let mut properties = outcome.scores.properties();
    properties.insert("hash".to_owned(), outcome.digest.to_string().into());
    properties.insert("ticks".to_owned(), outcome.ticks.into());
    properties.insert("complete".to_owned(), u64::from(outcome.complete).into());
    properties.insert("warnings".to_owned(), outcome.warnings.into());
    properties
}

/// Every law that can come to command in this run.
fn laws(trial: &ResolvedTrial) -> Vec<Law> {
    let standby = trial.standby.iter().map(|(_, config)| config);
    // That they can be built was checked when the trial was resolved.
    std::iter::once(&trial.controller)
        .chain(standby)
        .flat_map(|config| config.law.family().unwrap_or_default())
        .collect()
}

/// The net at rest as rings and verticals, the vehicle as a box with its thrusters, and limits.
///
/// # Errors
/// When the pen can't be built.
pub fn scene(trial: &ResolvedTrial, seed: u64) -> Result<Scene, ConfigError> {
    let config = &trial.environment.cage;
    let cage = Cage::new(config, seed)
        .map_err(|message| ConfigError::Combination { path: trial.path.display().to_string(), message })?;
    let point = |i: u32, n: u32, depth_m: f64| {
        let (sin, cos) = libm::sincos(core::f64::consts::TAU * f64::from(i) / f64::from(n));
        let radius_m = cage.radius([cos, sin], depth_m);
        [radius_m * cos, radius_m * sin, depth_m]
    };
    let bottom_m = config.depth_m.get();
    let rings = (0..=5).map(|ring| (0..=240).map(|i| point(i, 240, bottom_m * f64::from(ring) / 5.0)).collect());
    let verticals = (0..48).map(|i| (0..=10).map(|j| point(i, 48, bottom_m * f64::from(j) / 10.0)).collect());
    Ok(Scene {
        net_lines_m: rings.chain(verticals).collect(),
        body_half_size_m: trial.vehicle.size_m.map(|size| size.get() / 2.0),
        beams: SonarArray::new(trial.sensors.dvl.beam_angle_rad.get()).beams().map(Into::into),
        thrusters: trial.vehicle.thruster.iter().map(thruster).collect(),
        limits: limits(trial),
    })
}

fn thruster(config: &ThrusterConfig) -> ThrusterPlace {
    let direction = config.direction.map(Finite::get);
    let length = libm::sqrt(direction.iter().map(|x| x * x).sum());
    ThrusterPlace {
        position_m: config.position_m.map(Finite::get),
        direction: direction.map(|x| x / length),
        max_n: config.max_n.get(),
    }
}

fn limits(trial: &ResolvedTrial) -> Limits {
    // Of the law that steers first: a substitute, where it has one.
    let alpha_tol = trial.controller.law.family().ok().and_then(|laws| laws.last()?.sample().alpha_tol);
    let trust = &trial.estimator.measurement;
    let sensors = [
        (&estimator::INNOVATION_DVL, trust.dvl),
        (&estimator::INNOVATION_DEPTH, trust.depth),
        (&estimator::INNOVATION_HEADING, trust.compass),
        (&estimator::INNOVATION_YAW_RATE, trust.gyro),
    ];
    let nis_gates = sensors.into_iter().filter_map(|(innovation, sensor)| Some((innovation, sensor.gate?.get())));
    Limits { alpha_tol, nis_gates: nis_gates.collect() }
}
