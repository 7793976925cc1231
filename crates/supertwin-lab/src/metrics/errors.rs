//! Errors that scores do not have: mean absolute error and the integrals.

use super::{INTEGRALS, QUANTITIES, SQUARES};
use crate::score::Tracking;
use std::collections::BTreeMap;

/// Sums over the moments of a window.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Errors {
    n: u64,
    absolute: [[f64; QUANTITIES.len()]; 2],
    square: [[f64; QUANTITIES.len()]; 2],
}

impl Errors {
    pub(super) fn add(&mut self, tracking: &Tracking) {
        self.n += 1;
        for (side, value) in [&tracking.measured, &tracking.truth].into_iter().enumerate() {
            for (i, error) in tracking.error(value).into_iter().enumerate() {
                self.absolute[side][i] += libm::fabs(error);
                self.square[side][i] += error * error;
            }
        }
    }

    pub(super) fn values(&self, tick_s: f64, out: &mut BTreeMap<String, f64>) {
        let n = self.n.max(1) as f64;
        for (side, prefix) in ["measured", "true"].into_iter().enumerate() {
            for i in 0..QUANTITIES.len() {
                let (absolute, square) = (self.absolute[side][i], self.square[side][i]);
                out.insert(format!("{prefix}_mae.{}", QUANTITIES[i].0), absolute / n);
                out.insert(format!("{prefix}_iae.{}", INTEGRALS[i].0), absolute * tick_s);
                out.insert(format!("{prefix}_ise.{}", SQUARES[i].0), square * tick_s);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_integrals_of_a_constant_error_are_known() {
        let mut errors = Errors::default();
        for i in 0..500 {
            // Half a metre too deep, half a metre too shallow; never a mean error.
            let side = if i % 2 == 0 { 0.5 } else { -0.5 };
            let tracking = Tracking { measured: [2.0 + side; 6], reference: [2.0; 6], truth: [2.0 - side; 6] };
            errors.add(&tracking);
        }
        let mut values = BTreeMap::new();
        errors.values(0.02, &mut values);
        for (name, expected) in [
            ("measured_mae.depth_m", 0.5),
            ("true_mae.sway_m_per_s", 0.5),
            ("measured_iae.depth_m_s", 5.0),
            ("true_ise.distance_m2_s", 2.5),
        ] {
            assert!((values[name] - expected).abs() < 1e-12, "{name} = {}", values[name]);
        }
        // The heading goes the short way round: from −3.1 to 3.1 is less than a tenth.
        let mut errors = Errors::default();
        errors.add(&Tracking { measured: [3.1; 6], reference: [-3.1; 6], truth: [0.0; 6] });
        errors.values(0.02, &mut values);
        assert!((values["measured_mae.heading_rad"] - (core::f64::consts::TAU - 6.2)).abs() < 1e-12);
    }
}
