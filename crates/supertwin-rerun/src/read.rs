//! A recording back as numbers.
//!
//! A file without a footer, or one that ends in the middle of a message, is read up to there: that is what a killed
//! process and a full disk leave behind.

use crate::{TICK, TIME};
use rerun::external::arrow::array::{Array, ArrayRef, Float64Array, StringArray, UInt64Array};
use rerun::external::re_log_encoding::{Decodable, DecoderApp, StreamFooter};
use rerun::log::{Chunk, LogMsg};
use rerun::{ComponentIdentifier, StoreKind};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use supertwin_core::run::{Properties, Severity};
use supertwin_core::{Event, Property};

/// What was recorded.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Name of the run; empty when not even that was written.
    pub name: String,
    /// Groups of properties: `run` from the beginning, `result` from the end.
    pub properties: BTreeMap<String, Properties>,
    /// Numbers by path of the signal.
    pub signals: BTreeMap<String, Columns>,
    /// Changes of labels by path of the signal.
    pub labels: BTreeMap<String, Vec<Label>>,
    /// What happened, in order of time.
    pub events: Vec<Event>,
    /// How many rows every entity has, drawings included.
    pub rows: BTreeMap<String, usize>,
    /// The file was closed properly and nothing is missing.
    pub complete: bool,
}

/// Values of one signal, in order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Columns {
    /// Names of the curves.
    pub names: Vec<String>,
    /// Tick of every row.
    pub tick: Vec<i64>,
    /// Time of every row in nanoseconds.
    pub time_ns: Vec<i64>,
    /// Values per row.
    pub width: usize,
    /// Row by row.
    pub values: Vec<f64>,
}

/// A label took a new value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Label {
    /// At this tick.
    pub tick: i64,
    /// At this time in nanoseconds.
    pub time_ns: i64,
    /// This one.
    pub value: String,
}

/// A recording can't be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file can't be read at all.
    #[error("{}: {error}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// The file can be read, but does not contain a run.
    #[error("{}: {entity}: {problem}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Where.
        entity: String,
        /// What is wrong there.
        problem: String,
    },
}

/// Reads the recording at `path`, as much of it as there is.
///
/// # Errors
/// When the file can't be read, or when it contains something that is not a run.
pub fn read(path: &Path) -> Result<Recording, ReadError> {
    let failed = |error| ReadError::File { path: path.to_owned(), error };
    let file = File::open(path).map_err(failed)?;
    let mut recording = Recording { complete: is_closed(path).map_err(failed)?, ..Default::default() };
    let mut messages = DecoderApp::decode_lazy(BufReader::new(file));
    loop {
        // Arrow panics on a damaged schema. The decoder is not used again after that.
        let next = catch_unwind(AssertUnwindSafe(|| messages.next()));
        let (store, message) = match next {
            Ok(None) => break,
            Ok(Some(Ok(LogMsg::ArrowMsg(store, message)))) => (store, message),
            Ok(Some(Ok(_))) => continue,
            // The tail is missing or damaged; what came before is good.
            Ok(Some(Err(_))) | Err(_) => {
                recording.complete = false;
                break;
            }
        };
        if store.kind() != StoreKind::Recording {
            continue;
        }
        let Ok(chunk) = Chunk::from_arrow_msg(&message) else {
            recording.complete = false;
            break;
        };
        let entity = chunk.entity_path().to_string();
        recording.add(entity.trim_start_matches('/'), &chunk).map_err(|problem| ReadError::Content {
            path: path.to_owned(),
            entity,
            problem,
        })?;
    }
    recording.signals.values_mut().for_each(Columns::sort);
    recording.labels.values_mut().for_each(|labels| labels.sort_by_key(|label| label.tick));
    recording.events.sort_by_key(|event| event.tick);
    Ok(recording)
}

/// Whether the file at `path` ends with a footer that points into the file.
///
/// # Errors
/// When the file can't be read.
pub(crate) fn is_closed(path: &Path) -> io::Result<bool> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut end = [0; StreamFooter::ENCODED_SIZE_BYTES];
    let Some(start) = length.checked_sub(end.len() as u64) else { return Ok(false) };
    file.seek(SeekFrom::Start(start))?;
    file.read_exact(&mut end)?;
    let Ok(footer) = StreamFooter::from_rrd_bytes(&end) else { return Ok(false) };
    let Some(entry) = footer.entries.first() else { return Ok(false) };
    let span = entry.rrd_footer_byte_span_from_start_excluding_header;
    // The footer's own list is the last thing before this pointer to it.
    if span.start.checked_add(span.len) != Some(start) {
        return Ok(false);
    }
    let mut list = vec![0; span.len as usize];
    file.seek(SeekFrom::Start(span.start))?;
    file.read_exact(&mut list)?;
    Ok(StreamFooter::compute_crc(&list) == entry.crc_excluding_header)
}

