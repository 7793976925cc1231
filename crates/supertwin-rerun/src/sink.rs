//! A run as it is heard, gathered in columns and handed to the file batch by batch.

mod batch;

use crate::chunks::{Clocks, Problem, Rows, Times, columns, fixed, nanos, text};
use crate::derived::Derived;
use crate::late_rows::LateRows;
use crate::live::Live;
use crate::scene::Scene;
use crate::writer::{Job, Writer};
use crate::{blueprint, event, read, style};
use batch::{Column, Track, times_of};
use rerun::external::arrow::array::{Float64Array, UInt64Array};
use rerun::external::re_log_encoding::EncodingOptions;
use rerun::external::re_log_types::{SetStoreInfo, StoreInfo, StoreSource};
use rerun::log::RowId;
use rerun::{ComponentIdentifier, EntityPath, RecordingInfo, StoreId, StoreKind, Text};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use supertwin_core::observe::Slots;
use supertwin_core::run::Properties;
use supertwin_core::{Event, Probe, Property, RunHeader, RunSink, Signal, SinkError, Tick};

/// How a recording is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// Replace a file that exists already.
    pub overwrite: bool,
    /// Ticks that are gathered before they go to the file: what a crash can lose. Below some hundred, files get larger
    /// and the viewer slower; above a thousand nothing is gained.
    pub batch_ticks: usize,
    /// Compress the file (LZ4): about 40 per cent smaller, and writing takes twice as long.
    pub compress: bool,
    /// Embed the dashboards, 1.4 MB uncompressed.
    pub dashboards: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { overwrite: false, batch_ticks: 1000, compress: false, dashboards: true }
    }
}

/// Writes a run to one `.rrd` file.
///
/// A value costs a copy into a column; the file grows in a thread of its own. What goes wrong there, such as a full
/// disk, comes back from the next [`RunSink::tick`] and at the latest from [`RunSink::finish`].
pub struct RerunSink {
    /// For error messages.
    name: String,
    path: Option<PathBuf>,
    options: Options,
    state: State,
    /// Ticks of this batch, and when they are.
    ticks: Vec<i64>,
    nanos: Vec<i64>,
    /// Wall clocks of these ticks, if the run came over a network.
    clocks: Vec<Clocks>,
    last_tick: Option<Tick>,
    vectors: Slots<Column>,
    labels: Slots<Track>,
    events: BTreeMap<Cow<'static, str>, Vec<(Event, Option<Clocks>)>>,
    late_rows: LateRows,
    scene: Scene,
    derived: Derived,
    /// What went wrong in a call that can't return it.
    failure: Option<Problem>,
}

enum State {
    Created(Target),
    Writing(Outlet),
    Closed,
}

/// Where it is going to go.
enum Target {
    File(Box<dyn Write + Send>),
    Live(Live),
}

/// Where it goes.
enum Outlet {
    File(Writer),
    Live(Live, StoreId),
}

