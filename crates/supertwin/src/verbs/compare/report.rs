//! The comparison as tables, for a terminal or in Markdown.

use crate::terminal::{aligned, count, framed_table};
use comfy_table::Table;
use comfy_table::presets::ASCII_MARKDOWN;
use std::collections::{BTreeMap, BTreeSet};
use supertwin_lab::align::Window;
use supertwin_lab::limits::{Judged, Outcome};
use supertwin_lab::metrics::Selection;
use supertwin_lab::statistics::{DifferenceVerdict, FEWEST_SEEDS, Summary};
use supertwin_operations::compare::{Comparison, GroupReport, changes_text};

/// All of it.
pub(super) fn text(comparison: &Comparison, markdown: bool) -> String {
    let mut parts = vec![heading(comparison), means(comparison, &comparison.shown, markdown)];
    let others = comparison.groups.iter().filter(|group| group.name != comparison.baseline);
    for group in others {
        parts.push(title(&format!("{} against {}", group.name, comparison.baseline), markdown));
        parts.push(against(group, markdown));
        if let Some(changes) = changes_text(group, markdown) {
            parts.push(changes);
        }
    }
    if comparison.groups.len() > 1 {
        parts.push(careful(comparison));
    }
    if let Some(name) = &comparison.limits {
        parts.push(title(&format!("Limits of {name}"), markdown));
        parts.push(limits(comparison, markdown));
    }
    parts.join("\n\n")
}

fn title(text: &str, markdown: bool) -> String {
    if markdown { format!("## {text}") } else { text.to_owned() }
}

fn heading(comparison: &Comparison) -> String {
    let (runs, groups) = (comparison.runs.len(), comparison.groups.len());
    let zero = if comparison.align == "start" { "the start".to_owned() } else { format!("`{}`", comparison.align) };
    let against = if groups > 1 { format!(", held against {}", comparison.baseline) } else { String::new() };
    let unusable = match comparison.unusable.len() {
        0 => String::new(),
        n => format!("; {n} could not be used"),
    };
    let (runs, groups) = (count(runs, "run", "runs"), count(groups, "group", "groups"));
    format!("{runs}, {groups}{against}; {} from {zero}{unusable}.", windows(comparison))
}

/// The seconds that are compared; group by group when they are not the same.
fn windows(comparison: &Comparison) -> String {
    let said = |window: &Window| format!("{:.2} to {:.2} s", window.from_s, window.to_s);
    let of_group = |group: &GroupReport| -> BTreeSet<String> {
        comparison.runs.iter().filter(|run| run.group == group.name).map(|run| said(&run.window)).collect()
    };
    let all: BTreeSet<String> = comparison.runs.iter().map(|run| said(&run.window)).collect();
    if all.len() == 1 {
        return all.into_iter().collect();
    }
    let groups = comparison
        .groups
        .iter()
        .map(|group| format!("{}: {}", group.name, of_group(group).into_iter().collect::<Vec<_>>().join(" and ")));
    format!("each where its trial scores it ({}; --window makes them equal)", groups.collect::<Vec<_>>().join(", "))
}

fn table(header: Vec<String>, markdown: bool) -> Table {
    let mut table = framed_table(header);
    if markdown {
        table.load_style(ASCII_MARKDOWN);
    }
    table
}

/// Mean and deviation of every group, beside the paper's numbers where there are any.
fn means(comparison: &Comparison, shown: &Selection, markdown: bool) -> String {
    let papers: Vec<bool> =
        comparison.groups.iter().map(|group| group.metrics.iter().any(|row| row.paper.is_some())).collect();
    let mut header = vec!["mean ± standard deviation".to_owned()];
    for (group, paper) in comparison.groups.iter().zip(&papers) {
        if *paper {
            header.push("paper IV".to_owned());
        }
        header.push(format!("{} ({})", group.name, group.runs));
    }
    let mut table = table(header, markdown);
    for (i, metric) in shown.metrics().enumerate() {
        let rows = || comparison.groups.iter().filter_map(|group| group.metrics.get(i));
        if rows().all(|row| row.summary.is_none()) {
            continue;
        }
        let mut cells = vec![metric.label()];
        for (row, paper) in rows().zip(&papers) {
            if *paper {
                cells.push(row.paper.map_or_else(String::new, |value| format!("{value:.3}")));
            }
            cells.push(row.summary.as_ref().map_or_else(|| "-".to_owned(), cell));
        }
        table.add_row(cells);
    }
    aligned(table, 1..)
}

