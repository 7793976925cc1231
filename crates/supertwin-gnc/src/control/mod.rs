//! The controller service: navigation and reference in, thruster commands out; the laws are its rooms.
//!
//! Adding a law: one file beside this one, one arm in [`LawConfig`] and [`Law`], one parameter file.

mod agsta;
mod controller;
mod error;
mod external;
mod fallback;
mod gsta;
mod pid;
pub mod super_twisting;
pub mod surface;

pub use agsta::{AdaptationConfig, Agsta, AgstaConfig, SecondGain};
pub use controller::{Controller, ControllerInput, ControllerLimits, ControllerSetup, Status};
pub use error::TrackingError;
pub use external::{External, ExternalConfig};
pub use fallback::FallbackConfig;
pub use gsta::{Gsta, GstaConfig};
pub use pid::{Pid, PidConfig};

use nalgebra::Vector4;
use serde::{Deserialize, Serialize};
use supertwin_core::message::WrenchRequest;
use supertwin_core::{Observe, Probe};
use supertwin_model::Hydrodynamics;

/// A controller file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControllerConfig {
    /// What it is and where its numbers come from.
    pub description: String,
    /// The law with its gains.
    pub law: LawConfig,
}

/// A law with its gains. One arm per law.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LawConfig {
    /// Proportional, integral, derivative.
    Pid(PidConfig),
    /// Generalized super-twisting with fixed gains.
    Gsta(GstaConfig),
    /// Generalized super-twisting with adaptive gains.
    Agsta(AgstaConfig),
    /// A wrench from outside.
    External(ExternalConfig),
}

impl LawConfig {
    /// Builds the law on a nominal model (the implicit discretisation needs its inertia).
    ///
    /// # Errors
    /// Names the value and the rule when parameters contradict each other.
    pub fn build(&self, model: &Hydrodynamics) -> Result<Law, String> {
        Ok(match self {
            Self::Pid(config) => Law::Pid(Pid::new(config)),
            Self::Gsta(config) => Law::Gsta(Gsta::new(config, model)?),
            Self::Agsta(config) => Law::Agsta(Agsta::new(config, model)?),
            Self::External(config) => Law::External(External::new(config, model)?),
        })
    }

    /// Whether the law can be built at all; which vehicle it is for does not matter to that.
    ///
    /// # Errors
    /// Names the value and the rule when parameters contradict each other.
    pub fn check(&self) -> Result<(), String> {
        self.build(&Hydrodynamics::unit()).map(drop)
    }

    /// The arm's name.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Pid(_) => "pid",
            Self::Gsta(_) => "gsta",
            Self::Agsta(_) => "agsta",
            Self::External(_) => "external",
        }
    }
}

/// What a law is given at a tick.
#[derive(Clone, Copy, Debug)]
pub struct LawInput<'a> {
    /// Length of the tick in seconds.
    pub h_s: f64,
    /// Tracking errors.
    pub error: &'a TrackingError,
    /// Axes whose force allocation changed at the tick before: integrators and adaptation wait there.
    pub limited: [bool; 4],
    /// A fresh enough wrench from outside.
    pub request: Option<&'a WrenchRequest>,
}

/// A law at work. One arm per law.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "a handful per run, and no box on the way to a step")]
pub enum Law {
    /// See [`Pid`].
    Pid(Pid),
    /// See [`Gsta`].
    Gsta(Gsta),
    /// See [`Agsta`].
    Agsta(Agsta),
    /// See [`External`].
    External(External),
}

impl Law {
    /// One tick: the wrench it wants, in body axes.
    pub fn step(&mut self, input: &LawInput<'_>) -> Vector4<f64> {
        match self {
            Self::Pid(law) => law.step(input),
            Self::Gsta(law) => law.step(input),
            Self::Agsta(law) => law.step(input),
            Self::External(law) => law.step(input),
        }
    }

    /// Takes over so that the wrench at `input` is `wrench`, as far as the law has an integrator to do it with.
    pub fn start_from(&mut self, input: &LawInput<'_>, wrench: &Vector4<f64>) {
        match self {
            Self::Pid(law) => law.start_from(input, wrench),
            Self::Gsta(law) => law.start_from(input, wrench),
            Self::Agsta(law) => law.start_from(input, wrench),
            Self::External(law) => law.start_from(input, wrench),
        }
    }

    /// Takes over what `other`, the same law with other parameters, has learned.
    pub fn keep_adapted(&mut self, other: &Self) {
        match (self, other) {
            (Self::Agsta(law), Self::Agsta(other)) => law.keep_adapted(other),
            (Self::External(law), Self::External(other)) => law.keep_adapted(other),
            _ => {}
        }
    }

    /// Forgets integrators, filters and adapted gains.
    pub fn reset(&mut self) {
        match self {
            Self::Pid(law) => law.reset(),
            Self::Gsta(law) => law.reset(),
            Self::Agsta(law) => law.reset(),
            Self::External(law) => law.reset(),
        }
    }

    /// The arm's name.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Pid(_) => "pid",
            Self::Gsta(_) => "gsta",
            Self::Agsta(_) => "agsta",
            Self::External(_) => "external",
        }
    }

    /// Gains `k1` now; zero for laws that have none.
    #[must_use]
    pub fn k1(&self) -> [f64; 4] {
        match self {
            Self::Gsta(law) => law.twisting().k1.into(),
            Self::Agsta(law) => law.twisting().k1.into(),
            Self::Pid(_) | Self::External(_) => [0.0; 4],
        }
    }

    /// Sliding variable now; the position-like errors for laws that have none.
    #[must_use]
    pub fn sigma(&self) -> Option<[f64; 4]> {
        match self {
            Self::Gsta(law) => Some(law.twisting().sigma.into()),
            Self::Agsta(law) => Some(law.twisting().sigma.into()),
            Self::Pid(_) | Self::External(_) => None,
        }
    }

    /// `alpha_tol` of an adaptive law.
    #[must_use]
    pub fn alpha_tol(&self) -> Option<[f64; 4]> {
        match self {
            Self::Agsta(law) => Some(law.alpha_tol().into()),
            Self::Pid(_) | Self::Gsta(_) | Self::External(_) => None,
        }
    }
}

impl Observe for Law {
    fn observe<P: Probe>(&self, probe: &mut P) {
        match self {
            Self::Pid(law) => law.observe(probe),
            Self::Gsta(law) => law.observe(probe),
            Self::Agsta(law) => law.observe(probe),
            Self::External(law) => law.observe(probe),
        }
    }
}