impl RerunSink {
    /// Creates the file.
    ///
    /// # Errors
    /// When the file exists and may not be replaced, or when it can't be created.
    pub fn create(path: &Path, options: Options) -> Result<Self, SinkError> {
        let failed = |cause: String| SinkError { what: path.display().to_string(), cause };
        if options.batch_ticks == 0 {
            return Err(failed("a batch needs at least one tick".to_owned()));
        }
        let mut how = File::options();
        how.write(true);
        if options.overwrite {
            how.create(true).truncate(true)
        } else {
            how.create_new(true)
        };
        let file = how.open(path).map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => failed("the file exists already".to_owned()),
            io::ErrorKind::NotFound => failed(match path.parent() {
                Some(folder) if !folder.as_os_str().is_empty() => {
                    format!("the directory {} does not exist", folder.display())
                }
                _ => error.to_string(),
            }),
            _ => failed(format!("can't create the file: {error}")),
        })?;
        let mut sink = Self::onto(Target::File(Box::new(file)), &path.display().to_string(), options);
        sink.path = Some(path.to_owned());
        Ok(sink)
    }

    /// Feeds `live`, `batch_ticks` at a time, instead of a file. It never waits and never fails.
    #[must_use]
    pub fn live(live: &Live, batch_ticks: usize) -> Self {
        let options = Options { batch_ticks: batch_ticks.max(1), ..Options::default() };
        Self::onto(Target::Live(live.clone()), "live view", options)
    }

    fn onto(target: Target, name: &str, options: Options) -> Self {
        Self {
            name: name.to_owned(),
            path: None,
            state: State::Created(target),
            ticks: Vec::with_capacity(options.batch_ticks),
            nanos: Vec::with_capacity(options.batch_ticks),
            clocks: Vec::new(),
            last_tick: None,
            vectors: Slots::default(),
            labels: Slots::default(),
            events: BTreeMap::new(),
            late_rows: LateRows::default(),
            scene: Scene::default(),
            derived: Derived::default(),
            failure: None,
            options,
        }
    }

    fn error(&self, cause: Problem) -> SinkError {
        SinkError { what: self.name.clone(), cause }
    }

    fn fail(&mut self, cause: impl FnOnce() -> Problem) {
        self.failure.get_or_insert_with(cause);
    }

    /// What went wrong earlier.
    fn check(&self) -> Result<(), Problem> {
        if let Some(cause) = &self.failure {
            return Err(cause.clone());
        }
        match &self.state {
            State::Writing(Outlet::File(writer)) => writer.check(),
            State::Writing(Outlet::Live(..)) => Ok(()),
            State::Created(_) => Err("the run has not begun".to_owned()),
            State::Closed => Err("the recording is closed".to_owned()),
        }
    }

    fn send(&self, job: Job) -> Result<(), Problem> {
        match &self.state {
            State::Writing(Outlet::File(writer)) => writer.send(job),
            State::Writing(Outlet::Live(live, store)) => {
                live.offer(store, job);
                Ok(())
            }
            _ => Err("the recording is not open".to_owned()),
        }
    }

    fn start(&mut self, header: &RunHeader) -> Result<(), Problem> {
        let target = match std::mem::replace(&mut self.state, State::Closed) {
            State::Created(target) => target,
            begun => {
                self.state = begun;
                return Err("the run has begun already".to_owned());
            }
        };
        let encoding = if self.options.compress {
            EncodingOptions::PROTOBUF_COMPRESSED
        } else {
            EncodingOptions::PROTOBUF_UNCOMPRESSED
        };
        let store = StoreId::new(StoreKind::Recording, crate::APPLICATION, header.name.as_str());
        self.state = State::Writing(match target {
            Target::File(file) => Outlet::File(Writer::start(file, store.clone(), encoding)?),
            Target::Live(live) => Outlet::Live(live, store.clone()),
        });
        let source = StoreSource::Other(concat!("supertwin ", env!("CARGO_PKG_VERSION")).to_owned());
        let info = StoreInfo::new(store, source);
        let mut jobs = vec![Job::Message(SetStoreInfo { row_id: *RowId::new(), info }.into())];
        if self.options.dashboards {
            let about = blueprint::About::run(header);
            jobs.extend(blueprint::messages(blueprint::Dashboard::all(&about))?.into_iter().map(Job::Message));
        }
        // No start time: the same run makes the same recording whenever it runs.
        let info = RecordingInfo::new().with_name(header.name.as_str());
        jobs.push(Job::Chunk(fixed(EntityPath::properties(), &info)?));
        jobs.extend(properties("run", &header.properties)?);
        for chunk in Scene::fixed(&header.scene)? {
            jobs.push(Job::Chunk(chunk));
        }
        self.send(Job::All(jobs))?;
        self.scene = Scene::new(&header.scene);
        self.derived = Derived::new(&header.scene);
        Ok(())
    }

    /// The wall clocks of the present tick; of every tick, or of none.
    pub fn clocks(&mut self, clocks: Clocks) {
        self.clocks.push(clocks);
    }

    /// What is shown from here on belongs to `tick`, which has been written without it; until the next tick begins.
    /// Nothing is drawn of it, and no curves follow from it.
    pub fn late_tick(&mut self, tick: Tick, clocks: Clocks) {
        self.late_rows.at = Some((tick, clocks));
    }

    /// An event that came over a network.
    ///
    /// # Errors
    /// When something heard earlier could not be written.
    pub fn event_at(&mut self, event: &Event, clocks: Option<Clocks>) -> Result<(), SinkError> {
        self.check().map_err(|cause| self.error(cause))?;
        self.events.entry(event.service.clone()).or_default().push((event.clone(), clocks));
        Ok(())
    }

    /// Words at `path`, such as the account of a step or a state, at any tick.
    pub fn text(&mut self, path: &str, tick: Tick, clocks: Clocks, words: String) {
        self.late_rows.texts.entry(path.to_owned()).or_default().add(tick, clocks, [words]);
    }

    /// The exact bytes of a message at `path`, at any tick.
    pub fn bytes(&mut self, path: &str, tick: Tick, clocks: Clocks, bytes: Vec<u8>) {
        self.late_rows.bytes.entry(path.to_owned()).or_default().add(tick, clocks, [bytes]);
    }

    /// Hands what was heard so far to the file, without waiting for a batch to be full: what a crash can't take.
    ///
    /// # Errors
    /// When something could not be written.
    pub fn flush(&mut self) -> Result<(), SinkError> {
        self.check().and_then(|()| self.hand_over()).map_err(|cause| self.error(cause))
    }

    /// Hands what was heard so far to the file, and waits until the file has it.
    ///
    /// # Errors
    /// When something could not be written.
    pub fn sync(&mut self) -> Result<(), SinkError> {
        self.flush()?;
        match &self.state {
            State::Writing(Outlet::File(writer)) => writer.sync().map_err(|cause| self.error(cause)),
            _ => Ok(()),
        }
    }

    /// Length of the file so far; zero for a live view.
    #[must_use]
    pub fn written(&self) -> u64 {
        match &self.state {
            State::Writing(Outlet::File(writer)) => writer.written(),
            _ => 0,
        }
    }

    /// Hands everything that was heard since the last batch to the file.
    fn hand_over(&mut self) -> Result<(), Problem> {
        let room = self.options.batch_ticks;
        let ticks = std::mem::replace(&mut self.ticks, Vec::with_capacity(room));
        let nanos = std::mem::replace(&mut self.nanos, Vec::with_capacity(room));
        let every = Times::new(ticks, nanos).with_clocks(&std::mem::take(&mut self.clocks));
        let (mut jobs, mut derived) = (Vec::new(), Vec::new());
        let mut batch = Vec::with_capacity(self.vectors.slots.len());
        for (signal, column) in &mut self.vectors.slots {
            if column.rows.is_empty() {
                continue;
            }
            if !column.described {
                column.described = true;
                let lines = style::lines(signal, column.width);
                jobs.push(Job::Chunk(fixed(column.entity.clone(), &lines)?));
            }
            let room = column.values.len();
            let values = std::mem::replace(&mut column.values, Vec::with_capacity(room));
            // Signals of every tick share one pair of time columns.
            let times = times_of(&every, &column.rows);
            column.rows.clear();
            let rows = Rows { entity: column.entity.clone(), times, width: column.width, values };
            jobs.extend(self.scene.draw(signal, &rows)?.into_iter().map(Job::Chunk));
            derived.extend(self.derived.of(signal, &rows)?.into_iter().map(Job::Chunk));
            batch.push(rows);
        }
        for (_, track) in &mut self.labels.slots {
            if track.rows.is_empty() {
                continue;
            }
            if track.described != track.known.len() {
                track.described = track.known.len();
                jobs.push(Job::Chunk(fixed(track.entity.clone(), &style::states(&track.known))?));
            }
            let changes = rerun::StateChange::update_fields().with_state(std::mem::take(&mut track.changes));
            let changes = changes.columns_of_unit_batches();
            jobs.push(Job::Chunk(columns(track.entity.clone(), every.select(&track.rows), changes)?));
            track.rows.clear();
        }
        let dt_s = self.last_tick.map_or(0.0, |tick| tick.dt_s);
        for (service, events) in std::mem::take(&mut self.events) {
            jobs.push(Job::Chunk(event::chunk(&service, &events, dt_s)?));
        }
        jobs.extend(self.late_rows.chunks()?.into_iter().map(Job::Chunk));
        jobs.extend(derived);
        if !batch.is_empty() {
            jobs.push(Job::Batch(batch));
        }
        self.send(Job::All(jobs))
    }

    /// Writes what is left and the footer, and looks at the file whether all of it is there.
    fn close(&mut self) -> Result<(), Problem> {
        let writer = match std::mem::replace(&mut self.state, State::Closed) {
            State::Writing(Outlet::File(writer)) => writer,
            State::Writing(Outlet::Live(..)) => return Ok(()),
            _ => return Err("the recording is not open".to_owned()),
        };
        let written = writer.close()?;
        let Some(path) = &self.path else { return Ok(()) };
        let file = path.metadata().map_err(text)?;
        if file.is_file() && (file.len() != written || !read::is_closed(path).map_err(text)?) {
            return Err(format!("the file is incomplete: {} of {written} bytes are there", file.len()));
        }
        Ok(())
    }
}

