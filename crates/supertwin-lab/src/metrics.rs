//! What runs are compared by: names, units and definitions of all metrics, and their values in a window of any run.
//!
//! The names are those that scores have in a recording's properties (`measured.depth_m`); what scores do not have is
//! added here. Everything is defined over the moments `i = 1…n` of a window, `Δt` apart.

mod consistency;
mod errors;
mod evaluate;
mod link;
mod steps;

pub use evaluate::{Evaluated, MetricsError, evaluate};

use crate::config::suggestion;
use crate::statistics::Better;
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeSet;
use std::sync::LazyLock;
use supertwin_core::axes::{AXIS_NAMES, WRENCH_UNITS};
use supertwin_core::block::SERVICES;
use supertwin_core::signal::{self, tracking};

/// Metrics that are defined alike.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Family {
    /// First word of their names.
    pub name: &'static str,
    /// Title of each in tables and dashboards, with what it is of in the place of `{}`.
    title: &'static str,
    /// Last word of each name, and its unit; an empty word where there is one only.
    pub items: &'static [(&'static str, &'static str)],
    /// Which values are better.
    pub better: Better,
    /// Formula, as plain text.
    pub formula: &'static str,
    /// Definition in a sentence.
    pub about: &'static str,
    /// Where its numbers come from.
    source: Source,
}

/// Where numbers come from, and so what must be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Source {
    /// The scores of a run.
    Scores,
    /// Scores; a run without truth has none.
    Truth,
    /// Responses to steps of set-points.
    Steps,
    /// The same with truth.
    TrueSteps,
    /// The estimator's health.
    Health,
    /// The estimator's variances, and truth.
    Variances,
    /// Innovations of the Kalman filter, and their covariance.
    Innovations,
    /// The accounts of a run over a network.
    Link,
}

/// Each tracked quantity by its name among the scores.
const QUANTITIES: &[(&str, &str)] = &{
    let mut items = [("", ""); tracking::QUANTITIES.len()];
    let mut i = 0;
    while i < items.len() {
        let quantity = &tracking::QUANTITIES[i];
        items[i] = (quantity.score, quantity.signal.units[0]);
        i += 1;
    }
    items
};
const INTEGRALS: &[(&str, &str)] = &[
    ("distance_m_s", "m s"),
    ("speed_m", "m"),
    ("surge_m", "m"),
    ("sway_m", "m"),
    ("depth_m_s", "m s"),
    ("heading_rad_s", "rad s"),
];
const SQUARES: &[(&str, &str)] = &[
    ("distance_m2_s", "m² s"),
    ("speed_m2_per_s", "m²/s"),
    ("surge_m2_per_s", "m²/s"),
    ("sway_m2_per_s", "m²/s"),
    ("depth_m2_s", "m² s"),
    ("heading_rad2_s", "rad² s"),
];
const WRENCH: &[(&str, &str)] = &axes(WRENCH_UNITS);
const WRENCH_RATE: &[(&str, &str)] = &axes(&["N/s", "N/s", "N/s", "N m/s"]);
const SHARES: &[(&str, &str)] = &axes(&["1"; 4]);
const GAINS: &[(&str, &str)] = &axes(signal::controller::K1.units);
const GAIN_RATES: &[(&str, &str)] = &axes(&["N/(√σ s)", "N/(√σ s)", "N/(√σ s)", "N m/(√σ s)"]);
const SETTLING: &[(&str, &str)] = &[("distance_s", "s"), ("depth_s", "s"), ("heading_s", "s")];
const OVERSHOOT: &[(&str, &str)] = &[("distance_share", "1"), ("depth_share", "1"), ("heading_share", "1")];
const UNSETTLED: &[(&str, &str)] = &[("distance", "steps"), ("depth", "steps"), ("heading", "steps")];
const NIS: &[(&str, &str)] =
    &[("surge", "1"), ("sway", "1"), ("heave", "1"), ("depth", "1"), ("heading", "1"), ("yaw_rate", "1")];
const NEES: &[(&str, &str)] = &[
    ("distance", "1"),
    ("depth", "1"),
    ("heading", "1"),
    ("surge", "1"),
    ("sway", "1"),
    ("heave", "1"),
    ("yaw_rate", "1"),
];

