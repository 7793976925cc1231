//! Signals that no block shows, computed from those that are shown while they are written: what the dashboards need.
//!
//! All of them are declared in [`crate::signals`].

use crate::chunks::{Problem, Rows, columns, fixed};
use crate::{signals, style};
use rerun::log::Chunk;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use supertwin_core::Signal;
use supertwin_core::run::{Limits, Scene};
use supertwin_core::signal::{Component, controller, estimator, nav, plant, thrust};

/// What changes slowly is written at every so many ticks.
const EVERY: i64 = 5;
/// Chattering and saturation are counted over so long a time.
const WINDOW_NS: i64 = 1_000_000_000;
/// The filter's first doubts are so large that they would hide all others.
const SETTLED_NS: i64 = 1_000_000_000;
/// Beside an innovation whose sensor has no gate.
const BOUND_STD: f64 = 3.0;

/// An innovation, its predicted standard deviation, and the signal that shows it between its bounds.
struct Innovation {
    value: Component,
    std: Component,
    gated: &'static Signal,
    /// The same of a sensor without a gate.
    ungated: Signal,
}

const fn innovation(value: Component, std: Component, gated: &'static Signal) -> Innovation {
    let ungated = Signal {
        path: gated.path,
        components: &["innovation", "3 σ", "3 σ"],
        units: gated.units,
        about: "innovation between three standard deviations",
    };
    Innovation { value, std, gated, ungated }
}

const fn single(from: &'static Signal, gated: &'static Signal) -> Innovation {
    innovation(from.at("innovation"), from.at("std"), gated)
}

const fn of_dvl(value: &'static str, std: &'static str, gated: &'static Signal) -> Innovation {
    innovation(estimator::INNOVATION_DVL.at(value), estimator::INNOVATION_DVL.at(std), gated)
}

static INNOVATIONS: [Innovation; 6] = [
    of_dvl("surge", "surge_std", &signals::INNOVATION_SURGE),
    of_dvl("sway", "sway_std", &signals::INNOVATION_SWAY),
    of_dvl("heave", "heave_std", &signals::INNOVATION_HEAVE),
    single(&estimator::INNOVATION_DEPTH, &signals::INNOVATION_DEPTH),
    single(&estimator::INNOVATION_HEADING, &signals::INNOVATION_HEADING),
    single(&estimator::INNOVATION_YAW_RATE, &signals::INNOVATION_YAW_RATE),
];

const fn components<const N: usize>(of: &'static Signal, names: [&str; N]) -> [Component; N] {
    let mut components = [Component { signal: of, index: 0 }; N];
    let mut i = 0;
    while i < N {
        components[i] = of.at(names[i]);
        i += 1;
    }
    components
}

/// Normalised innovations squared, which stand beside their gate.
static NIS: [(&[Component], &Signal); 4] = [
    (&components(&estimator::INNOVATION_DVL, ["surge_nis", "sway_nis", "heave_nis"]), &signals::NIS_DVL),
    (&components(&estimator::INNOVATION_DEPTH, ["nis"]), &signals::NIS_DEPTH),
    (&components(&estimator::INNOVATION_HEADING, ["nis"]), &signals::NIS_HEADING),
    (&components(&estimator::INNOVATION_YAW_RATE, ["nis"]), &signals::NIS_YAW_RATE),
];

/// Variances whose roots are shown now and then.
static VARIANCES: [(&[Component], &Signal); 3] = [
    (&components(&nav::VARIANCE, ["depth", "heading"]), &signals::STD_POSE),
    (&components(&nav::VARIANCE, ["surge", "sway", "heave", "yaw"]), &signals::STD_VELOCITY),
    (&components(&nav::VARIANCE, ["b_surge", "b_sway", "b_heave", "b_yaw"]), &signals::STD_DISTURBANCE),
];

/// Counters that are shown now and then.
static COUNTERS: [(&[Component], &Signal); 2] = [
    (&components(&plant::HEALTH, ["pings_lost"]), &signals::PINGS_LOST),
    (&components(&estimator::COUNTERS, ["gated", "restarts"]), &signals::REFUSED),
];

