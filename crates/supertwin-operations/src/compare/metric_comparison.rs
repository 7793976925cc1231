//! Every metric of every group, and its difference to the baseline.

use super::run_group::RunGroup;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use supertwin_core::signal::tracking::QUANTITIES;
use supertwin_lab::metrics::{Metric, Selection};
use supertwin_lab::paper::table_iv;
use supertwin_lab::statistics::{Difference, Summary, mean};

/// A metric of a group.
#[derive(Debug, Serialize)]
pub struct MetricComparison {
    /// The metric with its title for people.
    #[serde(skip)]
    pub definition: &'static Metric,
    /// Machine name of the metric.
    pub metric: String,
    /// Its unit, `1` for none.
    pub unit: &'static str,
    /// `None`: these runs do not have it.
    pub summary: Option<Summary>,
    /// What the paper has, where a trial repeats it.
    pub paper: Option<f64>,
    /// To the baseline; none of the baseline itself, and none without a common seed.
    pub difference: Option<Difference>,
    /// The difference in words.
    pub verdict: Option<String>,
}

/// One list of rows per group, in the order of the metrics; the first group is the baseline.
pub(super) fn rows(groups: &[RunGroup], shown: &Selection) -> Vec<Vec<MetricComparison>> {
    let metrics: Vec<&'static Metric> = shown.metrics().collect();
    let jobs: Vec<(usize, &'static Metric)> =
        (0..groups.len()).flat_map(|group| metrics.iter().map(move |metric| (group, *metric))).collect();
    let rows: Vec<MetricComparison> = jobs.par_iter().map(|(group, metric)| row(groups, *group, metric)).collect();
    let mut rows = rows.into_iter();
    groups.iter().map(|_| rows.by_ref().take(metrics.len()).collect()).collect()
}

fn row(groups: &[RunGroup], number: usize, metric: &'static Metric) -> MetricComparison {
    let group = &groups[number];
    let values = group.runs.iter().filter_map(|run| run.values.get(&metric.name)).copied();
    let paper = group.facts.paper().and_then(|column| {
        let quantity = metric.name.strip_prefix("measured.")?;
        let at = QUANTITIES.iter().position(|known| known.score == quantity)?;
        Some(table_iv(column)[at])
    });
    let mut row = MetricComparison {
        definition: metric,
        metric: metric.name.clone(),
        unit: metric.unit,
        summary: Summary::of(values),
        paper,
        difference: None,
        verdict: None,
    };
    if number == 0 {
        return row;
    }
    let [before, after] = [&groups[0], group].map(|group| by_seed(group, &metric.name));
    // Runs that stand alone are held against each other whatever their seeds are.
    let alone = groups[0].runs.len() == 1 && group.runs.len() == 1;
    let [before, after] = [before, after].map(|values| if alone { renumbered(&values) } else { values });
    row.difference = Difference::of(&before, &after, metric.family.better, &metric.name);
    row.verdict = match &row.difference {
        Some(difference) => Some(difference.sentence(metric.unit)),
        None if !before.is_empty() && !after.is_empty() => Some("no seed in common with the baseline".to_owned()),
        None => None,
    };
    row
}

/// Mean of the runs of each seed; several runs of one seed are not the same in real time.
fn by_seed(group: &RunGroup, metric: &str) -> BTreeMap<u64, f64> {
    let mut values = BTreeMap::<u64, Vec<f64>>::new();
    for run in &group.runs {
        if let Some(value) = run.values.get(metric) {
            values.entry(run.seed.unwrap_or(0)).or_default().push(*value);
        }
    }
    values.into_iter().map(|(seed, values)| (seed, mean(&values))).collect()
}

fn renumbered(values: &BTreeMap<u64, f64>) -> BTreeMap<u64, f64> {
    (0..).zip(values.values().copied()).collect()
}
