//! Scores of a run: errors of measured and of true signals, and what they cost.

use serde::{Deserialize, Serialize};
use supertwin_core::frame::ssa;
use supertwin_core::message::{FromSignals, Mode, Nav, Reference, SignalValues, Thrust, Truth};
use supertwin_core::run::Properties;
use supertwin_core::signal::tracking::QUANTITIES;
use supertwin_core::{Axes, BodyVelocity, Observe, Probe, Signal, Tick, Wrench, signal};
use supertwin_gnc::control::LawSample;

/// Number of scored quantities.
const COUNT: usize = QUANTITIES.len();

/// Signals that the measured part of [`Tracking`] and its references follow from.
pub(crate) static MEASURED: [&Signal; 7] = [
    &signal::nav::POSE,
    &signal::nav::VELOCITY,
    &signal::nav::NET,
    &signal::reference::VELOCITY,
    &signal::reference::DEPTH,
    &signal::reference::HEADING,
    &signal::reference::SETPOINT,
];
/// Signals that its true part follows from.
pub(crate) static TRUE: [&Signal; 3] = [&signal::truth::POSE, &signal::truth::VELOCITY, &signal::truth::NET];

/// NaN in the place of what is not there: messages of which only a part is looked at.
pub(crate) struct OrNan<'a, V>(pub(crate) &'a V);

impl<V: SignalValues> OrNan<'_, V> {
    pub(crate) fn message<M: FromSignals>(&self) -> Option<M> {
        M::from_signals(self)
    }
}

impl<V: SignalValues> SignalValues for OrNan<'_, V> {
    fn numbers(&self, signal: &'static Signal) -> Option<&[f64]> {
        const NAN: [f64; 16] = [f64::NAN; 16];
        self.0.numbers(signal).or_else(|| NAN.get(..signal.width()))
    }
    fn label(&self, signal: &'static Signal) -> Option<&str> {
        // A mode stands for none.
        self.0.label(signal).or(Some(Mode::default().name()))
    }
}

/// The six quantities of the paper's figures at one tick, three times.
///
/// Measured is what the estimator says, as the paper's curves must be; distance is held against its set-point and
/// total speed against `U_d`, the others against the output of the reference models.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tracking {
    /// From the estimator, in the order of `QUANTITIES`.
    pub measured: [f64; COUNT],
    /// From guidance, in the order of `QUANTITIES`.
    pub reference: [f64; COUNT],
    /// As it is.
    pub truth: [f64; COUNT],
}

impl Tracking {
    /// From the messages of one tick.
    #[must_use]
    pub fn new(nav: &Nav, reference: &Reference, truth: &Truth) -> Self {
        // Total speed √(u² + v²) follows from surge and sway.
        let with_speed = |d: f64, velocity: &BodyVelocity, z: f64, psi: f64| {
            let (u, v) = (velocity.surge_m_per_s, velocity.sway_m_per_s);
            [d, libm::sqrt(u * u + v * v), u, v, z, psi]
        };
        Self {
            measured: with_speed(nav.net.distance_m, &nav.velocity, nav.depth_m, nav.heading_rad),
            reference: [
                reference.net_distance_m,
                reference.speed_m_per_s.abs(),
                reference.surge_m_per_s,
                reference.sway_m_per_s,
                reference.depth_m,
                reference.heading_rad,
            ],
            truth: with_speed(truth.net_distance_m, &truth.velocity, truth.depth_m, truth.heading_rad),
        }
    }

    /// From what was shown at one tick; `None` when something is missing.
    #[must_use]
    pub fn from_signals(values: &impl SignalValues) -> Option<Self> {
        let all = MEASURED.iter().chain(&TRUE).all(|signal| values.numbers(signal).is_some());
        let values = OrNan(values);
        all.then(|| Some(Self::new(&values.message()?, &values.message()?, &values.message()?)))?
    }

    /// `value − reference`, the heading the short way round.
    #[inline(always)]
    pub(crate) fn error(&self, value: &[f64; COUNT]) -> [f64; COUNT] {
        let mut error: [f64; COUNT] = core::array::from_fn(|i| value[i] - self.reference[i]);
        error[COUNT - 1] = ssa(error[COUNT - 1]);
        error
    }
}

impl Observe for Tracking {
    fn observe<P: Probe>(&self, probe: &mut P) {
        for (i, quantity) in QUANTITIES.iter().enumerate() {
            probe.vector(quantity.signal, &[self.measured[i], self.reference[i], self.truth[i]]);
        }
    }
}

