//! Tracking errors of paper section III-B.

use nalgebra::Vector4;
use supertwin_core::frame::ssa;
use supertwin_core::message::{Nav, Reference};
use supertwin_core::{Observe, Probe, signal};

/// `x1`, velocities and the model's acceleration relative to the reference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrackingError {
    /// `x1 = [ũ, ṽ, z̃, psĩ]`, paper eq. (4).
    pub x1: Vector4<f64>,
    /// `[ũ, ṽ, w̃, r̃]`: velocity errors of all axes, `w̃ = w − z_d'`, `r̃ = r − psi_d'`.
    pub velocity: Vector4<f64>,
    /// `[ũ', ṽ', w̃', r̃']` by the estimator's model: contains the controller's own output.
    pub model_acceleration: Vector4<f64>,
}

impl TrackingError {
    /// From navigation and reference; heading errors are wrapped, heave takes `z' = w` (Assumption 2).
    #[must_use]
    pub fn new(nav: &Nav, reference: &Reference) -> Self {
        let nu = nav.velocity.vector();
        let surge = nu[0] - reference.surge_m_per_s;
        let sway = nu[1] - reference.sway_m_per_s;
        Self {
            x1: Vector4::new(
                surge,
                sway,
                nav.depth_m - reference.depth_m,
                ssa(nav.heading_rad - reference.heading_rad),
            ),
            velocity: Vector4::new(surge, sway, nu[2] - reference.depth_m_per_s, nu[3] - reference.heading_rad_per_s),
            model_acceleration: nav.acceleration.vector()
                - Vector4::new(
                    reference.surge_m_per_s2,
                    reference.sway_m_per_s2,
                    reference.depth_m_per_s2,
                    reference.heading_rad_per_s2,
                ),
        }
    }
}

impl Observe for TrackingError {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.vector(&signal::controller::ERROR, self.x1.as_slice());
        probe.vector(&signal::controller::VELOCITY_ERROR, self.velocity.as_slice());
        probe.vector(&signal::controller::ACCELERATION_ERROR, self.model_acceleration.as_slice());
    }
}