/// One per axis.
const fn axes(units: &[&'static str]) -> [(&'static str, &'static str); 4] {
    let names = AXIS_NAMES;
    [(names[0], units[0]), (names[1], units[1]), (names[2], units[2]), (names[3], units[3])]
}

const LOWER: Better = Better::Lower;
const NEAR_ZERO: Better = Better::NearestTo(0.0);
const NEAR_ONE: Better = Better::NearestTo(1.0);

macro_rules! families {
    ($($name:literal $items:expr, $better:expr, $source:ident, $formula:literal, $title:literal, $about:literal;)*) => {
        &[$(Family {
            name: $name,
            items: $items,
            better: $better,
            formula: $formula,
            title: $title,
            about: $about,
            source: Source::$source,
        }),*]
    };
}

/// All families. Measured is what the estimator says, true is what is so; the error e is value minus reference, of the
/// heading the short way round; distance is held against its set-point, total speed against U_d, the others against
/// the reference models.
pub static FAMILIES: &[Family] = families! {
    "measured" QUANTITIES, LOWER, Scores, "√(Σeᵢ²/n)",
        "{}, measured RMS error", "root-mean-square error of the measured signals, the paper's table IV";
    "true" QUANTITIES, LOWER, Truth, "√(Σeᵢ²/n)", "{}, true RMS error", "root-mean-square error of the true signals";
    "measured_mae" QUANTITIES, LOWER, Scores, "Σ|eᵢ|/n",
        "{}, measured mean absolute error", "mean absolute error, measured";
    "true_mae" QUANTITIES, LOWER, Truth, "Σ|eᵢ|/n", "{}, true mean absolute error", "mean absolute error, true";
    "measured_bias" QUANTITIES, NEAR_ZERO, Scores, "Σeᵢ/n", "{}, measured mean error", "mean error, measured";
    "true_bias" QUANTITIES, NEAR_ZERO, Truth, "Σeᵢ/n", "{}, true mean error", "mean error, true";
    "measured_max" QUANTITIES, LOWER, Scores, "max|eᵢ|", "{}, measured largest error", "largest error, measured";
    "true_max" QUANTITIES, LOWER, Truth, "max|eᵢ|", "{}, true largest error", "largest error, true";
    "measured_iae" INTEGRALS, LOWER, Scores, "Σ|eᵢ|Δt",
        "{}, measured integral of the absolute error", "integral of the absolute error, measured";
    "true_iae" INTEGRALS, LOWER, Truth, "Σ|eᵢ|Δt",
        "{}, true integral of the absolute error", "integral of the absolute error, true";
    "measured_ise" SQUARES, LOWER, Scores, "Σeᵢ²Δt",
        "{}, measured integral of the squared error", "integral of the squared error, measured";
    "true_ise" SQUARES, LOWER, Truth, "Σeᵢ²Δt",
        "{}, true integral of the squared error", "integral of the squared error, true";
    "sway_bias_in_travel_direction_m_per_s" &[("", "m/s")], NEAR_ZERO, Scores, "Σ sgn(v_d)eᵢ/n",
        "Sway speed, mean error in travel direction",
        "mean sway error in the direction of travel, measured: negative when it lags behind";
    "measured_settling" SETTLING, LOWER, Steps, "min τ: |y − r| ≤ band on [τ, τ + 5 s]",
        "{}, measured settling time",
        "mean settling time after a step of the set-point: from when on it stays for 5 s within 5 % of the step, at least \
         0.2 m (distance), 0.1 m (depth), 0.1 rad (heading); a step that never settles counts as long as it was watched";
    "true_settling" SETTLING, LOWER, TrueSteps, "the same of the true signals",
        "{}, true settling time", "mean settling time, true";
    "measured_overshoot" OVERSHOOT, LOWER, Steps, "max(0, max (y − r) sgn Δ)/|Δ|",
        "{}, measured overshoot",
        "mean overshoot after a step of the set-point by Δ, until it has settled, as a share of the step; waves are part of it";
    "true_overshoot" OVERSHOOT, LOWER, TrueSteps, "the same of the true signals",
        "{}, true overshoot", "mean overshoot, true";
    "unsettled" UNSETTLED, LOWER, Steps, "count",
        "{}, steps that did not settle", "steps of a set-point after which it never settled, measured";
    "effort" WRENCH, LOWER, Scores, "√(Στᵢ²/n)", "{}, RMS allocated wrench", "root-mean-square of the allocated wrench";
    "requested_max" WRENCH, LOWER, Scores, "max|τ_c,i|", "{}, largest requested wrench", "largest requested wrench";
    "chattering" WRENCH_RATE, LOWER, Scores, "Σ|τ_c,i − τ_c,i−1|/(nΔt)",
        "{}, chattering of the requested wrench",
        "chattering index: total variation of the requested wrench per second";
    "activity" WRENCH_RATE, LOWER, Truth, "Σ|τᵢ − τᵢ₋₁|/(nΔt)",
        "{}, thruster activity", "total variation per second of the wrench that the thrusters really made: their wear";
    "saturated_share" SHARES, LOWER, Scores, "count/n",
        "{}, share of time saturated", "share of time in which allocation changed the axis";
    "outside_alpha_tol_share" SHARES, LOWER, Scores, "#{|σᵢ| ≥ α_tol}/n",
        "{}, share of time with |σ| ≥ α_tol",
        "share of time outside the band in which gains may fall; adaptive laws only";
    "k1_end" GAINS, Better::Neither, Scores, "k1 at i = n",
        "{}, gain k1 at the end", "gain k1 at the end; laws with such a gain only";
    "k1_growth" GAINS, LOWER, Scores, "k1 at i = n minus k1 at i = 1",
        "{}, growth of the gain k1", "growth of the gain k1 over the window";
    "k1_slope_per_s" GAIN_RATES, LOWER, Scores, "(k1(n) − k1(n/2))/(nΔt/2)",
        "{}, slope of the gain k1",
        "slope of the gain k1 over the second half of the window: gains that never come to rest";
    "estimation" QUANTITIES, LOWER, Truth, "√(Σ(ŷᵢ − yᵢ)²/n)",
        "{}, RMS error of the estimate", "root-mean-square error of the estimate itself";
    "nis" NIS, NEAR_ONE, Innovations, "Σ(innovation²/variance)/n",
        "{}, normalised innovation squared",
        "normalised innovation squared, mean; 1 when the filter doubts as much as it errs, more when it trusts too much; \
         innovations that a gate refused are part of it";
    "nees" NEES, NEAR_ONE, Variances, "Σ((ŷᵢ − yᵢ)²/variance)/n",
        "{}, normalised estimation error squared",
        "normalised estimation error squared, mean, per quantity (covariances are not recorded); distance while there is a net";
    "net_lost_share" &[("", "1")], LOWER, Health, "count/n",
        "Share of time without a net plane", "share of time without a net plane";
    "dead_reckoning_share" &[("", "1")], LOWER, Health, "count/n",
        "Share of time on dead reckoning", "share of time without a velocity measurement";
    "loop_us" &[("median", "µs"), ("p99", "µs"), ("max", "µs")], LOWER, Link, "median, median and max over seconds",
        "Loop time, {}", "from measurements sent to the thrust they led to, as the plant counts it each second";
    "step_us" &[(SERVICES[0], "µs"), (SERVICES[1], "µs"), (SERVICES[2], "µs"), (SERVICES[3], "µs")], LOWER, Link,
        "max over seconds of p99", "Step time, {}", "time of a step with all that belongs to it";
    "transport_ms_max" &[("", "ms")], LOWER, Link, "max over services, inputs and seconds",
        "Transport time, maximum", "longest way of an input from its sender, if their clocks agree";
    "input_age_ticks_max" &[("", "ticks")], LOWER, Link, "max over services, inputs and seconds",
        "Input age, maximum", "greatest age of an input at a step";
    "messages_lost" &[("", "messages")], LOWER, Link, "Σ growth of the counters",
        "Messages lost", "messages of inputs that never came";
    "deadlines_missed" &[("", "ticks")], LOWER, Link, "Σ growth of the counters",
        "Deadlines missed", "ticks that came too late";
    "recorder_lag_ms" &[("median", "ms"), ("p99", "ms")], LOWER, Link, "recorder's clock − plant's clock",
        "Recorder lag, {}", "from the plant's clock to the recorder's, if the clocks agree";
    "unrecorded_share" &[("", "1")], LOWER, Link, "missing/(4 · ticks)",
        "Share of telemetry that is not recorded",
        "share of the four services' telemetry that the recording misses, over the whole run";
};

/// A number that a run is judged by: name, unit, formula and which value is better.
#[derive(Clone, Debug, PartialEq)]
pub struct Metric {
    /// Machine name, such as `measured.depth_m`.
    pub name: String,
    /// `Depth, measured RMS error`.
    pub title: String,
    /// Of its values.
    pub unit: &'static str,
    /// What it is one of.
    pub family: &'static Family,
}

impl Metric {
    /// `[m]`; empty for numbers without a unit.
    #[must_use]
    pub fn bracketed_unit(&self) -> String {
        if self.unit == "1" { String::new() } else { format!(" [{}]", self.unit) }
    }

    /// `Depth, measured RMS error [m]`.
    #[must_use]
    pub fn label(&self) -> String {
        self.title.clone() + &self.bracketed_unit()
    }
}

static METRICS: LazyLock<Vec<Metric>> = LazyLock::new(|| {
    let of = |family: &'static Family| {
        family.items.iter().map(move |(item, unit)| {
            let name = if item.is_empty() { family.name.to_owned() } else { format!("{}.{item}", family.name) };
            Metric { name, title: title(family, item), unit, family }
        })
    };
    FAMILIES.iter().flat_map(of).collect()
});

