//! `supertwin replay`: recorded inputs into the blocks again, as they were or with other parameters.

use crate::failure::{Failure, INTERRUPTED};
use crate::output;
use crate::placement::provenance;
use clap::{Args, ValueEnum};
use comfy_table::presets::UTF8_FULL_CONDENSED;
use comfy_table::{CellAlignment, ContentArrangement, Table};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use supertwin_core::Message;
use supertwin_core::axes::AXIS_NAMES;
use supertwin_core::message::{Measurements, Nav, Reference, Thrust, WrenchRequest};
use supertwin_lab::paper::ROWS;
use supertwin_lab::replay::{BlockVerdict, Changed, FromBlock, Messages, Replay, ReplayError, Verification};
use supertwin_lab::{Library, Scores, rescore};
use supertwin_protocol::decode;
use supertwin_rerun::{Options, Recording, RerunSink, read_selected};

/// Arguments of `replay`.
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

/// Does it.
pub(crate) fn replay(arguments: &ReplayArguments, library: &Library) -> Result<ExitCode, Failure> {
    let from = arguments.from.map(FromArgument::block);
    if let Some(over) = library.overrides().first().filter(|_| arguments.verify) {
        let over = &over.text;
        return Err(Failure::Call(format!("--set {over} cannot be used with --verify: nothing is changed there")));
    }
    let changed =
        Changed::new(library, arguments.controller.as_deref(), from, arguments.closed_loop).map_err(failure)?;
    let file = &arguments.file;
    // Drawings, and curves that follow from others, are not read.
    let wanted = |path: &str| !["world", "derived"].contains(&path.split('/').next().unwrap_or_default());
    let recording = read_selected(file, &wanted).map_err(|error| Failure::Call(error.to_string()))?;
    if let Some(damage) = recording.damage.first() {
        let more = match recording.damage.len() {
            1 => String::new(),
            n => format!(" (and {} more places)", n - 1),
        };
        let hint = format!("`supertwin repair {}` makes what is left a whole recording", file.display());
        return Err(Failure::Call(format!("{damage}{more}; {hint}, which can be replayed")));
    }
    let replay = Replay::new(&recording, messages(&recording)).map_err(|error| at(file, error))?;
    if arguments.verify {
        return verify(arguments, &replay, from).map_err(|error| at(file, error));
    }
    let kind = if arguments.closed_loop { "closed-loop" } else { "replay" };
    let out = out(arguments, &recording.name, kind)?;
    // A what-if is worth as much as the blocks repeat what they did.
    let base = replay.verify(None).map_err(|error| at(file, error))?;
    let original = rescore(&recording).ok().map(|rescored| rescored.scores);
    // Only what can be done may take the place of a file.
    changed.apply(replay.trial())?;
    if arguments.closed_loop {
        let sink = create(arguments, &out)?;
        return closed_loop(arguments, &replay, &changed, &base, original.as_ref(), sink, &out);
    }
    let what_if = replay.what_if(&changed, &provenance()).map_err(|error| at(file, error))?;
    what_if.write(&mut create(arguments, &out)?).map_err(|error| at(&out, error))?;
    let scores = what_if.scores.as_ref().map(|rescored| &rescored.scores);
    let differs = what_if.wrench_difference(&recording);
    if arguments.json {
        let report = json!({
            "replay_of": recording.name,
            "file": file,
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
        output::print(&pretty(&report)?);
        return Ok(ExitCode::SUCCESS);
    }
    say_base(&base);
    output::print(&format!(
        "{}, from {} on, OPEN LOOP: the vehicle does not react to what is commanded here.",
        what(&changed),
        changed.from.name()
    ));
    say_inexact(&what_if.blocks);
    for event in &what_if.refused {
        output::warn(&format!("warning: tick {}: {}: {}", event.tick, event.service, event.text));
    }
    match (&original, scores) {
        (Some(original), Ok(scores)) => output::print(&table(original, scores)),
        (_, Err(why)) => output::print(&format!("No scores: {why}")),
        (None, Ok(_)) => {}
    }
    let axes: Vec<String> = AXIS_NAMES
        .iter()
        .zip(differs)
        .zip(["N", "N", "N", "N m"])
        .map(|((axis, most), unit)| format!("{axis} {most:.2} {unit}"))
        .collect();
    output::print(&format!("Largest difference of the requested wrench: {}.", axes.join(", ")));
    output::print(&format!("Written to {}", out.display()));
    Ok(ExitCode::SUCCESS)
}

fn verify(
    arguments: &ReplayArguments,
    replay: &Replay<'_, Recording>,
    from: Option<FromBlock>,
) -> Result<ExitCode, ReplayError> {
    let done = replay.verify(from)?;
    let status = if done.equal { ExitCode::SUCCESS } else { ExitCode::from(1) };
    if arguments.json {
        let report = json!({ "file": arguments.file, "from": from.map(FromBlock::name), "verification": done });
        output::print(&report.to_string());
        return Ok(status);
    }
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(["block", "starts", "steps", "compared", "bits"]);
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
    for column in table.column_iter_mut().skip(1).take(3) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    output::print(&table.to_string());
    say_inexact(&done.blocks);
    if done.hash == Some(true) {
        output::print("The hash over all blocks and ticks is that of the run.");
    }
    if let Some(first) = &done.first {
        output::print(&format!("First difference: {first}"));
    } else if done.equal {
        output::print("Every state and every output that was compared has the recorded bits.");
    } else {
        output::print("Nothing differs, but of some blocks nothing could be compared.");
    }
    Ok(status)
}

fn closed_loop(
    arguments: &ReplayArguments,
    replay: &Replay<'_, Recording>,
    changed: &Changed,
    base: &Verification,
    original: Option<&Scores>,
    mut sink: RerunSink,
    out: &Path,
) -> Result<ExitCode, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))
        .map_err(|cause| Failure::Call(format!("Ctrl-C can't be caught: {cause}")))?;
    let progress = output::progress("closed loop", replay.closed_ticks(), arguments.json);
    let closed = replay
        .closed_loop(changed, &provenance(), &mut sink, |ticks| {
            progress.set_position(ticks);
            !stop.load(Ordering::Relaxed)
        })
        .map_err(|error| at(&arguments.file, error))?;
    progress.finish_and_clear();
    let outcome = &closed.outcome;
    let interrupted = stop.load(Ordering::Relaxed) && !outcome.complete;
    let status = if interrupted { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS };
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
        output::print(&pretty(&report)?);
        return Ok(status);
    }
    say_base(base);
    output::print(&format!(
        "{}, CLOSED LOOP: the plant has the nominal model and is driven by the recorded disturbance.",
        what(changed)
    ));
    if closed.held > 0 {
        output::warn(&format!(
            "warning: at {} of {} ticks no disturbance was recorded; the last one went on",
            closed.held, outcome.ticks
        ));
    }
    for event in &outcome.refused {
        output::warn(&format!("warning: tick {}: {}", event.tick, event.text));
    }
    if let Some(original) = original {
        output::print(&table(original, &outcome.scores));
    }
    if interrupted {
        output::warn("interrupted; the recording is closed and readable");
    }
    output::print(&format!("Written to {}", out.display()));
    Ok(status)
}

