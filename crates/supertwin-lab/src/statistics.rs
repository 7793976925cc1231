//! Statistics of seeded runs: means, paired differences with their intervals, and sentences that say no more than the
//! numbers do.
//!
//! Runs with the same seed meet the same sea, sensors and faults, so two configurations are compared seed by seed: the
//! difference within a seed varies much less than the runs themselves do.

use serde::Serialize;
use std::collections::BTreeMap;
use supertwin_core::random::Stream;

/// Resamples of a bootstrap.
pub const RESAMPLES: usize = 10_000;

/// Share of intervals that hold the mean, were all seeds run again and again.
pub const CONFIDENCE: f64 = 0.95;

/// Fewer seeds than this allow no statement: even if all of them agreed, chance would do that in one case of sixteen.
pub const FEWEST_SEEDS: usize = 5;

/// Arithmetic mean, `Σx/n`, summed in the order given; 0 of none.
#[must_use]
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Sample standard deviation, `√(Σ(x − mean)²/(n − 1))`; `None` of fewer than two.
#[must_use]
pub fn standard_deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values);
    let square: f64 = values.iter().map(|x| (x - mean) * (x - mean)).sum();
    (values.len() > 1).then(|| libm::sqrt(square / (values.len() - 1) as f64))
}

/// The value below which a `share` of the sorted values lies, interpolated linearly between neighbours.
#[must_use]
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let place = share * last as f64;
    let below = (libm::floor(place) as usize).min(last);
    let above = (below + 1).min(last);
    Some(sorted[below] + (place - below as f64) * (sorted[above] - sorted[below]))
}

/// Bounds of an interval, in the unit of the quantity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the field names say it")]
pub struct Interval {
    pub low: f64,
    pub high: f64,
}

impl Interval {
    /// Zero is one of its values.
    #[must_use]
    pub fn includes_zero(self) -> bool {
        self.low <= 0.0 && self.high >= 0.0
    }
}

/// Bootstrap interval of a mean: the percentile method with [`RESAMPLES`] resamples at [`CONFIDENCE`].
///
/// The stream is named, so the same numbers have the same interval, bit by bit, whatever else is computed. The percentile
/// method is a little narrow for few values (about 90 instead of 95 per cent at ten). `None` of fewer than two values.
#[must_use]
pub fn bootstrap_interval(values: &[f64], name: &str) -> Option<Interval> {
    let n = u32::try_from(values.len()).ok().filter(|n| *n > 1)?;
    let mut stream = Stream::new(0, &format!("bootstrap {name}"));
    let mut means = Vec::with_capacity(RESAMPLES);
    for _ in 0..RESAMPLES {
        let sum: f64 = (0..n).map(|_| values[stream.below(n) as usize]).sum();
        means.push(sum / f64::from(n));
    }
    means.sort_unstable_by(f64::total_cmp);
    let tail = 0.5 * (1.0 - CONFIDENCE);
    Some(Interval { low: quantile(&means, tail)?, high: quantile(&means, 1.0 - tail)? })
}

/// Exact two-sided sign test: how probable it is that chance alone, a fair coin per seed, is at least as one-sided as
/// `wins` against `losses`. `p = min(1, 2 Σ_{k ≤ min} C(n, k)/2ⁿ)`; ties are left out.
#[must_use]
pub fn sign_test(wins: usize, losses: usize) -> f64 {
    let n = (wins + losses) as f64;
    // Where neither wins more often, every other outcome is at least as one-sided.
    if wins == losses {
        return 1.0;
    }
    let share = |k: f64| {
        let ways = libm::lgamma(n + 1.0) - libm::lgamma(k + 1.0) - libm::lgamma(n - k + 1.0);
        libm::exp(ways - n * core::f64::consts::LN_2)
    };
    let tail: f64 = (0..=wins.min(losses)).map(|k| share(k as f64)).sum();
    (2.0 * tail).min(1.0)
}

/// What several seeds have in common.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Number of finite values.
    pub n: usize,
    /// Arithmetic mean, `Σx/n`.
    pub mean: f64,
    /// Sample standard deviation; `None` of a single run.
    pub standard_deviation: Option<f64>,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
}

impl Summary {
    /// Of the values that are numbers; `None` without any.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let values: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
        let (min, max) = (values.iter().copied().reduce(f64::min)?, values.iter().copied().reduce(f64::max)?);
        Some(Self { n: values.len(), mean: mean(&values), standard_deviation: standard_deviation(&values), min, max })
    }
}

