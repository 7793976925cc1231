//! Recorded inputs into the blocks again, as they were or with other parameters.

use crate::placement::provenance;
use crate::{OperationError, Progress};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use supertwin_core::Message;
use supertwin_core::message::{Measurements, Nav, Reference, Thrust, WrenchRequest};
use supertwin_lab::replay::closed::Closed;
use supertwin_lab::replay::{Changed, FromBlock, Messages, Replay, ReplayError, Verification, WhatIf};
use supertwin_lab::{Library, Scores, rescore};
use supertwin_protocol::decode;
use supertwin_rerun::{Options, Recording, RerunSink, read_selected};

/// How many messages of a recording can't be read, and why the first can't.
pub type RejectedMessages = (usize, String);

/// What replaces the recorded configuration.
///
/// # Errors
/// A file of the library is wrong, or a change does not concern the blocks from `from` on.
pub fn changed(
    library: &Library,
    controller: Option<&str>,
    from: Option<FromBlock>,
    closed_loop: bool,
) -> Result<Changed, OperationError> {
    Changed::new(library, controller, from, closed_loop).map_err(|error| match error {
        ReplayError::Config(error) => error.into(),
        other => OperationError::Option(other.to_string()),
    })
}

/// A recording that can be replayed.
pub struct Source {
    file: PathBuf,
    /// The recording that is replayed.
    pub recording: Recording,
}

/// A what-if, with what it is to be compared with.
pub struct Replayed<T> {
    /// What was changed.
    pub changed: Changed,
    /// The recording that was written.
    pub out: PathBuf,
    /// Whether the blocks, unchanged, repeat the recording.
    pub base: Verification,
    /// Scores of the recorded run, if it has any.
    pub original: Option<Scores>,
    /// What came of the change.
    pub result: T,
}

impl Source {
    /// Reads a recording.
    ///
    /// # Errors
    /// It can't be read, or is damaged.
    pub fn read(file: &Path) -> Result<Self, OperationError> {
        // Drawings, and curves that follow from others, are not read.
        let wanted = |path: &str| !["world", "derived"].contains(&path.split('/').next().unwrap_or_default());
        let recording = read_selected(file, &wanted).map_err(|error| OperationError::Option(error.to_string()))?;
        if let Some(damage) = recording.damage.first() {
            let more = match recording.damage.len() {
                1 => String::new(),
                n => format!(" (and {} more places)", n - 1),
            };
            let hint = format!("`supertwin repair {}` makes what is left a whole recording", file.display());
            return Err(OperationError::Option(format!("{damage}{more}; {hint}, which can be replayed")));
        }
        Ok(Self { file: file.to_owned(), recording })
    }

    /// Ready to be replayed, and how many messages can't be read, with the first reason.
    ///
    /// # Errors
    /// The recording does not have what a replay needs.
    pub fn replay(&self) -> Result<(Replay<'_>, Option<RejectedMessages>), OperationError> {
        let (messages, rejected) = messages(&self.recording);
        let replay = Replay::new(&self.recording, messages).map_err(|error| at(&self.file, error))?;
        Ok((replay, rejected))
    }

    /// Compares every state and output with the recording; with `from`, of the chain from that block on.
    ///
    /// # Errors
    /// A block can't be built or stops.
    pub fn verify(&self, replay: &Replay<'_>, from: Option<FromBlock>) -> Result<Verification, OperationError> {
        replay.verify(from).map_err(|error| at(&self.file, error))
    }

    /// Runs the changed blocks on recorded inputs, into the recording `out`.
    ///
    /// # Errors
    /// The change can't be made, or `out` can't be written.
    pub fn what_if(
        &self,
        replay: &Replay<'_>,
        changed: Changed,
        out: PathBuf,
        force: bool,
    ) -> Result<Replayed<WhatIf>, OperationError> {
        let (base, original) = self.before(replay, &changed)?;
        let result = replay.what_if(&changed, &provenance()).map_err(|error| at(&self.file, error))?;
        result.write(&mut create(&out, force)?).map_err(|error| at(&out, error))?;
        Ok(Replayed { changed, out, base, original, result })
    }

