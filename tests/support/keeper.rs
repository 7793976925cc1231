//! Keeps a run in memory, to be read again and changed.
#![allow(unreachable_pub, reason = "two programs of tests use it")]

use supertwin_core::run::Properties;
use supertwin_core::source::Label;
use supertwin_core::{Event, Probe, RecordedRun, RunHeader, RunSink, Signal, SinkError, Tick};

/// Keeps a run in memory.
#[derive(Clone, Debug, Default)]
pub struct Keeper {
    pub run: RecordedRun,
    tick: i64,
}

impl Probe for Keeper {
    fn vector(&mut self, signal: &'static Signal, values: &[f64]) {
        let columns = self.run.signals.entry(signal.path.to_owned()).or_default();
        columns.width = values.len();
        columns.tick.push(self.tick);
        columns.time_ns.push(self.tick * 20_000_000);
        columns.values.extend_from_slice(values);
    }
    fn label(&mut self, signal: &'static Signal, value: &'static str) {
        let labels = self.run.labels.entry(signal.path.to_owned()).or_default();
        if labels.last().is_none_or(|last| last.value != value) {
            labels.push(Label { tick: self.tick, time_ns: self.tick * 20_000_000, value: value.to_owned() });
        }
    }
}

impl RunSink for Keeper {
    fn begin(&mut self, header: &RunHeader) -> Result<(), SinkError> {
        self.run.name.clone_from(&header.name);
        self.run.properties.insert("run".to_owned(), header.properties.clone());
        Ok(())
    }
    fn tick(&mut self, tick: Tick) -> Result<(), SinkError> {
        self.tick = tick.k as i64;
        Ok(())
    }
    fn event(&mut self, event: &Event) -> Result<(), SinkError> {
        self.run.events.push(event.clone());
        Ok(())
    }
    fn finish(&mut self, results: &Properties) -> Result<(), SinkError> {
        self.run.properties.insert("result".to_owned(), results.clone());
        Ok(())
    }
}
