//! Rows of ticks that were written without them: what a cut link brings after its end.

use crate::chunks::{Clocks, Problem, Rows, TimedValues, columns, text};
use rerun::EntityPath;
use rerun::log::Chunk;
use std::collections::BTreeMap;
use supertwin_core::{Signal, Tick};

/// What came too late, signal by signal.
#[derive(Default)]
pub(crate) struct LateRows {
    /// Where what is shown belongs to, while it is not the present tick.
    pub(crate) at: Option<(Tick, Clocks)>,
    /// Width of a row, and the rows.
    numbers: BTreeMap<&'static str, (usize, TimedValues<f64>)>,
    labels: BTreeMap<&'static str, TimedValues<&'static str>>,
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
        for (path, (width, mut rows)) in std::mem::take(&mut self.numbers) {
            let Some((times, values)) = rows.take() else { continue };
            chunks.push(Rows { entity: EntityPath::from(path), times, width, values }.into_chunk()?);
        }
        for (path, mut rows) in std::mem::take(&mut self.labels) {
            let Some((times, labels)) = rows.take() else { continue };
            let changes = rerun::StateChange::update_fields().with_state(labels);
            chunks.push(columns(EntityPath::from(path), times, changes.columns_of_unit_batches().map_err(text)?)?);
        }
        Ok(chunks)
    }
}
