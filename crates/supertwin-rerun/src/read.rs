//! A recording back as numbers.
//!
//! Whatever can be read is read: a file that a killed process or a full disk left behind up to its end, a damaged one
//! around the damage. What is missing is named in [`Recording::damage`].

use crate::chunk_rows::{add_rows, labels, property, strings, wired};
use crate::event;
use crate::frames::{Foreign, Frames, Piece, quietly};
use crate::{APPLICATION, COMPARISON};
use rerun::external::arrow::array::ListArray;
use rerun::log::Chunk;
use rerun::{ComponentIdentifier, StoreId, StoreKind};
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::ops::{Deref, Range};
use std::path::{Path, PathBuf};
use supertwin_core::run::FORMAT;
pub use supertwin_core::source::{Columns, Label, WireMessage};
use supertwin_core::{Property, RecordedRun};

/// Component of `wire/<key>` that holds the bytes of a message.
pub const BYTES: &str = "bytes";

/// What was recorded.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// The run, as far as it is there.
    pub run: RecordedRun,
    /// How many rows every entity has, drawings included; of those that were read.
    pub rows: BTreeMap<String, usize>,
    /// The file was closed properly and nothing is missing.
    pub complete: bool,
    /// What is missing, in the order of the file.
    pub damage: Vec<Damage>,
    /// Files that it consists of.
    pub parts: usize,
}

/// Something in a file that is missing or can't be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Path of the file as it was given.
    pub path: PathBuf,
    /// Where in the file.
    pub from: u64,
    /// Over how many bytes; 0 when it is known that something is missing and not how much.
    pub bytes: u64,
    /// What is wrong.
    pub problem: String,
}

impl std::fmt::Display for Damage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: byte {}", self.path.display(), self.from)?;
        if self.bytes > 0 {
            write!(f, ", {} bytes", self.bytes)?;
        }
        write!(f, ": {}", self.problem)
    }
}

/// A recording can't be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file can't be read at all.
    #[error("{}: {error}", path.display())]
    File {
        /// Path of the file as it was given.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// There is not even the beginning of a recording.
    #[error("{}: the file is empty, or ends before a recording begins", path.display())]
    Empty {
        /// Path of the file as it was given.
        path: PathBuf,
    },
    /// The file is something else: no recording, one of another program, or of a later version of this one.
    #[error("{}: {problem}", path.display())]
    Foreign {
        /// Path of the file as it was given.
        path: PathBuf,
        /// What there is instead.
        problem: String,
    },
    /// Several runs side by side.
    #[error("{}: a comparison, not a recording of a run; open it with `rerun {}`", path.display(), path.display())]
    Comparison {
        /// Path of the file as it was given.
        path: PathBuf,
    },
}

/// Reads the recording at `path`, as much of it as there is, with the further parts that lie beside it.
///
/// # Errors
/// When the file can't be read, or is no recording of this program.
pub fn read(path: &Path) -> Result<Recording, ReadError> {
    read_parts(&parts(path)?, &|_| true)
}

