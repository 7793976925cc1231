//! `supertwin replay`: recorded inputs into the blocks again, as they were or with other parameters.

use crate::terminal::{self, Bar, INTERRUPTED};
use clap::{Args, ValueEnum};
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use supertwin_core::axes::AXIS_NAMES;
use supertwin_core::signal::tracking::QUANTITIES;
use supertwin_lab::replay::closed::Closed;
use supertwin_lab::replay::{BlockVerdict, Changed, FromBlock, Verification, WhatIf};
use supertwin_lab::{Library, Scores};
use supertwin_operations::OperationError;
use supertwin_operations::replay::{self, Replayed, Source};
use supertwin_rerun::Recording;

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin replay run.rrd --verify              every block again on its recorded inputs: the same bits?
  supertwin replay run.rrd --controller agsta    what would the adaptive law have commanded? -> run.replay.rrd
  supertwin replay run.rrd --set estimator.measurement.dvl.std=0.02
  supertwin replay run.rrd --from guidance --set guidance.lookahead_m=3 --out what-if.rrd
  supertwin replay run.rrd --controller pid-tuned --closed-loop

Open loop (without --closed-loop): the blocks from --from on run anew on recorded inputs, and the VEHICLE DOES NOT REACT:
what the new controller commands is shown, where it would have led is not. The estimator goes on hearing the recorded
thrust, which is what moved the vehicle that was measured. A law that integrates or adapts winds up against a vehicle
that does not answer: look at its first reaction, not at its level.
Closed loop: the whole ring runs anew. The plant has the estimator's nominal model and is driven by the disturbance that
the estimator found (estimator/nav/disturbance), fixed in space and time, in the place of current, waves and tether. Good
near the recorded motion; a vehicle elsewhere would have met another disturbance, and of waves only what the filter
could follow is left.
The result is a recording like any other, for `show`, `compare` and the viewer.

--verify: each block from its recorded inputs, restarts and commands included; with --from, the chain from that block on.
Of a recording in real time every process that began is replayed from its own start, by the exact messages that it used.
Where messages are missing in the recording, it says from which to which tick the replay is not exact, and goes on.
Exit status: 0 done, or the same bits; 1 --verify: not the same bits, or nothing of a block could be compared; 2 the call
or the recording is wrong; 130 interrupted.")]
pub(crate) struct ReplayArguments {
    /// Recording; parts beside it (FILE.part2.rrd, ...) belong to it
    #[arg(value_name = "RUN")]
    pub(crate) file: PathBuf,

    /// First block that runs anew [default: the first that a change concerns]
    #[arg(long, value_enum)]
    pub(crate) from: Option<FromArgument>,

    /// Another controller: a name in config/controllers, or a path
    #[arg(long, value_name = "FILE")]
    pub(crate) controller: Option<String>,

    /// Compare every state and output with the recording, bit for bit; nothing is written
    #[arg(long, conflicts_with_all = ["controller", "closed_loop", "out", "force"])]
    pub(crate) verify: bool,

    /// Let the vehicle react: the plant twin driven by the recorded disturbance
    #[arg(long, conflicts_with = "from")]
    pub(crate) closed_loop: bool,

    /// The written recording, or a folder for it [default: beside RUN, as RUN.replay.rrd or RUN.closed-loop.rrd]
    #[arg(long, value_name = "FILE|DIR")]
    pub(crate) out: Option<PathBuf>,

    /// Replace a file that exists
    #[arg(long)]
    pub(crate) force: bool,

    /// Print one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}

/// Where a replay begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum FromArgument {
    /// Estimator, guidance and controller anew; measurements as recorded
    Estimator,
    /// Guidance and controller anew; navigation as recorded
    Guidance,
    /// The controller anew; navigation and references as recorded
    Controller,
}

impl FromArgument {
    fn block(self) -> FromBlock {
        match self {
            Self::Estimator => FromBlock::Estimator,
            Self::Guidance => FromBlock::Guidance,
            Self::Controller => FromBlock::Controller,
        }
    }
}

