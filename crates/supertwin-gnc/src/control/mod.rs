//! The controller service: navigation and reference in, thruster commands out. Each control law stands in a file of its own.
//!
//! Adding a law: one file beside this one with its [`ControlLaw`], one line in the list `laws!` below, one parameter file.

mod agsta;
#[cfg(feature = "another-law")]
mod boundary_layer;
mod controller;
mod error;
mod external;
mod fallback;
mod gsta;
mod pid;
pub mod super_twisting;
pub mod surface;

pub use agsta::{AdaptationConfig, Agsta, AgstaConfig, SecondGain};
#[cfg(feature = "another-law")]
pub use boundary_layer::{BoundaryLayer, BoundaryLayerConfig};
pub use controller::{Controller, ControllerInput, ControllerLimits, ControllerSetup, Status};
pub use error::TrackingError;
pub use external::{External, ExternalConfig};
pub use fallback::FallbackConfig;
pub use gsta::{Gsta, GstaConfig};
pub use pid::{Pid, PidConfig};

use nalgebra::Vector4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::message::WrenchRequest;
use supertwin_core::{Capability, Observe, Probe};
use supertwin_model::Hydrodynamics;

/// A controller file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ControllerConfig {
    /// What it is and where its numbers come from.
    pub description: String,
    /// The law with its gains.
    pub law: LawConfig,
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

/// What scores ask of a law at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LawSample {
    /// Gains `k1`, of laws that have them.
    pub k1: Option<[f64; 4]>,
    /// Sliding variable, of laws that have one.
    pub sigma: Option<[f64; 4]>,
    /// `α_tol`, of laws that adapt.
    pub alpha_tol: Option<[f64; 4]>,
}

/// A control law: what its file says of it.
pub trait ControlLaw: Observe + Clone {
    /// Its parameters.
    type Config;
    /// What it shows of its own, beside its wrench.
    const CAPABILITIES: &'static [Capability];

    /// Builds it on a nominal model.
    ///
    /// # Errors
    /// Names the value and the rule when parameters contradict each other.
    fn new(config: &Self::Config, model: &Hydrodynamics) -> Result<Self, String>;