/// The exact messages of a recording; what can't be read is as good as not recorded, and said.
fn messages(recording: &Recording) -> Messages {
    let mut messages = Messages::default();
    let mut rejected = Vec::new();
    read_wire::<Measurements>(recording, &mut messages, &mut rejected);
    read_wire::<Nav>(recording, &mut messages, &mut rejected);
    read_wire::<Reference>(recording, &mut messages, &mut rejected);
    read_wire::<Thrust>(recording, &mut messages, &mut rejected);
    read_wire::<WrenchRequest>(recording, &mut messages, &mut rejected);
    if let Some(first) = rejected.first() {
        output::warn(&format!("warning: {} messages can't be read; the first: {first}", rejected.len()));
    }
    messages
}

fn read_wire<M: Message>(recording: &Recording, messages: &mut Messages, rejected: &mut Vec<String>) {
    for message in recording.wires.get(M::KEY).map_or(&[][..], Vec::as_slice) {
        match decode::<M>(&message.bytes) {
            Ok(envelope) => messages.add(envelope.tick, &envelope.source, envelope.data),
            Err(cause) => rejected.push(format!("wire/{} at tick {}: {cause}", M::KEY, message.tick)),
        }
    }
}

/// Where the result goes.
fn out(arguments: &ReplayArguments, name: &str, kind: &str) -> Result<PathBuf, Failure> {
    let file = &arguments.file;
    let is_folder = |path: &Path| path.is_dir() || path.extension().is_none();
    let path = match &arguments.out {
        None => file.with_extension(format!("{kind}.rrd")),
        Some(folder) if is_folder(folder) => {
            std::fs::create_dir_all(folder)
                .map_err(|cause| Failure::Path { path: folder.display().to_string(), cause: cause.to_string() })?;
            folder.join(format!("{name}-{kind}.rrd"))
        }
        Some(path) => path.clone(),
    };
    let same = path.canonicalize().ok().zip(file.canonicalize().ok()).is_some_and(|(out, run)| out == run);
    if same {
        return Err(Failure::Path { path: path.display().to_string(), cause: "is the recording itself".to_owned() });
    }
    if path.exists() && !arguments.force {
        return Err(Failure::Path {
            path: path.display().to_string(),
            cause: "exists already; use --force to replace it, or another --out".to_owned(),
        });
    }
    Ok(path)
}

