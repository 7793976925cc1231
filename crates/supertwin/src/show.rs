//! `supertwin show`: what is in a recording, what is missing, and whether its scores are right.

use crate::failure::Failure;
use crate::output;
use clap::Args;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use comfy_table::{CellAlignment, ContentArrangement, Table};
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use supertwin_core::run::{Properties, Severity};
use supertwin_core::{Event, Property};
use supertwin_lab::paper::ROWS;
use supertwin_lab::{Rescored, Scores, rescore};
use supertwin_rerun::{Recording, read};

/// Arguments of `show`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin show runs/0001/paper-agsta-seed1.rrd
  supertwin show run.rrd --json                  every property, signal and event

Missing: rows between the first and the last that a signal of an even rate should have and has not.
Scores are computed again from what was recorded, and compared bit for bit with those that the run left.
Exit status: 0 shown, however little was left, 2 the file can't be read or is no recording.")]
pub(crate) struct ShowArguments {
    /// Recording; parts beside it (FILE.part2.rrd, ...) belong to it
    #[arg(value_name = "FILE")]
    file: PathBuf,

    /// Print one JSON object instead of tables
    #[arg(long)]
    json: bool,
}

/// Events that are printed, from the end.
const LAST_EVENTS: usize = 8;
/// Gaps that are printed, from the beginning.
const FIRST_GAPS: usize = 8;

/// Characters of a signal's components; all of them are in the JSON.
const WIDEST: usize = 52;

/// One signal, label or wire.
#[derive(Debug, Serialize)]
struct Line {
    path: String,
    components: Vec<String>,
    rows: usize,
    rate_hz: Option<f64>,
    first_s: Option<f64>,
    last_s: Option<f64>,
    /// Rows that an even rate would have between the first and the last; `None` where the rate is not even.
    missing: Option<u64>,
}

/// Ticks that nothing was recorded at.
#[derive(Debug, PartialEq, Serialize)]
struct Gap {
    from_tick: i64,
    to_tick: i64,
}

/// Recorded and recomputed scores.
#[derive(Debug, Serialize)]
struct Comparison {
    recorded: bool,
    recomputed: Option<Scores>,
    /// Every score of the recording has the same bits again.
    equal: Option<bool>,
    ticks: u64,
    missing_ticks: u64,
    /// Why there are none.
    problem: Option<String>,
}

/// Does it.
pub(crate) fn show(arguments: &ShowArguments) -> Result<ExitCode, Failure> {
    let recording = read(&arguments.file).map_err(|error| Failure::Call(error.to_string()))?;
    let lines = lines(&recording);
    let ticks: Vec<i64> = recording.moments().iter().map(|moment| moment.0).collect();
    let gaps = gaps(&ticks);
    let scores = compare(&recording);
    if arguments.json {
        let report = json!({
            "file": arguments.file,
            "parts": recording.parts,
            "name": recording.name,
            "complete": recording.complete,
            "damage": recording.damage.iter().map(ToString::to_string).collect::<Vec<_>>(),
            "properties": recording.properties,
            "signals": lines,
            "first_tick": ticks.first(),
            "last_tick": ticks.last(),
            "gaps": gaps,
            "events": recording.events,
            "commands": recording.commands.values().map(Vec::len).sum::<usize>(),
            "scores": scores,
        });
        output::print(&format!("{report:#}"));
        return Ok(ExitCode::SUCCESS);
    }
    output::print(&heading(&recording, &ticks));
    output::print(&properties(&recording));
    output::print(&table(&lines));
    output::print(&format!("{}\n", said_gaps(&gaps)));
    output::print(&format!("{}\n", said_events(&recording)));
    output::print(&said_scores(&scores));
    Ok(ExitCode::SUCCESS)
}

fn heading(recording: &Recording, ticks: &[i64]) -> String {
    let span = match (ticks.first(), ticks.last()) {
        (Some(first), Some(last)) => format!("ticks {first} to {last}"),
        _ => "no ticks".to_owned(),
    };
    let parts = if recording.parts > 1 { format!(", {} parts", recording.parts) } else { String::new() };
    let whole = if recording.complete { "complete" } else { "incomplete" };
    let mut text = format!("{}: {whole}, {span}{parts}", recording.name);
    for damage in &recording.damage {
        text += &format!("\n  {damage}");
    }
    if !recording.complete {
        text += "\n  `supertwin repair` makes such a file whole.";
    }
    text
}

