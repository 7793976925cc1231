//! Rerun chunks from plain columns, without copying them.
//!
//! `RecordingStream::send_columns` sorts the rows and hands the chunk through two more threads. The rows of a run are
//! in order already, so the chunks are built here and encoded by the one thread of [`crate::writer`].

use rerun::external::arrow::{array::Float64Array, buffer::ScalarBuffer};
use rerun::log::{Chunk, ChunkId, RowId};
use rerun::time::{TimePoint, Timeline};
use rerun::{AsComponents, EntityPath, SerializedComponentBatch, SerializedComponentColumn, TimeColumn};
use std::sync::Arc;
use supertwin_core::{Signal, Tick};

/// Why a chunk can't be built: always a defect of the caller, and still no reason to lose the rest of the run.
pub(crate) type Problem = String;

/// When the rows of a chunk were heard. Cloning shares the numbers.
#[derive(Clone)]
pub(crate) struct Times {
    pub(crate) ticks: ScalarBuffer<i64>,
    pub(crate) nanos: ScalarBuffer<i64>,
    /// Clock of the sender and of the recorder, nanoseconds since 1970; a run in one process has none.
    clocks: Option<[ScalarBuffer<i64>; 2]>,
}

impl Times {
    pub(crate) fn new(ticks: Vec<i64>, nanos: Vec<i64>) -> Self {
        Self { ticks: ticks.into(), nanos: nanos.into(), clocks: None }
    }

    /// The same, with the clocks of each row; none at all leaves them out.
    pub(crate) fn with_clocks(mut self, clocks: &[Clocks]) -> Self {
        if clocks.len() == self.len() && !clocks.is_empty() {
            let pick = |of: fn(&Clocks) -> i64| clocks.iter().map(of).collect::<Vec<_>>().into();
            self.clocks = Some([pick(|clocks| clocks.sender_ns), pick(|clocks| clocks.recorder_ns)]);
        }
        self
    }

    pub(crate) fn len(&self) -> usize {
        self.ticks.len()
    }

    /// The times of some rows only.
    pub(crate) fn select(&self, rows: &[u32]) -> Self {
        let pick = |all: &[i64]| ScalarBuffer::from(rows.iter().map(|&row| all[row as usize]).collect::<Vec<_>>());
        Self {
            ticks: pick(&self.ticks),
            nanos: pick(&self.nanos),
            clocks: self.clocks.as_ref().map(|clocks| clocks.each_ref().map(|clock| pick(clock))),
        }
    }

    /// One column per timeline.
    fn columns(self) -> impl Iterator<Item = TimeColumn> {
        let clock = |name, values| TimeColumn::new(None, Timeline::new_timestamp(name), values);
        let nanos = TimeColumn::new(None, Timeline::new_duration(crate::TIME), self.nanos);
        let ticks = TimeColumn::new(None, Timeline::new_sequence(crate::TICK), self.ticks);
        let clocks = self.clocks.into_iter().flat_map(move |[sender, recorder]| {
            [clock(crate::SENDER_CLOCK, sender), clock(crate::RECORDER_CLOCK, recorder)]
        });
        [nanos, ticks].into_iter().chain(clocks)
    }
}

/// Wall clocks of something that came over a network, nanoseconds since 1970.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clocks {
    /// Of who sent it.
    pub sender_ns: i64,
    /// Of who recorded it, at its arrival.
    pub recorder_ns: i64,
}

/// One signal's share of a batch.
pub(crate) struct Rows {
    pub(crate) entity: EntityPath,
    pub(crate) times: Times,
    pub(crate) width: usize,
    /// Row by row.
    pub(crate) values: Vec<f64>,
}

impl Rows {
    /// Whether these rows of `shown` are those of `signal`: a recorder has signals of its own with the same paths.
    pub(crate) fn are_of(&self, shown: &Signal, signal: &Signal) -> bool {
        shown.path == signal.path && self.width == signal.width()
    }

    pub(crate) fn into_chunk(self) -> Result<Chunk, Problem> {
        let array = Arc::new(Float64Array::from(self.values));
        let column = SerializedComponentBatch::new(array, rerun::Scalars::descriptor_scalars())
            .partitioned(std::iter::repeat_n(self.width, self.times.len()));
        columns(self.entity, self.times, column.map(|column| [column]))
    }
}

/// Values that come at any tick, one by one, until they are taken.
pub(crate) struct TimedValues<T> {
    ticks: Vec<i64>,
    nanos: Vec<i64>,
    clocks: Vec<Clocks>,
    values: Vec<T>,
}

impl<T> Default for TimedValues<T> {
    fn default() -> Self {
        Self { ticks: Vec::new(), nanos: Vec::new(), clocks: Vec::new(), values: Vec::new() }
    }
}

impl<T> TimedValues<T> {
    /// Adds a row, of one value or of several.
    pub(crate) fn add(&mut self, tick: Tick, clocks: Clocks, values: impl IntoIterator<Item = T>) {
        self.ticks.push(tick.k as i64);
        self.nanos.push(nanos(tick));
        self.clocks.push(clocks);
        self.values.extend(values);
    }

    pub(crate) fn columns(self) -> (Times, Vec<T>) {
        (Times::new(self.ticks, self.nanos).with_clocks(&self.clocks), self.values)
    }
}

/// Nanoseconds since the start of the run, rounded once.
pub(crate) fn nanos(tick: Tick) -> i64 {
    (tick.t_s() * 1e9).round() as i64
}

/// Columns of any components over both timelines.
pub(crate) fn columns<E: std::fmt::Display>(
    entity: impl Into<EntityPath>,
    times: Times,
    components: Result<impl IntoIterator<Item = SerializedComponentColumn>, E>,
) -> Result<Chunk, Problem> {
    let id = ChunkId::new();
    let first = RowId::from_tuid(*id).next();
    let rows: Vec<_> = (0..times.len() as u64).map(|row| first.incremented_by(row)).collect();
    let timelines = times.columns().map(|column| (*column.timeline().name(), column)).collect();
    let components =
        components.map_err(text)?.into_iter().map(|column| (column.descriptor, column.list_array)).collect();
    Chunk::from_native_row_ids(id, entity.into(), Some(true), &rows, timelines, components).map_err(text)
}

/// Something that holds for the whole run.
pub(crate) fn fixed(entity: impl Into<EntityPath>, components: &dyn AsComponents) -> Result<Chunk, Problem> {
    Chunk::builder(entity).with_archetype_auto_row(TimePoint::default(), components).build().map_err(text)
}

pub(crate) fn text(error: impl std::fmt::Display) -> Problem {
    error.to_string()
}