/// Verifies, or replays into another recording.
pub(crate) fn replay(arguments: &ReplayArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let from = arguments.from.map(FromArgument::block);
    if let Some(over) = library.overrides.first().filter(|_| arguments.verify) {
        let text = format!("--set {} cannot be used with --verify: nothing is changed there", over.text);
        return Err(OperationError::Option(text));
    }
    let changed = replay::changed(library, arguments.controller.as_deref(), from, arguments.closed_loop)?;
    let source = Source::read(&arguments.file)?;
    let (replay, rejected) = source.replay()?;
    if let Some((n, first)) = rejected {
        terminal::warn(&format!("warning: {n} messages can't be read; the first: {first}"));
    }
    if arguments.verify {
        return Ok(verified(arguments, &source.verify(&replay, from)?, from));
    }
    let kind = if arguments.closed_loop { "closed-loop" } else { "replay" };
    let name = &source.recording.name;
    let out = replay::destination(&arguments.file, arguments.out.as_deref(), name, kind, arguments.force)?;
    if arguments.closed_loop {
        let stop = terminal::stop_flag(|| {})?;
        let bar = Bar::new(arguments.json);
        let done = source.closed_loop(&replay, changed, out, arguments.force, &stop, &bar)?;
        let interrupted = stop.load(Ordering::Relaxed) && !done.result.outcome.complete;
        closed_loop(arguments, &done, interrupted);
        return Ok(if interrupted { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS });
    }
    what_if(arguments, &source.recording, &source.what_if(&replay, changed, out, arguments.force)?);
    Ok(ExitCode::SUCCESS)
}

fn what_if(arguments: &ReplayArguments, recording: &Recording, done: &Replayed<WhatIf>) {
    let Replayed { changed, out, base, original, result: what_if } = done;
    let scores = what_if.scores.as_ref().map(|rescored| &rescored.scores);
    let differs = what_if.wrench_difference(recording);
    if arguments.json {
        let report = json!({
            "replay_of": recording.name,
            "file": arguments.file,
            "out": out,
            "from": changed.from.name(),
            "closed_loop": false,
            "changed": changed.words,
            "unchanged": base,
            "blocks": what_if.blocks,
            "refused": what_if.refused,
            "scores": { "original": original, "replay": scores.ok() },
            "not_scored": scores.err(),
            "largest_difference_of_the_requested_wrench": differs,
        });
        return terminal::print(&format!("{report:#}"));
    }
    say_base(base);
    terminal::print(&format!(
        "{}, from {} on, OPEN LOOP: the vehicle does not react to what is commanded here.",
        what(changed),
        changed.from.name()
    ));
    say_inexact(&what_if.blocks);
    for event in &what_if.refused {
        terminal::warn(&format!("warning: tick {}: {}: {}", event.tick, event.service, event.what));
    }
    match (original, scores) {
        (Some(original), Ok(scores)) => terminal::print(&table(original, scores)),
        (_, Err(why)) => terminal::print(&format!("No scores: {why}")),
        (None, Ok(_)) => {}
    }
    let axes: Vec<String> = AXIS_NAMES
        .iter()
        .zip(differs)
        .zip(["N", "N", "N", "N m"])
        .map(|((axis, most), unit)| format!("{axis} {most:.2} {unit}"))
        .collect();
    terminal::print(&format!("Largest difference of the requested wrench: {}.", axes.join(", ")));
    terminal::print(&format!("Written to {}", out.display()));
}

fn verified(arguments: &ReplayArguments, done: &Verification, from: Option<FromBlock>) -> ExitCode {
    let status = if done.equal { ExitCode::SUCCESS } else { ExitCode::from(1) };
    if arguments.json {
        let report = json!({ "file": arguments.file, "from": from.map(FromBlock::name), "verification": done });
        terminal::print(&report.to_string());
        return status;
    }
    let mut table = terminal::framed_table(["block", "starts", "steps", "compared", "bits"]);
    for block in &done.blocks {
        let bits = match &block.difference {
            Some(difference) => format!("differ from tick {} on", difference.tick),
            None if block.compared == 0 => "not compared".to_owned(),
            None => "equal".to_owned(),
        };
        table.add_row([
            block.service.to_owned(),
            block.instances.to_string(),
            block.steps.to_string(),
            block.compared.to_string(),
            bits,
        ]);
    }
    terminal::print(&terminal::aligned(table, 1..4));
    say_inexact(&done.blocks);
    if done.hash == Some(true) {
        terminal::print("The hash over all blocks and ticks is that of the run.");
    }
    if let Some(first) = &done.first {
        terminal::print(&format!("First difference: {first}"));
    } else if done.equal {
        terminal::print("Every state and every output that was compared has the recorded bits.");
    } else {
        terminal::print("Nothing differs, but of some blocks nothing could be compared.");
    }
    status
}

