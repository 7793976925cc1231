//! Control allocation: a wrench into thruster forces that exist.

use nalgebra::Vector4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{Fraction, NonNegative};
use supertwin_model::thrusters::{Forces, Thrusters};

/// When an axis counts as limited, as it stands in a vehicle file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AllocationConfig {
    /// Newtons (newton metres in yaw) by which allocation may change an axis before it counts as limited, plus the share.
    pub tolerance_n: NonNegative,
    /// Share of the request by which it may.
    pub tolerance_share: Fraction,
}

/// Newtons (or newton metres) that no vehicle of this kind can make.
const BEYOND_ANY_THRUSTER: f64 = 1e6;

/// `f = B⁺ tau`, each group scaled by one factor to its limits, forces inside the dead band dropped.
#[derive(Clone, Debug)]
pub struct Allocation {
    pub(crate) thrusters: Thrusters,
    dead_band_n: f64,
    tolerance: AllocationConfig,
}

/// What allocation made of a wrench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allocated {
    /// Force of each thruster in newtons.
    pub force_n: Forces,
    /// `tau = B f`.
    pub wrench: Vector4<f64>,
    /// Axes on which that differs from the request by more than the tolerance.
    pub limited: [bool; 4],
}

impl Allocation {
    /// From the vehicle's thrusters and the dead band below which they do not turn.
    #[must_use]
    pub fn new(thrusters: Thrusters, dead_band_n: f64, config: &AllocationConfig) -> Self {
        Self { thrusters, dead_band_n, tolerance: *config }
    }

    /// Allocates `tau`, in body axes. Scaling by groups keeps the direction of the horizontal part
    /// (surge, sway, yaw) and lets heave saturate by itself (control.md, section 5).
    #[must_use]
    pub fn allocate(&self, tau: &Vector4<f64>) -> Allocated {
        // A request beyond any thruster is cut first, so that no product overflows.
        let tau = &tau.map(|axis| axis.clamp(-BEYOND_ANY_THRUSTER, BEYOND_ANY_THRUSTER));
        let mut force_n = self.thrusters.forces(tau);
        // One factor per group: [horizontal, vertical].
        let mut excess = [1.0f64; 2];
        for i in 0..self.thrusters.count() {
            let group = usize::from(self.thrusters.is_vertical(i));
            if force_n[i].abs() > self.thrusters.max_n()[i] {
                excess[group] = excess[group].max(force_n[i].abs() / self.thrusters.max_n()[i]);
            }
        }
        for i in 0..self.thrusters.count() {
            let excess = excess[usize::from(self.thrusters.is_vertical(i))];
            if excess > 1.0 {
                force_n[i] /= excess;
            }
            if force_n[i].abs() < self.dead_band_n {
                force_n[i] = 0.0;
            }
        }
        let wrench = self.thrusters.wrench(&force_n);
        let (least_n, share) = (self.tolerance.tolerance_n.get(), self.tolerance.tolerance_share.get());
        let limited = core::array::from_fn(|i| (wrench[i] - tau[i]).abs() > least_n + share * tau[i].abs());
        Allocated { force_n, wrench, limited }
    }
}
