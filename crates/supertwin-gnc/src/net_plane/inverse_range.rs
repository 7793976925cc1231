//! Kalman filter on the plane in inverse-range coordinates, with a gate per beam.
//!
//! State `a = n/d` in body axes: unit normal over distance. A beam measures `q_i = 1/r_i = b_i · a`, linearly.
//! As the vehicle moves with `v` and turns with `r`: `a' = −[0,0,r] × a + a (a · v)` (control.md, section 3.3).

use super::PingReport;
use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::Positive;
use supertwin_core::frame::ssa;
use supertwin_core::message::{DvlPing, NetEstimate};
use supertwin_model::SonarArray;

/// Parameters of the fit of the net plane to inverse ranges.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InverseRangeConfig {
    /// Power spectral densities of `a_x`, `a_y`, `a_z`, in 1/m² per second.
    pub process_noise: [Positive; 3],
    /// Standard deviation of a range.
    pub range_std_m: Positive,
    /// Factor on it, for what is not noise: folds of the net.
    pub range_std_factor: Positive,
    /// Gate on each beam's normalised innovation squared (chi-square with one degree of freedom).
    pub gate: Positive,
    /// Pings in a row without one good beam after which the plane is taken from the next one afresh.
    pub restart_after: u32,
    /// Bounds of |a|: inverse of the farthest and of the nearest plane.
    pub bounds_per_m: [Positive; 2],
}

/// The filter's state.
#[derive(Clone, Debug)]
pub struct InverseRange {
    config: InverseRangeConfig,
    array: SonarArray,
    /// The plane.
    pub a: Vector3<f64>,
    P: Matrix3<f64>,
    known: bool,
    bad_pings: u32,
    /// What the last ping said.
    pub report: PingReport,
}

impl InverseRange {
    /// Other parameters from now on; the plane stays.
    pub fn retune(&mut self, config: &InverseRangeConfig) {
        self.config = *config;
    }

    /// Without a plane yet.
    #[must_use]
    pub fn new(config: &InverseRangeConfig, array: SonarArray) -> Self {
        Self {
            config: *config,
            array,
            a: Vector3::zeros(),
            P: Matrix3::zeros(),
            known: false,
            bad_pings: 0,
            report: PingReport::default(),
        }
    }

    /// `a' = −[0,0,r] × a + a (a · v)` over one step, with its covariance.
    pub fn predict(&mut self, v: &Vector3<f64>, r: f64, h_s: f64) {
        if !self.known {
            return;
        }
        let a = self.a;
        let approach = a.dot(v);
        // ∂a'/∂a = −[0,0,r]× + (a · v) I + a vᵀ
        let turn = Matrix3::new(0.0, r, 0.0, -r, 0.0, 0.0, 0.0, 0.0, 0.0);
        let A = turn + Matrix3::identity() * approach + a * v.transpose();
        let F = Matrix3::identity() + A * h_s;
        self.a += (turn * a + a * approach) * h_s;
        self.P = F * self.P * F.transpose();
        for i in 0..3 {
            self.P[(i, i)] += h_s * self.config.process_noise[i].get();
        }
        self.clip();
    }

    /// Takes a ping beam by beam; true when at least one beam was used.
    pub fn update(&mut self, ping: &DvlPing) -> bool {
        self.report = PingReport::default();
        if let Some(q) = super::inverse_ranges(ping) {
            self.report.parity_per_m = SonarArray::parity(&q);
        }
        if !self.known || self.bad_pings >= self.config.restart_after {
            return self.start(ping);
        }
        for (i, range_m) in ping.beam_range_m.iter().enumerate() {
            let Some(range_m) = range_m.filter(|range| range.is_finite() && *range > 0.0) else { continue };
            let q = 1.0 / range_m;
            let b = self.array.beams()[i];
            let Pb = self.P * b;
            let s = b.dot(&Pb) + self.variance(q);
            let innovation = q - b.dot(&self.a);
            self.report.innovation_per_m[i] = innovation;
            if innovation * innovation / s <= self.config.gate.get() {
                self.a += Pb * (innovation / s);
                self.P -= Pb * Pb.transpose() / s;
                self.report.accepted[i] = true;
            }
        }
        self.clip();
        let good = self.report.accepted.contains(&true);
        self.bad_pings = if good { 0 } else { self.bad_pings + 1 };
        good
    }

    /// Starts from the least-squares plane of at least three beams; of four, only if they lie on one: their parity is
    /// inside the gate too.
    fn start(&mut self, ping: &DvlPing) -> bool {
        let (mut N, mut rhs, mut variance, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0.0, 0.0);
        for (beam, range_m) in self.array.beams().iter().zip(ping.beam_range_m) {
            if let Some(range_m) = range_m.filter(|range| range.is_finite() && *range > 0.0) {
                let q = 1.0 / range_m;
                N += beam * beam.transpose();
                rhs += beam * q;
                variance += self.variance(q);
                count += 1.0;
            }
        }
        let parity = self.report.parity_per_m;
        if count < 3.0 || parity * parity > self.config.gate.get() * variance {
            return false;
        }
        let Some(inverse) = N.try_inverse() else { return false };
        let a = inverse * rhs;
        if a.x.is_nan() || a.x <= 0.0 {
            return false;
        }
        self.a = a;
        self.P = inverse * (variance / count);
        self.known = true;
        self.bad_pings = 0;
        self.report.accepted = ping.beam_range_m.map(|range| range.is_some());
        self.clip();
        true
    }

    /// Variance of an inverse range: `(factor s_r q²)²`.
    fn variance(&self, q: f64) -> f64 {
        let std = self.config.range_std_factor.get() * self.config.range_std_m.get() * q * q;
        std * std
    }

    fn clip(&mut self) {
        let norm = self.a.norm();
        let [least, most] = self.config.bounds_per_m.map(Positive::get);
        if norm > 0.0 {
            self.a *= norm.clamp(least, most) / norm;
        }
    }

    /// Distance `1/|a|` and heading `psi + atan2(a_y, a_x)` with first-order variances.
    #[must_use]
    pub fn estimate(&self, heading_rad: f64) -> Option<NetEstimate> {
        if !self.known {
            return None;
        }
        let a = self.a;
        let norm = a.norm();
        let distance_gradient = a * (-1.0 / (norm * norm * norm));
        let horizontal2 = (a.x * a.x + a.y * a.y).max(1e-12);
        let heading_gradient = Vector3::new(-a.y, a.x, 0.0) / horizontal2;
        Some(NetEstimate {
            distance_m: 1.0 / norm,
            heading_rad: ssa(heading_rad + libm::atan2(a.y, a.x)),
            distance_variance_m2: distance_gradient.dot(&(self.P * distance_gradient)),
            heading_variance_rad2: heading_gradient.dot(&(self.P * heading_gradient)),
            valid: true,
        })
    }

    /// Forgets the plane.
    pub fn restart(&mut self) {
        self.known = false;
        self.bad_pings = 0;
    }
}
