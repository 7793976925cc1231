//! Whether the estimator errs as much as it doubts: NIS from innovations, NEES where there is truth; and its health.

use super::{NEES, NIS};
use crate::align::Grid;
use crate::rescore::Sample;
use std::collections::BTreeMap;
use supertwin_core::frame::ssa;
use supertwin_core::signal::{Component, estimator, nav, truth};
use supertwin_core::source::Columns;
use supertwin_core::{RecordedRun, Signal};

/// Normalised squares, in the order of [`NIS`].
const SQUARES: [Component; NIS.len()] = [
    estimator::INNOVATION_DVL.at("surge_nis"),
    estimator::INNOVATION_DVL.at("sway_nis"),
    estimator::INNOVATION_DVL.at("heave_nis"),
    estimator::INNOVATION_DEPTH.at("nis"),
    estimator::INNOVATION_HEADING.at("nis"),
    estimator::INNOVATION_YAW_RATE.at("nis"),
];
/// Variances, in the order of [`NEES`].
const VARIANCES: [Component; NEES.len()] = [
    nav::NET.at("distance_variance"),
    nav::VARIANCE.at("depth"),
    nav::VARIANCE.at("heading"),
    nav::VARIANCE.at("surge"),
    nav::VARIANCE.at("sway"),
    nav::VARIANCE.at("heave"),
    nav::VARIANCE.at("yaw"),
];
const NET_VALID: Component = nav::HEALTH.at("net_valid");
const DEAD_RECKONING: Component = nav::HEALTH.at("dead_reckoning");

pub(super) fn is_innovation(path: &str) -> bool {
    SQUARES.iter().any(|square| square.signal.path == path)
}

/// What was recorded of `signal`, if it has all its components.
fn whole<'a>(source: &'a RecordedRun, signal: &Signal) -> Option<&'a Columns> {
    source.signal(signal).filter(|columns| columns.width == signal.width())
}

/// Mean normalised innovations squared of all measurements in the window.
pub(super) fn nis(source: &RecordedRun, grid: &Grid, out: &mut BTreeMap<String, f64>) {
    let (from, to) = (grid.tick(grid.from), grid.tick(grid.to));
    for (square, (name, _)) in SQUARES.iter().zip(NIS) {
        let Some(columns) = whole(source, square.signal) else { continue };
        let first = columns.tick.partition_point(|tick| *tick < from);
        let last = columns.tick.partition_point(|tick| *tick < to);
        let squares: Vec<f64> = (first..last).filter_map(|row| square.of(columns.row(row)?)).collect();
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
    pub(super) fn add(&mut self, source: &RecordedRun, sample: &Sample) {
        let k = sample.tick.k as i64;
        let row = |signal| whole(source, signal).and_then(|columns| columns.at(k));
        let flag = |component: Component| row(component.signal).and_then(|health| component.of(health));
        let net_valid = flag(NET_VALID);
        if let Some((valid, dead_reckoning)) = net_valid.zip(flag(DEAD_RECKONING)) {
            self.moments += 1;
            self.net_lost += u64::from(valid == 0.0);
            self.dead_reckoning += u64::from(dead_reckoning != 0.0);
        }
        let mut variances = [0.0; NEES.len()];
        for (variance, component) in variances.iter_mut().zip(VARIANCES) {
            let Some(number) = row(component.signal).and_then(|row| component.of(row)) else { return };
            *variance = number;
        }
        // Without a net there is no distance.
        if net_valid.is_none_or(|valid| valid == 0.0) {
            variances[0] = 0.0;
        }
        let (Some(velocity), Some(true_velocity)) = (row(&nav::VELOCITY), row(&truth::VELOCITY)) else { return };
        let (measured, truth) = (&sample.tracking.measured, &sample.tracking.truth);
        let errors = [
            measured[0] - truth[0],
            measured[4] - truth[4],
            ssa(measured[5] - truth[5]),
            velocity[0] - true_velocity[0],
            velocity[1] - true_velocity[1],
            velocity[2] - true_velocity[2],
            velocity[3] - true_velocity[3],
        ];
        for (i, (error, variance)) in errors.into_iter().zip(variances).enumerate() {
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