    /// Runs the whole ring, driven by the recorded disturbance, into the recording `out`. Ends early when `stop` is set.
    ///
    /// # Errors
    /// The change can't be made, the run stops, or `out` can't be written.
    pub fn closed_loop(
        &self,
        replay: &Replay<'_>,
        changed: Changed,
        out: PathBuf,
        force: bool,
        stop: &AtomicBool,
        progress: &dyn Progress,
    ) -> Result<Replayed<Closed>, OperationError> {
        let (base, original) = self.before(replay, &changed)?;
        let mut sink = create(&out, force)?;
        progress.begin("closed loop", replay.closed_ticks());
        let result = replay.closed_loop(&changed, &provenance(), &mut sink, |ticks| {
            progress.reach(ticks);
            !stop.load(Ordering::Relaxed)
        });
        progress.end();
        let result = result.map_err(|error| at(&self.file, error))?;
        Ok(Replayed { changed, out, base, original, result })
    }

    /// A what-if is worth as much as the blocks repeat what they did.
    fn before(&self, replay: &Replay<'_>, changed: &Changed) -> Result<(Verification, Option<Scores>), OperationError> {
        let base = self.verify(replay, None)?;
        let original = rescore(&self.recording).ok().map(|rescored| rescored.scores);
        // Only what can be done may take the place of a file.
        changed.apply(&replay.trial)?;
        Ok((base, original))
    }
}

/// The exact messages of a recording; how many can't be read, which is as good as not recorded, and the first reason.
fn messages(recording: &Recording) -> (Messages, Option<RejectedMessages>) {
    let mut messages = Messages::default();
    let mut rejected = Vec::new();
    read_wire::<Measurements>(recording, &mut messages, &mut rejected);
    read_wire::<Nav>(recording, &mut messages, &mut rejected);
    read_wire::<Reference>(recording, &mut messages, &mut rejected);
    read_wire::<Thrust>(recording, &mut messages, &mut rejected);
    read_wire::<WrenchRequest>(recording, &mut messages, &mut rejected);
    let n = rejected.len();
    (messages, rejected.into_iter().next().map(|first| (n, first)))
}

fn read_wire<M: Message>(recording: &Recording, messages: &mut Messages, rejected: &mut Vec<String>) {
    for message in recording.wires.get(M::KEY).map_or(&[][..], Vec::as_slice) {
        match decode::<M>(&message.bytes) {
            Ok(envelope) => messages.add(envelope.tick, &envelope.source, envelope.data),
            Err(cause) => rejected.push(format!("wire/{} at tick {}: {cause}", M::KEY, message.tick)),
        }
    }
}

/// Where the result of a replay of `file`, a run called `name`, goes: as it was asked for, or beside it.
///
/// # Errors
/// It is the recording itself, or is there and `force` is not given.
pub fn destination(
    file: &Path,
    asked_for: Option<&Path>,
    name: &str,
    kind: &str,
    force: bool,
) -> Result<PathBuf, OperationError> {
    let is_folder = |path: &Path| path.is_dir() || path.extension().is_none();
    let path = match asked_for {
        None => file.with_extension(format!("{kind}.rrd")),
        Some(folder) if is_folder(folder) => {
            std::fs::create_dir_all(folder).map_err(|cause| OperationError::at(folder, &cause))?;
            folder.join(format!("{name}-{kind}.rrd"))
        }
        Some(path) => path.to_owned(),
    };
    let same = path.canonicalize().ok().zip(file.canonicalize().ok()).is_some_and(|(out, run)| out == run);
    if same {
        return Err(OperationError::at(&path, &"is the recording itself"));
    }
    if path.exists() && !force {
        return Err(OperationError::at(&path, &"exists already; use --force to replace it, or another --out"));
    }
    Ok(path)
}

fn create(out: &Path, force: bool) -> Result<RerunSink, OperationError> {
    let options = Options { overwrite: force, ..Options::default() };
    RerunSink::create(out, options).map_err(|error| OperationError::Option(error.to_string()))
}

/// The file's name to what is wrong with it.
fn at(file: &Path, error: ReplayError) -> OperationError {
    match error {
        ReplayError::Run(cause) => OperationError::Run { name: file.display().to_string(), cause },
        ReplayError::Sink(error) => OperationError::Option(error.to_string()),
        other => OperationError::Path { path: file.display().to_string(), cause: other.to_string() },
    }
}
