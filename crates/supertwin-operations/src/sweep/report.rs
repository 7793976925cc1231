//! The report of a sweep, its tables and figures.

use super::configuration_runs::{
    ConfigurationRuns, Estimate, Score, chapters, difference, estimate, grid, groups, wins,
};
use super::figures::{self, IntervalPanel, IntervalRow, ScatterPanel, Series};
use super::run_row::{self, RunRow};
use super::{Prepared, TABLE, program, verdicts};
use crate::OperationError;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use supertwin_lab::statistics::{self, Better, Difference, DifferenceVerdict, Interval};
use supertwin_lab::sweep::{Parameter, rank_correlation};

/// Name of the report in the folder of the sweep.
pub(super) const FILE: &str = "report.md";
/// Folder of its figures.
const FIGURES: &str = "figures";
/// Configurations of a trial that are shown; the table has all.
const SHOWN: usize = 60;
/// Grid points at which controllers are compared.
const COMPARED: usize = 12;
/// Invalid runs that are listed.
const LISTED: usize = 50;

/// Writes report and figures; what is there is replaced.
pub(super) fn write(prepared: &Prepared, rows: &[RunRow], folder: &Path) -> Result<(), OperationError> {
    let figures = folder.join(FIGURES);
    std::fs::create_dir_all(&figures).map_err(|cause| OperationError::at(&figures, &cause))?;
    let mut report = Report { prepared, text: String::new(), figures: BTreeMap::new() };
    report.head(rows);
    let groups = groups(prepared, rows);
    for name in distinct(groups.iter().map(|group| group.trial)) {
        let groups: Vec<&ConfigurationRuns<'_>> = groups.iter().filter(|group| group.trial == name).collect();
        let controllers = distinct(groups.iter().map(|group| group.controller));
        let told = report.trial(&Trial { name, groups, controllers });
        told.map_err(|error| OperationError::Option(error.to_string()))?;
    }
    report.rest(rows);
    for (name, svg) in &report.figures {
        let path = figures.join(name);
        std::fs::write(&path, svg).map_err(|cause| OperationError::at(&path, &cause))?;
    }
    // The text comes last, whole or not at all: where it is, the figures are.
    let path = folder.join(FILE);
    let unfinished = folder.join(format!("{FILE}.unfinished"));
    std::fs::write(&unfinished, &report.text)
        .and_then(|()| std::fs::rename(&unfinished, &path))
        .map_err(|cause| OperationError::at(&path, &cause))
}

/// What a sweep did with one of its trials.
struct Trial<'a> {
    name: &'a str,
    groups: Vec<&'a ConfigurationRuns<'a>>,
    controllers: Vec<&'a str>,
}

impl Trial<'_> {
    /// Index of a controller's colour in figures.
    fn colour(&self, controller: &str) -> usize {
        self.controllers.iter().position(|other| *other == controller).unwrap_or(0)
    }
}

struct Report<'a> {
    prepared: &'a Prepared,
    text: String,
    /// By file name.
    figures: BTreeMap<String, String>,
}