    /// One tick: the wrench it wants, in body axes.
    fn step(&mut self, input: &LawInput<'_>) -> Vector4<f64>;

    /// Takes over so that the wrench at `input` is `wrench`, as far as the law has an integrator to do it with.
    fn start_from(&mut self, input: &LawInput<'_>, wrench: &Vector4<f64>);

    /// Takes over what `other`, the same law with other parameters, has learned.
    fn keep_adapted(&mut self, other: &Self) {
        let _ = other;
    }

    /// Forgets integrators, filters and adapted gains.
    fn reset(&mut self);

    /// What it is scored by.
    fn sample(&self) -> LawSample {
        LawSample::default()
    }

    /// The law that steers where this one does not.
    fn substitute(&self) -> Option<&Law> {
        None
    }
}

macro_rules! laws {
    ($($(#[doc = $about:literal])+ $([$feature:literal])? $arm:ident = $name:literal),* $(,)?) => {
        /// A law with its gains. One arm per law.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        pub enum LawConfig {
            $($(#[doc = $about])+ $(#[cfg(feature = $feature)])? #[serde(rename = $name)] $arm(<$arm as ControlLaw>::Config)),*
        }

        /// A law at work. One arm per law.
        #[derive(Clone, Debug)]
        #[allow(clippy::large_enum_variant, reason = "a handful per run, and no box on the way to a step")]
        pub enum Law {
            $($(#[doc = $about])+ $(#[cfg(feature = $feature)])? $arm($arm)),*
        }

        /// Every law by name, with what it shows of its own.
        pub const LAWS: &[(&str, &[Capability])] =
            &[$($(#[cfg(feature = $feature)])? ($name, $arm::CAPABILITIES)),*];

        impl LawConfig {
            /// Builds the law on a nominal model (the implicit discretisation needs its inertia).
            ///
            /// # Errors
            /// Names the value and the rule when parameters contradict each other.
            pub fn build(&self, model: &Hydrodynamics) -> Result<Law, String> {
                Ok(match self {
                    $($(#[cfg(feature = $feature)])? Self::$arm(config) => Law::$arm($arm::new(config, model)?)),*
                })
            }

            /// The arm's name.
            #[must_use]
            pub fn name(&self) -> &'static str {
                match self {
                    $($(#[cfg(feature = $feature)])? Self::$arm(_) => $name),*
                }
            }
        }

        impl Law {
            /// See [`ControlLaw::step`].
            pub fn step(&mut self, input: &LawInput<'_>) -> Vector4<f64> {
                match self {
                    $($(#[cfg(feature = $feature)])? Self::$arm(law) => law.step(input)),*
                }
            }

            /// See [`ControlLaw::start_from`].
            pub fn start_from(&mut self, input: &LawInput<'_>, wrench: &Vector4<f64>) {
                match self {
                    $($(#[cfg(feature = $feature)])? Self::$arm(law) => law.start_from(input, wrench)),*
                }
            }

            /// See [`ControlLaw::keep_adapted`].
            pub fn keep_adapted(&mut self, other: &Self) {
                match (self, other) {
                    $($(#[cfg(feature = $feature)])? (Self::$arm(law), Self::$arm(other)) => law.keep_adapted(other),)*
                    _ => {}
                }
            }

            /// See [`ControlLaw::reset`].
            pub fn reset(&mut self) {
                match self {
                    $($(#[cfg(feature = $feature)])? Self::$arm(law) => law.reset()),*
                }
            }

            /// The arm's name.
            #[must_use]
            pub fn name(&self) -> &'static str {
                match self {
                    $($(#[cfg(feature = $feature)])? Self::$arm(_) => $name),*
                }
            }

            /// See [`ControlLaw::sample`].
            #[must_use]
            pub fn sample(&self) -> LawSample {
                match self {
                    $($(#[cfg(feature = $feature)])? Self::$arm(law) => law.sample()),*
                }
            }

            /// See [`ControlLaw::substitute`].
            #[must_use]
            pub fn substitute(&self) -> Option<&Self> {
                match self {
                    $($(#[cfg(feature = $feature)])? Self::$arm(law) => law.substitute()),*
                }
            }
        }

        impl Observe for Law {
            fn observe<P: Probe>(&self, probe: &mut P) {
                match self {
                    $($(#[cfg(feature = $feature)])? Self::$arm(law) => law.observe(probe)),*
                }
            }
        }
    };
}

laws! {
    /// Proportional, integral, derivative.
    Pid = "pid",
    /// Generalized super-twisting with fixed gains.
    Gsta = "gsta",
    /// Generalized super-twisting with adaptive gains.
    Agsta = "agsta",
    /// A wrench from outside.
    External = "external",
    /// Sliding mode with a boundary layer: a law more, which tests add.
    ["another-law"] BoundaryLayer = "boundary_layer",
}

impl LawConfig {
    /// Whether the law can be built at all; which vehicle it is for does not matter to that.
    ///
    /// # Errors
    /// Names the value and the rule when parameters contradict each other.
    pub fn check(&self) -> Result<(), String> {
        self.build(&Hydrodynamics::unit()).map(drop)
    }

    /// The law and, where another steers in its place, that one: every law that this one can bring to command.
    ///
    /// # Errors
    /// As [`LawConfig::build`].
    pub fn family(&self) -> Result<Vec<Law>, String> {
        let law = self.build(&Hydrodynamics::unit())?;
        let substitute = law.substitute().cloned();
        Ok(std::iter::once(law).chain(substitute).collect())
    }
}

impl Law {
    /// What it shows of its own, beside its wrench.
    #[must_use]
    pub fn capabilities(&self) -> &'static [Capability] {
        LAWS.iter().find(|(name, _)| *name == self.name()).map_or(&[], |(_, capabilities)| capabilities)
    }
}
