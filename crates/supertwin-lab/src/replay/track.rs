//! What a block showed while it was replayed, and the first place where that is not what was recorded.

use super::Difference;
use std::collections::{BTreeMap, BTreeSet};
use supertwin_core::observe::Slots;
use supertwin_core::source::{Columns, Label};
use supertwin_core::{Event, Observe, Probe, RecordedRun, Signal, Tick};

/// Rows of one signal.
#[derive(Clone, Debug, Default)]
struct Rows {
    tick: Vec<u64>,
    width: usize,
    values: Vec<f64>,
}

/// One block over a run.
#[derive(Clone, Debug, Default)]
pub(crate) struct Track {
    pub(crate) service: &'static str,
    dt_s: f64,
    tick: u64,
    vectors: Slots<Rows>,
    labels: Slots<Vec<(u64, &'static str)>>,
    pub(crate) events: Vec<Event>,
}

impl Probe for Track {
    fn vector(&mut self, signal: &'static Signal, values: &[f64]) {
        let rows = self.vectors.get_or_insert_with(signal, || Rows { width: values.len(), ..Rows::default() });
        // A signal keeps its width; a vehicle without thrusters shows an empty one, which is not recorded.
        if rows.width == values.len() && !values.is_empty() {
            rows.tick.push(self.tick);
            rows.values.extend_from_slice(values);
        }
    }
    fn label(&mut self, signal: &'static Signal, value: &'static str) {
        self.labels.get_or_insert_with(signal, Vec::new).push((self.tick, value));
    }
}

impl Track {
    pub(crate) fn new(service: &'static str, dt_s: f64) -> Self {
        Self { service, dt_s, ..Self::default() }
    }

    /// What `block` and its output show at `tick`.
    pub(crate) fn show(&mut self, tick: u64, block: &impl Observe, out: &impl Observe) {
        (self.tick, self.vectors.cursor, self.labels.cursor) = (tick, 0, 0);
        block.observe(self);
        out.observe(self);
    }

    /// Its signals, by path.
    pub(crate) fn signals(&self) -> impl Iterator<Item = &'static Signal> {
        let vectors = self.vectors.slots.iter().map(|(signal, _)| *signal);
        vectors.chain(self.labels.slots.iter().map(|(signal, _)| *signal))
    }

    fn time_ns(&self, tick: u64) -> i64 {
        (Tick { k: tick, dt_s: self.dt_s }.t_s() * 1e9).round() as i64
    }

    /// As a recording has it.
    pub(crate) fn columns(&self) -> BTreeMap<String, Columns> {
        let mut columns = BTreeMap::new();
        for (signal, rows) in &self.vectors.slots {
            let names = signal.components.iter().map(|name| (*name).to_owned()).collect();
            let mut one = Columns {
                names,
                tick: rows.tick.iter().map(|&tick| tick.cast_signed()).collect(),
                time_ns: rows.tick.iter().map(|&tick| self.time_ns(tick)).collect(),
                width: rows.width,
                values: rows.values.clone(),
                clocks: BTreeMap::new(),
            };
            one.sort();
            columns.insert(signal.path.to_owned(), one);
        }
        columns
    }

    /// Changes of its labels, as a recording has them.
    pub(crate) fn changes(&self) -> BTreeMap<String, Vec<Label>> {
        let mut changes = BTreeMap::new();
        for (signal, values) in &self.labels.slots {
            let mut values = values.clone();
            values.sort_by_key(|(tick, _)| *tick);
            values.dedup_by_key(|(_, value)| *value);
            let label = |(tick, value): (u64, &str)| Label {
                tick: tick.cast_signed(),
                time_ns: self.time_ns(tick),
                value: value.to_owned(),
            };
            changes.insert(signal.path.to_owned(), values.into_iter().map(label).collect::<Vec<_>>());
        }
        changes
    }

    /// The first place where what was recorded at the ticks of `compared` is not what was shown: of the earliest tick the
    /// first in the order in which the block shows itself.
    pub(crate) fn first_difference(&self, source: &RecordedRun, compared: &BTreeSet<u64>) -> Option<Difference> {
        let mut found = Vec::new();
        let mut differs = |tick: u64, signal: &str, component: &str, recorded: String, replayed: String| {
            found.push(Difference {
                service: self.service.to_owned(),
                tick,
                signal: signal.to_owned(),
                component: component.to_owned(),
                recorded,
                replayed,
            });
        };
        let empty = Columns::default();
        for (signal, rows) in &self.vectors.slots {
            let recorded = source.signals.get(signal.path).unwrap_or(&empty);
            for (row, &tick) in rows.tick.iter().enumerate().filter(|(_, tick)| compared.contains(tick)) {
                let shown = &rows.values[row * rows.width..][..rows.width];
                let Some(known) = recorded.at(tick.cast_signed()) else {
                    differs(tick, signal.path, "", "not there".to_owned(), format!("{shown:?}"));
                    break;
                };
                if known.len() != shown.len() {
                    let count = |values: &[f64]| format!("{} components", values.len());
                    differs(tick, signal.path, "", count(known), count(shown));
                    break;
                }
                if let Some(i) = (0..shown.len()).find(|&i| known[i].to_bits() != shown[i].to_bits()) {
                    let component = signal.components.get(i).copied().unwrap_or_default();
                    differs(tick, signal.path, component, number_text(known[i]), number_text(shown[i]));
                    break;
                }
            }
        }
        for (signal, values) in &self.labels.slots {
            let recorded = source.label(signal);
            for (tick, shown) in values.iter().filter(|(tick, _)| compared.contains(tick)) {
                let at = recorded.partition_point(|label| label.tick <= tick.cast_signed());
                let known = at.checked_sub(1).map_or("not there", |at| recorded[at].value.as_str());
                if known != *shown {
                    differs(*tick, signal.path, "", known.to_owned(), (*shown).to_owned());
                    break;
                }
            }
        }
        // What was recorded and is not shown any more.
        let prefix = format!("{}/", self.service);
        for (path, columns) in source.signals.iter().filter(|(path, _)| path.starts_with(&prefix)) {
            let shown = self.vectors.slots.iter().find(|(signal, _)| signal.path == path).map(|(_, rows)| &rows.tick);
            let shown: BTreeSet<u64> = shown.into_iter().flatten().copied().collect();
            let gone = columns.tick.iter().filter_map(|&tick| u64::try_from(tick).ok());
            if let Some(tick) = gone.filter(|tick| compared.contains(tick)).find(|tick| !shown.contains(tick)) {
                let known = columns.at(tick.cast_signed()).unwrap_or_default();
                differs(tick, path, "", format!("{known:?}"), "not there".to_owned());
            }
        }
        found.into_iter().min_by_key(|difference| difference.tick)
    }
}

/// A number with all its digits; two that print alike differ in their bits.
fn number_text(number: f64) -> String {
    format!("{number:?} (0x{:016x})", number.to_bits())
}
