//! GSTA: generalized super-twisting with fixed gains, paper eq. (14)-(17).

use super::super_twisting::{AntiWindup, Discretisation, SuperTwisting};
use super::surface::SurfaceConfig;
use super::{ControlLaw, LawInput, LawSample};
use nalgebra::Vector4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::Positive;
use supertwin_core::{Axes, Capability, Observe, Probe};
use supertwin_model::Hydrodynamics;

/// Gains of the law (units in [`super::super_twisting`]).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GstaConfig {
    /// The sliding surface.
    pub surface: SurfaceConfig,
    /// How it is sampled.
    pub discretisation: Discretisation,
    /// What saturation does to the integrator.
    pub anti_windup: AntiWindup,
    /// `β`.
    pub beta: Axes<Positive>,
    /// `K1`.
    pub k1: Axes<Positive>,
    /// `K2`.
    pub k2: Axes<Positive>,
}

/// The law at work.
#[derive(Clone, Debug)]
pub struct Gsta {
    /// The algorithm's state.
    pub twisting: SuperTwisting,
}

impl ControlLaw for Gsta {
    type Config = GstaConfig;
    const CAPABILITIES: &'static [Capability] = &[Capability::SlidingVariable, Capability::Gains];

    /// Fails when the discretisation does not go with the surface.
    fn new(config: &GstaConfig, model: &Hydrodynamics) -> Result<Self, String> {
        let mut twisting = SuperTwisting::new(
            &config.surface,
            config.discretisation,
            config.anti_windup,
            config.beta.vector(),
            model,
        )?;
        twisting.k1 = config.k1.vector();
        twisting.k2 = config.k2.vector();
        Ok(Self { twisting })
    }

    fn step(&mut self, input: &LawInput<'_>) -> Vector4<f64> {
        self.twisting.slide(input.error, input.h_s);
        self.twisting.twist(input)
    }

    fn start_from(&mut self, input: &LawInput<'_>, wrench: &Vector4<f64>) {
        self.twisting.start_from(input, wrench);
    }

    fn reset(&mut self) {
        self.twisting.reset();
    }

    fn sample(&self) -> LawSample {
        self.twisting.sample()
    }
}

impl Observe for Gsta {
    fn observe<P: Probe>(&self, probe: &mut P) {
        self.twisting.observe(probe);
    }
}
