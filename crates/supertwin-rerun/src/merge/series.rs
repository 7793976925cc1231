//! Curves of one quantity over aligned time, and what several of them come to.

use supertwin_core::frame::ssa;
use supertwin_core::source::Columns;

/// Times that differ by less are the same: shifted ticks are rounded twice.
const SAME_NS: i64 = 1_000;
/// Nothing is read between two rows that are farther apart.
const LONGEST_GAP_NS: i64 = 1_000_000_000;
/// Errors are averaged over so long a time.
pub(super) const WINDOW_NS: i64 = 10_000_000_000;
/// An average over less says nothing.
const LEAST_NS: i64 = 2_000_000_000;

/// One quantity of one run.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Series {
    pub(super) tick: Vec<i64>,
    pub(super) time_ns: Vec<i64>,
    pub(super) values: Vec<f64>,
}

impl Series {
    /// A component of a signal; `None` when there is no such component, or no row.
    pub(super) fn of(columns: &Columns, component: usize) -> Option<Self> {
        if component >= columns.width || columns.tick.is_empty() {
            return None;
        }
        let values = columns.values.iter().skip(component).step_by(columns.width).copied().collect();
        Some(Self { tick: columns.tick.clone(), time_ns: columns.time_ns.clone(), values })
    }

    /// `a − b` of a signal, angles the short way round.
    pub(super) fn error(columns: &Columns, a: usize, b: usize, angle: bool) -> Option<Self> {
        let (mut error, minus) = (Self::of(columns, a)?, Self::of(columns, b)?);
        error.values.iter_mut().zip(minus.values).for_each(|(x, y)| *x = short(*x - y, angle));
        Some(error)
    }

    fn push(&mut self, tick: i64, time_ns: i64, value: f64) {
        self.tick.push(tick);
        self.time_ns.push(time_ns);
        self.values.push(value);
    }

    /// Only the ticks that `every` divides.
    pub(super) fn thin(&mut self, every: i64) {
        let mut kept = Self::default();
        for (i, &tick) in self.tick.iter().enumerate().filter(|(_, tick)| *tick % every == 0) {
            kept.push(tick, self.time_ns[i], self.values[i]);
        }
        *self = kept;
    }

    /// Root of the mean square over the last ten seconds, at the ticks that `every` divides.
    pub(super) fn rms(&self, every: i64) -> Self {
        let mut rms = Self::default();
        let Some(&first) = self.time_ns.first() else { return rms };
        let (mut from, mut sum, mut n) = (0, 0.0, 0usize);
        for (i, &time_ns) in self.time_ns.iter().enumerate() {
            let mut count = |value: f64, one: i64| {
                if value.is_finite() {
                    sum += one as f64 * value * value;
                    n = n.saturating_add_signed(one as isize);
                }
            };
            count(self.values[i], 1);
            while self.time_ns[from] <= time_ns - WINDOW_NS {
                count(self.values[from], -1);
                from += 1;
            }
            if self.tick[i] % every == 0 && time_ns - first >= LEAST_NS && n > 0 {
                // What was added is taken away again, but for the last bits.
                rms.push(self.tick[i], time_ns, f64::max(sum / n as f64, 0.0).sqrt());
            }
        }
        rms
    }

    /// This minus `other` wherever both are, angles the short way round.
    pub(super) fn minus(&self, other: &Self, angle: bool) -> Self {
        let (mut difference, mut other) = (Self::default(), Cursor::new(other, angle));
        for (i, &time_ns) in self.time_ns.iter().enumerate() {
            if let Some(value) = other.at(time_ns) {
                difference.push(self.tick[i], time_ns, short(self.values[i] - value, angle));
            }
        }
        difference
    }

    /// The largest distance from `other` wherever both are; `None` where they never meet.
    pub(super) fn distance(&self, other: &Self, angle: bool) -> Option<f64> {
        self.minus(other, angle).values.iter().map(|x| x.abs()).reduce(f64::max)
    }
}

fn short(x: f64, angle: bool) -> f64 {
    if angle { ssa(x) } else { x }
}

/// Reads a series at times that only grow: its own values, and on straight lines between them where rates differ.
struct Cursor<'a> {
    series: &'a Series,
    angle: bool,
    next: usize,
}

impl<'a> Cursor<'a> {
    fn new(series: &'a Series, angle: bool) -> Self {
        Self { series, angle, next: 0 }
    }

    fn at(&mut self, time_ns: i64) -> Option<f64> {
        let Series { time_ns: times, values, .. } = self.series;
        while times.get(self.next).is_some_and(|&time| time < time_ns - SAME_NS) {
            self.next += 1;
        }
        let after = *times.get(self.next)?;
        if after <= time_ns + SAME_NS {
            return Some(values[self.next]).filter(|value| value.is_finite());
        }
        let before = self.next.checked_sub(1)?;
        let gap = after - times[before];
        let part = (time_ns - times[before]) as f64 / gap as f64;
        let value = values[before] + part * short(values[self.next] - values[before], self.angle);
        Some(value).filter(|value| gap <= LONGEST_GAP_NS && value.is_finite())
    }
}

/// Quantiles that are drawn.
const QUANTILES: [f64; 3] = [0.5, 0.1, 0.9];