/// A family's title with what the item is of: a tracked quantity, or its own name.
fn title(family: &Family, item: &str) -> String {
    let word = item.split('_').next().unwrap_or_default();
    let tracked = |quantity: &&tracking::Quantity| item != word && quantity.score.split('_').next() == Some(word);
    let of = match (tracking::QUANTITIES.iter().find(tracked), item) {
        (Some(quantity), _) => quantity.title,
        (None, "yaw_rate") => "yaw rate",
        (None, "p99") => "99th percentile",
        (None, "max") => "maximum",
        _ => word,
    };
    let title = family.title.replace("{}", of);
    title[..1].to_uppercase() + &title[1..]
}

/// Every metric, in the order of the families.
#[must_use]
pub fn all_metrics() -> &'static [Metric] {
    &METRICS
}

/// The metric of this name.
#[must_use]
pub fn named(name: &str) -> Option<&'static Metric> {
    all_metrics().iter().find(|metric| metric.name == name)
}

/// Families that are shown when nobody asks for others.
const USUAL: [&str; 5] = ["measured", "true", "sway_bias_in_travel_direction_m_per_s", "activity", "saturated_share"];

/// Which metrics are wanted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection(BTreeSet<usize>);

impl Default for Selection {
    /// What the paper's table has, the same of the true signals, and what it cost.
    fn default() -> Self {
        Self::of(|metric| USUAL.contains(&metric.family.name))
    }
}