/// One number per scored quantity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "the field names carry quantity and unit")]
pub struct PerQuantity {
    pub distance_m: f64,
    pub speed_m_per_s: f64,
    pub surge_m_per_s: f64,
    pub sway_m_per_s: f64,
    pub depth_m: f64,
    pub heading_rad: f64,
}

impl From<[f64; COUNT]> for PerQuantity {
    fn from(v: [f64; COUNT]) -> Self {
        let [distance_m, speed_m_per_s, surge_m_per_s, sway_m_per_s, depth_m, heading_rad] = v;
        Self { distance_m, speed_m_per_s, surge_m_per_s, sway_m_per_s, depth_m, heading_rad }
    }
}

impl PerQuantity {
    /// In the order of the paper's table IV.
    #[must_use]
    pub fn to_array(self) -> [f64; COUNT] {
        [self.distance_m, self.speed_m_per_s, self.surge_m_per_s, self.sway_m_per_s, self.depth_m, self.heading_rad]
    }
}

/// Scores of a run over its window.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scores {
    /// Root-mean-square error of the estimated signals: the paper's table IV.
    pub measured: PerQuantity,
    /// Root-mean-square error of the true signals.
    #[serde(rename = "true")]
    pub truth: PerQuantity,
    /// Mean error of the estimated signals.
    pub measured_bias: PerQuantity,
    /// Mean error of the true signals.
    pub true_bias: PerQuantity,
    /// Largest error of the estimated signals.
    pub measured_max: PerQuantity,
    /// Largest error of the true signals.
    pub true_max: PerQuantity,
    /// Mean sway error of the estimated signals in the direction of travel: negative when it lags behind.
    pub sway_bias_in_travel_direction_m_per_s: f64,
    /// Root-mean-square of the allocated wrench, in N and N m.
    pub effort: Axes<f64>,
    /// Total variation of the requested wrench per second, in N/s and N m/s.
    pub chattering: Axes<f64>,
    /// Total variation per second of the wrench that the thrusters really made, in N/s and N m/s.
    pub activity: Axes<f64>,
    /// Largest requested force, in N and N m.
    pub requested_max: Axes<f64>,
    /// Share of time in which allocation changed the axis.
    pub saturated_share: Axes<f64>,
    /// Share of time with |σ| ≥ α_tol; absent for laws that do not adapt.
    pub outside_alpha_tol_share: Option<Axes<f64>>,
    /// k1 at the end; zero for laws without.
    pub k1_end: Axes<f64>,
    /// Slope of k1 over the second half of the window, per second.
    pub k1_slope_per_s: Axes<f64>,
    /// Root-mean-square error of the estimate itself: estimated minus true.
    pub estimation: PerQuantity,
    /// Seconds that were scored.
    pub window_s: f64,
}

#[derive(Clone, Copy, Debug, Default)]
struct ErrorSums {
    square: [f64; COUNT],
    sum: [f64; COUNT],
    max: [f64; COUNT],
}

impl ErrorSums {
    fn add(&mut self, error: &[f64; COUNT]) {
        for (i, e) in error.iter().enumerate() {
            self.square[i] += e * e;
            self.sum[i] += e;
            self.max[i] = self.max[i].max(e.abs());
        }
    }
    fn rms(&self, n: f64) -> PerQuantity {
        self.square.map(|square| libm::sqrt(square / n)).into()
    }
    fn mean(&self, n: f64) -> PerQuantity {
        self.sum.map(|sum| sum / n).into()
    }
}

/// Adds a run up, tick by tick, in one fixed order: the same numbers from the run and from its recording.
#[derive(Clone, Debug, Default)]
pub struct Scorer {
    from_tick: u64,
    middle_tick: u64,
    n: u64,
    dt_s: f64,
    measured: ErrorSums,
    truth: ErrorSums,
    estimation: ErrorSums,
    travel: f64,
    effort: [f64; 4],
    variation: [f64; 4],
    activity: [f64; 4],
    requested_max: [f64; 4],
    limited: [u64; 4],
    outside: [u64; 4],
    adaptive: bool,
    last: Option<[[f64; 4]; 2]>,
    k1_middle: [f64; 4],
    k1: [f64; 4],
}

