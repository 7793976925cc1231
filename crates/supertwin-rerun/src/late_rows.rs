//! Rows of ticks that were written without them: what a cut link brings after its end.

use crate::chunks::{Clocks, Problem, Rows, Times, columns, text};
use crate::sink::nanos;
use rerun::EntityPath;
use rerun::log::Chunk;
use std::collections::BTreeMap;
use supertwin_core::{Signal, Tick};

/// What came too late, signal by signal.
#[derive(Default)]
pub(crate) struct LateRows {
    /// Where what is shown belongs to, while it is not the present tick.
    pub(crate) at: Option<(Tick, Clocks)>,
    numbers: BTreeMap<&'static str, Late<f64>>,
    labels: BTreeMap<&'static str, Late<&'static str>>,
}

struct Late<T> {
    width: usize,
    ticks: Vec<i64>,
    nanos: Vec<i64>,
    clocks: Vec<Clocks>,
    values: Vec<T>,
}

impl<T> Late<T> {
    fn new(width: usize) -> Self {
        Self { width, ticks: Vec::new(), nanos: Vec::new(), clocks: Vec::new(), values: Vec::new() }
    }

    fn add(&mut self, tick: Tick, clocks: Clocks, values: impl IntoIterator<Item = T>) {
        self.ticks.push(tick.k as i64);
        self.nanos.push(nanos(tick));
        self.clocks.push(clocks);
        self.values.extend(values);
    }

    fn times(ticks: Vec<i64>, nanos: Vec<i64>, clocks: &[Clocks]) -> Times {
        Times::new(ticks, nanos).with_clocks(clocks)
    }
}

impl LateRows {
    /// A row of numbers; false when it has another width than those before.
    pub(crate) fn numbers(&mut self, signal: &'static Signal, values: &[f64]) -> bool {
        let Some((tick, clocks)) = self.at else { return true };
        let late = self.numbers.entry(signal.path).or_insert_with(|| Late::new(values.len()));
        if late.width != values.len() {
            return false;
        }
        late.add(tick, clocks, values.iter().copied());
        true
    }

    /// A label that has changed.
    pub(crate) fn label(&mut self, signal: &'static Signal, value: &'static str) {
        if let Some((tick, clocks)) = self.at {
            self.labels.entry(signal.path).or_insert_with(|| Late::new(1)).add(tick, clocks, [value]);
        }
    }

    /// Everything so far, as chunks; leaves nothing behind.
    pub(crate) fn chunks(&mut self) -> Result<Vec<Chunk>, Problem> {
        let mut chunks = Vec::new();
        for (path, late) in std::mem::take(&mut self.numbers) {
            let times = Late::<f64>::times(late.ticks, late.nanos, &late.clocks);
            let rows = Rows { entity: EntityPath::from(path), times, width: late.width, values: late.values };
            chunks.push(rows.into_chunk()?);
        }
        for (path, late) in std::mem::take(&mut self.labels) {
            let times = Late::<&str>::times(late.ticks, late.nanos, &late.clocks);
            let changes = rerun::StateChange::update_fields().with_state(late.values);
            chunks.push(columns(EntityPath::from(path), times, changes.columns_of_unit_batches().map_err(text)?)?);
        }
        Ok(chunks)
    }
}