fn properties(recording: &Recording) -> String {
    let mut text = String::new();
    for (group, properties) in &recording.properties {
        // Scores have their own table, and a configuration is a book of its own.
        let short = properties.iter().filter(|(name, _)| !name.contains('.') && *name != "config");
        let short: Vec<String> = short.map(|(name, value)| format!("{name} = {}", plain(value))).collect();
        text += &format!("{group}: {}\n", short.join(", "));
    }
    text
}

fn plain(value: &Property) -> String {
    match value {
        Property::Integer(n) => n.to_string(),
        Property::Number(x) => x.to_string(),
        Property::Text(text) => text.lines().next().unwrap_or_default().to_owned(),
    }
}

fn lines(recording: &Recording) -> Vec<Line> {
    let mut lines = Vec::new();
    let seconds = |nanos: Option<&i64>| nanos.map(|nanos| *nanos as f64 / 1e9);
    for (path, columns) in &recording.signals {
        lines.push(Line {
            path: path.clone(),
            components: columns.names.clone(),
            rows: columns.tick.len(),
            rate_hz: rate(&columns.time_ns),
            first_s: seconds(columns.time_ns.first()),
            last_s: seconds(columns.time_ns.last()),
            missing: missing(&columns.tick),
        });
    }
    let texts = |path: String, rows: usize, first: Option<&i64>, last: Option<&i64>| Line {
        path,
        components: Vec::new(),
        rows,
        rate_hz: None,
        first_s: seconds(first),
        last_s: seconds(last),
        missing: None,
    };
    for (path, changes) in &recording.labels {
        let (first, last) =
            (changes.first().map(|change| &change.time_ns), changes.last().map(|change| &change.time_ns));
        lines.push(texts(path.clone(), changes.len(), first, last));
    }
    for (key, messages) in &recording.wires {
        let ticks: Vec<i64> = messages.iter().map(|message| message.tick).collect();
        let times: Vec<i64> = messages.iter().map(|message| message.time_ns).collect();
        let line = texts(format!("wire/{key}"), messages.len(), times.first(), times.last());
        lines.push(Line { rate_hz: rate(&times), missing: missing(&ticks), ..line });
    }
    lines.sort_by(|a, b| a.path.cmp(&b.path));
    lines
}

fn rate(time_ns: &[i64]) -> Option<f64> {
    let span_s = (time_ns.last()? - time_ns.first()?) as f64 / 1e9;
    (span_s > 0.0).then(|| (time_ns.len() - 1) as f64 / span_s)
}

/// The usual distance between rows, when nine of ten have it.
fn stride(ticks: &[i64]) -> Option<i64> {
    let mut counts = BTreeMap::<i64, usize>::new();
    ticks.windows(2).for_each(|pair| *counts.entry(pair[1].saturating_sub(pair[0])).or_default() += 1);
    let (stride, count) = counts.into_iter().max_by_key(|(_, count)| *count)?;
    (stride > 0 && 10 * count >= 9 * (ticks.len() - 1)).then_some(stride)
}

fn missing(ticks: &[i64]) -> Option<u64> {
    let stride = stride(ticks)?;
    let between = |pair: &[i64]| (pair[1].saturating_sub(pair[0]) / stride - 1).max(0) as u64;
    Some(ticks.windows(2).map(between).sum())
}

fn gaps(ticks: &[i64]) -> Vec<Gap> {
    let stride = stride(ticks).unwrap_or(1);
    let wide = ticks.windows(2).filter(|pair| pair[1].saturating_sub(pair[0]) > stride);
    wide.map(|pair| Gap { from_tick: pair[0] + stride, to_tick: pair[1] - stride }).collect()
}

fn table(lines: &[Line]) -> String {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED).set_content_arrangement(ContentArrangement::Dynamic);
    table.set_header(["signal", "components", "rows", "Hz", "first [s]", "last [s]", "missing"]);
    let number =
        |value: Option<f64>, digits: usize| value.map_or_else(String::new, |value| format!("{value:.digits$}"));
    for line in lines {
        table.add_row([
            line.path.clone(),
            shortened(&line.components.join(", ")),
            line.rows.to_string(),
            number(line.rate_hz, 2),
            number(line.first_s, 2),
            number(line.last_s, 2),
            line.missing.map_or_else(String::new, |missing| missing.to_string()),
        ]);
    }
    for column in table.column_iter_mut().skip(2) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table.to_string()
}