impl Scorer {
    /// Scores the ticks `from_tick..to_tick`.
    #[must_use]
    pub fn new(from_tick: u64, to_tick: u64, dt_s: f64) -> Self {
        Self { from_tick, middle_tick: from_tick.midpoint(to_tick), dt_s, ..Self::default() }
    }

    /// Adds one tick; `made` is the wrench that the thrusters really made.
    pub fn add(&mut self, tick: Tick, tracking: &Tracking, thrust: &Thrust, made: &Wrench, law: &LawSample) {
        let requested = thrust.requested.to_array();
        let made = made.to_array();
        let last = self.last.replace([requested, made]);
        if tick.k < self.from_tick {
            return;
        }
        self.n += 1;
        let measured = tracking.error(&tracking.measured);
        self.measured.add(&measured);
        self.truth.add(&tracking.error(&tracking.truth));
        let mut estimation: [f64; COUNT] = core::array::from_fn(|i| tracking.measured[i] - tracking.truth[i]);
        estimation[COUNT - 1] = ssa(estimation[COUNT - 1]);
        self.estimation.add(&estimation);
        // Reference sway tells the direction of travel; where it passes through zero there is none.
        let direction = supertwin_gnc::control::super_twisting::sgn(tracking.reference[3]);
        self.travel += direction * measured[3];
        let allocated = thrust.allocated.to_array();
        let limited = thrust.limited.to_array();
        for i in 0..4 {
            self.effort[i] += allocated[i] * allocated[i];
            self.requested_max[i] = self.requested_max[i].max(requested[i].abs());
            if let Some([last_requested, last_made]) = last {
                self.variation[i] += (requested[i] - last_requested[i]).abs();
                self.activity[i] += (made[i] - last_made[i]).abs();
            }
            self.limited[i] += u64::from(limited[i]);
        }
        if let (Some(sigma), Some(alpha_tol)) = (law.sigma, law.alpha_tol) {
            self.adaptive = true;
            for i in 0..4 {
                self.outside[i] += u64::from(sigma[i].abs() >= alpha_tol[i]);
            }
        }
        self.k1 = law.k1.unwrap_or_default();
        if tick.k <= self.middle_tick {
            self.k1_middle = self.k1;
        }
    }

    /// The scores so far.
    #[must_use]
    pub fn scores(&self) -> Scores {
        let n = (self.n.max(1)) as f64;
        let window_s = n * self.dt_s;
        let share = |counts: [u64; 4]| Axes::from(counts.map(|count| count as f64 / n));
        let half_s = (0.5 * window_s).max(self.dt_s);
        Scores {
            measured: self.measured.rms(n),
            truth: self.truth.rms(n),
            measured_bias: self.measured.mean(n),
            true_bias: self.truth.mean(n),
            measured_max: self.measured.max.into(),
            true_max: self.truth.max.into(),
            sway_bias_in_travel_direction_m_per_s: self.travel / n,
            effort: Axes::from(self.effort.map(|square| libm::sqrt(square / n))),
            chattering: Axes::from(self.variation.map(|total| total / window_s)),
            activity: Axes::from(self.activity.map(|total| total / window_s)),
            requested_max: Axes::from(self.requested_max),
            saturated_share: share(self.limited),
            outside_alpha_tol_share: self.adaptive.then(|| share(self.outside)),
            k1_end: Axes::from(self.k1),
            k1_slope_per_s: Axes::from(core::array::from_fn(|i| (self.k1[i] - self.k1_middle[i]) / half_s)),
            estimation: self.estimation.rms(n),
            window_s,
        }
    }
}

impl Scores {
    /// As properties of a recording: `measured.distance_m` and so on.
    #[must_use]
    pub fn properties(&self) -> Properties {
        let mut properties = Properties::new();
        // The scores are plain numbers by name: their JSON tree is the list of their properties.
        if let Ok(serde_json::Value::Object(tree)) = serde_json::to_value(self) {
            flatten("", &tree, &mut properties);
        }
        properties
    }
}

fn flatten(prefix: &str, tree: &serde_json::Map<String, serde_json::Value>, out: &mut Properties) {
    for (key, value) in tree {
        let path = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        match value {
            serde_json::Value::Object(inner) => flatten(&path, inner, out),
            serde_json::Value::Number(number) => {
                if let Some(number) = number.as_f64() {
                    out.insert(path, number.into());
                }
            }
            _ => {}
        }
    }
}