/// Which of two values of a quantity is the better one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    /// The lower one: errors, effort, wear.
    Lower,
    /// The higher one.
    Higher,
    /// The one that is nearer to this value; what is compared is the distance from it.
    NearestTo(f64),
    /// Neither is: it is only shown.
    Neither,
}

impl Better {
    /// What is compared of a value; less is better, except for [`Better::Higher`] and [`Better::Neither`].
    #[must_use]
    pub fn compared(self, value: f64) -> f64 {
        match self {
            Self::NearestTo(target) => libm::fabs(value - target),
            _ => value,
        }
    }

    /// Whether a difference, other minus baseline, is in favour of the other; `None` where nothing is.
    fn favours(self, difference: f64) -> Option<bool> {
        match self {
            Self::Lower | Self::NearestTo(_) if difference != 0.0 => Some(difference < 0.0),
            Self::Higher if difference != 0.0 => Some(difference > 0.0),
            _ => None,
        }
    }
}

/// What the numbers allow to say.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DifferenceVerdict {
    /// The interval is on the good side of zero, and more seeds are better than worse.
    Better,
    /// The interval is on the bad side of zero, and more seeds are worse than better.
    Worse,
    /// The interval includes zero, or the seeds do not agree with it.
    NoClearDifference,
    /// Every seed has the same value twice.
    Equal,
    /// The interval does not include zero, and neither value is the better one.
    Different,
    /// Fewer than [`FEWEST_SEEDS`] seeds are in both.
    TooFewSeeds,
}

/// Paired differences of a quantity, other minus baseline, seed by seed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Seeds that are in both, with a number in both.
    pub seeds: usize,
    /// Mean of the differences; of their distances from the target where the nearest is the best.
    pub mean: f64,
    /// Sample standard deviation of the differences.
    pub standard_deviation: Option<f64>,
    /// Bootstrap interval of the mean; `None` with fewer than [`FEWEST_SEEDS`] seeds.
    pub interval: Option<Interval>,
    /// Seeds in which the other one is better, is worse, and neither.
    pub better_seeds: usize,
    /// Seeds in which the other one is worse than the baseline.
    pub worse_seeds: usize,
    /// Seeds in which neither is better.
    pub equal_seeds: usize,
    /// Of the exact two-sided sign test; `None` where neither value is the better one.
    pub sign_test_p: Option<f64>,
    /// What may be said.
    pub verdict: DifferenceVerdict,
}

impl Difference {
    /// Of values by seed. `name` names the quantity: the stream of the bootstrap belongs to it.
    #[must_use]
    pub fn of(baseline: &BTreeMap<u64, f64>, other: &BTreeMap<u64, f64>, better: Better, name: &str) -> Option<Self> {
        let both = baseline.iter().filter_map(|(seed, value)| Some((*value, *other.get(seed)?)));
        let both = both.filter(|(before, after)| before.is_finite() && after.is_finite());
        let differences: Vec<f64> =
            both.map(|(before, after)| better.compared(after) - better.compared(before)).collect();
        if differences.is_empty() {
            return None;
        }
        let count = |wanted| differences.iter().filter(|value| better.favours(**value) == Some(wanted)).count();
        let (better_seeds, worse_seeds) = (count(true), count(false));
        let seeds = differences.len();
        let interval = (seeds >= FEWEST_SEEDS).then(|| bootstrap_interval(&differences, name)).flatten();
        let mean = mean(&differences);
        let verdict = match (interval, better.favours(mean)) {
            _ if differences.iter().all(|difference| *difference == 0.0) => DifferenceVerdict::Equal,
            (None, _) => DifferenceVerdict::TooFewSeeds,
            (Some(interval), _) if interval.includes_zero() => DifferenceVerdict::NoClearDifference,
            (Some(_), Some(true)) if better_seeds > worse_seeds => DifferenceVerdict::Better,
            (Some(_), Some(false)) if worse_seeds > better_seeds => DifferenceVerdict::Worse,
            (Some(_), None) => DifferenceVerdict::Different,
            (Some(_), Some(_)) => DifferenceVerdict::NoClearDifference,
        };
        Some(Self {
            seeds,
            mean,
            standard_deviation: standard_deviation(&differences),
            interval,
            better_seeds,
            worse_seeds,
            equal_seeds: seeds - better_seeds - worse_seeds,
            sign_test_p: (better != Better::Neither).then(|| sign_test(better_seeds, worse_seeds)),
            verdict,
        })
    }

