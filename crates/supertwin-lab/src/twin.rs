//! The ring: plant, estimator, guidance and controller in lock step, in one process.
#![allow(non_snake_case, reason = "matrices are capitals, as in the book")]

use crate::config::ConfigError;
use crate::trial::ResolvedTrial;
use crate::wire::Wire;
use arrayvec::ArrayVec;
use nalgebra::Vector4;
use std::path::Path;
use supertwin_core::command::{Command, LinkCommand, Wire as WireName};
use supertwin_core::digest::{DigestProbe, RunDigest, block_digest};
use supertwin_core::message::{Measurements, Nav, Reference, Thrust, Truth, WrenchRequest};
use supertwin_core::observe::Snapshot;
use supertwin_core::random::Stream;
use supertwin_core::{Block, Event, Observe, OperatorLink, Prev, Probe, Refusal, Tick, Watch, signal};
use supertwin_gnc::control::ControllerSetup;
use supertwin_gnc::{Allocation, Controller, ControllerInput, Estimator, EstimatorInput, Guidance, GuidanceInput};
use supertwin_model::{Hydrodynamics, Thrusters};
use supertwin_plant::{Drive, Plant, PlantConfig, Shadow};

/// Events that one tick can have; more are counted.
const MAX_EVENTS: usize = 16;

/// A quantity that is no number: the run stops here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("tick {k}: {path} is NaN or infinite")]
pub struct NonFinite {
    /// When.
    pub k: u64,
    /// What.
    pub path: &'static str,
}

/// The four blocks and their wires.
#[derive(Clone, Debug)]
pub struct Twin {
    plant: Plant,
    estimator: Estimator,
    guidance: Guidance,
    controller: Controller,
    measurements: Wire<Measurements>,
    nav: Wire<Nav>,
    reference: Wire<Reference>,
    thrust: Wire<Thrust>,
    wrench_request: Wire<WrenchRequest>,
    /// An external controller of the mission: what it asks for, and until which tick.
    requesting: Option<(u64, WrenchRequest)>,
    operator_lost_until: u64,
    digests: [u64; 4],
    run_digest: RunDigest,
    events: ArrayVec<Event, MAX_EVENTS>,
    events_dropped: u64,
    watches: Watches,
}

/// The four messages of one tick.
#[derive(Clone, Copy, Debug)]
pub struct Outputs<'a> {
    /// Plant to estimator.
    pub measurements: &'a Measurements,
    /// Estimator to guidance and controller.
    pub nav: &'a Nav,
    /// Guidance to controller.
    pub reference: &'a Reference,
    /// Controller to plant and estimator.
    pub thrust: &'a Thrust,
}

/// The four blocks of a trial, not yet wired.
#[derive(Clone, Debug)]
pub struct Blocks {
    /// The truth.
    pub plant: Plant,
    /// Measurements into navigation.
    pub estimator: Estimator,
    /// Set-points into references.
    pub guidance: Guidance,
    /// References into thrust.
    pub controller: Controller,
}

/// What each block last gave notice of.
#[derive(Clone, Debug)]
struct Watches {
    plant: Watch,
    estimator: Watch,
    guidance: Watch,
    controller: Watch,
}

impl Blocks {
    /// Builds the blocks of a trial for one seed. The nominal model is drawn from the stream `nominal`.
    ///
    /// # Errors
    /// When pieces that are legal alone do not fit together.
    pub fn new(trial: &ResolvedTrial, seed: u64) -> Result<Self, ConfigError> {
        Self::build(trial, seed, false)
    }

