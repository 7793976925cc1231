//! `supertwin show`: what is in a recording, what is missing, and whether its scores are right.

use crate::terminal;
use clap::Args;
use comfy_table::ContentArrangement;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use supertwin_core::signal::tracking::QUANTITIES;
use supertwin_core::{Event, Property, Severity};
use supertwin_operations::inspect::{Inspection, RecordedScores, RecordedSignal, TickGap, inspect};
use supertwin_operations::{OperationError, shortened};
use supertwin_rerun::{Recording, read};

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

/// Reads a recording and shows what is in it.
pub(crate) fn show(arguments: &ShowArguments) -> Result<ExitCode, OperationError> {
    let recording = read(&arguments.file).map_err(|error| OperationError::Option(error.to_string()))?;
    let Inspection { signals, ticks, gaps, scores } = inspect(&recording);
    if arguments.json {
        let report = json!({
            "file": arguments.file,
            "parts": recording.parts,
            "name": recording.name,
            "complete": recording.complete,
            "damage": recording.damage.iter().map(ToString::to_string).collect::<Vec<_>>(),
            "properties": recording.properties,
            "signals": signals,
            "first_tick": ticks.map(|(first, _)| first),
            "last_tick": ticks.map(|(_, last)| last),
            "gaps": gaps,
            "events": recording.events,
            "commands": recording.commands.values().map(Vec::len).sum::<usize>(),
            "scores": scores,
        });
        terminal::print(&format!("{report:#}"));
        return Ok(ExitCode::SUCCESS);
    }
    terminal::print(&heading(&recording, ticks));
    terminal::print(&properties(&recording));
    terminal::print(&table(&signals));
    terminal::print(&format!("{}\n", gaps_text(&gaps)));
    terminal::print(&format!("{}\n", events_text(&recording)));
    terminal::print(&scores_text(&scores));
    Ok(ExitCode::SUCCESS)
}

fn heading(recording: &Recording, ticks: Option<(i64, i64)>) -> String {
    let span = match ticks {
        Some((first, last)) => format!("ticks {first} to {last}"),
        None => "no ticks".to_owned(),
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

fn table(lines: &[RecordedSignal]) -> String {
    let header = ["signal", "components", "rows", "Hz", "first [s]", "last [s]", "missing"];
    let mut table = terminal::framed_table(header);
    table.set_content_arrangement(ContentArrangement::Dynamic);
    let number =
        |value: Option<f64>, digits: usize| value.map_or_else(String::new, |value| format!("{value:.digits$}"));
    for line in lines {
        table.add_row([
            line.path.clone(),
            shortened(&line.components.join(", "), WIDEST),
            line.rows.to_string(),
            number(line.rate_hz, 2),
            number(line.first_s, 2),
            number(line.last_s, 2),
            line.missing.map_or_else(String::new, |missing| missing.to_string()),
        ]);
    }
    terminal::aligned(table, 2..)
}

fn gaps_text(gaps: &[TickGap]) -> String {
    if gaps.is_empty() {
        return "No gaps: something was recorded at every tick.".to_owned();
    }
    let ticks: i64 = gaps.iter().map(|gap| gap.to_tick - gap.from_tick + 1).sum();
    let first: Vec<String> =
        gaps.iter().take(FIRST_GAPS).map(|gap| format!("{} to {}", gap.from_tick, gap.to_tick)).collect();
    let more = if gaps.len() > FIRST_GAPS { ", …" } else { "" };
    format!("{} gaps, {ticks} ticks: {}{more}", gaps.len(), first.join(", "))
}

fn events_text(recording: &Recording) -> String {
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
        text += &format!("\n  tick {:>7}  {}: {severity}{}", event.tick, event.service, event.what);
    }
    text
}

fn scores_text(scores: &RecordedScores) -> String {
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
    let mut table = terminal::framed_table(["root-mean-square error", "measured", "true"]);
    let (measured, truth) = (again.measured.to_array(), again.truth.to_array());
    for (i, quantity) in QUANTITIES.iter().enumerate() {
        table.add_row([quantity.label(), format!("{:.3}", measured[i]), format!("{:.3}", truth[i])]);
    }
    let table = terminal::aligned(table, 1..);
    format!("Scores over {} ticks, computed from the recording: {verdict}{missing}\n{table}", scores.ticks)
}
