//! The net in front as a plane, from four beam ranges: two ways, selected in the configuration.

mod inverse_range;
mod rate_gated;

pub use inverse_range::{InverseRange, InverseRangeConfig};
pub use rate_gated::{RateGated, RateGatedConfig};

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::message::{DvlPing, NetEstimate};
use supertwin_core::{Observe, Probe, signal};
use supertwin_model::SonarArray;

/// Which way, with its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NetPlaneConfig {
    /// Least squares per ping, gated by its rate of change and low-passed: as in the paper.
    RateGated(RateGatedConfig),
    /// Kalman filter on the inverse-range plane with a gate per beam.
    InverseRange(InverseRangeConfig),
}

/// Estimator of the plane.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "one per run")]
pub enum NetPlane {
    /// See [`RateGated`].
    RateGated(RateGated),
    /// See [`InverseRange`].
    InverseRange(InverseRange),
}

/// What a ping said about the plane; kept for display.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PingReport {
    /// `q1 − q2 + q3 − q4` in 1/m, zero for a plane.
    pub parity_per_m: f64,
    /// Beams that were used.
    pub accepted: [bool; 4],
    /// Innovation of each beam's inverse range in 1/m.
    pub innovation_per_m: [f64; 4],
}

impl NetPlane {
    /// From the configuration and the instrument's beam angle.
    #[must_use]
    pub fn new(config: &NetPlaneConfig, beam_angle_rad: f64) -> Self {
        let array = SonarArray::new(beam_angle_rad);
        match config {
            NetPlaneConfig::RateGated(config) => Self::RateGated(RateGated::new(config, array)),
            NetPlaneConfig::InverseRange(config) => Self::InverseRange(InverseRange::new(config, array)),
        }
    }

    /// Other parameters from now on; the plane stays. The way itself can't change: every path names it.
    pub fn retune(&mut self, config: &NetPlaneConfig) {
        match (self, config) {
            (Self::RateGated(fit), NetPlaneConfig::RateGated(config)) => fit.retune(config),
            (Self::InverseRange(filter), NetPlaneConfig::InverseRange(config)) => filter.retune(config),
            (Self::RateGated(_), NetPlaneConfig::InverseRange(_))
            | (Self::InverseRange(_), NetPlaneConfig::RateGated(_)) => {}
        }
    }

    /// One tick without a ping: the plane moves as the vehicle does.
    pub fn predict(&mut self, velocity: &Vector3<f64>, yaw_rate_rad_per_s: f64, h_s: f64) {
        if let Self::InverseRange(filter) = self {
            filter.predict(velocity, yaw_rate_rad_per_s, h_s);
        }
    }

    /// A ping, with the heading at its arrival. True when it improved the estimate.
    pub fn update(&mut self, ping: &DvlPing, heading_rad: f64) -> bool {
        match self {
            Self::RateGated(fit) => fit.update(ping, heading_rad),
            Self::InverseRange(filter) => filter.update(ping),
        }
    }

    /// The estimate; `valid` is left to the caller, who knows its age.
    #[must_use]
    pub fn estimate(&self, heading_rad: f64) -> Option<NetEstimate> {
        match self {
            Self::RateGated(fit) => fit.estimate(),
            Self::InverseRange(filter) => filter.estimate(heading_rad),
        }
    }

    /// Forgets the plane.
    pub fn restart(&mut self) {
        match self {
            Self::RateGated(fit) => fit.restart(),
            Self::InverseRange(filter) => filter.restart(),
        }
    }

    /// What the last ping said.
    #[must_use]
    pub fn report(&self) -> &PingReport {
        match self {
            Self::RateGated(fit) => &fit.report,
            Self::InverseRange(filter) => &filter.report,
        }
    }
}

/// Inverse ranges, when all four beams came back.
fn inverse_ranges(ping: &DvlPing) -> Option<[f64; 4]> {
    let mut q = [0.0; 4];
    for (q, range) in q.iter_mut().zip(ping.beam_range_m) {
        *q = range.filter(|range| range.is_finite() && *range > 0.0).map(|range| 1.0 / range)?;
    }
    Some(q)
}

impl Observe for PingReport {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.scalar(&signal::estimator::NET_PLANE_PARITY, self.parity_per_m);
        let accepted = self.accepted.map(|flag| f64::from(u8::from(flag)));
        probe.vector(&signal::estimator::NET_PLANE_ACCEPTED, &accepted);
        probe.vector(&signal::estimator::NET_PLANE_INNOVATION, &self.innovation_per_m);
    }
}

impl Observe for NetPlane {
    fn observe<P: Probe>(&self, probe: &mut P) {
        match self {
            Self::RateGated(fit) => {
                let (distance_m, heading_rad, rejections) = fit.state();
                probe.vector(&signal::estimator::NET_PLANE_FIT, &[distance_m, heading_rad, f64::from(rejections)]);
            }
            Self::InverseRange(filter) => probe.vector(&signal::estimator::NET_PLANE_STATE, filter.a.as_slice()),
        }
    }
}