    /// In words, with its unit: `better in 19 of 20 seeds, difference -0.031 m/s [-0.036, -0.027]`.
    ///
    /// Negative means less than the baseline.
    #[must_use]
    pub fn sentence(&self, unit: &str) -> String {
        let seeds = self.seeds;
        // A share has the unit 1.
        let unit = if ["", "1"].contains(&unit) { String::new() } else { format!(" {unit}") };
        let number = match self.interval {
            Some(Interval { low, high }) => {
                let digits = digits(high - low);
                format!("difference {:+.digits$}{unit} [{low:+.digits$}, {high:+.digits$}]", self.mean)
            }
            None => format!("difference {:+.digits$}{unit}", self.mean, digits = digits(libm::fabs(self.mean))),
        };
        match self.verdict {
            DifferenceVerdict::Better => format!("better in {} of {seeds} seeds, {number}", self.better_seeds),
            DifferenceVerdict::Worse => format!("worse in {} of {seeds} seeds, {number}", self.worse_seeds),
            DifferenceVerdict::Different => number,
            DifferenceVerdict::NoClearDifference if self.sign_test_p.is_none() => {
                format!("no clear difference: {number}")
            }
            DifferenceVerdict::NoClearDifference => {
                format!("no clear difference: better in {} of {seeds} seeds, {number}", self.better_seeds)
            }
            DifferenceVerdict::Equal if seeds == 1 => "equal".to_owned(),
            DifferenceVerdict::Equal => format!("equal in all {seeds} seeds"),
            DifferenceVerdict::TooFewSeeds => {
                let s = if seeds == 1 { "" } else { "s" };
                format!("{number}; {seeds} seed{s}, a verdict needs {FEWEST_SEEDS}")
            }
        }
    }
}

