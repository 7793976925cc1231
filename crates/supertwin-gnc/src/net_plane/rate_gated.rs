//! The paper-like baseline: a least-squares plane per ping, refused when it jumps, then low-passed.
//!
//! It leaks fish, as the paper's did: a burst that lasts longer than the release count is believed.

use super::{PingReport, inverse_ranges};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{Fraction, Positive};
use supertwin_core::frame::ssa;
use supertwin_core::message::{DvlPing, NetEstimate};
use supertwin_model::SonarArray;

/// Parameters (control.md, section 3.3).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RateGatedConfig {
    /// A distance that differs by more from the filtered one is refused.
    pub max_jump_m: Positive,
    /// A heading that differs by more from the filtered one is refused.
    pub max_jump_rad: Positive,
    /// After this many refusals in a row the next ping is believed.
    pub release_after: u32,
    /// Share of a new distance in the filtered one.
    pub distance_gain: Fraction,
    /// Share of a new heading in the filtered one.
    pub heading_gain: Fraction,
    /// Standard deviation of a range, for the variances it reports.
    pub range_std_m: Positive,
}

/// The baseline's state.
#[derive(Clone, Debug)]
pub struct RateGated {
    config: RateGatedConfig,
    array: SonarArray,
    filtered: Option<(f64, f64)>,
    rejections: u32,
    /// What the last ping said.
    pub report: PingReport,
}

impl RateGated {
    /// Other parameters from now on; the plane stays.
    pub fn retune(&mut self, config: &RateGatedConfig) {
        self.config = *config;
    }

    /// Without a plane yet.
    #[must_use]
    pub fn new(config: &RateGatedConfig, array: SonarArray) -> Self {
        Self { config: *config, array, filtered: None, rejections: 0, report: PingReport::default() }
    }

    /// Takes a ping; true when it was believed.
    pub fn update(&mut self, ping: &DvlPing, heading_rad: f64) -> bool {
        self.report = PingReport::default();
        let Some(q) = inverse_ranges(ping) else { return false };
        self.report.parity_per_m = SonarArray::parity(&q);
        let a = self.array.plane(&q);
        let norm = a.norm();
        if !(norm > 0.0 && a.x > 0.0) {
            return false;
        }
        let distance_m = 1.0 / norm;
        let net_heading_rad = ssa(heading_rad + libm::atan2(a.y, a.x));
        let c = &self.config;
        let believed = match &mut self.filtered {
            None => {
                self.filtered = Some((distance_m, net_heading_rad));
                true
            }
            Some((d, psi)) => {
                let (jump_m, jump_rad) = (distance_m - *d, ssa(net_heading_rad - *psi));
                let jumps = jump_m.abs() > c.max_jump_m.get() || jump_rad.abs() > c.max_jump_rad.get();
                if jumps && self.rejections < c.release_after {
                    self.rejections += 1;
                    false
                } else {
                    self.rejections = 0;
                    *d += c.distance_gain.get() * jump_m;
                    *psi = ssa(*psi + c.heading_gain.get() * jump_rad);
                    true
                }
            }
        };
        self.report.accepted = [believed; 4];
        self.report.innovation_per_m = core::array::from_fn(|i| q[i] - self.array.beams()[i].dot(&a));
        believed
    }

    /// The filtered plane with the variances of a single fit (control.md, section 3.2, first order).
    #[must_use]
    pub fn estimate(&self) -> Option<NetEstimate> {
        let (distance_m, heading_rad) = self.filtered?;
        // r = d/cos θ on the axis: dq = s_r q², d = 1/a_x, so that s_d = s_r cos θ/2 and s_psi = s_d/(d tan(θ)/√2).
        let beam = self.array.beams()[0];
        let distance_std_m = self.config.range_std_m.get() * beam.x / 2.0;
        let heading_std_rad = distance_std_m * beam.x / (distance_m * beam.y.abs());
        Some(NetEstimate {
            distance_m,
            heading_rad,
            distance_variance_m2: distance_std_m * distance_std_m,
            heading_variance_rad2: heading_std_rad * heading_std_rad,
            valid: true,
        })
    }

    /// Forgets the plane.
    pub fn restart(&mut self) {
        self.filtered = None;
        self.rejections = 0;
    }

    /// Filtered distance and heading, and refusals in a row.
    #[must_use]
    pub fn state(&self) -> (f64, f64, u32) {
        let (d, psi) = self.filtered.unwrap_or_default();
        (d, psi, self.rejections)
    }
}