fn closed_loop(arguments: &ReplayArguments, done: &Replayed<Closed>, interrupted: bool) {
    let Replayed { changed, out, base, original, result: closed } = done;
    let outcome = &closed.outcome;
    if arguments.json {
        let report = json!({
            "file": arguments.file,
            "out": out,
            "closed_loop": true,
            "changed": changed.words,
            "unchanged": base,
            "hash": outcome.digest.to_string(),
            "ticks": outcome.ticks,
            "complete": outcome.complete,
            "refused": outcome.refused,
            "disturbance_held_ticks": closed.held,
            "scores": { "original": original, "replay": outcome.scores },
        });
        return terminal::print(&format!("{report:#}"));
    }
    say_base(base);
    terminal::print(&format!(
        "{}, CLOSED LOOP: the plant has the nominal model and is driven by the recorded disturbance.",
        what(changed)
    ));
    if closed.held > 0 {
        terminal::warn(&format!(
            "warning: at {} of {} ticks no disturbance was recorded; the last one went on",
            closed.held, outcome.ticks
        ));
    }
    for event in &outcome.refused {
        terminal::warn(&format!("warning: tick {}: {}", event.tick, event.what));
    }
    if let Some(original) = original {
        terminal::print(&table(original, &outcome.scores));
    }
    if interrupted {
        terminal::warn("interrupted; the recording is closed and readable");
    }
    terminal::print(&format!("Written to {}", out.display()));
}

fn what(changed: &Changed) -> String {
    if changed.is_nothing() { "With nothing changed".to_owned() } else { format!("With {}", changed.words.join(", ")) }
}

fn say_base(base: &Verification) {
    match &base.first {
        Some(first) => terminal::warn(&format!("warning: unchanged, the blocks do not repeat the recording: {first}")),
        None if base.equal => terminal::print("Unchanged, every block repeats the recording in every bit."),
        None => terminal::warn("warning: unchanged, not every block could be compared with the recording"),
    }
}

fn say_inexact(blocks: &[BlockVerdict]) {
    for block in blocks {
        for gap in &block.inexact {
            terminal::warn(&format!(
                "warning: {}: not exact from tick {} to {}: {}",
                block.service, gap.from_tick, gap.to_tick, gap.why
            ));
        }
    }
}

/// The original's scores beside those of the replay.
fn table(original: &Scores, replay: &Scores) -> String {
    let mut table = terminal::framed_table(["", "recorded", "replay"]);
    let mut row = |name: String, digits: usize, value: &dyn Fn(&Scores) -> f64| {
        table.add_row([name, format!("{:.digits$}", value(original)), format!("{:.digits$}", value(replay))]);
    };
    for (i, quantity) in QUANTITIES.iter().enumerate() {
        row(format!("{}, measured", quantity.label()), 3, &|scores| scores.measured.to_array()[i]);
    }
    for (i, quantity) in QUANTITIES.iter().enumerate() {
        row(format!("{}, true", quantity.label()), 3, &|scores| scores.truth.to_array()[i]);
    }
    for (i, axis) in AXIS_NAMES.iter().enumerate() {
        let unit = if i == 3 { "N m" } else { "N" };
        row(format!("Effort {axis} [{unit}]"), 2, &|scores| scores.effort.to_array()[i]);
    }
    for (i, axis) in AXIS_NAMES.iter().enumerate() {
        let unit = if i == 3 { "N m/s" } else { "N/s" };
        row(format!("Chattering {axis} [{unit}]"), 2, &|scores| scores.chattering.to_array()[i]);
    }
    terminal::aligned(table, 1..)
}
