//! How long the scores of 200 recordings take, from their files alone, on all cores.
//!
//! `cargo bench -p supertwin-operations --bench scores`. Twenty runs are recorded once, and each is read ten times: what is measured
//! is reading and scoring, with the files in the page cache.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a bench that can not go on has failed, and says what it measured"
)]

use rayon::prelude::*;
use std::path::PathBuf;
use std::time::Instant;
use supertwin_core::run::Properties;
use supertwin_lab::{Library, Scores, rescore, trial};
use supertwin_rerun::{Options, RerunSink, read_selected};

const RUNS: u64 = 20;
const READS: usize = 200;

#[allow(clippy::disallowed_methods, reason = "a bench measures time")]
fn main() {
    let folder = tempfile::tempdir().expect("a folder");
    let library = Library::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../config"), Vec::new());
    let trial = trial::load(&library, "fair").expect("is legal").swap_remove(0);
    let runs: Vec<(PathBuf, Scores)> = (1..=RUNS)
        .map(|seed| {
            let path = folder.path().join(format!("{seed}.rrd"));
            let mut sink = RerunSink::create(&path, Options::default()).expect("a file");
            let outcome = supertwin_lab::run(&trial, seed, &mut sink, Some(&Properties::new()), |_| true);
            (path, outcome.expect("runs").scores)
        })
        .collect();
    let megabytes = runs[0].0.metadata().expect("is there").len() as f64 / 1e6;
    let length_s = trial.trial.duration_s.get();
    for round in 1..=3 {
        let began = Instant::now();
        let equal = (0..READS).into_par_iter().filter(|i| {
            let (path, scores) = &runs[i % runs.len()];
            let recording = read_selected(path, &rescore::is_needed).expect("is read");
            rescore(&recording).expect("is scored").scores == *scores
        });
        let equal = equal.count();
        let took_s = began.elapsed().as_secs_f64();
        println!(
            "round {round}: {READS} recordings of {length_s} s and {megabytes:.1} MB scored in {took_s:.2} s, {equal} as the run itself"
        );
    }
}