impl Report<'_> {
    fn say(&mut self, paragraph: &str) {
        self.text += paragraph;
        self.text += "\n\n";
    }

    fn table(&mut self, header: Vec<String>, rows: Vec<Vec<String>>) {
        self.say(&markdown_table(header, rows));
    }

    fn figure(&mut self, name: &str, about: &str, svg: String) {
        let file = format!("{}.svg", name.replace(|c: char| !c.is_ascii_alphanumeric() && c != '-' && c != '_', "-"));
        self.say(&format!("![{about}]({FIGURES}/{file})"));
        self.figures.insert(file, svg);
    }

    fn head(&mut self, rows: &[RunRow]) {
        let sweep = &self.prepared.sweep;
        self.say(&format!("# Sweep {}", sweep.name));
        self.say(sweep.description.trim());
        let verdicts: Vec<String> = verdicts(rows).into_iter().map(|(name, count)| format!("{count} {name}")).collect();
        let seeds = match (sweep.seed_per_sample, &sweep.seeds[..]) {
            (true, [first, ..]) => format!("a seed per sample from {first} on"),
            (_, [only]) => format!("seed {only}"),
            (_, seeds) => format!("{} seeds, {} to {}", seeds.len(), seeds[0], seeds[seeds.len() - 1]),
        };
        self.say(&format!(
            "{} run{}: {}. Trials {}; {seeds}. Made by supertwin {} with the plan `{}`; a row per run is in `{TABLE}.parquet`.",
            rows.len(),
            if rows.len() == 1 { "" } else { "s" },
            verdicts.join(", "),
            sweep.trials.join(", "),
            program(),
            &self.prepared.fingerprint[..16],
        ));
        if !sweep.parameters.is_empty() {
            let rows = sweep.parameters.iter().map(|parameter| {
                let numbers: Vec<f64> = parameter.values.iter().filter_map(run_row::number).collect();
                let least = numbers.iter().copied().fold(f64::INFINITY, f64::min);
                let most = numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                let values = match (parameter.sampled, parameter.values.len()) {
                    (true, n) => format!("{n} samples, {least:.4} to {most:.4}"),
                    (false, n) if n > 12 => format!("{n} values, {least} to {most}"),
                    _ => parameter.values.iter().map(run_row::value_text).collect::<Vec<_>>().join(", "),
                };
                let times = if parameter.times { "times what the file says" } else { "" };
                vec![parameter.name.clone(), parameter.places.join(", "), values, times.to_owned()]
            });
            let rows = rows.collect();
            self.table(["Parameter", "Replaces", "Values", ""].map(str::to_owned).into(), rows);
        }
        self.say(&format!(
            "Numbers in brackets are {:.0} % intervals of the mean, by bootstrap over the runs of a configuration. \
             Differences are taken run by run, between runs with the same seed and sample, which meet the same sea, \
             sensors and faults.",
            100.0 * statistics::CONFIDENCE
        ));
    }

    fn trial(&mut self, trial: &Trial<'_>) -> Result<(), Box<dyn std::error::Error>> {
        let Trial { name, groups, .. } = trial;
        self.say(&format!("## {name}"));
        let shown = &groups[..groups.len().min(SHOWN)];
        if shown.len() < groups.len() {
            self.say(&format!("The first {} of {} configurations; the table has all.", shown.len(), groups.len()));
        }
        for chapter in chapters() {
            self.say(&format!("### {}", chapter.title));
            let estimates: Vec<Vec<Option<Estimate>>> = shown
                .par_iter()
                .map(|group| chapter.scores.iter().map(|score| estimate(group, &score.metric.name)).collect())
                .collect();
            let mut header = vec!["mean [interval]".to_owned(), "runs".to_owned()];
            header.extend(chapter.scores.iter().map(|score| score.label.clone()));
            let rows = shown.iter().zip(&estimates).map(|(group, estimates)| {
                let mut cells = vec![group.label.clone(), group.rows.len().to_string()];
                cells.extend(
                    estimates.iter().zip(&chapter.scores).map(|(estimate, score)| cell(estimate.as_ref(), score)),
                );
                cells
            });
            self.table(header, rows.collect());
            let panels = chapter.scores.iter().enumerate().map(|(i, score)| IntervalPanel {
                title: score.label.clone(),
                rows: shown
                    .iter()
                    .zip(&estimates)
                    .filter_map(|(group, estimates)| {
                        let estimate = estimates[i].as_ref()?;
                        Some(IntervalRow {
                            label: group.label.clone(),
                            colour: trial.colour(group.controller),
                            values: group.values(&score.metric.name),
                            mean: estimate.summary.mean,
                            interval: estimate.interval.map(|interval| (interval.low, interval.high)),
                        })
                    })
                    .collect(),
            });
            let title = format!("{name}: {}", chapter.title.to_lowercase());
            let svg = figures::intervals(&title, &panels.collect::<Vec<_>>())?;
            self.figure(&format!("{name}-{}", chapter.short), &title, svg);
        }
        self.differences(trial);
        self.best(trial);
        self.influence(trial)
    }

    /// Controllers against the baseline at the same point; and of each controller, points against the first one.
    fn differences(&mut self, trial: &Trial<'_>) {
        let Trial { groups, controllers, .. } = trial;
        let named = self.prepared.sweep.baseline.as_deref().filter(|name| controllers.contains(name));
        let Some(baseline) = named.or(controllers.first().copied()) else { return };
        let of = |controller: &str| -> Vec<&ConfigurationRuns<'_>> {
            groups.iter().copied().filter(|group| group.controller == controller).collect()
        };
        let of_baseline = of(baseline);
        if controllers.len() > 1 {
            self.say(&format!("### Against {baseline}"));
            self.say(
                "Difference to the baseline [interval], and in how many of the runs it is better or worse. \
                 Less is better, for the bias what is nearer to none.",
            );
            for base in of_baseline.iter().take(COMPARED) {
                let same_point = |group: &&ConfigurationRuns<'_>| {
                    let mut both = group.values.iter().zip(&base.values);
                    group.controller != baseline && both.all(|(a, b)| a.is_none() || b.is_none() || a == b)
                };
                self.against(base, &groups.iter().copied().filter(same_point).collect::<Vec<_>>());
            }
            if of_baseline.len() > COMPARED {
                self.say(&format!("The first {COMPARED} of {} grid points.", of_baseline.len()));
            }
        }
        if grid(self.prepared).is_empty() {
            return;
        }
        for controller in controllers {
            if let [first, others @ ..] = of(controller).as_slice()
                && !others.is_empty()
            {
                self.say(&format!("### {controller}, against its first point"));
                self.against(first, &others[..others.len().min(COMPARED)]);
            }
        }
    }

    fn against(&mut self, base: &ConfigurationRuns<'_>, others: &[&ConfigurationRuns<'_>]) {
        let mut header = vec![format!("against {}", base.label)];
        header.extend(others.iter().map(|group| group.label.clone()));
        let chapters = chapters();
        let scores: Vec<&Score> = chapters
            .iter()
            .flat_map(|chapter| &chapter.scores)
            .filter(|score| score.metric.family.better != Better::Neither)
            .collect();
        let rows: Vec<Vec<String>> = scores
            .par_iter()
            .map(|score| {
                let mut cells = vec![score.label.clone()];
                cells.extend(others.iter().map(|other| {
                    let difference = difference(base, other, score);
                    difference.map_or_else(|| "–".to_owned(), |difference| told(&difference, score.digits))
                }));
                cells
            })
            .collect();
        self.table(header, rows);
    }

    /// Of groups of controllers, who has the least error, seed by seed.
    fn best(&mut self, trial: &Trial<'_>) {
        let points: Vec<usize> = distinct(trial.groups.iter().map(|group| group.grid));
        for names in self.prepared.sweep.best_of.iter().filter(|names| names.len() > 1) {
            for point in points.iter().take(COMPARED) {
                let member = |name: &String| {
                    trial.groups.iter().copied().find(|group| group.grid == *point && group.controller == *name)
                };
                let members: Vec<&ConfigurationRuns<'_>> = names.iter().filter_map(member).collect();
                if members.len() < names.len() {
                    continue;
                }
                self.say(&format!("### Best of {}", names.join(", ")));
                if points.len() > 1 {
                    self.say(members[0].label.split_once(", ").map_or("", |(_, point)| point));
                }
                let mut header = vec!["runs in which it is best".to_owned()];
                header.extend(members.iter().map(|group| group.controller.to_owned()));
                header.push("of".to_owned());
                let mut rows = Vec::new();
                for score in chapters().iter().take(2).flat_map(|chapter| &chapter.scores) {
                    let (counts, of) = wins(&members, &score.metric.name);
                    let mut cells = vec![score.label.clone()];
                    cells.extend(counts.iter().map(usize::to_string));
                    cells.push(of.to_string());
                    rows.push(cells);
                }
                self.table(header, rows);
            }
        }
    }

    /// Scores over every parameter that is a number and takes several values.
    fn influence(&mut self, trial: &Trial<'_>) -> Result<(), Box<dyn std::error::Error>> {
        let Trial { name, groups, controllers } = trial;
        let prepared = self.prepared;
        let parameters: Vec<(usize, &Parameter)> = prepared
            .sweep
            .parameters
            .iter()
            .enumerate()
            .filter(|(_, one)| one.values.len() > 1 && one.values.iter().all(|value| run_row::number(value).is_some()))
            .collect();
        if parameters.is_empty() {
            return Ok(());
        }
        let [measured, ..] = chapters();
        // The points of a score over a parameter, for a controller.
        let points = |parameter: usize, controller: &str, score: &str| -> Vec<(f64, f64)> {
            let rows =
                groups.iter().filter(|group| group.controller == controller).flat_map(|group| group.rows.values());
            rows.filter_map(|row| {
                let one = &prepared.plan.configurations[prepared.plan.runs[row.run].configuration];
                Some((run_row::number(one.values[parameter].as_ref()?)?, *row.scores.get(score)?))
            })
            .collect()
        };
        self.say("### What the parameters do");
        self.say(
            "Rank correlation of parameter and measured error over all runs: +1 the error grows with the parameter, \
             −1 it shrinks, near 0 the parameter does not matter or does not act one way.",
        );
        let mut header = vec!["rank correlation".to_owned()];
        header.extend(measured.scores.iter().map(|score| score.label.clone()));
        let mut rows = Vec::new();
        for (i, parameter) in &parameters {
            for controller in controllers {
                let cells: Vec<String> = measured
                    .scores
                    .iter()
                    .map(|score| {
                        let correlation = rank_correlation(&points(*i, controller, &score.metric.name));
                        correlation.map_or_else(|| "–".to_owned(), |correlation| format!("{correlation:+.2}"))
                    })
                    .collect();
                if cells.iter().any(|cell| cell != "–") {
                    rows.push([vec![format!("{controller}: {}", parameter.name)], cells].concat());
                }
            }
        }
        self.table(header, rows);
        for (i, parameter) in &parameters {
            let panels: Vec<ScatterPanel> = measured
                .scores
                .iter()
                .map(|score| ScatterPanel {
                    title: score.label.clone(),
                    series: controllers
                        .iter()
                        .map(|controller| Series {
                            label: (*controller).to_owned(),
                            colour: trial.colour(controller),
                            points: points(*i, controller, &score.metric.name),
                        })
                        .filter(|series| !series.points.is_empty())
                        .collect(),
                })
                .collect();
            if panels.iter().all(|panel| panel.series.is_empty()) {
                continue;
            }
            let title = format!("{name}: measured errors over {}", parameter.name);
            self.figure(&format!("{name}-over-{}", parameter.name), &title, figures::scatter(&title, &panels)?);
        }
        Ok(())
    }

    fn rest(&mut self, rows: &[RunRow]) {
        let wrong: Vec<&RunRow> = rows.iter().filter(|row| !row.verdict.is_well()).collect();
        if !wrong.is_empty() {
            self.say("## Runs that are invalid or fail");
            let cells = |row: &&RunRow| {
                vec![row.id.clone(), row.verdict.name().to_owned(), row.error.clone().unwrap_or_default()]
            };
            let listed = wrong.iter().take(LISTED).map(cells).collect();
            self.table(["run", "verdict", "why"].map(str::to_owned).into(), listed);
            if wrong.len() > LISTED {
                self.say(&format!("The first {LISTED} of {}.", wrong.len()));
            }
        }
        self.say("## The sweep's file");
        self.say(&format!("```toml\n{}\n```", self.prepared.sweep.text.trim_end()));
        // One line break at the end.
        self.text.truncate(self.text.trim_end().len());
        self.text.push('\n');
    }
}