/// Reads the properties, and of everything else what is `wanted` by its path, such as `controller/sigma` or
/// `event/guidance`. Of a file that was closed only these parts are read.
///
/// # Errors
/// As [`read`].
pub fn read_selected(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<Recording, ReadError> {
    read_parts(&parts(path)?, wanted)
}

/// Reads a recording that was written in several parts, given in their order.
///
/// # Errors
/// As [`read`].
pub fn read_parts(paths: &[PathBuf], wanted: &dyn Fn(&str) -> bool) -> Result<Recording, ReadError> {
    read_and_keep(paths, wanted, &|_| false).map(|(recording, _)| recording)
}

/// Reads a recording, and of what is to be kept also the pieces as they stand in the file, in their order.
pub(crate) fn read_and_keep(
    paths: &[PathBuf],
    wanted: &dyn Fn(&str) -> bool,
    kept: &dyn Fn(&str) -> bool,
) -> Result<(Recording, Vec<Chunk>), ReadError> {
    let mut reader = Reader { wanted, kept, stores: Vec::new(), damage: Vec::new() };
    for path in paths {
        reader.part(path)?;
    }
    let (mut recording, chunks) = reader.run(paths)?;
    recording.parts = paths.len();
    for (number, path) in paths.iter().enumerate().skip(1) {
        if part_number(path).is_some_and(|(_, found)| found != number as u64 + 1) {
            let problem = format!("part {} is not there", number + 1);
            recording.damage.push(Damage { path: path.clone(), from: 0, bytes: 0, problem });
            break;
        }
    }
    recording.complete = recording.damage.is_empty();
    let run = &mut recording.run;
    run.signals.values_mut().for_each(Columns::sort);
    run.labels.values_mut().for_each(|labels| labels.sort_by_key(|label| label.tick));
    run.commands.values_mut().for_each(|commands| commands.sort_by_key(|command| command.tick));
    run.words.values_mut().for_each(|words| words.sort_by_key(|words| words.tick));
    run.wires.values_mut().for_each(|wire| wire.sort_by_key(|message| message.tick));
    run.events.sort_by_key(|event| event.tick);
    Ok((recording, chunks))
}

/// The file at `path` and the parts that follow it: `run.rrd`, `run.part2.rrd`, `run.part3.rrd`, …
///
/// # Errors
/// When the folder can't be read.
pub fn parts(path: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let mut parts = vec![path.to_owned()];
    let (None, Some(stem)) = (part_number(path), path.file_stem()) else { return Ok(parts) };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let Ok(entries) = folder.read_dir() else { return Ok(parts) };
    let mut further: Vec<(u64, PathBuf)> = entries
        .flatten()
        .filter_map(|entry| {
            let path = path.with_file_name(entry.file_name());
            let (first, number) = part_number(&path)?;
            (first.as_os_str() == stem && number > 1).then_some((number, path))
        })
        .collect();
    further.sort();
    parts.extend(further.into_iter().map(|(_, path)| path));
    Ok(parts)
}

/// The first file of the run that this further part belongs to, whether it is there or not.
#[must_use]
pub fn first_part(path: &Path) -> Option<PathBuf> {
    let (stem, _) = part_number(path).filter(|(_, number)| *number > 1)?;
    Some(path.with_file_name(stem).with_added_extension("rrd"))
}

/// Whether the run of this file has other files.
pub(crate) fn is_one_of_several(path: &Path) -> Result<bool, ReadError> {
    Ok(part_number(path).is_some() || parts(path)?.len() > 1)
}

/// `run` and 2 of `run.part2.rrd`.
fn part_number(path: &Path) -> Option<(PathBuf, u64)> {
    let stem = Path::new(path.file_stem().filter(|_| path.extension().is_some_and(|extension| extension == "rrd"))?);
    let number = stem.extension()?.to_str()?.strip_prefix("part")?.parse().ok()?;
    Some((PathBuf::from(stem.file_stem()?), number))
}

/// Whether the file at `path` ends with a footer that points into the file.
///
/// # Errors
/// When the file can't be read.
pub(crate) fn is_closed(path: &Path) -> io::Result<bool> {
    match Frames::open(File::open(path)?) {
        Ok(mut frames) => Ok(frames.manifests()?.is_some()),
        Err(Foreign::Io(error)) => Err(error),
        Err(_) => Ok(false),
    }
}

/// Opens a file for its messages.
pub(crate) fn open(path: &Path) -> Result<Frames<File>, ReadError> {
    let failed = |error| ReadError::File { path: path.to_owned(), error };
    let file = File::open(path).map_err(failed)?;
    if file.metadata().map_err(failed)?.is_dir() {
        return Err(failed(io::ErrorKind::IsADirectory.into()));
    }
    Frames::open(file).map_err(|foreign| match foreign {
        Foreign::Empty => ReadError::Empty { path: path.to_owned() },
        Foreign::Other(problem) => {
            ReadError::Foreign { path: path.to_owned(), problem: format!("not a recording: {problem}") }
        }
        Foreign::Io(error) => failed(error),
    })
}

/// A recording on its way from the file.
struct Reader<'a> {
    wanted: &'a dyn Fn(&str) -> bool,
    /// Pieces that are also kept as they are.
    kept: &'a dyn Fn(&str) -> bool,
    /// Everything by the run that it says it belongs to; one, where nothing is damaged.
    stores: Vec<Store>,
    damage: Vec<Damage>,
}

/// What belongs to one run.
struct Store {
    id: StoreId,
    recording: Recording,
    /// Where it was found.
    places: Vec<(PathBuf, Range<u64>)>,
    /// How much of it is more than an introduction.
    chunks: usize,
    kept: Vec<Chunk>,
}