/// A flag that is also written as a lane of states, which many of can be read at once.
struct Lane {
    flag: Component,
    signal: &'static Signal,
    /// When the flag is down, and when it is up.
    states: [&'static str; 2],
    colors: [u32; 2],
}

const fn lane(flag: Component, signal: &'static Signal, states: [&'static str; 2], colors: [u32; 2]) -> Lane {
    Lane { flag, signal, states, colors }
}

const SATURATED: [u32; 2] = [style::IDLE, style::ALERT];
const HEALTHY: [u32; 2] = [style::GOOD, style::ALERT];
const OUTSIDE: [&str; 2] = ["own law", "outside"];

static LANES: [Lane; 12] = [
    lane(nav::HEALTH.at("net_valid"), &signals::HEALTH_NET, ["lost", "found"], [style::ALERT, style::GOOD]),
    lane(nav::HEALTH.at("dead_reckoning"), &signals::HEALTH_VELOCITY, ["measured", "dead reckoning"], HEALTHY),
    lane(nav::HEALTH.at("depth_lost"), &signals::HEALTH_DEPTH, ["measured", "lost"], HEALTHY),
    lane(nav::HEALTH.at("heading_lost"), &signals::HEALTH_HEADING, ["measured", "lost"], HEALTHY),
    lane(nav::HEALTH.at("thrust_unknown"), &signals::HEALTH_THRUST, ["known", "unknown"], HEALTHY),
    lane(nav::HEALTH.at("restarted"), &signals::HEALTH_FILTER, ["running", "restarted"], HEALTHY),
    lane(plant::HEALTH.at("thrust_lost"), &signals::NEUTRAL_PLANT, ["commanded", "no fresh command"], SATURATED),
    lane(
        Component { signal: &thrust::EMERGENCY_NEUTRAL, index: 0 },
        &signals::NEUTRAL_EMERGENCY,
        ["off", "neutral"],
        SATURATED,
    ),
    lane(controller::EXTERNAL.at("surge"), &signals::EXTERNAL_SURGE, OUTSIDE, SATURATED),
    lane(controller::EXTERNAL.at("sway"), &signals::EXTERNAL_SWAY, OUTSIDE, SATURATED),
    lane(controller::EXTERNAL.at("heave"), &signals::EXTERNAL_HEAVE, OUTSIDE, SATURATED),
    lane(controller::EXTERNAL.at("yaw"), &signals::EXTERNAL_YAW, OUTSIDE, SATURATED),
];

/// What is derived from one run.
#[derive(Default)]
pub(crate) struct Derived {
    limits: Limits,
    max_n: Vec<f64>,
    /// Paths of lanes and signals whose looks are in the file.
    described: BTreeSet<&'static str>,
    /// Last state of each lane.
    lanes: BTreeMap<&'static str, bool>,
    last_wrench: Option<[f64; 4]>,
    chattering: LastSecond,
    limited: LastSecond,
    /// Largest share of a thruster's limit since the last row.
    share: f64,
    /// The lines beside sigma have begun.
    bounded: bool,
}

impl Derived {
    pub(crate) fn new(scene: &Scene) -> Self {
        let max_n = scene.thrusters.iter().map(|thruster| thruster.max_n).collect();
        Self { limits: scene.limits.clone(), max_n, ..Self::default() }
    }

    /// What follows from rows of `signal`.
    pub(crate) fn of(&mut self, signal: &Signal, rows: &Rows) -> Result<Vec<Chunk>, Problem> {
        let mut chunks = Vec::new();
        for derived in self.signals(signal, rows) {
            if derived.times.is_empty() {
                continue;
            }
            if self.described.insert(derived.signal.path) {
                chunks.push(fixed(derived.signal.path, &style::lines(derived.signal, derived.width))?);
            }
            let times = rows.times.select(&derived.times);
            let entity = derived.signal.path.into();
            chunks.push(Rows { entity, times, width: derived.width, values: derived.values }.into_chunk()?);
        }
        let of_signal = |lane: &&Lane| lane.flag.signal.path == signal.path && lane.flag.index < rows.width;
        for lane in LANES.iter().filter(of_signal) {
            self.states(lane, rows, &mut chunks)?;
        }
        Ok(chunks)
    }