impl Selection {
    fn of(wanted: impl Fn(&Metric) -> bool) -> Self {
        Self(all_metrics().iter().enumerate().filter(|(_, metric)| wanted(metric)).map(|(i, _)| i).collect())
    }

    /// From names, names of families, patterns with `*`, `usual` and `all`.
    ///
    /// # Errors
    /// The word that is none, with a suggestion.
    pub fn parse<'a>(words: impl IntoIterator<Item = &'a str>) -> Result<Self, String> {
        let mut chosen = BTreeSet::new();
        for word in words {
            let more = match word {
                "all" => Self::of(|_| true),
                "usual" => Self::default(),
                _ => Self::of(|metric| metric.family.name == word || fits(&metric.name, word)),
            };
            if more.0.is_empty() {
                let names = all_metrics().iter().map(|metric| metric.name.as_str());
                let known = names.chain(FAMILIES.iter().map(|family| family.name));
                return Err(format!("no metric `{word}`{}", suggestion(word, known)));
            }
            chosen.extend(more.0);
        }
        Ok(Self(chosen))
    }

    /// Adds `metric` to the selection; does nothing when it is there.
    pub fn add(&mut self, metric: &Metric) {
        self.0.extend(all_metrics().iter().position(|other| other.name == metric.name));
    }

    /// In the order of [`all_metrics`].
    pub fn metrics(&self) -> impl Iterator<Item = &'static Metric> + '_ {
        self.0.iter().filter_map(|i| all_metrics().get(*i))
    }

    fn wants(&self, sources: &[Source]) -> bool {
        self.metrics().any(|metric| sources.contains(&metric.family.source))
    }

    /// Whether a signal, label or command is needed: for reading no more than that.
    #[must_use]
    pub fn is_needed(&self, path: &str) -> bool {
        crate::rescore::is_needed(path)
            || (steps::is_needed(path) && self.wants(&[Source::Steps, Source::TrueSteps]))
            || (consistency::is_innovation(path) && self.wants(&[Source::Innovations]))
            || (path == signal::nav::VARIANCE.path && self.wants(&[Source::Variances]))
            || (path == signal::nav::HEALTH.path && self.wants(&[Source::Variances, Source::Health]))
            || (path.starts_with("link/") && self.wants(&[Source::Link]))
    }
}

