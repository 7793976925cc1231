//! From a trial to hosts: which block, which mission, which limits. The glue between files and wires.

use crate::OperationError;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use supertwin_core::run::Properties;
use supertwin_core::{Tick, Wired};
use supertwin_lab::mission::{Mission, Parts};
use supertwin_lab::{Blocks, Library, ResolvedTrial, trial};
use supertwin_protocol::{Clock, FaultRates};
use supertwin_zenoh::host::Hosted;
use supertwin_zenoh::{Engine, Host, HostOptions, LinkError, Mailbox, Pace, Session, unique};

/// A service that hosts a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostedService {
    /// The twin of the vehicle, its sensors and the sea.
    Plant,
    /// Measurements into navigation.
    Estimator,
    /// Set-points into references.
    Guidance,
    /// References into thrust.
    Controller,
    /// The twin beside a real vehicle.
    Shadow,
}

/// What is placed, and how it runs.
#[derive(Clone, Debug, Default)]
pub struct PlacementOptions {
    /// A name in `config/trials`, or a path.
    pub trial: String,
    /// Which of the trial's controllers; `None`: its first.
    pub controller: Option<String>,
    /// Instead of the trial's own.
    pub seed: Option<u64>,
    /// Real time or lock step.
    pub pace: Pace,
    /// Simulated seconds; `None`: the trial's in lock step, until it is stopped in real time.
    pub duration_s: Option<f64>,
    /// Whether the trial's timed commands are given.
    pub mission: bool,
    /// Name of the run; `None`: trial and a unique number.
    pub run: Option<String>,
    /// Telemetry at every n-th tick, 0 for none.
    pub telemetry_every: u64,
    /// Lock step: witnesses without whose receipt of a tick the plant does not go on.
    pub witnesses: Vec<String>,
    /// Messages that are lost and doubled on purpose.
    pub faults: Option<FaultRates>,
    /// Lock step: how long the others are waited for.
    pub patience: Duration,
    /// All services run in this process: in lock step the run's hash is wanted at its end, and nobody joins again.
    pub one_process: bool,
}

/// What all services of one call have in common.
pub struct Placement {
    trial: ResolvedTrial,
    options: PlacementOptions,
    /// Ticks of the run; `None`: until it is stopped.
    pub ticks: Option<u64>,
    /// Name of the run.
    pub run: String,
    /// Real time or lock step.
    pub pace: Pace,
    seed: u64,
    parts: Parts,
    blocks: Blocks,
}

/// Where the program comes from: its git commit.
#[must_use]
pub fn provenance() -> Properties {
    Properties::from([("git_commit".to_owned(), env!("SUPERTWIN_GIT_COMMIT").into())])
}

impl Placement {
    /// Reads the trial and builds its blocks.
    ///
    /// # Errors
    /// The configuration is wrong, or the trial has no such controller.
    pub fn new(options: PlacementOptions, library: &Library) -> Result<Self, OperationError> {
        let mut trials = trial::load(library, &options.trial)?;
        library.all_used(&trials)?;
        let names: Vec<String> = trials.iter().map(|trial| trial.controller_name.clone()).collect();
        let chosen = match &options.controller {
            None => 0,
            Some(name) => names.iter().position(|other| other == name).ok_or_else(|| {
                OperationError::Option(format!("--controller {name}: {} has {}", options.trial, names.join(", ")))
            })?,
        };
        let trial = trials.swap_remove(chosen);
        let seed = options.seed.unwrap_or(trial.trial.seed);
        let dt_s = trial.trial.tick_s.get();
        let ticks = match options.duration_s {
            Some(duration_s) => Some(Tick::at_or_after(duration_s, dt_s)),
            None if options.pace == Pace::LockStep => Some(trial.ticks()),
            None => None,
        };
        let mission = Mission::new(if options.mission { &trial.trial.mission } else { &[] }, dt_s);
        let parts = Parts::of(&mission).map_err(|cause| OperationError::at(&trial.path, &cause))?;
        let run = options.run.clone().unwrap_or_else(|| format!("{}-{}", trial.name, unique()));
        let (pace, blocks) = (options.pace, Blocks::new(&trial, seed)?);
        Ok(Self { trial, options, ticks, run, pace, seed, parts, blocks })
    }

    /// Length of a tick in simulated seconds.
    #[must_use]
    pub fn tick_s(&self) -> f64 {
        self.trial.trial.tick_s.get()
    }

    /// Name of the vehicle on the network: the one asked for, else the trial's.
    #[must_use]
    pub fn vehicle(&self, asked_for: Option<&str>) -> String {
        asked_for.map_or_else(|| self.trial.trial.vehicle.clone(), str::to_owned)
    }

    /// What recordings keep of this configuration.
    fn about(&self) -> Properties {
        let placement = if self.pace == Pace::LockStep { "lockstep" } else { "realtime" };
        let mut about = supertwin_lab::run::properties(&self.trial, self.seed, placement, &provenance());
        match self.ticks {
            Some(ticks) => about.insert("duration_s".to_owned(), (ticks as f64 * self.tick_s()).into()),
            // Until it is stopped.
            None => about.remove("duration_s"),
        };
        about
    }

    /// Puts services on the network; the engine that drives them ends when `stop` is set and `mailbox` woken.
    ///
    /// # Errors
    /// A key of a service can't be declared.
    pub fn host(
        &self,
        services: &[HostedService],
        session: &Session,
        mailbox: &Arc<Mailbox>,
        clock: &Arc<dyn Clock>,
        stop: &Arc<AtomicBool>,
    ) -> Result<Engine, LinkError> {
        let mut engine = Engine::new(Arc::clone(mailbox), Arc::clone(clock), Arc::clone(stop), self.tick_s());
        for service in services {
            let (blocks, parts) = (self.blocks.clone(), self.parts.clone());
            let at = (session, mailbox, engine.next_index(), clock);
            engine.add(match service {
                HostedService::Plant => self.open(at, blocks.plant, parts.plant)?,
                HostedService::Estimator => self.open(at, blocks.estimator, parts.estimator)?,
                HostedService::Guidance => self.open(at, blocks.guidance, parts.guidance)?,
                HostedService::Controller => self.open(at, blocks.controller, parts.controller)?,
                // The vehicle has its own faults: those of a mission are the plant's.
                HostedService::Shadow => self.open(at, blocks.shadow(), Vec::new())?,
            });
        }
        Ok(engine)
    }

    fn open<B: Wired + 'static>(
        &self,
        (session, mailbox, index, clock): (&Session, &Arc<Mailbox>, usize, &Arc<dyn Clock>),
        block: B,
        mission: Vec<(u64, B::Command)>,
    ) -> Result<Box<dyn Hosted>, LinkError> {
        let options = HostOptions {
            run: self.run.clone(),
            instance: unique(),
            pace: self.pace,
            tick_s: self.tick_s(),
            ticks: self.ticks,
            about: self.about(),
            telemetry_every: self.options.telemetry_every,
            mission,
            lead_ticks: 3,
            patience: self.options.patience,
            deadman: Duration::from_secs_f64(self.trial.safety.operator.setpoint_s.get()),
            keeps_authority: B::NAME == "controller",
            takes_setpoints: B::NAME == "guidance",
            witnesses: self.options.witnesses.clone(),
            faults: self.options.faults,
            rejoins: !self.options.one_process,
            keep_digests: self.options.one_process && self.pace == Pace::LockStep,
        };
        Ok(Box::new(Host::open(session, block, options, mailbox, index, Arc::clone(clock))?))
    }
}
