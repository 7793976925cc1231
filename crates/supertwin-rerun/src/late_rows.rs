//! Rows that come when they come: what a cut link brings after its end, accounts of steps, states, the exact messages of
//! wires.

use crate::chunks::{Clocks, Problem, Rows, TimedValues, columns, text};
use crate::read::BYTES;
use rerun::log::Chunk;
use rerun::{ComponentDescriptor, EntityPath, Loggable as _, SerializedComponentBatch};
use std::collections::BTreeMap;
use supertwin_core::{Signal, Tick};

/// What came since the last batch, path by path.
#[derive(Default)]
pub(crate) struct LateRows {
    /// Where what is shown belongs to, while it is not the present tick.
    pub(crate) at: Option<(Tick, Clocks)>,
    /// Width of a row, and the rows.
    numbers: BTreeMap<&'static str, (usize, TimedValues<f64>)>,
    labels: BTreeMap<&'static str, TimedValues<&'static str>>,
    pub(crate) texts: BTreeMap<String, TimedValues<String>>,
    pub(crate) bytes: BTreeMap<String, TimedValues<Vec<u8>>>,
}

impl LateRows {
    /// A row of numbers; false when it has another width than those before.
    pub(crate) fn numbers(&mut self, signal: &'static Signal, values: &[f64]) -> bool {
        let Some((tick, clocks)) = self.at else { return true };
        let (width, rows) = self.numbers.entry(signal.path).or_insert_with(|| (values.len(), TimedValues::default()));
        if *width != values.len() {
            return false;
        }
        rows.add(tick, clocks, values.iter().copied());
        true
    }

    /// A label that has changed.
    pub(crate) fn label(&mut self, signal: &'static Signal, value: &'static str) {
        if let Some((tick, clocks)) = self.at {
            self.labels.entry(signal.path).or_default().add(tick, clocks, [value]);
        }
    }

    /// Everything so far, as chunks; leaves nothing behind.
    pub(crate) fn chunks(&mut self) -> Result<Vec<Chunk>, Problem> {
        let mut chunks = Vec::new();
        for (path, (width, rows)) in std::mem::take(&mut self.numbers) {
            let (times, values) = rows.columns();
            chunks.push(Rows { entity: EntityPath::from(path), times, width, values }.into_chunk()?);
        }
        for (path, rows) in std::mem::take(&mut self.labels) {
            let (times, labels) = rows.columns();
            let changes = rerun::StateChange::update_fields().with_state(labels);
            chunks.push(columns(path, times, changes.columns_of_unit_batches())?);
        }
        for (path, rows) in std::mem::take(&mut self.texts) {
            let (times, words) = rows.columns();
            let documents = rerun::TextDocument::update_fields().with_many_text(words);
            chunks.push(columns(path, times, documents.columns_of_unit_batches())?);
        }
        for (path, rows) in std::mem::take(&mut self.bytes) {
            let (times, blobs) = rows.columns();
            let blobs = blobs.into_iter().map(rerun::components::Blob::from);
            let array = rerun::components::Blob::to_arrow(blobs.map(std::borrow::Cow::Owned)).map_err(text)?;
            let column = SerializedComponentBatch::new(array, ComponentDescriptor::partial(BYTES))
                .partitioned(std::iter::repeat_n(1, times.len()));
            chunks.push(columns(path, times, column.map(|column| [column]))?);
        }
        Ok(chunks)
    }
}
