//! The controller service: errors, law, allocation, and what to do when an input is missing.

use super::fallback::{Fallback, FallbackConfig};
use super::{Law, LawConfig, LawInput, TrackingError};
use crate::allocation::Allocation;
use nalgebra::Vector4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::NonNegative;
use supertwin_core::command::ControllerCommand;
use supertwin_core::message::{Mode, Nav, Reference, Thrust, WrenchRequest};
use supertwin_core::{
    Block, Input, Notice, Notices, Observe, OperatorLink, PortRule, Prev, Probe, Refusal, Tick, Wired, Wires,
    parameter, signal,
};
use supertwin_model::Hydrodynamics;

/// How old inputs may get, in seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ControllerLimits {
    /// Navigation older than this: neutral.
    pub nav_s: NonNegative,
    /// A reference older than this: the vehicle brakes and holds by itself.
    pub reference_s: NonNegative,
    /// A wrench request older than this: the substitute steers.
    pub wrench_request_s: NonNegative,
}

/// Everything a controller is made of.
#[derive(Clone, Debug)]
pub struct ControllerSetup<'a> {
    /// Laws by name; the first is in command.
    pub laws: Vec<(String, &'a LawConfig)>,
    /// Nominal model, for the implicit discretisation.
    pub model: Hydrodynamics,
    /// Thrusters and their dead band.
    pub allocation: Allocation,
    /// Ages of inputs.
    pub limits: &'a ControllerLimits,
    /// How the vehicle brakes by itself.
    pub fallback: &'a FallbackConfig,
    /// Length of a tick.
    pub dt_s: f64,
}

/// What the controller consumes.
#[derive(Clone, Copy, Debug)]
pub struct ControllerInput<'a> {
    /// Estimate of the state, from the estimator.
    pub nav: Input<&'a Nav>,
    /// Reference trajectory, from guidance.
    pub reference: Input<&'a Reference>,
    /// What was really allocated at the tick before.
    pub applied: Prev<Input<&'a Thrust>>,
    /// A wrench from outside, for the law `external`.
    pub wrench_request: Input<&'a WrenchRequest>,
}

/// What the controller is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// The law follows guidance's reference.
    Tracking,
    /// Guidance wants no force.
    Neutral,
    /// Somebody demanded no force.
    EmergencyNeutral,
    /// Navigation is too old: no force.
    NavStale,
    /// Guidance is silent: the vehicle brakes and holds by itself.
    Fallback,
    /// The law's wrench was no number: no force, and the law starts afresh.
    NotFinite,
}

impl Status {
    /// The name used in recordings and events.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Tracking => "tracking",
            Self::Neutral => "neutral",
            Self::EmergencyNeutral => "emergency_neutral",
            Self::NavStale => "nav_stale",
            Self::Fallback => "fallback",
            Self::NotFinite => "not_finite",
        }
    }
}

/// What may be changed while the controller runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Tunable {
    /// The law in command, with its gains.
    law: LawConfig,
    /// How the vehicle brakes by itself.
    fallback: FallbackConfig,
}

/// A law with the name and the parameters it runs with.
#[derive(Clone, Debug)]
struct Candidate {
    name: String,
    config: LawConfig,
    law: Law,
}

/// The controller of one run.
#[derive(Clone, Debug)]
pub struct Controller {
    laws: Vec<Candidate>,
    model: Hydrodynamics,
    fallback_config: FallbackConfig,
    active: usize,
    allocation: Allocation,
    nav_limit: u64,
    reference_limit: u64,
    request_limit: u64,
    fallback: Fallback,
    last_reference: Option<Reference>,
    started: bool,
    neutral_demanded: bool,
    /// The last that guidance said was that it wants no force.
    wants_none: bool,
    /// The law has not steered at the tick before and takes over from what was applied.
    taking_over: bool,
    /// What the controller is doing.
    pub status: Status,
    error: TrackingError,
    non_finite: u32,
}