/// Whether a name fits a pattern, in which `*` stands for anything.
fn fits(name: &str, pattern: &str) -> bool {
    let Some((first, rest)) = pattern.split_once('*') else { return name == pattern };
    let Some(tail) = name.strip_prefix(first) else { return false };
    let mut ends = tail.char_indices().map(|(i, _)| i).chain([tail.len()]);
    ends.any(|i| fits(&tail[i..], rest))
}

/// The name of a metric in a file.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, JsonSchema)]
#[serde(transparent)]
pub struct MetricName(String);

impl MetricName {
    /// Metric of this name; `None` when there is none.
    #[must_use]
    pub fn metric(&self) -> Option<&'static Metric> {
        named(&self.0)
    }

    /// Name as it stands in the file.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl<'de> Deserialize<'de> for MetricName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        if named(&name).is_some() {
            return Ok(Self(name));
        }
        let hint = suggestion(&name, all_metrics().iter().map(|metric| metric.name.as_str()));
        Err(serde::de::Error::custom(format!("no metric `{name}`{hint}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scores;
    use supertwin_core::Axes;

    #[test]
    fn names_are_unique_and_those_of_the_scores() {
        let names: BTreeSet<&str> = all_metrics().iter().map(|metric| metric.name.as_str()).collect();
        assert_eq!(names.len(), all_metrics().len());
        let scores = Scores { outside_alpha_tol_share: Some(Axes::default()), ..Scores::default() };
        for name in scores.properties().keys().filter(|name| *name != "window_s") {
            assert!(names.contains(name.as_str()), "{name} has no definition");
        }
        for family in FAMILIES {
            assert!(!family.about.is_empty() && !family.formula.is_empty(), "{}", family.name);
        }
        let labels: BTreeSet<String> = all_metrics().iter().map(Metric::label).collect();
        assert_eq!(labels.len(), all_metrics().len(), "people can tell them apart");
        let label = |name| named(name).expect("is there").label();
        assert_eq!(label("measured.distance_m"), "Distance to net, measured RMS error [m]");
        assert_eq!(label("nis.yaw_rate"), "Yaw rate, normalised innovation squared");
        assert_eq!(label("loop_us.p99"), "Loop time, 99th percentile [µs]");
    }

    #[test]
    fn metrics_are_chosen_by_name_family_and_pattern() {
        let names = |words: &[&str]| -> Vec<&str> {
            let chosen = Selection::parse(words.iter().copied()).expect("are known");
            chosen.metrics().map(|metric| metric.name.as_str()).collect()
        };
        assert_eq!(names(&["true.depth_m", "measured.depth_m"]), ["measured.depth_m", "true.depth_m"]);
        assert_eq!(names(&["nis"]).len(), 6);
        assert_eq!(names(&["*_bias.sway*"]), ["measured_bias.sway_m_per_s", "true_bias.sway_m_per_s"]);
        assert_eq!(names(&["all"]).len(), all_metrics().len());
        let error = Selection::parse(["measured.dept_m"]).expect_err("is none");
        assert!(error.ends_with("did you mean `measured.depth_m`?"), "{error}");
        assert!(fits("abc", "a*c") && fits("abc", "*") && !fits("abc", "a*b") && fits("a.b.c", "*.b.*"));
    }

    #[test]
    fn no_more_is_read_than_is_wanted() {
        let (variance, loop_time) = (signal::nav::VARIANCE.path, signal::link::LOOP_TIME.path("plant"));
        let usual = Selection::default();
        assert!(usual.is_needed(signal::truth::POSE.path) && !usual.is_needed(variance));
        let more = Selection::parse(["nees.depth", "loop_us"]).expect("are known");
        assert!(more.is_needed(variance) && more.is_needed(&loop_time));
        assert!(!more.is_needed(signal::guidance::TARGET.path) && !more.is_needed("scene/net"));
    }
}