/// Decimals that show a width with one or two digits that count: between 5 and 50 units of the last one.
fn digits(width: f64) -> usize {
    if !(width > 0.0 && width.is_finite()) {
        return 3;
    }
    libm::ceil(-libm::log10(width / 5.0)).clamp(0.0, 9.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn by_seed(values: &[f64]) -> BTreeMap<u64, f64> {
        (1..).zip(values.iter().copied()).collect()
    }

    #[test]
    fn means_deviations_and_quantiles_are_those_of_the_textbook() {
        let values = [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0];
        assert_eq!(mean(&values), 5.0);
        assert_eq!(standard_deviation(&values), Some(libm::sqrt(32.0 / 7.0)));
        assert_eq!((standard_deviation(&[1.0]), mean(&[]), quantile(&[], 0.5)), (None, 0.0, None));
        assert_eq!(quantile(&[1.0, 2.0, 4.0], 0.75), Some(3.0));
        assert_eq!(quantile(&[1.0, 2.0, 4.0], 1.0), Some(4.0));
        let summary = Summary::of([3.0, f64::NAN, 1.0]).expect("two numbers");
        assert_eq!((summary.n, summary.mean, summary.min, summary.max), (2, 2.0, 1.0, 3.0));
        assert_eq!(Summary::of([f64::NAN]), None);
    }

    #[test]
    fn the_sign_test_is_the_binomial_one() {
        // Twice the sum of C(20, 0) and C(20, 1) over 2²⁰.
        let expected = 2.0 * 21.0 / 1_048_576.0;
        assert!((sign_test(19, 1) / expected - 1.0).abs() < 1e-12, "{}", sign_test(19, 1));
        assert_eq!(sign_test(19, 1).to_bits(), sign_test(1, 19).to_bits());
        assert!((sign_test(5, 0) - 0.0625).abs() < 1e-15);
        assert_eq!((sign_test(0, 0), sign_test(7, 7)), (1.0, 1.0));
        // No underflow: 2⁻²⁰⁰⁰ is no number of this size.
        let many = sign_test(1050, 950);
        assert!(many > 0.02 && many < 0.03, "{many}");
    }

    #[test]
    fn an_interval_repeats_by_name_and_holds_the_mean() {
        let values: Vec<f64> = (0..20).map(|i| f64::from(i % 7) - 1.3 * f64::from(i % 3)).collect();
        let interval = bootstrap_interval(&values, "depth").expect("enough");
        assert_eq!(Some(interval), bootstrap_interval(&values, "depth"));
        assert_ne!(Some(interval), bootstrap_interval(&values, "heading"));
        assert!(interval.low < mean(&values) && mean(&values) < interval.high);
        // Near 1.96 standard errors either way.
        let half = 0.5 * (interval.high - interval.low);
        let error = standard_deviation(&values).expect("twenty") / 20f64.sqrt();
        assert!((half / (1.96 * error) - 1.0).abs() < 0.06, "{half} against {error}");
        assert_eq!(bootstrap_interval(&[1.0], "one"), None);
    }

    #[test]
    fn nineteen_of_twenty_intervals_hold_the_true_mean() {
        let mut stream = Stream::new(4, "test");
        let trials = 400;
        let holds = (0..trials).filter(|_| {
            let values: Vec<f64> = (0..30).map(|_| 2.0 + stream.normal()).collect();
            let interval = bootstrap_interval(&values, "test").expect("enough");
            interval.low <= 2.0 && 2.0 <= interval.high
        });
        // Binomial: 0.94 ± 0.012; the method is a little narrow at thirty.
        let share = holds.count() as f64 / f64::from(trials);
        assert!((0.90..=0.98).contains(&share), "{share}");
    }

    #[test]
    fn sentences_say_what_the_numbers_allow() {
        let before: Vec<f64> = (0..20).map(|i| 0.1 + 0.01 * f64::from(i)).collect();
        let mut after: Vec<f64> = before.iter().enumerate().map(|(i, x)| x - 0.02 - 0.001 * (i % 5) as f64).collect();
        after[7] = before[7] + 0.001;
        let difference =
            |after: &[f64], better| Difference::of(&by_seed(&before), &by_seed(after), better, "x").expect("pairs");
        let better = difference(&after, Better::Lower);
        let sentence = better.sentence("m/s");
        assert!(sentence.starts_with("better in 19 of 20 seeds, difference -0.02"), "{sentence}");
        assert!(sentence.contains(" m/s [-0.02"), "{sentence}");
        assert_eq!(better.verdict, DifferenceVerdict::Better);
        assert_eq!(difference(&after, Better::Higher).verdict, DifferenceVerdict::Worse);
        let shown = difference(&after, Better::Neither);
        assert_eq!((shown.verdict, shown.sign_test_p), (DifferenceVerdict::Different, None));

        let noise: Vec<f64> =
            before.iter().enumerate().map(|(i, x)| x + if i % 2 == 0 { 0.01 } else { -0.0099 }).collect();
        let none = difference(&noise, Better::Lower).sentence("m");
        assert!(none.starts_with("no clear difference: better in 10 of 20 seeds, difference +0.000 m ["), "{none}");
        assert_eq!(difference(&before, Better::Lower).sentence("m"), "equal in all 20 seeds");

        let few = difference(&after[..4], Better::Lower);
        assert_eq!((few.verdict, few.interval), (DifferenceVerdict::TooFewSeeds, None));
        let few = few.sentence("m");
        assert!(few.ends_with("4 seeds, a verdict needs 5") && !few.contains("better"), "{few}");
    }

    #[test]
    fn one_wild_seed_makes_no_verdict() {
        // Nineteen are a little worse, one is so much better that the mean is.
        let before = vec![1.0; 20];
        let after: Vec<f64> = (0..20).map(|i| if i == 3 { -99.0 } else { 1.0 + 0.01 * f64::from(i + 1) }).collect();
        let difference = Difference::of(&by_seed(&before), &by_seed(&after), Better::Lower, "x").expect("pairs");
        assert!(difference.mean < 0.0 && difference.worse_seeds == 19);
        assert_eq!(difference.verdict, DifferenceVerdict::NoClearDifference);
    }

    #[test]
    fn seeds_are_paired_and_what_is_no_number_is_left_out() {
        let before = BTreeMap::from([(1, 1.0), (2, 2.0), (3, f64::NAN), (9, 4.0)]);
        let after = BTreeMap::from([(2, 2.5), (3, 1.0), (9, 4.5), (10, 0.0)]);
        let difference = Difference::of(&before, &after, Better::Lower, "x").expect("two pairs");
        assert_eq!((difference.seeds, difference.mean, difference.worse_seeds), (2, 0.5, 2));
        assert_eq!(Difference::of(&before, &BTreeMap::new(), Better::Lower, "x"), None);
        // A bias of +0.1 is as good as one of −0.1.
        let sides =
            Difference::of(&BTreeMap::from([(1, -0.1)]), &BTreeMap::from([(1, 0.1)]), Better::NearestTo(0.0), "bias");
        assert_eq!(sides.map(|sides| sides.verdict), Some(DifferenceVerdict::Equal));
    }

    #[test]
    fn numbers_are_as_exact_as_they_are_wide() {
        assert_eq!([0.009, 0.05, 0.049, 12.0, 300.0].map(digits), [3, 2, 3, 0, 0]);
        assert_eq!([0.0, f64::NAN].map(digits), [3, 3]);
    }
}