/// What runs of one group have in common: at every time that half of them know, the median, and the values that a tenth
/// of them are below and above; three values a row.
pub(super) fn spread(series: &[Series]) -> Series {
    let mut grid: Vec<(i64, i64)> =
        series.iter().flat_map(|series| series.time_ns.iter().copied().zip(series.tick.iter().copied())).collect();
    grid.sort_unstable();
    grid.dedup_by(|next, kept| next.0 - kept.0 <= SAME_NS);
    // What is compared are deviations, so angles need no turns here.
    let mut cursors: Vec<Cursor<'_>> = series.iter().map(|series| Cursor::new(series, false)).collect();
    let mut spread = Series::default();
    let mut values = Vec::with_capacity(series.len());
    for (time_ns, tick) in grid {
        values.clear();
        values.extend(cursors.iter_mut().filter_map(|cursor| cursor.at(time_ns)));
        if 2 * values.len() < series.len() {
            continue;
        }
        values.sort_unstable_by(f64::total_cmp);
        spread.tick.push(tick);
        spread.time_ns.push(time_ns);
        spread.values.extend(QUANTILES.map(|part| quantile(&values, part)));
    }
    spread
}

/// Between the two values of a sorted row that are next to this part of it.
fn quantile(sorted: &[f64], part: f64) -> f64 {
    let place = part * (sorted.len() - 1) as f64;
    let below = place as usize;
    let above = sorted[(below + 1).min(sorted.len() - 1)];
    sorted[below] + (place - below as f64) * (above - sorted[below])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// Rows at multiples of `dt_ms`, from tick `first` on.
    fn series(first: i64, dt_ms: i64, values: &[f64]) -> Series {
        let tick: Vec<i64> = (first..first + values.len() as i64).collect();
        let time_ns = tick.iter().map(|tick| tick * dt_ms * 1_000_000).collect();
        Series { tick, time_ns, values: values.to_vec() }
    }

    #[test]
    fn a_difference_is_taken_where_both_are() {
        let (a, b) = (series(0, 20, &[1.0, 2.0, 3.0, 4.0]), series(2, 20, &[0.5, f64::NAN, 0.5]));
        let difference = a.minus(&b, false);
        assert_eq!((difference.tick, difference.values), (vec![2], vec![2.5]));
        assert_eq!(a.distance(&series(9, 20, &[1.0]), false), None);
        // A nanosecond is no other time.
        let mut late = b;
        late.time_ns.iter_mut().for_each(|time| *time += 1);
        assert_eq!(a.minus(&late, false).values, [2.5]);
    }

    #[test]
    fn angles_differ_the_short_way_round_and_rates_need_not_be_equal() {
        let (a, b) = (series(0, 20, &[3.1, 3.1, 3.1]), series(0, 40, &[-3.1, -3.1]));
        let difference = a.minus(&b, true);
        assert_eq!(difference.tick, [0, 1, 2]);
        assert!(difference.values.iter().all(|x| (x - (6.2 - 2.0 * PI)).abs() < 1e-12), "{difference:?}");
        let line = series(0, 40, &[0.0, 1.0]);
        assert_eq!(series(1, 20, &[1.0]).minus(&line, false).values, [0.5]);
        // Half way between 3 and -3 is π, not 0.
        let turn = series(0, 40, &[3.0, -3.0]);
        assert!((series(1, 20, &[3.0]).minus(&turn, true).values[0] - (3.0 - PI)).abs() < 1e-12);
    }

    #[test]
    fn nothing_is_read_across_a_gap() {
        let gap = series(0, 2000, &[0.0, 1.0]);
        assert_eq!(series(50, 20, &[1.0]).minus(&gap, false), Series::default());
    }

    #[test]
    fn the_root_mean_square_forgets_what_is_older_than_its_window() {
        // 3 for ten seconds, then 4 for twenty.
        let values: Vec<f64> = (0..1500).map(|k| if k < 500 { 3.0 } else { 4.0 }).collect();
        let rms = series(0, 20, &values).rms(5);
        assert_eq!((rms.tick[0], rms.tick[1]), (100, 105));
        let at = |tick: i64| rms.values[rms.tick.iter().position(|&t| t == tick).unwrap()];
        assert!((at(200) - 3.0).abs() < 1e-9 && (at(1400) - 4.0).abs() < 1e-9);
        assert!((at(745) - ((254.0 * 9.0 + 246.0 * 16.0) / 500.0f64).sqrt()).abs() < 1e-9, "{}", at(745));
        assert_eq!(series(0, 20, &[f64::NAN; 300]).rms(5), Series::default());
    }

    #[test]
    fn a_spread_has_its_quantiles_where_half_of_the_runs_are() {
        let runs: Vec<Series> = (0..11).map(|i| series(0, 20, &vec![f64::from(i); 3 + usize::from(i < 5)])).collect();
        let spread = spread(&runs);
        assert_eq!(spread.tick, [0, 1, 2], "only five of eleven have the fourth");
        assert_eq!(spread.values[..3], [5.0, 1.0, 9.0]);
        assert_eq!(quantile(&[1.0, 2.0], 0.5), 1.5);
        assert_eq!(quantile(&[7.0], 0.9), 7.0);
    }
}
