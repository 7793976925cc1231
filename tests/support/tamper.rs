//! A recording that was tampered with.

use super::CONFIG;
use std::path::Path;
use supertwin_core::run::Properties;
use supertwin_core::{Event, Probe, RunHeader, RunSink, Signal, SinkError, Tick};
use supertwin_lab::{Library, trial};
use supertwin_rerun::{Options, RerunSink};

/// Keeps a run, but for one number or one word of it.
pub struct Tamper {
    sink: RerunSink,
    now: u64,
    done: bool,
    /// Tick and path of what is changed.
    pub at: (u64, &'static str),
    /// What becomes of the number.
    pub number: fn(f64) -> f64,
    /// What becomes of the properties.
    pub properties: fn(&mut Properties),
}

impl Probe for Tamper {
    fn vector(&mut self, signal: &'static Signal, values: &[f64]) {
        let mut values = values.to_vec();
        if self.at == (self.now, signal.path) {
            values[1] = (self.number)(values[1]);
            self.done = true;
        }
        self.sink.vector(signal, &values);
    }
    fn label(&mut self, signal: &'static Signal, value: &'static str) {
        let tampered = self.at == (self.now, signal.path);
        self.done |= tampered;
        self.sink.label(signal, if tampered { "neutral" } else { value });
    }
}

impl RunSink for Tamper {
    fn begin(&mut self, header: &RunHeader) -> Result<(), SinkError> {
        let mut header = header.clone();
        (self.properties)(&mut header.properties);
        self.sink.begin(&header)
    }
    fn tick(&mut self, tick: Tick) -> Result<(), SinkError> {
        self.now = tick.k;
        self.sink.tick(tick)
    }
    fn event(&mut self, event: &Event) -> Result<(), SinkError> {
        self.sink.event(event)
    }
    fn finish(&mut self, results: &Properties) -> Result<(), SinkError> {
        self.sink.finish(results)
    }
}

/// Records a GSTA run with these overrides and seed that is changed on the way; whether there was something to change. A
/// number loses its last bit unless `change` says otherwise.
pub fn tampered(file: &Path, sets: [&str; 2], seed: u64, change: impl FnOnce(&mut Tamper)) -> bool {
    let library = Library::new(CONFIG, sets.map(|set| set.parse().expect("legal")).to_vec());
    let trial = trial::load(&library, "paper-gsta").expect("is legal").swap_remove(0);
    let sink = RerunSink::create(file, Options::default()).expect("is created");
    let number = |x: f64| f64::from_bits(x.to_bits() ^ 1);
    let mut sink = Tamper { sink, now: 0, done: false, at: (u64::MAX, ""), number, properties: |_| {} };
    change(&mut sink);
    supertwin_lab::run(&trial, seed, &mut sink, Some(&Properties::new()), |_| true).expect("runs");
    sink.done
}