fn create(arguments: &ReplayArguments, out: &Path) -> Result<RerunSink, Failure> {
    let options = Options { overwrite: arguments.force, ..Options::default() };
    RerunSink::create(out, options).map_err(|error| Failure::Call(error.to_string()))
}

fn what(changed: &Changed) -> String {
    if changed.is_nothing() { "With nothing changed".to_owned() } else { format!("With {}", changed.words.join(", ")) }
}

fn say_base(base: &Verification) {
    match &base.first {
        Some(first) => output::warn(&format!("warning: unchanged, the blocks do not repeat the recording: {first}")),
        None if base.equal => output::print("Unchanged, every block repeats the recording in every bit."),
        None => output::warn("warning: unchanged, not every block could be compared with the recording"),
    }
}

fn say_inexact(blocks: &[BlockVerdict]) {
    for block in blocks {
        for gap in &block.inexact {
            output::warn(&format!(
                "warning: {}: not exact from tick {} to {}: {}",
                block.service, gap.from_tick, gap.to_tick, gap.why
            ));
        }
    }
}

/// The original's scores beside those of the replay.
fn table(original: &Scores, replay: &Scores) -> String {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(["", "recorded", "replay"]);
    let mut row = |name: String, digits: usize, value: &dyn Fn(&Scores) -> f64| {
        table.add_row([name, format!("{:.digits$}", value(original)), format!("{:.digits$}", value(replay))]);
    };
    for (i, name) in ROWS.iter().enumerate() {
        row(format!("{name}, measured"), 3, &|scores| scores.measured.to_array()[i]);
    }
    for (i, name) in ROWS.iter().enumerate() {
        row(format!("{name}, true"), 3, &|scores| scores.truth.to_array()[i]);
    }
    for (i, axis) in AXIS_NAMES.iter().enumerate() {
        let unit = if i == 3 { "N m" } else { "N" };
        row(format!("Effort {axis} [{unit}]"), 2, &|scores| scores.effort.to_array()[i]);
    }
    for (i, axis) in AXIS_NAMES.iter().enumerate() {
        let unit = if i == 3 { "N m/s" } else { "N/s" };
        row(format!("Chattering {axis} [{unit}]"), 2, &|scores| scores.chattering.to_array()[i]);
    }
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table.to_string()
}

fn pretty(report: &Value) -> Result<String, Failure> {
    serde_json::to_string_pretty(report)
        .map_err(|cause| Failure::Call(format!("the report can't be written as JSON: {cause}")))
}

fn failure(error: ReplayError) -> Failure {
    match error {
        ReplayError::Config(error) => error.into(),
        other => Failure::Call(other.to_string()),
    }
}

/// The file's name to what is wrong with it.
fn at(file: &Path, error: ReplayError) -> Failure {
    match error {
        ReplayError::Run(cause) => Failure::Run { name: file.display().to_string(), cause },
        ReplayError::Sink(error) => Failure::Call(error.to_string()),
        other => Failure::Path { path: file.display().to_string(), cause: other.to_string() },
    }
}