impl Controller {
    /// # Errors
    /// When there is no law, two have one name, or one can't be built.
    pub fn new(setup: &ControllerSetup<'_>) -> Result<Self, String> {
        let mut laws: Vec<Candidate> = Vec::with_capacity(setup.laws.len());
        for (name, config) in &setup.laws {
            if laws.iter().any(|other| other.name == *name) {
                return Err(format!("controller {name:?} is given twice: every law needs its own name"));
            }
            let law = config.build(&setup.model)?;
            laws.push(Candidate { name: name.clone(), config: (*config).clone(), law });
        }
        if laws.is_empty() {
            return Err("no controller given: there must be at least one".to_owned());
        }
        let ticks = |limit_s: NonNegative| Tick::at_or_after(limit_s.get(), setup.dt_s);
        Ok(Self {
            laws,
            model: setup.model,
            fallback_config: *setup.fallback,
            active: 0,
            allocation: setup.allocation.clone(),
            nav_limit: ticks(setup.limits.nav_s),
            reference_limit: ticks(setup.limits.reference_s),
            request_limit: ticks(setup.limits.wrench_request_s),
            fallback: Fallback::new(setup.fallback),
            last_reference: None,
            started: false,
            neutral_demanded: false,
            wants_none: false,
            taking_over: true,
            status: Status::Neutral,
            error: TrackingError::default(),
            non_finite: 0,
        })
    }

    /// The law in command.
    #[must_use]
    pub fn law(&self) -> &Law {
        &self.laws[self.active].law
    }

    /// Every law that a command may hand over to, and the one in command.
    pub fn laws(&self) -> impl Iterator<Item = &Law> {
        self.laws.iter().map(|candidate| &candidate.law)
    }

    /// The name of the law in command.
    #[must_use]
    pub fn law_name(&self) -> &str {
        &self.laws[self.active].name
    }

    fn tunable(&self) -> Tunable {
        Tunable { law: self.laws[self.active].config.clone(), fallback: self.fallback_config }
    }

    /// Other parameters from now on: adapted gains are kept, and the law takes over from itself without a jump.
    fn retune(&mut self, tunable: Tunable) -> Result<(), String> {
        let active = &mut self.laws[self.active];
        if active.config != tunable.law {
            let mut law = tunable.law.build(&self.model)?;
            law.keep_adapted(&active.law);
            active.law = law;
            active.config = tunable.law;
            self.taking_over = true;
        }
        self.fallback.retune(&tunable.fallback);
        self.fallback_config = tunable.fallback;
        Ok(())
    }

    fn idle(&mut self, status: Status) -> Thrust {
        self.status = status;
        self.last_reference = None;
        self.taking_over = true;
        self.error = TrackingError::default();
        self.thrust(&Vector4::zeros())
    }

    fn thrust(&self, tau: &Vector4<f64>) -> Thrust {
        let allocated = self.allocation.allocate(tau);
        Thrust {
            force_n: allocated.force_n.iter().take(self.allocation.thrusters.count()).copied().collect(),
            requested: (*tau).into(),
            allocated: allocated.wrench.into(),
            limited: allocated.limited.into(),
            emergency_neutral: self.neutral_demanded,
        }
    }
}

impl Block for Controller {
    const NAME: &'static str = "controller";
    type In<'a> = ControllerInput<'a>;
    type Out = Thrust;
    type Command = ControllerCommand;

