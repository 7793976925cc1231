//! Signals that no block shows, computed from those that are shown while they are written: what the dashboards need.
//!
//! All of them are below `derived/`, and none is needed to repeat or to score a run.

use crate::chunks::{Problem, Rows, Times, columns, fixed};
use crate::style;
use rerun::log::Chunk;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use supertwin_core::Signal;
use supertwin_core::run::{Limits, Scene};

/// What changes slowly is written at every so many ticks.
const EVERY: i64 = 5;
/// Chattering and saturation are counted over so long a time.
const WINDOW_NS: i64 = 1_000_000_000;
/// The filter's first doubts are so large that they would hide all others.
const SETTLED_NS: i64 = 1_000_000_000;
/// Beside an innovation whose sensor has no gate.
const BOUND_STD: f64 = 3.0;

const AXES: &[&str] = &["surge", "sway", "heave", "yaw"];

macro_rules! signals {
    ($($name:ident = $path:literal $components:expr, $units:expr, $about:literal;)*) => {
        $(static $name: Signal =
            Signal { path: concat!("derived/", $path), components: $components, units: $units, about: $about };)*
    };
}

signals! {
    CHATTERING = "chattering" AXES, &["N/s", "N/s", "N/s", "N m/s"],
        "total variation of the requested wrench over the last second";
    LIMITED = "limited" AXES, &["%"], "part of the last second in which allocation changed the wrench";
    THRUST_SHARE = "thrust_share" &[], &["%"], "largest thruster command as a share of its limit";
    BEAMS_USED = "beams_used" &[], &["count"], "beams of the last ping that the estimator used";
    PINGS_LOST = "pings_lost" &[], &["count"], "pings that the DVL lost";
    REFUSED = "refused" &["gated", "restarts"], &["count"], "measurements refused by their gates, restarts of the filter";
    STD_POSE = "std/pose" &["depth", "heading"], &["m", "rad"], "standard deviation of the estimates";
    STD_VELOCITY = "std/velocity" AXES, &["m/s", "m/s", "m/s", "rad/s"], "standard deviation of the estimates";
    STD_DISTURBANCE = "std/disturbance" AXES, &["N", "N", "N", "N m"], "standard deviation of the estimates";
    NIS_DVL = "nis/dvl" &["surge", "sway", "heave", "gate"], &["1"], "normalised innovations squared";
    NIS_DEPTH = "nis/depth" &["depth", "gate"], &["1"], "normalised innovation squared";
    NIS_HEADING = "nis/heading" &["heading", "gate"], &["1"], "normalised innovation squared";
    NIS_YAW_RATE = "nis/yaw_rate" &["yaw rate", "gate"], &["1"], "normalised innovation squared";
}

/// `[innovation, gate, −gate]`; the second form is for sensors without a gate.
macro_rules! innovations {
    ($($path:literal $unit:literal),*) => {
        [$([
            &Signal {
                path: concat!("derived/innovation/", $path),
                components: &["innovation", "gate", "gate"],
                units: &[$unit],
                about: "innovation between its gates",
            },
            &Signal {
                path: concat!("derived/innovation/", $path),
                components: &["innovation", "3 σ", "3 σ"],
                units: &[$unit],
                about: "innovation between three standard deviations",
            },
        ]),*]
    };
}

static INNOVATIONS: [[&Signal; 2]; 6] =
    innovations!("surge" "m/s", "sway" "m/s", "heave" "m/s", "depth" "m", "heading" "rad", "yaw_rate" "rad/s");

macro_rules! tolerances {
    ($($axis:literal $unit:literal),*) => {
        [$(&Signal {
            path: concat!("derived/alpha_tol/", $axis),
            components: &["α_tol", "α_tol"],
            units: &[$unit],
            about: "inside this band of the sliding variable gains fall; as configured",
        }),*]
    };
}

static TOLERANCES: [&Signal; 4] = tolerances!("surge" "m/s", "sway" "m/s", "heave" "m", "yaw" "rad");