impl Recording {
    fn add(&mut self, path: &str, chunk: &Chunk) -> Result<(), String> {
        if let Some(group) = path.strip_prefix("__properties") {
            return self.add_properties(group.trim_start_matches('/'), chunk);
        }
        *self.rows.entry(path.to_owned()).or_default() += chunk.num_rows();
        let scalars = rerun::Scalars::descriptor_scalars().component;
        let state = rerun::StateChange::descriptor_state().component;
        let text = rerun::TextLog::descriptor_text().component;
        let names = rerun::SeriesLines::descriptor_names().component;
        if chunk.components().contains_component(scalars) {
            self.signals.entry(path.to_owned()).or_default().add(chunk, scalars)?;
        }
        if chunk.components().contains_component(names) {
            self.signals.entry(path.to_owned()).or_default().names = strings(chunk, names).collect();
        }
        if chunk.components().contains_component(state) {
            let changes = moments(chunk, state)?.zip(strings(chunk, state));
            let changes = changes.map(|((tick, time_ns), value)| Label { tick, time_ns, value });
            self.labels.entry(path.to_owned()).or_default().extend(changes);
        }
        if chunk.components().contains_component(text) {
            let service = path.strip_prefix("event/").unwrap_or(path).to_owned();
            let levels = strings(chunk, rerun::TextLog::descriptor_level().component);
            for (((tick, _), text), level) in moments(chunk, text)?.zip(strings(chunk, text)).zip(levels) {
                let severity = match level.as_str() {
                    "INFO" => Severity::Info,
                    "WARN" => Severity::Warning,
                    _ => Severity::Error,
                };
                let (service, text) = (service.clone().into(), text.into());
                self.events.push(Event { tick: tick as u64, service, severity, text });
            }
        }
        Ok(())
    }

    fn add_properties(&mut self, group: &str, chunk: &Chunk) -> Result<(), String> {
        if group.is_empty() {
            if let Some(name) = strings(chunk, rerun::RecordingInfo::descriptor_name().component).next() {
                self.name = name;
            }
            return Ok(());
        }
        for component in chunk.components_identifiers() {
            let values = chunk.components().get_array(component).map(|list| list.values());
            let property = values.and_then(property).ok_or_else(|| format!("{component} is not a property"))?;
            self.properties.entry(group.to_owned()).or_default().insert(component.to_string(), property);
        }
        Ok(())
    }
}

impl Columns {
    fn add(&mut self, chunk: &Chunk, component: ComponentIdentifier) -> Result<(), String> {
        for ((tick, time_ns), values) in moments(chunk, component)?.zip(chunk.iter_slices::<f64>(component)) {
            if self.tick.is_empty() {
                self.width = values.len();
            } else if self.width != values.len() {
                return Err(format!("{} values at tick {tick}, {} before", values.len(), self.width));
            }
            self.tick.push(tick);
            self.time_ns.push(time_ns);
            self.values.extend_from_slice(values);
        }
        Ok(())
    }

    /// Values of the row at `tick`.
    #[must_use]
    pub fn at(&self, tick: i64) -> Option<&[f64]> {
        let row = self.tick.binary_search(&tick).ok()?;
        self.values.get(row * self.width..(row + 1) * self.width)
    }

    fn sort(&mut self) {
        if self.tick.is_sorted() {
            return;
        }
        let mut order: Vec<usize> = (0..self.tick.len()).collect();
        order.sort_by_key(|&row| self.tick[row]);
        self.tick = order.iter().map(|&row| self.tick[row]).collect();
        self.time_ns = order.iter().map(|&row| self.time_ns[row]).collect();
        self.values = order.iter().flat_map(|&row| &self.values[row * self.width..][..self.width]).copied().collect();
    }
}

/// Tick and time of every row that has this component.
fn moments(chunk: &Chunk, component: ComponentIdentifier) -> Result<impl Iterator<Item = (i64, i64)>, String> {
    if [TICK, TIME].iter().any(|&timeline| !chunk.timelines().contains_key(&timeline.into())) {
        return Err(format!("not on the timelines {TICK} and {TIME}"));
    }
    let on = |timeline: &'static str| {
        chunk.iter_component_indices(timeline.into(), component).map(|(time, _)| time.as_i64())
    };
    Ok(on(TICK).zip(on(TIME)))
}

/// Every string of a component, over all rows.
fn strings(chunk: &Chunk, component: ComponentIdentifier) -> impl Iterator<Item = String> {
    chunk.iter_slices::<String>(component).flatten().map(|text| text.as_str().to_owned())
}

fn property(values: &ArrayRef) -> Option<Property> {
    let any = values.as_any();
    if values.len() != 1 || values.is_null(0) {
        return None;
    }
    if let Some(text) = any.downcast_ref::<StringArray>() {
        return Some(Property::Text(text.value(0).to_owned()));
    }
    if let Some(number) = any.downcast_ref::<Float64Array>() {
        return Some(Property::Number(number.value(0)));
    }
    any.downcast_ref::<UInt64Array>().map(|integer| Property::Integer(integer.value(0)))
}
