//! What the tests of the lab share: the shipped configuration, and runs that are kept.
#![allow(dead_code, unreachable_pub, reason = "each test file uses its part")]

pub mod kept;

use supertwin_core::{NoSink, Tick};
use supertwin_lab::mission::Mission;
use supertwin_lab::{Library, Override, ResolvedTrial, RunOutcome, Scores, Twin, run, trial};

/// Folder of the shipped configuration.
pub const CONFIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config");

/// The shipped configuration with overrides.
pub fn library(overrides: &[&str]) -> Library {
    let overrides: Vec<Override> = overrides.iter().map(|text| text.parse().expect("a legal override")).collect();
    Library::new(CONFIG, overrides)
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

/// A twin that goes through its mission; `look` sees it after every step of the first `ticks`.
pub fn fly(trial: &ResolvedTrial, ticks: u64, mut look: impl FnMut(Tick, &mut Twin)) {
    let mut twin = Twin::new(trial, 1).expect("legal");
    let mut mission = Mission::new(&trial.trial.mission, 0.02);
    for k in 0..ticks {
        let tick = Tick { k, dt_s: 0.02 };
        while let Some(command) = mission.due(tick) {
            twin.command(tick, command).expect("accepted");
        }
        twin.step(tick);
        look(tick, &mut twin);
    }
}