    fn signals(&mut self, signal: &Signal, rows: &Rows) -> Vec<Made> {
        let is = |handle: &Signal| rows.are_of(signal, handle);
        let mut made = Vec::new();
        if is(&thrust::REQUESTED) {
            made.push(self.chattering(rows));
        } else if is(&thrust::LIMITED) {
            let share = |flags: [f64; 4], n: f64| flags.map(|flags| 100.0 * flags / n);
            made.push(self.limited.of(&signals::LIMITED, rows, |row| row, share));
        } else if signal.path == thrust::FORCE.path && rows.width == self.max_n.len() {
            made.push(self.thrust_share(rows));
        } else if is(&controller::SIGMA) {
            made.extend(self.tolerances(rows));
        } else if signal.path == estimator::NET_PLANE_ACCEPTED.path {
            made.push(row_by_row(&signals::BEAMS_USED, rows, 1, |used| vec![used.iter().sum()]));
        }
        for innovation in INNOVATIONS.iter().filter(|innovation| is(innovation.value.signal)) {
            made.push(innovation.of(rows, self.limits.nis_gate(signal)));
        }
        for (squares, shown) in NIS.iter().filter(|(squares, _)| is(squares[0].signal)) {
            let gate = self.limits.nis_gate(signal);
            made.push(row_by_row(shown, rows, 1, |row| pick(squares, row).chain(gate).collect()));
        }
        for (variances, shown) in VARIANCES.iter().filter(|(variances, _)| is(variances[0].signal)) {
            let root = |variance: f64| variance.max(0.0).sqrt();
            made.push(row_by_row(shown, rows, EVERY, |row| pick(variances, row).map(root).collect()));
        }
        for (counters, shown) in COUNTERS.iter().filter(|(counters, _)| is(counters[0].signal)) {
            made.push(row_by_row(shown, rows, EVERY, |row| pick(counters, row).collect()));
        }
        made
    }

    /// The band is constant: its ends in this batch are enough.
    fn tolerances(&mut self, rows: &Rows) -> Vec<Made> {
        let Some(alpha_tol) = self.limits.alpha_tol else { return Vec::new() };
        let Some(last) = rows.times.len().checked_sub(1) else { return Vec::new() };
        let begins = !std::mem::replace(&mut self.bounded, true);
        let times: Vec<u32> = if begins && last > 0 { vec![0, last as u32] } else { vec![last as u32] };
        let made = signals::ALPHA_TOL.iter().zip(alpha_tol).map(|(&signal, tolerance)| {
            let values = times.iter().flat_map(|_| [tolerance, -tolerance]).collect();
            Made { signal, width: 2, times: times.clone(), values }
        });
        made.collect()
    }

    /// Total variation: the sum of all steps, up and down.
    fn chattering(&mut self, rows: &Rows) -> Made {
        let last = &mut self.last_wrench;
        let step = |now: [f64; 4]| {
            let before = last.replace(now).unwrap_or(now);
            core::array::from_fn(|axis| (now[axis] - before[axis]).abs())
        };
        self.chattering.of(&signals::CHATTERING, rows, step, |sum, _| sum)
    }

    fn thrust_share(&mut self, rows: &Rows) -> Made {
        let mut made = Made::new(&signals::THRUST_SHARE, 1);
        for (i, forces) in rows.values.chunks_exact(rows.width).enumerate() {
            let shares = forces.iter().zip(&self.max_n).map(|(force, most)| 100.0 * force.abs() / most);
            self.share = shares.fold(self.share, f64::max);
            if rows.times.ticks[i] % EVERY == 0 {
                made.push(i, &[std::mem::take(&mut self.share)]);
            }
        }
        made
    }

