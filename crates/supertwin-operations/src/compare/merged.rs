//! The compared runs side by side in one recording, with the scores beside the curves.

use super::{Comparison, GroupReport, changes_text};
use std::collections::BTreeSet;
use supertwin_lab::metrics::{Metric, Selection};
use supertwin_lab::statistics::Better;
use supertwin_rerun::merge::{self, Cell, ScoreRow, Scores};
use supertwin_rerun::{Merge, MergeError, MergedRun};

/// What the merged recording is made of.
pub(super) fn plan(comparison: &Comparison, shown: &Selection) -> Result<Merge, MergeError> {
    let place = |name: &str| comparison.groups.iter().position(|group| group.name == name);
    let baseline = place(&comparison.baseline).unwrap_or(0);
    let mut runs = Vec::with_capacity(comparison.runs.len());
    let mut taken = BTreeSet::new();
    for run in &comparison.runs {
        let numbered = (2..).map(|n| format!("{}-{n}", run.name));
        let free = std::iter::once(run.name.clone()).chain(numbered).find(|name| !taken.contains(name));
        let name = free.unwrap_or_else(|| run.name.clone());
        taken.insert(name.clone());
        let group = place(&run.group).unwrap_or(0);
        // The baseline's run of the same seed; a run that stands alone is held against the only one there is.
        let mut candidates = comparison.runs.iter().enumerate().filter(|(_, other)| other.group == comparison.baseline);
        let same = candidates.clone().find(|(_, other)| other.seed == run.seed);
        let only = candidates.next().filter(|_| comparison.groups[baseline].runs == 1);
        let against = same.or(only).map(|(at, _)| at).filter(|_| group != baseline);
        let offset_ns = -(run.zero_s * 1e9).round() as i64;
        runs.push(MergedRun { name, paths: supertwin_rerun::read::parts(&run.file)?, offset_ns, group, against });
    }
    let aligned_on = match comparison.align.as_str() {
        "start" => String::new(),
        "following" => "net following engaged".to_owned(),
        "reversed" => "direction reversed".to_owned(),
        "fault" => "fault injected".to_owned(),
        other => other.strip_prefix("event:").unwrap_or(other).to_owned(),
    };
    Ok(Merge {
        name: comparison.groups.iter().map(|group| group.name.as_str()).collect::<Vec<_>>().join(" · "),
        groups: comparison.groups.iter().map(|group| group.name.clone()).collect(),
        runs,
        baseline,
        aligned_on,
        scores: scores(comparison, shown),
        all: false,
    })
}

fn scores(comparison: &Comparison, shown: &Selection) -> Scores {
    let others = || comparison.groups.iter().filter(|group| group.name != comparison.baseline);
    let verdicts = others().flat_map(|group| sentences(group, &comparison.baseline)).collect();
    let rows = shown.metrics().enumerate().map(|(i, metric)| row(comparison, i, metric));
    let notes = others().filter_map(|group| {
        let changes = changes_text(group, true)?;
        Some(format!("**{}** against {}. {changes}", group.name, comparison.baseline))
    });
    Scores {
        verdicts,
        rows: rows.filter(|row| row.cells.iter().any(Option::is_some)).collect(),
        notes: notes.collect::<Vec<_>>().join("\n\n"),
    }
}

/// What may be said of the paper's quantities; of whatever is shown when they are not.
fn sentences(group: &GroupReport, baseline: &str) -> Vec<String> {
    let sentence = |row: &super::metric_comparison::MetricComparison| {
        Some(format!("**{}** against {baseline}: {}: {}", group.name, row.definition.title, row.verdict.as_ref()?))
    };
    let of_the_paper: Vec<String> =
        group.metrics.iter().filter(|row| row.metric.starts_with("measured.")).filter_map(sentence).collect();
    if of_the_paper.is_empty() { group.metrics.iter().filter_map(sentence).collect() } else { of_the_paper }
}

fn row(comparison: &Comparison, number: usize, metric: &Metric) -> ScoreRow {
    let cell = |group: &GroupReport| {
        let summary = group.metrics.get(number)?.summary?;
        Some(Cell { value: summary.mean, plus_minus: summary.standard_deviation })
    };
    ScoreRow {
        name: metric.name.clone(),
        title: metric.title.clone(),
        unit: if metric.unit == "1" { String::new() } else { metric.unit.to_owned() },
        cells: comparison.groups.iter().map(cell).collect(),
        better: match metric.family.better {
            Better::Lower => merge::Better::Lower,
            Better::Higher => merge::Better::Higher,
            Better::NearestTo(0.0) => merge::Better::NearZero,
            Better::NearestTo(_) | Better::Neither => merge::Better::Neither,
        },
        chart: metric.name.starts_with("measured."),
    }
}