    /// The same with a plant that moves as the brain's nominal model says: for one that is driven by the disturbance that
    /// an estimator with this model has found.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn nominal(trial: &ResolvedTrial, seed: u64) -> Result<Self, ConfigError> {
        Self::build(trial, seed, true)
    }

    fn build(trial: &ResolvedTrial, seed: u64, as_nominal: bool) -> Result<Self, ConfigError> {
        let wrong = |place: &Path| {
            let path = place.display().to_string();
            move |message: String| ConfigError::Combination { path: path.clone(), message }
        };
        let config = &trial.trial;
        let vehicle = &trial.vehicle;
        let dt_s = config.tick_s.get();
        let thrusters =
            Thrusters::new(&vehicle.thruster).map_err(|error| wrong(&trial.places.vehicle)(error.to_string()))?;
        let nominal = nominal_model(&Hydrodynamics::from(&vehicle.nominal), config.nominal_spread.get(), seed);
        let plant = Plant::new(
            &PlantConfig {
                dynamics: if as_nominal { nominal } else { Hydrodynamics::from(&vehicle.truth) },
                mass_kg: vehicle.truth.rigid_body.mass_kg.get(),
                height_m: vehicle.size_m[2].get(),
                thrusters,
                propulsion: &vehicle.propulsion,
                unmodelled: &vehicle.unmodelled,
                environment: &trial.environment,
                sensors: &trial.sensors,
                start: &config.start,
                dt_s,
                substeps: config.substeps,
                thrust_stale_after_ticks: Tick::at_or_after(trial.safety.plant.thrust_s.get(), dt_s),
            },
            seed,
        )
        .map_err(wrong(&trial.places.vehicle))?;
        let estimator = Estimator::new(
            &trial.estimator,
            nominal,
            trial.sensors.dvl.beam_angle_rad.get(),
            &trial.safety.estimator,
            dt_s,
        );
        let guidance = Guidance::new(&trial.guidance, trial.safety.guidance.nav_s.get(), dt_s);
        let laws = std::iter::once((trial.controller_name.clone(), &trial.controller.law))
            .chain(trial.standby.iter().map(|(name, config)| (name.clone(), &config.law)))
            .collect();
        let controller = Controller::new(&ControllerSetup {
            laws,
            model: nominal,
            allocation: Allocation::new(thrusters, vehicle.propulsion.dead_band_n.get(), &vehicle.allocation),
            limits: &trial.safety.controller,
            fallback: &trial.safety.fallback,
            dt_s,
        })
        .map_err(wrong(&trial.places.controller))?;
        Ok(Self { plant, estimator, guidance, controller })
    }

    /// The plant of these blocks beside a real vehicle.
    #[must_use]
    pub fn shadow(self) -> Shadow {
        Shadow::new(self.plant)
    }
}

impl Twin {
    /// Builds the blocks of a trial for one seed and wires them.
    ///
    /// # Errors
    /// When pieces that are legal alone do not fit together.
    pub fn new(trial: &ResolvedTrial, seed: u64) -> Result<Self, ConfigError> {
        Ok(Self::of(Blocks::new(trial, seed)?))
    }

    /// Wires blocks.
    #[must_use]
    pub fn of(blocks: Blocks) -> Self {
        let Blocks { plant, estimator, guidance, controller } = blocks;
        Self {
            watches: Watches {
                plant: Watch::new(&plant),
                estimator: Watch::new(&estimator),
                guidance: Watch::new(&guidance),
                controller: Watch::new(&controller),
            },
            plant,
            estimator,
            guidance,
            controller,
            measurements: Wire::default(),
            nav: Wire::default(),
            reference: Wire::default(),
            thrust: Wire::default(),
            wrench_request: Wire::default(),
            requesting: None,
            operator_lost_until: 0,
            digests: [0; 4],
            run_digest: RunDigest::default(),
            events: ArrayVec::new(),
            events_dropped: 0,
        }
    }

    /// From the next step on the plant is driven by this disturbance in the place of its environment.
    pub fn drive(&mut self, drive: Drive) {
        self.plant.drive(drive);
    }

    /// A command, from now on.
    ///
    /// # Errors
    /// When the block refuses it.
    pub fn command(&mut self, tick: Tick, command: &Command) -> Result<(), Refusal> {
        match command {
            Command::Plant(command) => self.plant.command(tick, command),
            Command::Estimator(command) => self.estimator.command(tick, command),
            Command::Guidance(command) => self.guidance.command(tick, command),
            Command::Controller(command) => self.controller.command(tick, command),
            Command::Link(command) => self.link(tick, command),
        }
    }

    fn link(&mut self, tick: Tick, command: &LinkCommand) -> Result<(), Refusal> {
        let until = command.until(tick)?;
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
        Ok(())
    }

    /// One lap: the block diagram, read top to bottom.
    pub fn step(&mut self, tick: Tick) {
        let k = tick.k;
        let before = k.checked_sub(1);
        if let Some((_, request)) = self.requesting.as_ref().filter(|(until, _)| k < *until) {
            self.wrench_request.send(k, request.clone());
        }
        let operator = if k < self.operator_lost_until { OperatorLink::Lost } else { OperatorLink::Present };
        let measurements = self.plant.step(tick, Prev(self.thrust.receive(before)));
        self.measurements.send(k, measurements);

        let nav = self.estimator.step(
            tick,
            EstimatorInput {
                measurements: self.measurements.fresh(k).map_or(&[], std::slice::from_ref),
                thrust: Prev(self.thrust.receive(before)),
            },
        );
        self.nav.send(k, nav);

        let reference = self.guidance.step(tick, GuidanceInput { nav: self.nav.receive(Some(k)), operator });
        self.reference.send(k, reference);

        let thrust = self.controller.step(
            tick,
            ControllerInput {
                nav: self.nav.receive(Some(k)),
                reference: self.reference.receive(Some(k)),
                applied: Prev(self.thrust.receive(before)),
                wrench_request: self.wrench_request.receive(Some(k)),
            },
        );
        self.thrust.send(k, thrust);
        self.watch(tick);
    }