impl Reader<'_> {
    fn part(&mut self, path: &Path) -> Result<(), ReadError> {
        let failed = |error| ReadError::File { path: path.to_owned(), error };
        let mut frames = open(path)?;
        let manifests = frames.manifests().map_err(failed)?;
        if let Some(places) = manifests.as_deref().and_then(|manifests| self.places(manifests)) {
            // The first piece tells whether the beginning is damaged.
            if let Some((place, piece)) = frames.next().map_err(failed)?.filter(|(place, _)| place.start == 0) {
                self.take(path, place, piece);
            }
            for place in places {
                let piece = frames.chunk(place.clone()).map_err(failed)?;
                self.take(path, place, piece.unwrap_or_else(Piece::Lost));
            }
        } else {
            while let Some((place, piece)) = frames.next().map_err(failed)? {
                self.take(path, place, piece);
            }
        }
        if manifests.is_none() {
            let from = frames.length;
            self.lost(path, from..from, "not closed: the writer was killed, or the end of the file is gone".to_owned());
        }
        Ok(())
    }

    /// The run that most of what was found belongs to; the rest is damage.
    fn run(mut self, paths: &[PathBuf]) -> Result<(Recording, Vec<Chunk>), ReadError> {
        let path = || paths.first().cloned().unwrap_or_default();
        let foreign = |problem: String| ReadError::Foreign { path: path(), problem };
        let most = (0..self.stores.len()).max_by_key(|&i| (self.stores[i].chunks, std::cmp::Reverse(i)));
        let Some(most) = most else {
            if self.damage.is_empty() {
                return Err(foreign("not a recording: there is no run in it".to_owned()));
            }
            return Ok((Recording { damage: self.damage, ..Recording::default() }, Vec::new()));
        };
        let run = self.stores.swap_remove(most);
        let application = run.id.application_id().as_str();
        if application == COMPARISON {
            return Err(ReadError::Comparison { path: path() });
        }
        if application != APPLICATION {
            return Err(foreign(format!("a recording of {application:?}, must be one of {APPLICATION:?}")));
        }
        for store in std::mem::take(&mut self.stores) {
            let (application, name) = (store.id.application_id().as_str(), store.id.recording_id().as_str());
            for (path, place) in store.places {
                self.lost(&path, place, format!("part of another run, {application:?} {name:?}"));
            }
        }
        if let Some(&Property::Integer(format)) = run.recording.property("run", "format")
            && format > FORMAT
        {
            return Err(foreign(format!("format = {format}: must be at most {FORMAT}; a newer supertwin wrote this")));
        }
        let mut recording = run.recording;
        recording.damage = self.damage;
        recording.damage.sort_by_key(|damage| (paths.iter().position(|path| *path == damage.path), damage.from));
        Ok((recording, run.kept))
    }

    /// Where in the file everything wanted is, when not all of it is wanted and there is a list.
    fn places(&self, manifests: &[rerun::external::re_log_encoding::RawRrdManifest]) -> Option<Vec<Range<u64>>> {
        let mut places = Vec::new();
        let mut all = true;
        for manifest in manifests.iter().filter(|manifest| manifest.store_id.kind() == StoreKind::Recording) {
            let paths = manifest.col_chunk_entity_path_raw().ok()?;
            let starts = manifest.col_chunk_byte_offset().ok()?;
            let sizes = manifest.col_chunk_byte_size().ok()?;
            for ((path, start), size) in paths.iter().zip(starts).zip(sizes) {
                let path = path?.trim_start_matches('/');
                if is_property(path) || (self.wanted)(path) || (self.kept)(path) {
                    places.push(start..start.checked_add(size)?);
                } else {
                    all = false;
                }
            }
        }
        places.sort_by_key(|place| place.start);
        (!all).then_some(places)
    }

    fn lost(&mut self, path: &Path, place: Range<u64>, problem: String) {
        let bytes = place.end - place.start;
        self.damage.push(Damage { path: path.to_owned(), from: place.start, bytes, problem });
    }

    fn take(&mut self, path: &Path, place: Range<u64>, piece: Piece) {
        let (message, chunk) = match piece {
            Piece::Chunk(message, chunk) => (message, Some(chunk)),
            Piece::Message(message) => (message, None),
            Piece::Lost(problem) => return self.lost(path, place, problem),
        };
        let id = message.store_id();
        if id.kind() != StoreKind::Recording {
            return;
        }
        let at = self.stores.iter().position(|store| store.id == *id).unwrap_or_else(|| {
            let (recording, places) = (Recording::default(), Vec::new());
            self.stores.push(Store { id: id.clone(), recording, places, chunks: 0, kept: Vec::new() });
            self.stores.len() - 1
        });
        let (wanted, kept) = (self.wanted, self.kept);
        let store = &mut self.stores[at];
        store.places.push((path.to_owned(), place.clone()));
        let Some(chunk) = chunk else { return };
        store.chunks += 1;
        let entity = chunk.entity_path().to_string();
        let entity = entity.trim_start_matches('/');
        if id.application_id().as_str() != APPLICATION {
            return;
        }
        if is_property(entity) || wanted(entity) {
            // Arrow panics on some damages only when the values are looked at.
            let added = quietly(|| store.recording.add(entity, &chunk)).unwrap_or_else(|()| Err("damaged".to_owned()));
            if let Err(problem) = added {
                return self.lost(path, place, format!("{entity}: {problem}"));
            }
        }
        if kept(entity) {
            store.kept.push(*chunk);
        }
    }
}

