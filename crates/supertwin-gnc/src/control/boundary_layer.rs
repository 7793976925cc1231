//! Sliding mode with a boundary layer, and a gain that grows outside of it (Slotine and Li 1991, section 7.2):
//! `tau = −k1 sat(σ/α_tol)`, `k1' = ρ` while `|σ| ≥ α_tol`.
//!
//! Not for vehicles: with it, tests find out what a law costs that is added.

use super::surface::{Surface, SurfaceConfig};
use super::{ControlLaw, LawInput, LawSample};
use nalgebra::Vector4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{NonNegative, Positive};
use supertwin_core::{Axes, Capability, Observe, Probe, signal};
use supertwin_model::Hydrodynamics;

/// Parameters of the law.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BoundaryLayerConfig {
    /// The sliding surface.
    pub surface: SurfaceConfig,
    /// `k1` at the start.
    pub k1: Axes<NonNegative>,
    /// `ρ`, per second.
    pub growth: Axes<NonNegative>,
    /// `α_tol`: half the width of the layer, in the unit of σ.
    pub alpha_tol: Axes<Positive>,
}

/// The law at work.
#[derive(Clone, Debug)]
pub struct BoundaryLayer {
    config: BoundaryLayerConfig,
    surface: Surface,
    sigma: Vector4<f64>,
    k1: Vector4<f64>,
}

impl ControlLaw for BoundaryLayer {
    type Config = BoundaryLayerConfig;
    const CAPABILITIES: &'static [Capability] =
        &[Capability::SlidingVariable, Capability::Gains, Capability::AdaptiveGains];

    fn new(config: &BoundaryLayerConfig, _: &Hydrodynamics) -> Result<Self, String> {
        let surface = Surface::new(&config.surface);
        Ok(Self { config: *config, surface, sigma: Vector4::zeros(), k1: config.k1.vector() })
    }

    fn step(&mut self, input: &LawInput<'_>) -> Vector4<f64> {
        self.sigma = self.surface.step(input.error, input.h_s);
        let ratio = self.sigma.component_div(&self.config.alpha_tol.vector());
        let growth = self.config.growth.vector();
        self.k1 += Vector4::from_fn(|i, _| if ratio[i].abs() >= 1.0 { input.h_s * growth[i] } else { 0.0 });
        -self.k1.component_mul(&ratio.map(|ratio| ratio.clamp(-1.0, 1.0)))
    }

    fn start_from(&mut self, _: &LawInput<'_>, _: &Vector4<f64>) {
        self.surface.reset();
    }

    fn reset(&mut self) {
        self.surface.reset();
        self.k1 = self.config.k1.vector();
    }

    fn sample(&self) -> LawSample {
        LawSample {
            k1: Some(self.k1.into()),
            sigma: Some(self.sigma.into()),
            alpha_tol: Some(self.config.alpha_tol.vector().into()),
        }
    }
}

impl Observe for BoundaryLayer {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.vector(&signal::controller::SIGMA, self.sigma.as_slice());
        probe.vector(&signal::controller::K1, self.k1.as_slice());
    }
}