    /// Hashes this tick's states and outputs; returns the tick's own hash.
    ///
    /// # Errors
    /// When a quantity is no number.
    pub fn digest(&mut self, tick: Tick, probe: &mut DigestProbe) -> Result<u64, NonFinite> {
        if let Some(now) = self.outputs() {
            self.digests = [
                block_digest(probe, &self.plant, now.measurements),
                block_digest(probe, &self.estimator, now.nav),
                block_digest(probe, &self.guidance, now.reference),
                block_digest(probe, &self.controller, now.thrust),
            ];
        }
        if probe.take_finite() {
            return Ok(self.run_digest.fold(tick, self.digests));
        }
        match Snapshot::of(self).first_non_finite() {
            Some(culprit) => Err(NonFinite { k: tick.k, path: culprit.path }),
            // Only their sum was none.
            None => Ok(self.run_digest.fold(tick, self.digests)),
        }
    }

    /// Hashes of plant, estimator, guidance and controller at the last tick.
    #[must_use]
    pub fn digests(&self) -> [u64; 4] {
        self.digests
    }

    /// Hash of the run so far.
    #[must_use]
    pub fn run_digest(&self) -> RunDigest {
        self.run_digest
    }

    /// What happened at the last tick.
    #[must_use]
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// Events that did not fit; always zero unless something is very wrong.
    #[must_use]
    pub fn events_dropped(&self) -> u64 {
        self.events_dropped
    }

    /// The truth.
    #[must_use]
    pub fn truth(&self) -> &Truth {
        self.plant.truth()
    }

    /// Everything that the blocks put out at the last tick, whether or not it got through; `None` before the first.
    #[must_use]
    pub fn outputs(&self) -> Option<Outputs<'_>> {
        Some(Outputs {
            measurements: self.measurements.at_source()?,
            nav: self.nav.at_source()?,
            reference: self.reference.at_source()?,
            thrust: self.thrust.at_source()?,
        })
    }

    /// The controller.
    #[must_use]
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// What guidance gives as its reason.
    #[must_use]
    pub fn guidance(&self) -> &Guidance {
        &self.guidance
    }

    /// Messages lost on cut wires: measurements, nav, reference, thrust.
    #[must_use]
    pub fn withheld(&self) -> [u64; 4] {
        [self.measurements.withheld(), self.nav.withheld(), self.reference.withheld(), self.thrust.withheld()]
    }

    fn watch(&mut self, tick: Tick) {
        self.events.clear();
        let (Some(measurements), Some(nav)) = (self.measurements.at_source(), self.nav.at_source()) else { return };
        let (Some(reference), Some(thrust)) = (self.reference.at_source(), self.thrust.at_source()) else { return };
        let (events, dropped) = (&mut self.events, &mut self.events_dropped);
        let mut happened = |event| *dropped += u64::from(events.try_push(event).is_err());
        self.watches.plant.after(tick, &self.plant, measurements, &mut happened);
        self.watches.estimator.after(tick, &self.estimator, nav, &mut happened);
        self.watches.guidance.after(tick, &self.guidance, reference, &mut happened);
        self.watches.controller.after(tick, &self.controller, thrust, &mut happened);
    }
}

impl Observe for Twin {
    /// Everything that the blocks and the wires show, in the order of the ring.
    fn observe<P: Probe>(&self, probe: &mut P) {
        let Some(now) = self.outputs() else { return };
        self.plant.observe(probe);
        now.measurements.observe(probe);
        self.estimator.observe(probe);
        now.nav.observe(probe);
        self.guidance.observe(probe);
        now.reference.observe(probe);
        self.controller.observe(probe);
        now.thrust.observe(probe);
        probe.vector(&signal::link::WITHHELD, &self.withheld().map(|count| count as f64));
    }
}

/// The brain's model: every inertia and damping wrong by a factor drawn from `1 ± spread`.
fn nominal_model(model: &Hydrodynamics, spread: f64, seed: u64) -> Hydrodynamics {
    let mut stream = Stream::new(seed, "nominal");
    let mut factors = || Vector4::from_fn(|_, _| stream.uniform(1.0 - spread, 1.0 + spread));
    let (M, D_l, D_q) = (factors(), factors(), factors());
    model.perturbed(&M, &D_l, &D_q)
}