/// Properties are always read.
fn is_property(path: &str) -> bool {
    path.starts_with("__properties")
}

impl Deref for Recording {
    type Target = RecordedRun;
    fn deref(&self) -> &RecordedRun {
        &self.run
    }
}

impl Recording {
    /// The last tick of any signal.
    #[must_use]
    pub fn last_tick(&self) -> Option<i64> {
        self.signals.values().filter_map(|columns| columns.tick.last().copied()).max()
    }

    fn add(&mut self, path: &str, chunk: &Chunk) -> Result<(), String> {
        if let Some(group) = path.strip_prefix("__properties") {
            return self.add_properties(group.trim_start_matches('/'), chunk);
        }
        let scalars = rerun::Scalars::descriptor_scalars().component;
        let state = rerun::StateChange::descriptor_state().component;
        let text = rerun::TextLog::descriptor_text().component;
        let words = rerun::TextDocument::descriptor_text().component;
        let names = rerun::SeriesLines::descriptor_names().component;
        let bytes = ComponentIdentifier::from(BYTES);
        let has = |component| chunk.components().contains_component(component);
        // All of a chunk or nothing of it: what does not fit is found before anything is entered.
        let changes = has(state).then(|| labels(chunk, state)).transpose()?;
        let happened =
            has(text).then(|| event::read(path.strip_prefix("event/").unwrap_or(path), chunk)).transpose()?;
        let said = has(words).then(|| labels(chunk, words)).transpose()?;
        let wire = path.strip_prefix("wire/").filter(|_| has(bytes));
        let sent = wire.map(|key| Ok::<_, String>((key, wired(chunk, bytes)?))).transpose()?;
        if has(scalars) {
            let mut columns = self.run.signals.remove(path).unwrap_or_default();
            let known = !columns.tick.is_empty() || !columns.names.is_empty();
            let added = add_rows(&mut columns, chunk, scalars);
            if known || added.is_ok() {
                self.run.signals.insert(path.to_owned(), columns);
            }
            added?;
        }
        if has(names) {
            self.run.signals.entry(path.to_owned()).or_default().names =
                strings(chunk, names).map(|name| name.unwrap_or_default()).collect();
        }
        if let Some(changes) = changes {
            self.run.labels.entry(path.to_owned()).or_default().extend(changes);
        }
        self.run.events.extend(happened.into_iter().flatten());
        if let Some(said) = said {
            let (of_path, path) = match path.strip_prefix("command/") {
                Some(service) => (&mut self.run.commands, service),
                None => (&mut self.run.words, path),
            };
            of_path.entry(path.to_owned()).or_default().extend(said);
        }
        if let Some((key, sent)) = sent {
            self.run.wires.entry(key.to_owned()).or_default().extend(sent);
        }
        *self.rows.entry(path.to_owned()).or_default() += chunk.num_rows();
        Ok(())
    }

    fn add_properties(&mut self, group: &str, chunk: &Chunk) -> Result<(), String> {
        if group.is_empty() {
            if let Some(name) = strings(chunk, rerun::RecordingInfo::descriptor_name().component).flatten().next() {
                self.run.name = name;
            }
            return Ok(());
        }
        for component in chunk.components_identifiers() {
            let values = chunk.components().get_array(component).map(ListArray::values);
            let property = values.and_then(property).ok_or_else(|| format!("{component} is not a property"))?;
            self.run.properties.entry(group.to_owned()).or_default().insert(component.to_string(), property);
        }
        Ok(())
    }
}