impl Probe for RerunSink {
    fn vector(&mut self, signal: &'static Signal, values: &[f64]) {
        let width = values.len();
        if self.late_rows.at.is_some() {
            if width > 0 && !self.late_rows.numbers(signal, values) {
                self.fail(|| format!("{} changed its width to {width}", signal.path));
            }
            return;
        }
        let Some(row) = self.ticks.len().checked_sub(1) else {
            return self.fail(|| format!("{} is shown before the first tick", signal.path));
        };
        let at = match self.vectors.find(signal) {
            Some(at) => at,
            // A vehicle without thrusters shows an empty vector: there is nothing to draw.
            None if width == 0 => return,
            None => self.vectors.insert(signal, Column::new(signal, width, self.options.batch_ticks)),
        };
        let column = &mut self.vectors.slots[at].1;
        if column.width != width {
            let before = column.width;
            return self.fail(|| format!("{} changed its width from {before} to {width}", signal.path));
        }
        column.rows.push(row as u32);
        column.values.extend_from_slice(values);
    }

    fn label(&mut self, signal: &'static Signal, value: &'static str) {
        let row = self.ticks.len().checked_sub(1);
        if row.is_none() && self.late_rows.at.is_none() {
            return self.fail(|| format!("{} is shown before the first tick", signal.path));
        }
        let track = self.labels.get_or_insert_with(signal, || Track::new(signal));
        if track.last == Some(value) {
            return;
        }
        track.last = Some(value);
        match row.filter(|_| self.late_rows.at.is_none()) {
            Some(row) => {
                track.rows.push(row as u32);
                track.changes.push(value);
            }
            None => self.late_rows.label(signal, value),
        }
        if !track.known.contains(&value) {
            track.known.push(value);
        }
    }
}

