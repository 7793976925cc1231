//! A full lap: plant, sensors, estimator, guidance, AGSTA, allocation, hash, score.
//!
//! `cargo bench -p supertwin-lab --bench lap` times it with criterion. `… --bench lap -- --instructions` counts the
//! instructions of a tick instead: the program runs itself twice under callgrind, with few and with many ticks, and
//! divides the difference, so that start-up costs cancel. That figure is the same on a busy machine.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "a bench")]

use criterion::{Criterion, Throughput, criterion_group};
use std::hint::black_box;
use std::process::Command;
use supertwin_core::digest::DigestProbe;
use supertwin_core::{NoSink, Tick};
use supertwin_lab::{Library, ResolvedTrial, Twin, trial};

/// Ticks of the two counted runs.
const COUNTED: [u64; 2] = [1_000, 11_000];

fn load(name: &str, overrides: &[&str]) -> ResolvedTrial {
    let overrides = overrides.iter().map(|text| text.parse().unwrap()).collect();
    let library = Library::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../config"), overrides);
    trial::load(&library, name).unwrap().remove(0)
}

fn whole_runs(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("run");
    group.sample_size(20);
    for name in ["paper-gsta", "paper-agsta", "paper-pid"] {
        let trial = load(name, &[]);
        group.throughput(Throughput::Elements(trial.ticks()));
        group.bench_function(name, |bencher| {
            bencher.iter(|| supertwin_lab::run(&trial, black_box(1), &mut NoSink, None, |_| true).unwrap());
        });
    }
    group.finish();
}

fn parts(criterion: &mut Criterion) {
    let trial = load("paper-agsta", &[]);
    let mut twin = Twin::new(&trial, 1).unwrap();
    let mut k = 0;
    for step in &trial.trial.mission {
        twin.command(Tick { k, dt_s: 0.02 }, &step.command).unwrap();
    }
    let mut group = criterion.benchmark_group("tick");
    group.bench_function("four blocks", |bencher| {
        bencher.iter(|| {
            twin.step(Tick { k, dt_s: 0.02 });
            k += 1;
        });
    });
    let mut probe = DigestProbe::default();
    group.bench_function("state hash", |bencher| {
        bencher.iter(|| twin.digest(Tick { k, dt_s: 0.02 }, &mut probe).unwrap());
    });
    group.finish();
}

criterion_group!(benches, whole_runs, parts);

fn instructions() {
    let program = std::env::current_exe().unwrap();
    let count = |ticks: u64| -> u64 {
        let out = Command::new("valgrind")
            .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
            .arg(&program)
            .args(["--ticks", &ticks.to_string()])
            .output()
            .expect("valgrind must be installed to count instructions");
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let text = String::from_utf8_lossy(&out.stderr);
        let line = text.lines().find(|line| line.contains("Collected :")).expect("callgrind prints its total");
        line.rsplit(' ').next().unwrap().parse().unwrap()
    };
    let [few, many] = COUNTED.map(count);
    println!("instructions per tick: {:.0}", (many - few) as f64 / (COUNTED[1] - COUNTED[0]) as f64);
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let Some(at) = arguments.iter().position(|argument| argument == "--ticks") {
        // The trial of the table: AGSTA, net following from 17 s, for as long as asked.
        let duration_s = arguments[at + 1].parse::<f64>().unwrap() * 0.02;
        let trial = load("paper-agsta", &[&format!("trial.duration_s={duration_s}"), "trial.score.from_s=0.0"]);
        black_box(supertwin_lab::run(&trial, 1, &mut NoSink, None, |_| true).unwrap());
    } else if arguments.iter().any(|argument| argument == "--instructions") {
        instructions();
    } else {
        benches();
        Criterion::default().configure_from_args().final_summary();
    }
}
