//! What recording costs per tick, next to the same columns sent with plain Rerun calls.

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use std::path::Path;
use std::sync::OnceLock;
use supertwin_core::run::Properties;
use supertwin_core::{Probe, RunHeader, RunSink, Signal, Tick};
use supertwin_rerun::{Options, RerunSink};

const TICKS: u64 = 5000;
const BATCH: usize = 1000;
const DT_NS: i64 = 20_000_000;

fn signals() -> &'static [Signal] {
    static MADE: OnceLock<Vec<Signal>> = OnceLock::new();
    MADE.get_or_init(|| {
        let path = |i| Box::leak(format!("bench/signal_{i}").into_boxed_str());
        let components = &["surge", "sway", "heave", "yaw"];
        (0..40).map(|i| Signal { path: path(i), components, units: &["N"], about: "" }).collect()
    })
}

/// Smooth like a real signal: constant columns would compress to nothing.
fn values(k: u64, signal: usize) -> [f64; 4] {
    let t = k as f64 * 0.02 + signal as f64;
    let x = t * (1.0 - t * 1e-3);
    [x, x * x, x * 0.7 - 1.0, 1.0 / (1.0 + t)]
}

fn ours(path: &Path, compress: bool) {
    let options = Options { batch_ticks: BATCH, overwrite: true, compress, ..Options::default() };
    let mut sink = RerunSink::create(path, options).expect("sink");
    sink.begin(&RunHeader { name: "bench".to_owned(), ..Default::default() }).expect("begin");
    for k in 0..TICKS {
        sink.tick(Tick { k, dt_s: 0.02 }).expect("tick");
        for (i, signal) in signals().iter().enumerate() {
            sink.vector(signal, &values(k, i));
        }
    }
    sink.finish(&Properties::new()).expect("finish");
}

fn plain(path: &Path) {
    let stream = rerun::RecordingStreamBuilder::new("bench").recording_id("bench").save(path).expect("stream");
    let entities: Vec<_> = signals().iter().map(|signal| rerun::EntityPath::from(signal.path)).collect();
    for start in (0..TICKS).step_by(BATCH) {
        let ticks = start..start + BATCH as u64;
        for (i, entity) in entities.iter().enumerate() {
            let times = [
                rerun::TimeColumn::new_duration_nanos("sim_time", ticks.clone().map(|k| k as i64 * DT_NS)),
                rerun::TimeColumn::new_sequence("tick", ticks.clone().map(|k| k as i64)),
            ];
            let scalars = rerun::Scalars::new(ticks.clone().flat_map(|k| values(k, i)));
            let columns = scalars.columns(std::iter::repeat_n(4, BATCH)).expect("columns");
            stream.send_columns(entity.clone(), times, columns).expect("send");
        }
    }
    stream.flush_blocking().expect("flush");
    stream.disconnect();
}

fn record(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().expect("directory");
    let mut group = criterion.benchmark_group("record 40 signals x 4");
    group.throughput(Throughput::Elements(TICKS)).sample_size(20);
    let ways = [("supertwin", Some(true)), ("supertwin without compression", Some(false)), ("plain rerun", None)];
    for (name, compress) in ways {
        let path = folder.path().join(format!("{name}.rrd"));
        let run = || compress.map_or_else(|| plain(&path), |compress| ours(&path, compress));
        group.bench_function(name, |bencher| bencher.iter_batched(|| (), |()| run(), BatchSize::PerIteration));
    }
    group.finish();
}

criterion_group!(benches, record);
criterion_main!(benches);
