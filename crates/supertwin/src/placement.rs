//! From a trial to hosts: which block, which mission, which limits. The glue between files and wires.

use crate::cli::{PlacementArguments, Service};
use crate::failure::Failure;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use supertwin_core::run::Properties;
use supertwin_core::{Tick, Wired};
use supertwin_lab::mission::{Mission, Parts};
use supertwin_lab::{Blocks, Library, ResolvedTrial, trial};
use supertwin_protocol::{Clock, FaultRates};
use supertwin_zenoh::host::Hosted;
use supertwin_zenoh::{Engine, Host, HostOptions, LinkError, Mailbox, Pace, Session};

/// What all services of one call have in common.
pub(crate) struct Placement {
    pub(crate) trial: ResolvedTrial,
    pub(crate) pace: Pace,
    pub(crate) ticks: Option<u64>,
    pub(crate) run: String,
    pub(crate) telemetry_every: u64,
    pub(crate) witnesses: Vec<String>,
    pub(crate) faults: Option<FaultRates>,
    pub(crate) patience: Duration,
    pub(crate) keep_digests: bool,
    pub(crate) rejoins: bool,
    seed: u64,
    parts: Parts,
    blocks: Blocks,
}

/// Where the program comes from.
pub(crate) fn provenance() -> Properties {
    Properties::from([("git_commit".to_owned(), env!("SUPERTWIN_GIT_COMMIT").into())])
}

/// Eight hexadecimal digits that nobody else has.
pub(crate) fn unique() -> String {
    supertwin_zenoh::unique()
}

impl Placement {
    /// Reads the trial and builds its blocks.
    pub(crate) fn new(arguments: &PlacementArguments, library: &Library) -> Result<Self, Failure> {
        let mut trials = trial::load(library, &arguments.trial)?;
        library.all_used(&trials)?;
        let names: Vec<String> = trials.iter().map(|trial| trial.controller_name.clone()).collect();
        let chosen = match &arguments.controller {
            None => 0,
            Some(name) => names.iter().position(|other| other == name).ok_or_else(|| {
                Failure::Call(format!("--controller {name}: {} has {}", arguments.trial, names.join(", ")))
            })?,
        };
        let trial = trials.swap_remove(chosen);
        let seed = arguments.seed.unwrap_or(trial.trial.seed);
        let dt_s = trial.trial.tick_s.get();
        let lock_step = arguments.pace == crate::cli::PaceArgument::Lockstep;
        let ticks = match arguments.duration {
            Some(duration_s) => Some(Tick::at_or_after(duration_s, dt_s)),
            None if lock_step => Some(trial.ticks()),
            None => None,
        };
        let mission = Mission::new(if arguments.no_mission { &[] } else { &trial.trial.mission }, dt_s);
        let parts =
            Parts::of(&mission).map_err(|cause| Failure::Path { path: trial.path.display().to_string(), cause })?;
        let faults = (arguments.fault_drop > 0.0 || arguments.fault_double > 0.0).then_some(FaultRates {
            drop: arguments.fault_drop,
            double: arguments.fault_double,
            seed: arguments.fault_seed,
        });
        Ok(Self {
            blocks: Blocks::new(&trial, seed)?,
            pace: if lock_step { Pace::LockStep } else { Pace::RealTime(arguments.rtf) },
            ticks,
            run: arguments.run.clone().unwrap_or_else(|| format!("{}-{}", trial.name, unique())),
            telemetry_every: arguments.telemetry_every,
            witnesses: arguments.witness.clone(),
            faults,
            patience: Duration::from_secs_f64(arguments.patience),
            keep_digests: false,
            rejoins: true,
            seed,
            parts,
            trial,
        })
    }

    /// Name of the vehicle on the network.
    pub(crate) fn vehicle(&self, asked_for: Option<&str>) -> String {
        asked_for.map_or_else(|| self.trial.trial.vehicle.clone(), str::to_owned)
    }

    /// What recordings keep of this configuration.
    fn about(&self) -> Properties {
        let placement = if self.pace == Pace::LockStep { "lockstep" } else { "realtime" };
        let mut about = supertwin_lab::run::properties(&self.trial, self.seed, placement, &provenance());
        match self.ticks {
            Some(ticks) => about.insert("duration_s".to_owned(), (ticks as f64 * self.trial.trial.tick_s.get()).into()),
            // Until it is stopped.
            None => about.remove("duration_s"),
        };
        about
    }

    /// Puts a service on the network, into `engine`.
    pub(crate) fn host(
        &self,
        service: Service,
        session: &Session,
        mailbox: &Arc<Mailbox>,
        clock: &Arc<dyn Clock>,
        engine: &mut Engine,
    ) -> Result<(), LinkError> {
        let index = engine.next_index();
        let blocks = self.blocks.clone();
        let host: Box<dyn Hosted> = match service {
            Service::Plant => self.open(session, blocks.plant, self.parts.plant.clone(), mailbox, index, clock)?,
            Service::Estimator => {
                self.open(session, blocks.estimator, self.parts.estimator.clone(), mailbox, index, clock)?
            }
            Service::Guidance => {
                self.open(session, blocks.guidance, self.parts.guidance.clone(), mailbox, index, clock)?
            }
            Service::Controller => {
                self.open(session, blocks.controller, self.parts.controller.clone(), mailbox, index, clock)?
            }
            // The vehicle has its own faults: those of a mission are the plant's.
            Service::Shadow => self.open(session, blocks.shadow(), Vec::new(), mailbox, index, clock)?,
            Service::Router | Service::Recorder => return Ok(()),
        };
        engine.add(host);
        Ok(())
    }

    fn open<B: Wired + 'static>(
        &self,
        session: &Session,
        block: B,
        mission: Vec<(u64, B::Command)>,
        mailbox: &Arc<Mailbox>,
        index: usize,
        clock: &Arc<dyn Clock>,
    ) -> Result<Box<dyn Hosted>, LinkError> {
        let options = HostOptions {
            run: self.run.clone(),
            instance: unique(),
            pace: self.pace,
            tick_s: self.trial.trial.tick_s.get(),
            ticks: self.ticks,
            about: self.about(),
            telemetry_every: self.telemetry_every,
            mission,
            lead_ticks: 3,
            patience: self.patience,
            deadman: Duration::from_secs_f64(self.trial.safety.operator.setpoint_s.get()),
            keeps_authority: B::NAME == "controller",
            takes_setpoints: B::NAME == "guidance",
            witnesses: self.witnesses.clone(),
            faults: self.faults,
            rejoins: self.rejoins,
            keep_digests: self.keep_digests,
        };
        Ok(Box::new(Host::open(session, block, options, mailbox, index, Arc::clone(clock))?))
    }
}

/// Set by Ctrl-C and SIGTERM.
pub(crate) fn stop_flag(mailbox: &Arc<Mailbox>) -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let (flag, mailbox) = (Arc::clone(&stop), Arc::clone(mailbox));
    ctrlc::set_handler(move || {
        flag.store(true, Ordering::Relaxed);
        mailbox.wake();
    })
    .map_err(|cause| Failure::Call(format!("Ctrl-C can't be caught: {cause}")))?;
    Ok(stop)
}
