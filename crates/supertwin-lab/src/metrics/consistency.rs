//! Whether the estimator errs as much as it doubts: NIS from innovations, NEES where there is truth; and its health.

use super::{NEES, NIS};
use crate::align::Grid;
use crate::rescore::Sample;
use std::collections::BTreeMap;
use supertwin_core::RunSource;
use supertwin_core::frame::ssa;

pub(super) const VARIANCE: &str = "estimator/nav/variance";
pub(super) const HEALTH: &str = "estimator/nav/health";
const NET: &str = "estimator/nav/net";
const VELOCITY: &str = "estimator/nav/velocity";
const TRUE_VELOCITY: &str = "plant/truth/velocity";
/// Signal, its width, and where its normalised squares stand, in the order of [`NIS`].
const INNOVATIONS: [(&str, usize, usize); 6] = [
    ("estimator/innovation/dvl", 9, 6),
    ("estimator/innovation/dvl", 9, 7),
    ("estimator/innovation/dvl", 9, 8),
    ("estimator/innovation/depth", 3, 2),
    ("estimator/innovation/heading", 3, 2),
    ("estimator/innovation/yaw_rate", 3, 2),
];

pub(super) fn is_innovation(path: &str) -> bool {
    INNOVATIONS.iter().any(|(innovation, ..)| *innovation == path)
}

/// Mean normalised innovations squared of all measurements in the window.
pub(super) fn nis(source: &impl RunSource, grid: &Grid, out: &mut BTreeMap<String, f64>) {
    let (from, to) = (grid.tick(grid.from), grid.tick(grid.to));
    for ((path, width, column), (name, _)) in INNOVATIONS.iter().zip(NIS) {
        let Some(columns) = source.signals().get(*path).filter(|columns| columns.width == *width) else { continue };
        let first = columns.tick.partition_point(|tick| *tick < from);
        let last = columns.tick.partition_point(|tick| *tick < to);
        let squares: Vec<f64> = (first..last).filter_map(|row| Some(columns.row(row)?[*column])).collect();
        if !squares.is_empty() {
            out.insert(format!("nis.{name}"), crate::statistics::mean(&squares));
        }
    }
}

/// Sums over the moments of a window.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Consistency {
    sums: [f64; NEES.len()],
    counts: [u64; NEES.len()],
    moments: u64,
    net_lost: u64,
    dead_reckoning: u64,
}

impl Consistency {
    pub(super) fn add(&mut self, source: &impl RunSource, sample: &Sample) {
        let k = sample.tick.k as i64;
        let row = |path: &str, width: usize| {
            let columns = source.signals().get(path).filter(|columns| columns.width == width)?;
            columns.at(k)
        };
        let health = row(HEALTH, 6);
        if let Some(health) = health {
            self.moments += 1;
            self.net_lost += u64::from(health[0] == 0.0);
            self.dead_reckoning += u64::from(health[1] != 0.0);
        }
        let (Some(variance), Some(net)) = (row(VARIANCE, 10), row(NET, 4)) else { return };
        let (Some(velocity), Some(true_velocity)) = (row(VELOCITY, 4), row(TRUE_VELOCITY, 4)) else { return };
        let (measured, truth) = (&sample.tracking.measured, &sample.tracking.truth);
        let valid = health.is_some_and(|health| health[0] != 0.0);
        let errors = [
            (measured[0] - truth[0], if valid { net[2] } else { 0.0 }),
            (measured[4] - truth[4], variance[0]),
            (ssa(measured[5] - truth[5]), variance[1]),
            (velocity[0] - true_velocity[0], variance[2]),
            (velocity[1] - true_velocity[1], variance[3]),
            (velocity[2] - true_velocity[2], variance[4]),
            (velocity[3] - true_velocity[3], variance[5]),
        ];
        for (i, (error, variance)) in errors.into_iter().enumerate() {
            if variance > 0.0 {
                self.sums[i] += error * error / variance;
                self.counts[i] += 1;
            }
        }
    }

    pub(super) fn values(&self, out: &mut BTreeMap<String, f64>) {
        for (i, (name, _)) in NEES.iter().enumerate().filter(|(i, _)| self.counts[*i] > 0) {
            out.insert(format!("nees.{name}"), self.sums[i] / self.counts[i] as f64);
        }
        if self.moments > 0 {
            let share = |count: u64| count as f64 / self.moments as f64;
            out.insert("net_lost_share".to_owned(), share(self.net_lost));
            out.insert("dead_reckoning_share".to_owned(), share(self.dead_reckoning));
        }
    }
}
