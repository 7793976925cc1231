//! What the tests of the lab share: the shipped configuration, and sinks that listen.
#![allow(dead_code, unreachable_pub, reason = "each test file uses its part")]

pub mod kept;

use supertwin_core::run::Properties;
use supertwin_core::{Event, NoSink, Probe, RunHeader, RunSink, Signal, SinkError, Tick};
use supertwin_lab::{Library, Override, ResolvedTrial, RunOutcome, Scores, run, trial};

/// The shipped configuration with overrides.
pub fn library(overrides: &[&str]) -> Library {
    let overrides: Vec<Override> = overrides.iter().map(|text| text.parse().expect("a legal override")).collect();
    Library::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../config"), overrides)
}

/// A shipped trial's first controller.
pub fn load(name: &str, overrides: &[&str]) -> ResolvedTrial {
    load_all(name, overrides).remove(0)
}

/// A shipped trial, one per controller.
pub fn load_all(name: &str, overrides: &[&str]) -> Vec<ResolvedTrial> {
    trial::load(&library(overrides), name).expect("a shipped trial")
}

/// Runs without a sink.
pub fn outcome(trial: &ResolvedTrial, seed: u64) -> RunOutcome {
    run(trial, seed, &mut NoSink, None, |_| true).expect("a run without NaN")
}

/// Scores of the seeds 1..=n.
pub fn scores(trial: &ResolvedTrial, n: u64) -> Vec<Scores> {
    (1..=n).map(|seed| outcome(trial, seed).scores).collect()
}

/// Mean of a score over runs.
pub fn mean(scores: &[Scores], value: impl Fn(&Scores) -> f64) -> f64 {
    scores.iter().map(value).sum::<f64>() / scores.len() as f64
}

/// Remembers one signal, all events, and how often it was called.
#[derive(Default)]
pub struct Listener {
    pub path: &'static str,
    pub rows: Vec<(u64, Vec<f64>)>,
    pub events: Vec<Event>,
    pub header: Option<RunHeader>,
    pub results: Option<Properties>,
    pub signals: std::collections::BTreeSet<&'static str>,
    tick: u64,
}

impl Listener {
    /// Listens to one signal.
    pub fn to(path: &'static str) -> Self {
        Self { path, ..Self::default() }
    }
}

impl Probe for Listener {
    fn vector(&mut self, signal: &'static Signal, values: &[f64]) {
        self.signals.insert(signal.path);
        if signal.path == self.path {
            self.rows.push((self.tick, values.to_vec()));
        }
    }
    fn label(&mut self, signal: &'static Signal, _: &'static str) {
        self.signals.insert(signal.path);
    }
}

impl RunSink for Listener {
    fn begin(&mut self, header: &RunHeader) -> Result<(), SinkError> {
        self.header = Some(header.clone());
        Ok(())
    }
    fn tick(&mut self, tick: Tick) -> Result<(), SinkError> {
        self.tick = tick.k;
        Ok(())
    }
    fn event(&mut self, event: &Event) -> Result<(), SinkError> {
        self.events.push(event.clone());
        Ok(())
    }
    fn finish(&mut self, results: &Properties) -> Result<(), SinkError> {
        self.results = Some(results.clone());
        Ok(())
    }
}