fn shortened(text: &str) -> String {
    if text.chars().count() <= WIDEST {
        return text.to_owned();
    }
    text.chars().take(WIDEST - 1).chain(['…']).collect()
}

fn said_gaps(gaps: &[Gap]) -> String {
    if gaps.is_empty() {
        return "No gaps: something was recorded at every tick.".to_owned();
    }
    let ticks: i64 = gaps.iter().map(|gap| gap.to_tick - gap.from_tick + 1).sum();
    let first: Vec<String> =
        gaps.iter().take(FIRST_GAPS).map(|gap| format!("{} to {}", gap.from_tick, gap.to_tick)).collect();
    let more = if gaps.len() > FIRST_GAPS { ", …" } else { "" };
    format!("{} gaps, {ticks} ticks: {}{more}", gaps.len(), first.join(", "))
}

fn said_events(recording: &Recording) -> String {
    let events = &recording.events;
    let count = |severity| events.iter().filter(|event: &&Event| event.severity == severity).count();
    let mut text = format!(
        "Events: {} errors, {} warnings, {} as planned",
        count(Severity::Error),
        count(Severity::Warning),
        count(Severity::Info)
    );
    for event in &events[events.len().saturating_sub(LAST_EVENTS)..] {
        let severity = match event.severity {
            Severity::Info => "",
            Severity::Warning => "warning: ",
            Severity::Error => "error: ",
        };
        text += &format!("\n  tick {:>7}  {}: {severity}{}", event.tick, event.service, event.text);
    }
    text
}

fn compare(recording: &Recording) -> Comparison {
    let empty = Properties::new();
    let result = recording.properties.get("result").unwrap_or(&empty);
    let recorded = result.keys().any(|name| name.starts_with("measured."));
    match rescore(recording) {
        Ok(Rescored { scores, ticks, missing }) => {
            let bits = |value: &Property| match value {
                Property::Number(x) => Some(x.to_bits()),
                _ => None,
            };
            let again = scores.properties();
            let same = |(name, value): (&String, &Property)| result.get(name).and_then(bits) == bits(value);
            let equal = recorded.then(|| again.iter().all(same));
            Comparison { recorded, recomputed: Some(scores), equal, ticks, missing_ticks: missing, problem: None }
        }
        Err(error) => {
            let problem = Some(error.to_string());
            Comparison { recorded, recomputed: None, equal: None, ticks: 0, missing_ticks: 0, problem }
        }
    }
}

fn said_scores(scores: &Comparison) -> String {
    let Some(again) = &scores.recomputed else {
        return format!("Scores: none; {}", scores.problem.as_deref().unwrap_or_default());
    };
    let verdict = match scores.equal {
        Some(true) => "equal to the run's own in every bit",
        Some(false) => "NOT those that the run left in its properties",
        None => "the run left none to compare with",
    };
    let missing = match scores.missing_ticks {
        0 => String::new(),
        missing => format!(", {missing} ticks of the window are missing"),
    };
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(["root-mean-square error", "measured", "true"]);
    let (measured, truth) = (again.measured.to_array(), again.truth.to_array());
    for (i, row) in ROWS.iter().enumerate() {
        table.add_row([(*row).to_owned(), format!("{:.3}", measured[i]), format!("{:.3}", truth[i])]);
    }
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    format!("Scores over {} ticks, computed from the recording: {verdict}{missing}\n{table}", scores.ticks)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_told_from_a_slower_rate() {
        let every: Vec<i64> = (0..100).filter(|tick| !(40..43).contains(tick)).collect();
        assert_eq!((missing(&every), gaps(&every)), (Some(3), vec![Gap { from_tick: 40, to_tick: 42 }]));
        let fifth: Vec<i64> = (0..100).step_by(5).collect();
        assert_eq!((missing(&fifth), gaps(&fifth)), (Some(0), vec![]));
        // Pings come when they come.
        assert_eq!(missing(&[0, 6, 12, 19, 25, 31, 38]), None);
        assert_eq!((missing(&[7]), missing(&[])), (None, None));
    }
}