impl RunSink for RerunSink {
    fn begin(&mut self, header: &RunHeader) -> Result<(), SinkError> {
        self.start(header).map_err(|cause| self.error(cause))
    }

    fn tick(&mut self, tick: Tick) -> Result<(), SinkError> {
        self.check().map_err(|cause| self.error(cause))?;
        if let Some(last) = self.last_tick.filter(|last| last.k >= tick.k) {
            return Err(self.error(format!("tick {} comes after tick {}", tick.k, last.k)));
        }
        if self.ticks.len() >= self.options.batch_ticks {
            self.hand_over().map_err(|cause| self.error(cause))?;
        }
        self.late_rows.at = None;
        self.last_tick = Some(tick);
        self.ticks.push(tick.k as i64);
        self.nanos.push(nanos(tick));
        // Most signals are shown once per tick, in the order of the last tick.
        self.vectors.cursor = 0;
        self.labels.cursor = 0;
        Ok(())
    }

    fn event(&mut self, event: &Event) -> Result<(), SinkError> {
        self.event_at(event, None)
    }

    fn finish(&mut self, results: &Properties) -> Result<(), SinkError> {
        // Whatever went wrong, what was heard is written and the file closed; the first problem explains the others.
        let heard = self.check();
        let written =
            self.hand_over().and_then(|()| properties("result", results)?.map_or(Ok(()), |job| self.send(job)));
        let closed = self.close();
        heard.and(written).and(closed).map_err(|cause| self.error(cause))
    }
}

impl Drop for RerunSink {
    fn drop(&mut self) {
        match &self.state {
            // Nobody can be told about errors here; what can be saved is saved.
            State::Writing(_) => {
                drop(self.hand_over());
                drop(self.close());
            }
            // An empty file would only be in the way of the next attempt.
            State::Created(_) => {
                if let Some(path) = self.path.as_ref().filter(|path| path.is_file()) {
                    drop(std::fs::remove_file(path));
                }
            }
            State::Closed => (),
        }
    }
}

/// A group of properties, if there are any.
pub(crate) fn properties(group: &str, properties: &Properties) -> Result<Option<Job>, Problem> {
    if properties.is_empty() {
        return Ok(None);
    }
    let mut values = rerun::AnyValues::default();
    for (name, property) in properties {
        let name = ComponentIdentifier::try_new(name.as_str()).map_err(text)?;
        values = match property {
            Property::Text(text) => values.with_component::<Text>(name, [text.as_str()]),
            Property::Number(x) => values.with_component_from_data(name, Arc::new(Float64Array::from(vec![*x]))),
            Property::Integer(n) => values.with_component_from_data(name, Arc::new(UInt64Array::from(vec![*n]))),
        };
    }
    let entity = EntityPath::properties().join(&EntityPath::from_single_string(group));
    Ok(Some(Job::Chunk(fixed(entity, &values)?)))
}

#[cfg(test)]
mod tests;