    fn states(&mut self, lane: &'static Lane, rows: &Rows, chunks: &mut Vec<Chunk>) -> Result<(), Problem> {
        let (mut times, mut states) = (Vec::new(), Vec::new());
        for (i, row) in rows.values.chunks_exact(rows.width).enumerate() {
            let up = row[lane.flag.index] > 0.5;
            if self.lanes.insert(lane.signal.path, up) != Some(up) {
                times.push(i as u32);
                states.push(lane.states[usize::from(up)]);
            }
        }
        if times.is_empty() {
            return Ok(());
        }
        if self.described.insert(lane.signal.path) {
            let looks = rerun::StateConfiguration::new().with_values(lane.states).with_labels(lane.states);
            chunks.push(fixed(lane.signal.path, &looks.with_colors(lane.colors))?);
        }
        let changes = rerun::StateChange::update_fields().with_state(states);
        chunks.push(columns(lane.signal.path, rows.times.select(&times), changes.columns_of_unit_batches())?);
        Ok(())
    }
}

/// Rows of a derived signal.
struct Made {
    signal: &'static Signal,
    width: usize,
    /// Places among the rows that it comes from.
    times: Vec<u32>,
    values: Vec<f64>,
}

impl Made {
    fn new(signal: &'static Signal, width: usize) -> Self {
        Self { signal, width, times: Vec::new(), values: Vec::new() }
    }

    fn push(&mut self, row: usize, values: &[f64]) {
        self.width = values.len();
        self.times.push(row as u32);
        self.values.extend_from_slice(values);
    }
}

/// A row of every so many ticks.
fn row_by_row(signal: &'static Signal, rows: &Rows, every: i64, value: impl Fn(&[f64]) -> Vec<f64>) -> Made {
    let mut made = Made::new(signal, 1);
    for (i, row) in rows.values.chunks_exact(rows.width).enumerate() {
        if rows.times.ticks[i] % every == 0 {
            made.push(i, &value(row));
        }
    }
    made
}

/// These numbers of a row.
fn pick<'a>(components: &'a [Component], row: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
    components.iter().filter_map(|component| component.of(row))
}

impl Innovation {
    /// The innovation between `±√gate` times its predicted standard deviation.
    fn of(&'static self, rows: &Rows, gate: Option<f64>) -> Made {
        let mut made = Made::new(if gate.is_some() { self.gated } else { &self.ungated }, 3);
        for (i, row) in rows.values.chunks_exact(rows.width).enumerate() {
            if rows.times.nanos[i] >= SETTLED_NS {
                let bound = row[self.std.index] * gate.map_or(BOUND_STD, f64::sqrt);
                made.push(i, &[row[self.value.index], bound, -bound]);
            }
        }
        made
    }
}

/// Sums over the last second.
#[derive(Default)]
struct LastSecond {
    /// When, and how much.
    parts: VecDeque<(i64, [f64; 4])>,
}

impl LastSecond {
    /// A row now and then: `result` of the sums of `part` and of how many there are.
    fn of(
        &mut self,
        signal: &'static Signal,
        rows: &Rows,
        mut part: impl FnMut([f64; 4]) -> [f64; 4],
        result: impl Fn([f64; 4], f64) -> [f64; 4],
    ) -> Made {
        let mut made = Made::new(signal, 4);
        let (ticks, nanos) = (&rows.times.ticks, &rows.times.nanos);
        for (i, row) in rows.values.chunks_exact(4).enumerate() {
            self.parts.push_back((nanos[i], part(core::array::from_fn(|axis| row[axis]))));
            while self.parts.front().is_some_and(|(then, _)| then + WINDOW_NS <= nanos[i]) {
                self.parts.pop_front();
            }
            if ticks[i] % EVERY == 0 {
                let sum = |axis: usize| self.parts.iter().map(|(_, part)| part[axis]).sum::<f64>();
                made.push(i, &result([0, 1, 2, 3].map(sum), self.parts.len() as f64));
            }
        }
        made
    }
}