    fn step(&mut self, tick: Tick, input: ControllerInput<'_>) -> Thrust {
        if !core::mem::replace(&mut self.started, true) {
            // A predecessor's emergency outlives it: only a command ends it.
            self.neutral_demanded |= input.applied.0.newest().is_some_and(|thrust| thrust.emergency_neutral);
        }
        if self.neutral_demanded {
            return self.idle(Status::EmergencyNeutral);
        }
        let Some(nav) = input.nav.within(tick, self.nav_limit) else {
            return self.idle(Status::NavStale);
        };
        let status = match input.reference.within(tick, self.reference_limit) {
            Some(reference) if reference.mode == Mode::Neutral => {
                self.wants_none = true;
                return self.idle(Status::Neutral);
            }
            Some(reference) => {
                self.wants_none = false;
                self.error = TrackingError::new(nav, reference);
                self.last_reference = Some(reference.clone());
                Status::Tracking
            }
            // Who wanted no force and fell silent still wants none: there may be a diver beside the vehicle.
            None if self.wants_none => return self.idle(Status::Neutral),
            None => {
                if self.status != Status::Fallback {
                    // Taken, so that a later fallback does not speed up again to what was braked from.
                    self.fallback.begin(self.last_reference.take().as_ref(), nav);
                }
                self.error = TrackingError::new(nav, self.fallback.step(tick.dt_s));
                Status::Fallback
            }
        };
        let applied = input.applied.0.newest();
        let law_input = LawInput {
            h_s: tick.dt_s,
            error: &self.error,
            limited: applied.map_or([false; 4], |thrust| thrust.limited.to_array()),
            request: input.wrench_request.within(tick, self.request_limit),
        };
        let law = &mut self.laws[self.active].law;
        if core::mem::take(&mut self.taking_over) {
            match applied {
                Some(applied) => law.start_from(&law_input, &applied.allocated.vector()),
                None => law.reset(),
            }
        }
        let tau = law.step(&law_input);
        if tau.iter().all(|force| force.is_finite()) {
            self.status = status;
            self.thrust(&tau)
        } else {
            // Nothing that is no number leaves the controller; the law starts afresh.
            law.reset();
            self.non_finite += 1;
            self.idle(Status::NotFinite)
        }
    }

    fn command(&mut self, _: Tick, command: &ControllerCommand) -> Result<(), Refusal> {
        match command {
            ControllerCommand::Parameter(change) => {
                let tunable = parameter::changed(&self.tunable(), change)?;
                self.retune(tunable).map_err(Refusal)?;
            }
            ControllerCommand::Neutral(neutral) => {
                self.started = true;
                self.neutral_demanded = *neutral;
            }
            ControllerCommand::Law(name) => {
                let Some(index) = self.laws.iter().position(|other| other.name == *name) else {
                    let known: Vec<&str> = self.laws.iter().map(|law| law.name.as_str()).collect();
                    return Err(Refusal(format!("law = {name:?}: must be one of {}", known.join(", "))));
                };
                if index != self.active {
                    self.active = index;
                    self.taking_over = true;
                }
            }
        }
        Ok(())
    }

    fn notices(&self, _: Option<&Thrust>) -> Notices {
        let usual = matches!(self.status, Status::Tracking | Status::Neutral);
        Notices::from_iter([Notice::either(!usual, "status", self.status.name(), self.status.name())])
    }

    fn succeed(&mut self, old: &Self) {
        self.started = true;
        self.neutral_demanded = old.neutral_demanded;
    }

    fn parameters(&self) -> serde_json::Value {
        parameter::tree(&self.tunable())
    }
}

impl Wired for Controller {
    fn input<'a>(wires: &mut impl Wires<'a>, _: OperatorLink) -> ControllerInput<'a> {
        ControllerInput {
            nav: wires.newest(PortRule::TRIGGER),
            reference: wires.newest(PortRule::NEWEST),
            applied: Prev(wires.newest(PortRule::BEFORE)),
            wrench_request: wires.newest(PortRule::OPTIONAL),
        }
    }
}

impl Observe for Controller {
    fn observe<P: Probe>(&self, probe: &mut P) {
        self.error.observe(probe);
        self.law().observe(probe);
        probe.scalar(&signal::controller::NON_FINITE, f64::from(self.non_finite));
        probe.label(&signal::controller::LAW, self.law().name());
        probe.label(&signal::controller::STATUS, self.status.name());
    }
}