/// A table in Markdown; all columns but the first are numbers. Columns are as wide as their widest cell.
fn markdown_table(header: Vec<String>, rows: Vec<Vec<String>>) -> String {
    let safe = |cells: Vec<String>| cells.into_iter().map(|cell| cell.replace('|', "\\|")).collect::<Vec<_>>();
    let lines: Vec<Vec<String>> = std::iter::once(header).chain(rows).map(safe).collect();
    let columns = lines[0].len();
    let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let written = |line: &Vec<String>| {
        let cells = line.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| match column {
            0 => format!("| {cell:<width$} "),
            _ => format!("| {cell:>width$} "),
        });
        cells.collect::<String>() + "|"
    };
    let rule = widths.iter().map(|width| format!("|{}", "-".repeat(width + 2))).collect::<String>() + "|";
    let mut text: Vec<String> = lines.iter().map(written).collect();
    text.insert(1, rule);
    text.join("\n")
}

/// Without repetitions, in order.
fn distinct<T: PartialEq>(items: impl Iterator<Item = T>) -> Vec<T> {
    let mut distinct = Vec::new();
    for item in items {
        if !distinct.contains(&item) {
            distinct.push(item);
        }
    }
    distinct
}

fn cell(estimate: Option<&Estimate>, score: &Score) -> String {
    let digits = score.digits;
    match estimate {
        None => "–".to_owned(),
        Some(Estimate { summary, interval: None }) => format!("{:.digits$}", summary.mean),
        Some(Estimate { summary, interval: Some(Interval { low, high }) }) => {
            format!("{:.digits$} [{low:.digits$}, {high:.digits$}]", summary.mean)
        }
    }
}

/// `+0.0212 [+0.0181, +0.0243] worse in 20 of 20`
fn told(difference: &Difference, digits: usize) -> String {
    // Differences within a pair are known better than the values themselves.
    let digits = digits + 1;
    let interval = difference
        .interval
        .map_or_else(String::new, |Interval { low, high }| format!(" [{low:+.digits$}, {high:+.digits$}]"));
    let of = difference.seeds;
    let verdict = match difference.verdict {
        DifferenceVerdict::Better => format!("**better** in {} of {of}", difference.better_seeds),
        DifferenceVerdict::Worse => format!("**worse** in {} of {of}", difference.worse_seeds),
        DifferenceVerdict::Equal => "equal".to_owned(),
        DifferenceVerdict::TooFewSeeds => format!("too few runs ({of})"),
        DifferenceVerdict::NoClearDifference | DifferenceVerdict::Different => {
            format!("no clear difference (better in {} of {of})", difference.better_seeds)
        }
    };
    format!("{:+.digits$}{interval} {verdict}", difference.mean)
}
