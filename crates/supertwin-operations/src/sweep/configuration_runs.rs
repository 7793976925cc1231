//! The numbers of a sweep's report: runs of one configuration, their means with intervals, differences, who is best.

use super::Prepared;
use super::run_row::{self, RunRow};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use supertwin_lab::metrics::{self, Metric};
use supertwin_lab::statistics::{Difference, Interval, Summary, bootstrap_interval};
use supertwin_lab::sweep::Parameter;

/// A score of the report.
pub(super) struct Score {
    pub(super) metric: &'static Metric,
    pub(super) label: String,
    pub(super) digits: usize,
}

/// Groups of scores, each a table and a figure.
pub(super) struct Chapter {
    pub(super) title: &'static str,
    /// Of its figure's file.
    pub(super) short: &'static str,
    pub(super) scores: Vec<Score>,
}

pub(super) fn chapters() -> [Chapter; 3] {
    let score = |metric: &'static Metric, digits| Score { metric, label: metric.label(), digits };
    let errors = |family: &str| {
        let metrics = metrics::all_metrics().iter().filter(|metric| metric.family.name == family);
        metrics.map(|metric| score(metric, 3)).collect()
    };
    let cost = [
        ("activity.surge", 1),
        ("activity.sway", 1),
        ("activity.heave", 1),
        ("activity.yaw", 2),
        ("sway_bias_in_travel_direction_m_per_s", 3),
        ("k1_end.heave", 1),
    ];
    let cost = cost.into_iter().filter_map(|(name, digits)| Some(score(metrics::named(name)?, digits)));
    [
        Chapter { title: "Root-mean-square errors, measured", short: "measured", scores: errors("measured") },
        Chapter { title: "Root-mean-square errors, true", short: "true", scores: errors("true") },
        Chapter { title: "What it cost", short: "cost", scores: cost.collect() },
    ]
}

/// Runs that differ in seeds and samples only.
pub(super) struct ConfigurationRuns<'a> {
    pub(super) trial: &'a str,
    pub(super) controller: &'a str,
    pub(super) grid: usize,
    /// Controller and point of the grid: `agsta, hs = 0.3`
    pub(super) label: String,
    /// Per parameter of the grid its value, if it concerns the controller.
    pub(super) values: Vec<Option<&'a toml::Value>>,
    /// By sample and seed.
    pub(super) rows: BTreeMap<(usize, u64), &'a RunRow>,
}

impl ConfigurationRuns<'_> {
    pub(super) fn values(&self, score: &str) -> Vec<f64> {
        self.rows.values().filter_map(|row| row.scores.get(score).copied()).collect()
    }
}

/// Parameters of the grid that change anything.
pub(super) fn grid(prepared: &Prepared) -> Vec<(usize, &Parameter)> {
    let parameters = prepared.sweep.parameters.iter().enumerate();
    parameters.filter(|(_, parameter)| !parameter.sampled && parameter.values.len() > 1).collect()
}

pub(super) fn groups<'a>(prepared: &'a Prepared, rows: &'a [RunRow]) -> Vec<ConfigurationRuns<'a>> {
    let grid = grid(prepared);
    let mut places: BTreeMap<(&str, usize, &str), usize> = BTreeMap::new();
    let mut groups: Vec<ConfigurationRuns<'a>> = Vec::new();
    for row in rows {
        let planned = &prepared.plan.runs[row.run];
        let one = &prepared.plan.configurations[planned.configuration];
        let (trial, controller) = (one.trial.name.as_str(), one.trial.controller_name.as_str());
        let place = *places.entry((trial, one.grid, controller)).or_insert_with(|| {
            let values: Vec<_> = grid.iter().map(|(i, _)| one.values[*i].as_ref()).collect();
            let mut label = controller.to_owned();
            for ((_, parameter), value) in grid.iter().zip(&values) {
                let name = parameter.name.rsplit('.').next().unwrap_or(&parameter.name);
                label += &value.map_or_else(String::new, |value| format!(", {name} = {}", run_row::value_text(value)));
            }
            groups.push(ConfigurationRuns { trial, controller, grid: one.grid, label, values, rows: BTreeMap::new() });
            groups.len() - 1
        });
        groups[place].rows.insert((one.sample, planned.seed), row);
    }
    groups
}

/// Mean and interval of a score.
#[derive(Serialize)]
pub(super) struct Estimate {
    #[serde(flatten)]
    pub(super) summary: Summary,
    /// Of the mean, by bootstrap.
    pub(super) interval: Option<Interval>,
}

pub(super) fn estimate(group: &ConfigurationRuns<'_>, score: &str) -> Option<Estimate> {
    let values = group.values(score);
    let name = format!("{} {} {} {score}", group.trial, group.grid, group.controller);
    Some(Estimate { summary: Summary::of(values.iter().copied())?, interval: bootstrap_interval(&values, &name) })
}

/// Runs with the same controller at the same point, for `--json`.
#[derive(Serialize)]
pub struct Configured {
    trial: String,
    controller: String,
    grid: usize,
    parameters: BTreeMap<String, toml::Value>,
    runs: usize,
    scores: BTreeMap<String, Estimate>,
}

/// Means and intervals of every configuration.
pub(super) fn summaries(prepared: &Prepared, rows: &[RunRow]) -> Vec<Configured> {
    let grid = grid(prepared);
    let chapters = chapters();
    let summary = |group: &ConfigurationRuns<'_>| Configured {
        trial: group.trial.to_owned(),
        controller: group.controller.to_owned(),
        grid: group.grid,
        parameters: grid
            .iter()
            .zip(&group.values)
            .filter_map(|((_, parameter), value)| Some((parameter.name.clone(), (*value)?.clone())))
            .collect(),
        runs: group.rows.len(),
        scores: chapters
            .iter()
            .flat_map(|chapter| &chapter.scores)
            .filter_map(|score| Some((score.metric.name.clone(), estimate(group, &score.metric.name)?)))
            .collect(),
    };
    groups(prepared, rows).par_iter().map(summary).collect()
}

pub(super) fn difference(
    base: &ConfigurationRuns<'_>,
    other: &ConfigurationRuns<'_>,
    score: &Score,
) -> Option<Difference> {
    // Runs are paired by sample and seed; a key stands for such a pair.
    let keys: BTreeMap<(usize, u64), u64> = base.rows.keys().copied().zip(0..).collect();
    let values = |group: &ConfigurationRuns<'_>| -> BTreeMap<u64, f64> {
        let rows = group.rows.iter();
        rows.filter_map(|(key, row)| Some((*keys.get(key)?, *row.scores.get(&score.metric.name)?))).collect()
    };
    let name = format!(
        "{} {} {} {} {} {}",
        base.trial, base.grid, base.controller, other.grid, other.controller, score.metric.name
    );
    Difference::of(&values(base), &values(other), score.metric.family.better, &name)
}

/// In how many runs each group has the least value, and of how many that all of them have. A tie counts for nobody.
pub(super) fn wins(groups: &[&ConfigurationRuns<'_>], score: &str) -> (Vec<usize>, usize) {
    let mut counts = vec![0; groups.len()];
    let mut of = 0;
    let Some(first) = groups.first() else { return (counts, of) };
    for key in first.rows.keys() {
        let values: Option<Vec<f64>> =
            groups.iter().map(|group| group.rows.get(key)?.scores.get(score).copied()).collect();
        let Some(values) = values else { continue };
        of += 1;
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let mut holders = (0..values.len()).filter(|i| values[*i] == least);
        if let (Some(winner), None) = (holders.next(), holders.next()) {
            counts[winner] += 1;
        }
    }
    (counts, of)
}
