//! The sliding surface `σ = x1 + x2`, paper eq. (5), in the forms that are well-posed, and the literal one.

use super::TrackingError;
use nalgebra::{Vector3, Vector4};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::Positive;
use supertwin_core::{Observe, Probe, signal};
use supertwin_model::Hydrodynamics;

/// Where the acceleration in `x2 = [ũ', ṽ', 2w̃ + w̃', r̃]` comes from.
///
/// Taken literally, surge, sway and heave have relative degree 0: the force is inside σ (control.md, section 1.4).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SurfaceConfig {
    /// From a first-order filtered derivative of the velocity error: relative degree 1, no model, no accelerometer.
    LeadFilter {
        /// `T_f`; towards zero it is the paper's surface, towards infinity the acceleration-free one.
        time_constant_s: Positive,
    },
    /// Left out: `σ = [ũ, ṽ, z̃ + c w̃, psĩ + r̃]`. Relative degree 1, less damping.
    AccelerationFree {
        /// `c`, 1 or 2 s in the literature.
        heave_rate_weight: Positive,
    },
    /// From the estimator's model, as a literal reading of the paper has it. For experiments: it contains the
    /// controller's own output and performs worst.
    ModelAcceleration,
}

/// A surface at work.
#[derive(Clone, Debug)]
pub struct Surface {
    config: SurfaceConfig,
    filter: Vector3<f64>,
    started: bool,
    acceleration: Vector3<f64>,
}

impl Surface {
    /// At rest; the lead filter starts at the first velocity error, so that its first acceleration is zero.
    #[must_use]
    pub fn new(config: &SurfaceConfig) -> Self {
        Self { config: *config, filter: Vector3::zeros(), started: false, acceleration: Vector3::zeros() }
    }

    /// Forgets the filter.
    pub fn reset(&mut self) {
        self.started = false;
        self.acceleration = Vector3::zeros();
    }

    /// One step of `h_s` seconds: the sliding variable.
    ///
    /// Lead filter, `y = [ũ, ṽ, w̃]`: `x_a = (y − ξ)/T_f`, `ξ⁺ = ξ + (1 − e^{−h/T_f})(y − ξ)` (exact discretisation).
    pub fn step(&mut self, error: &TrackingError, h_s: f64) -> Vector4<f64> {
        let y = error.velocity.fixed_rows::<3>(0).into_owned();
        let heave_rate_weight = match self.config {
            SurfaceConfig::LeadFilter { time_constant_s } => {
                let tf = time_constant_s.get();
                if !self.started {
                    self.started = true;
                    self.filter = y;
                }
                self.acceleration = (y - self.filter) / tf;
                self.filter += (y - self.filter) * -libm::expm1(-h_s / tf);
                2.0
            }
            SurfaceConfig::AccelerationFree { heave_rate_weight } => {
                self.acceleration = Vector3::zeros();
                heave_rate_weight.get()
            }
            SurfaceConfig::ModelAcceleration => {
                self.acceleration = error.model_acceleration.fixed_rows::<3>(0).into_owned();
                2.0
            }
        };
        let (x1, v, a) = (&error.x1, &error.velocity, &self.acceleration);
        Vector4::new(x1[0] + a.x, x1[1] + a.y, x1[2] + heave_rate_weight * v[2] + a.z, x1[3] + v[3])
    }

    /// High-frequency gain `G` of `σ' = G tau + …`, axis by axis: `(1 + 1/T_f)/m`, heave `(2 + 1/T_f)/m`, yaw `1/m`.
    ///
    /// `None` for the literal surface, which has relative degree 0.
    #[must_use]
    pub fn control_gain(&self, model: &Hydrodynamics) -> Option<Vector4<f64>> {
        let factor = match self.config {
            SurfaceConfig::LeadFilter { time_constant_s } => {
                let lead = 1.0 / time_constant_s.get();
                Vector4::new(1.0 + lead, 1.0 + lead, 2.0 + lead, 1.0)
            }
            SurfaceConfig::AccelerationFree { heave_rate_weight } => {
                Vector4::new(1.0, 1.0, heave_rate_weight.get(), 1.0)
            }
            SurfaceConfig::ModelAcceleration => return None,
        };
        Some(factor.component_mul(&model.M_inv()))
    }
}

impl Observe for Surface {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.vector(&signal::controller::SURFACE_ACCELERATION, self.acceleration.as_slice());
    }
}