/// A flag that is also written as a lane of states, which many of can be read at once.
struct Lane {
    signal: &'static str,
    component: usize,
    path: &'static str,
    /// When the flag is down, and when it is up.
    states: [&'static str; 2],
    colors: [u32; 2],
}

const fn lane(
    signal: &'static str,
    component: usize,
    path: &'static str,
    states: [&'static str; 2],
    colors: [u32; 2],
) -> Lane {
    Lane { signal, component, path, states, colors }
}

const HEALTH: &str = "/estimator/nav/health";
const OUTSIDE: &str = "/controller/external";
const SATURATED: [u32; 2] = [style::IDLE, style::ALERT];
const HEALTHY: [u32; 2] = [style::GOOD, style::ALERT];

static LANES: [Lane; 12] = [
    lane(HEALTH, 0, "derived/health/net", ["lost", "found"], [style::ALERT, style::GOOD]),
    lane(HEALTH, 1, "derived/health/velocity", ["measured", "dead reckoning"], HEALTHY),
    lane(HEALTH, 2, "derived/health/depth", ["measured", "lost"], HEALTHY),
    lane(HEALTH, 3, "derived/health/heading", ["measured", "lost"], HEALTHY),
    lane(HEALTH, 4, "derived/health/thrust", ["known", "unknown"], HEALTHY),
    lane(HEALTH, 5, "derived/health/filter", ["running", "restarted"], HEALTHY),
    lane("/plant/health", 0, "derived/neutral/plant", ["commanded", "no fresh command"], SATURATED),
    lane("/controller/thrust/emergency_neutral", 0, "derived/neutral/emergency", ["off", "neutral"], SATURATED),
    lane(OUTSIDE, 0, "derived/external/surge", ["own law", "outside"], SATURATED),
    lane(OUTSIDE, 1, "derived/external/sway", ["own law", "outside"], SATURATED),
    lane(OUTSIDE, 2, "derived/external/heave", ["own law", "outside"], SATURATED),
    lane(OUTSIDE, 3, "derived/external/yaw", ["own law", "outside"], SATURATED),
];

/// What is derived from one run.
#[derive(Default)]
pub(crate) struct Derived {
    limits: Limits,
    max_n: Vec<f64>,
    /// Lanes and signals whose looks are in the file.
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
        Self { limits: scene.limits, max_n, ..Self::default() }
    }

    /// What follows from the signals of one batch.
    pub(crate) fn of(&mut self, batch: &[Rows]) -> Result<Vec<Chunk>, Problem> {
        let mut chunks = Vec::new();
        for rows in batch {
            let path = rows.entity.to_string();
            for derived in self.signals(&path, rows) {
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
            for lane in LANES.iter().filter(|lane| lane.signal == path && lane.component < rows.width) {
                self.states(lane, rows, &mut chunks)?;
            }
        }
        Ok(chunks)
    }

    fn signals(&mut self, path: &str, rows: &Rows) -> Vec<Made> {
        let gate = &self.limits.nis_gate;
        match (path, rows.width) {
            ("/controller/thrust/requested", 4) => vec![self.chattering(rows)],
            ("/controller/thrust/limited", 4) => {
                vec![self.limited.of(&LIMITED, rows, |row| row, |flags, n| flags.map(|flags| 100.0 * flags / n))]
            }
            ("/controller/thrust/force", n) if n == self.max_n.len() => vec![self.thrust_share(rows)],
            ("/controller/sigma", 4) => self.tolerances(rows),
            ("/estimator/net_plane/accepted", _) => vec![row_by_row(&BEAMS_USED, rows, |used| vec![used.iter().sum()])],
            ("/plant/health", 2) => vec![now_and_then(&PINGS_LOST, rows, |health| vec![health[1]])],
            ("/estimator/counters", 3) => vec![now_and_then(&REFUSED, rows, |counts| counts[1..].to_vec())],
            ("/estimator/nav/variance", 10) => {
                let root = |of: &[f64]| of.iter().map(|variance| variance.max(0.0).sqrt()).collect();
                vec![
                    now_and_then(&STD_POSE, rows, |row| root(&row[..2])),
                    now_and_then(&STD_VELOCITY, rows, |row| root(&row[2..6])),
                    now_and_then(&STD_DISTURBANCE, rows, |row| root(&row[6..])),
                ]
            }
            ("/estimator/innovation/dvl", 9) => {
                let gate = gate.dvl;
                let between = |i: usize| innovation(i, gate, rows, move |row| (row[i], row[i + 3]));
                let nis = row_by_row(&NIS_DVL, rows, |row| row[6..].iter().copied().chain(gate).collect());
                vec![between(0), between(1), between(2), nis]
            }
            ("/estimator/innovation/depth", 3) => scalar(3, &NIS_DEPTH, gate.depth, rows),
            ("/estimator/innovation/heading", 3) => scalar(4, &NIS_HEADING, gate.heading, rows),
            ("/estimator/innovation/yaw_rate", 3) => scalar(5, &NIS_YAW_RATE, gate.yaw_rate, rows),
            _ => Vec::new(),
        }
    }

    /// The band is constant: its ends in this batch are enough.
    fn tolerances(&mut self, rows: &Rows) -> Vec<Made> {
        let Some(alpha_tol) = self.limits.alpha_tol else { return Vec::new() };
        let Some(last) = rows.times.len().checked_sub(1) else { return Vec::new() };
        let begins = !std::mem::replace(&mut self.bounded, true);
        let times: Vec<u32> = if begins && last > 0 { vec![0, last as u32] } else { vec![last as u32] };
        let made = TOLERANCES.iter().zip(alpha_tol).map(|(&signal, tolerance)| {
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
        self.chattering.of(&CHATTERING, rows, step, |sum, _| sum)
    }

    fn thrust_share(&mut self, rows: &Rows) -> Made {
        let mut made = Made::new(&THRUST_SHARE, 1);
        let ticks = rows.times.ticks();
        for (i, forces) in rows.values.chunks_exact(rows.width).enumerate() {
            let shares = forces.iter().zip(&self.max_n).map(|(force, most)| 100.0 * force.abs() / most);
            self.share = shares.fold(self.share, f64::max);
            if ticks[i] % EVERY == 0 {
                made.push(i, &[std::mem::take(&mut self.share)]);
            }
        }
        made
    }

    fn states(&mut self, lane: &'static Lane, rows: &Rows, chunks: &mut Vec<Chunk>) -> Result<(), Problem> {
        let (mut times, mut states) = (Vec::new(), Vec::new());
        for (i, row) in rows.values.chunks_exact(rows.width).enumerate() {
            let up = row[lane.component] > 0.5;
            if self.lanes.insert(lane.path, up) != Some(up) {
                times.push(i as u32);
                states.push(lane.states[usize::from(up)]);
            }
        }
        if times.is_empty() {
            return Ok(());
        }
        if self.described.insert(lane.path) {
            let looks = rerun::StateConfiguration::new().with_values(lane.states).with_labels(lane.states);
            chunks.push(fixed(lane.path, &looks.with_colors(lane.colors))?);
        }
        let changes = rerun::StateChange::update_fields().with_state(states);
        let changes = changes.columns_of_unit_batches().map_err(crate::chunks::text)?;
        let times: Times = rows.times.select(&times);
        chunks.push(columns(lane.path.into(), times, changes)?);
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

fn row_by_row(signal: &'static Signal, rows: &Rows, value: impl Fn(&[f64]) -> Vec<f64>) -> Made {
    let mut made = Made::new(signal, 1);
    for (i, row) in rows.values.chunks_exact(rows.width).enumerate() {
        made.push(i, &value(row));
    }
    made
}

fn now_and_then(signal: &'static Signal, rows: &Rows, value: impl Fn(&[f64]) -> Vec<f64>) -> Made {
    let mut made = Made::new(signal, 1);
    let ticks = rows.times.ticks();
    for (i, row) in rows.values.chunks_exact(rows.width).enumerate() {
        if ticks[i] % EVERY == 0 {
            made.push(i, &value(row));
        }
    }
    made
}

/// An innovation between `±√gate` times its predicted standard deviation.
fn innovation(which: usize, gate: Option<f64>, rows: &Rows, value: impl Fn(&[f64]) -> (f64, f64)) -> Made {
    let signal = INNOVATIONS[which][usize::from(gate.is_none())];
    let mut made = Made::new(signal, 3);
    for (i, row) in rows.values.chunks_exact(rows.width).enumerate() {
        if rows.times.nanos()[i] >= SETTLED_NS {
            let (innovation, std) = value(row);
            let bound = std * gate.map_or(BOUND_STD, f64::sqrt);
            made.push(i, &[innovation, bound, -bound]);
        }
    }
    made
}

/// Innovation and NIS of a sensor that measures one number.
fn scalar(which: usize, nis: &'static Signal, gate: Option<f64>, rows: &Rows) -> Vec<Made> {
    let nis = row_by_row(nis, rows, |row| std::iter::once(row[2]).chain(gate).collect());
    vec![innovation(which, gate, rows, |row| (row[0], row[1])), nis]
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
        let (ticks, nanos) = (rows.times.ticks(), rows.times.nanos());
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