/// Three digits that count, or as many as the deviation deserves.
fn cell(summary: &Summary) -> String {
    let size = summary.mean.abs().max(summary.standard_deviation.unwrap_or(0.0));
    let digits = if size > 0.0 { (2.0 - size.log10().floor()).clamp(0.0, 6.0) as usize } else { 0 };
    match summary.standard_deviation {
        Some(deviation) => format!("{:.digits$} ± {deviation:.digits$}", summary.mean),
        None => format!("{:.digits$}", summary.mean),
    }
}

fn against(group: &GroupReport, markdown: bool) -> String {
    let mut table = table(vec!["metric".to_owned(), "verdict, difference and its 95 % interval".to_owned()], markdown);
    for row in &group.metrics {
        if let Some(verdict) = &row.verdict {
            table.add_row([row.definition.label(), verdict.clone()]);
        }
    }
    format!("{}\n{table}", glance(group))
}

/// How many metrics speak for it, and how many against.
fn glance(group: &GroupReport) -> String {
    let verdicts = group.metrics.iter().filter_map(|row| row.difference.as_ref().map(|difference| difference.verdict));
    let mut counts = BTreeMap::<DifferenceVerdict, usize>::new();
    verdicts.for_each(|verdict| *counts.entry(verdict).or_default() += 1);
    let said = counts.into_iter().map(|(verdict, n)| {
        let words = match verdict {
            DifferenceVerdict::Better => "better in",
            DifferenceVerdict::Worse => "worse in",
            DifferenceVerdict::NoClearDifference => "no clear difference in",
            DifferenceVerdict::Equal => "equal in",
            DifferenceVerdict::Different => "different in",
            DifferenceVerdict::TooFewSeeds => "too few seeds for a verdict in",
        };
        format!("{words} {n}")
    });
    let said = said.collect::<Vec<_>>().join(", ");
    if said.is_empty() { "No metric is in both.".to_owned() } else { format!("Of the metrics here: {said}.\n") }
}

/// What the verdicts do not say.
fn careful(comparison: &Comparison) -> String {
    let judged = comparison
        .groups
        .iter()
        .flat_map(|group| &group.metrics)
        .filter(|row| {
            row.difference.as_ref().is_some_and(|it| it.interval.is_some() && it.verdict != DifferenceVerdict::Equal)
        })
        .count();
    if judged == 0 {
        return format!("Differences are this minus baseline; a verdict needs {FEWEST_SEEDS} seeds in both.");
    }
    format!(
        "Differences are this minus baseline, paired by seed (of a bias: of its size), with the 95 % interval of their mean\n\
         (bootstrap, percentiles). Of {judged} such intervals about {} would miss zero by chance alone.",
        (0.05 * judged as f64).ceil()
    )
}

fn limits(comparison: &Comparison, markdown: bool) -> String {
    let count = |outcome| comparison.runs.iter().filter(|run| run.outcome == Some(outcome)).count();
    let mut text = format!(
        "{} passed, {} failed, {} invalid; {} could not be used.",
        count(Outcome::Pass),
        count(Outcome::Fail),
        count(Outcome::Invalid),
        comparison.unusable.len()
    );
    let bad: Vec<_> = comparison.runs.iter().filter(|run| run.outcome > Some(Outcome::Pass)).collect();
    if bad.is_empty() {
        return text;
    }
    let mut table = table(["run", "outcome", "why"].map(str::to_owned).to_vec(), markdown);
    for run in bad {
        let reasons: Vec<String> = run.judged.iter().filter_map(reason).collect();
        let why = if run.judged.is_empty() { "no limit concerns it".to_owned() } else { reasons.join("; ") };
        table.add_row([run.name.clone(), run.outcome.map_or("", Outcome::name).to_owned(), why]);
    }
    text += &format!("\n{}{table}", if markdown { "\n" } else { "" });
    text
}

fn reason(judged: &Judged) -> Option<String> {
    let metric = &judged.metric;
    match (judged.outcome, judged.value) {
        (Outcome::Pass, _) => None,
        (_, None) => Some(format!("{metric} is not there")),
        (_, Some(value)) => Some(match (judged.min.filter(|min| value < *min), judged.max) {
            (Some(min), _) => format!("{metric} = {value:.6}: must be at least {min}"),
            (None, max) => format!("{metric} = {value:.6}: must be at most {}", max.unwrap_or(f64::INFINITY)),
        }),
    }
}
