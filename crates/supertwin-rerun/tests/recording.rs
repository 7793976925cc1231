//! What goes into a recording comes out of it.

#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use crate::common::{DT_S, header, play, results};
use std::fs;
use std::path::Path;
use supertwin_core::observe::{Both, Probe, Snapshot};
use supertwin_core::run::Properties;
use supertwin_core::signal::{estimator, nav, reference, thrust, tracking};
use supertwin_core::{Event, Property, RunHeader, RunSink, Severity, Signal, SinkError, Tick};
use supertwin_rerun::{Clocks, Options, ReadError, Recording, RerunSink, read, signals};

static WIDE: Signal = Signal { path: "test/wide", components: &["a", "b", "c"], units: &["m", "s"], about: "" };
static SPARSE: Signal = Signal { path: "test/sparse", components: &[], units: &["m"], about: "" };
static NEVER: Signal = Signal { path: "test/never", components: &["t1"], units: &["N"], about: "" };

/// A recording next to what it should contain.
struct Doubled {
    sink: RerunSink,
    heard: Vec<(Tick, Snapshot)>,
}

impl Probe for Doubled {
    fn vector(&mut self, signal: &'static Signal, values: &[f64]) {
        Both(&mut self.sink, &mut self.heard.last_mut().unwrap().1).vector(signal, values);
    }
    fn label(&mut self, signal: &'static Signal, value: &'static str) {
        Both(&mut self.sink, &mut self.heard.last_mut().unwrap().1).label(signal, value);
    }
}

impl RunSink for Doubled {
    fn begin(&mut self, header: &RunHeader) -> Result<(), SinkError> {
        self.sink.begin(header)
    }
    fn tick(&mut self, tick: Tick) -> Result<(), SinkError> {
        self.heard.push((tick, Snapshot::default()));
        self.sink.tick(tick)
    }
    fn event(&mut self, event: &Event) -> Result<(), SinkError> {
        self.sink.event(event)
    }
    fn finish(&mut self, results: &Properties) -> Result<(), SinkError> {
        self.sink.finish(results)
    }
}

fn create(path: &Path) -> RerunSink {
    RerunSink::create(path, Options { batch_ticks: 128, ..Default::default() }).unwrap()
}

fn record(path: &Path, ticks: u64) -> Recording {
    let mut sink = create(path);
    sink.begin(&header("run-7")).unwrap();
    play(&mut sink, ticks).unwrap();
    sink.finish(&results()).unwrap();
    read(path).unwrap()
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|x| x.to_bits()).collect()
}

#[test]
fn what_came_after_its_tick_was_written_stands_at_its_tick() {
    static STATE: Signal = Signal { path: "test/state", components: &[], units: &[], about: "" };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    let mut sink = create(&path);
    sink.begin(&header("run-7")).unwrap();
    let tick = |k: u64| Tick { k, dt_s: DT_S };
    for k in 0..30_u64 {
        sink.tick(tick(k)).unwrap();
        sink.clocks(Clocks { sender_ns: 7, recorder_ns: k.cast_signed() });
        sink.vector(&SPARSE, &[k as f64]);
        if !(10..20).contains(&k) {
            sink.vector(&WIDE, &[k as f64, 0.5, -0.0]);
            sink.label(&STATE, if k < 10 { "before" } else { "after" });
        }
        if k == 19 {
            // The far side of a cut link is heard again; nothing of a tick is waiting to be written.
            sink.flush().unwrap();
            for k in 10..20_u64 {
                sink.late_tick(tick(k), Clocks { sender_ns: 7, recorder_ns: 19 });
                sink.vector(&WIDE, &[k as f64, 0.5, -0.0]);
                sink.label(&STATE, if k < 15 { "before" } else { "cut" });
            }
        }
    }
    sink.finish(&results()).unwrap();
    let recording = read(&path).unwrap();
    assert!(recording.complete);
    let wide = &recording.signals["test/wide"];
    assert_eq!(wide.tick, (0..30).collect::<Vec<_>>());
    assert_eq!(bits(wide.at(13).unwrap()), bits(&[13.0, 0.5, -0.0]));
    assert_eq!(wide.clocks["recorder_clock"][13..21], [19, 19, 19, 19, 19, 19, 19, 20].map(Some));
    assert_eq!(recording.signals["test/sparse"].tick, wide.tick);
    let states: Vec<(i64, &str)> =
        recording.labels["test/state"].iter().map(|label| (label.tick, label.value.as_str())).collect();
    assert_eq!(states, [(0, "before"), (15, "cut"), (20, "after")]);
}

#[test]
fn every_value_comes_back_bit_by_bit_with_its_tick() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    let mut doubled = Doubled { sink: create(&path), heard: Vec::new() };
    doubled.begin(&header("run-7")).unwrap();
    play(&mut doubled, 1601).unwrap();
    doubled.finish(&results()).unwrap();

    let recording = read(&path).unwrap();
    assert!(recording.complete);
    assert_eq!(recording.name, "run-7");
    let mut shown = 0;
    for (tick, snapshot) in &doubled.heard {
        for (signal, values) in &snapshot.vectors {
            let columns = &recording.signals[signal.path];
            assert_eq!(bits(columns.at(tick.k as i64).unwrap()), bits(values), "{} {tick:?}", signal.path);
            shown += 1;
        }
    }
    assert_eq!(shown, 17 * 1601 - 1601 + 161);
    let heard =
        recording.signals.iter().filter(|(path, _)| signals::SIGNALS.iter().all(|derived| *path != derived.path));
    assert_eq!(heard.map(|(_, columns)| columns.tick.len()).sum::<usize>(), shown);
    for (path, columns) in &recording.signals {
        assert!(columns.tick.windows(2).all(|pair| pair[0] < pair[1]), "{path}");
        let times = columns.tick.iter().map(|tick| tick * 20_000_000);
        assert!(times.eq(columns.time_ns.iter().copied()), "{path}");
        assert_eq!(columns.names.len(), columns.width, "{path}");
    }
}

#[test]
fn signals_that_show_themselves_now_and_then_keep_their_ticks() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    let mut sink = create(&path);
    sink.begin(&header("sparse")).unwrap();
    for k in 5..1000 {
        sink.tick(Tick { k, dt_s: DT_S }).unwrap();
        if k % 7 == 0 {
            sink.scalar(&SPARSE, -(k as f64));
        }
        sink.vector(&NEVER, &[]);
        sink.vector(&WIDE, &[f64::NAN, -0.0]);
    }
    sink.finish(&Properties::new()).unwrap();
    let recording = read(&path).unwrap();
    let sparse = &recording.signals["test/sparse"];
    assert!(sparse.tick.iter().copied().eq((5..1000).filter(|k| k % 7 == 0)));
    assert!(sparse.values.iter().zip(&sparse.tick).all(|(x, &k)| *x == -(k as f64)));
    let wide = &recording.signals["test/wide"];
    assert_eq!((wide.tick.len(), wide.width), (995, 2));
    assert_eq!(bits(&wide.values[1988..]), bits(&[f64::NAN, -0.0]));
    assert_eq!(wide.names, ["a [m]", "b [s]"]);
    assert!(!recording.signals.contains_key("test/never"));
}

#[test]
fn labels_are_written_when_they_change() {
    let folder = tempfile::tempdir().unwrap();
    let recording = record(&folder.path().join("run.rrd"), 1200);
    let mode = &recording.labels[reference::MODE.path];
    let changes: Vec<_> = mode.iter().map(|label| (label.tick, label.time_ns, label.value.as_str())).collect();
    let expected =
        [(0, 0, "neutral"), (100, 2_000_000_000, "depth_heading_hold"), (1001, 20_020_000_000, "follow_net")];
    assert_eq!(changes, expected);
}

#[test]
fn events_come_back_with_service_and_severity() {
    let folder = tempfile::tempdir().unwrap();
    let recording = record(&folder.path().join("run.rrd"), 1600);
    let events: Vec<_> = recording.events.iter().map(|event| (event.tick, &*event.service, event.severity)).collect();
    let expected = [
        (100, "guidance", Severity::Info),
        (300, "estimator", Severity::Warning),
        (1000, "guidance", Severity::Info),
        (1500, "guidance", Severity::Error),
    ];
    assert_eq!(events, expected);
    assert_eq!(recording.events[1].text(), "no velocity from the DVL for 0.5 s: dead reckoning");
}

#[test]
fn properties_keep_their_types() {
    let folder = tempfile::tempdir().unwrap();
    let recording = record(&folder.path().join("run.rrd"), 10);
    assert_eq!(recording.properties["run"], header("").properties);
    assert_eq!(recording.properties["run"]["seed"], Property::Integer(u64::MAX));
    assert_eq!(recording.properties["result"], results());
}

#[test]
fn there_is_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let recording = record(&folder.path().join("run.rrd"), 1000);
    assert_eq!(recording.rows["world/vehicle"], 201);
    // Once how they look, once that nobody has judged them.
    assert_eq!(recording.rows["world/vehicle/beams"], 102);
    assert_eq!(recording.rows["world/path"], 39);
    for still in ["world", "world/net", "world/vehicle/body", "world/vehicle/bow", "world/vehicle/marker"] {
        assert_eq!(recording.rows[still], 1, "{still}");
    }
}

#[test]
fn the_chattering_of_a_staircase_is_its_steps_per_second() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    let mut sink = create(&path);
    sink.begin(&header("stairs")).unwrap();
    for k in 0..400 {
        sink.tick(Tick { k, dt_s: DT_S }).unwrap();
        let up_and_down = if k % 2 == 0 { 0.0 } else { 3.0 };
        // The last axis rises at one tick only, from batch to batch.
        sink.vector(&thrust::REQUESTED, &[up_and_down, k as f64, -2.0, if k < 128 { 0.0 } else { 7.0 }]);
    }
    sink.finish(&Properties::new()).unwrap();
    let chattering = &read(&path).unwrap().signals[signals::CHATTERING.path];
    assert!(chattering.tick.iter().copied().eq((0..400).step_by(5)));
    assert_eq!(chattering.at(0).unwrap(), [0.0; 4]);
    // Half a second: half of its steps.
    assert_eq!(chattering.at(25).unwrap(), [75.0, 25.0, 0.0, 0.0]);
    assert_eq!(chattering.at(125).unwrap(), [150.0, 50.0, 0.0, 0.0]);
    assert_eq!(chattering.at(130).unwrap(), [150.0, 50.0, 0.0, 7.0]);
    assert_eq!(chattering.at(175).unwrap(), [150.0, 50.0, 0.0, 7.0]);
    assert_eq!(chattering.at(180).unwrap(), [150.0, 50.0, 0.0, 0.0]);
}

#[test]
fn innovations_stand_between_their_gates_and_flags_become_lanes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    let mut header = header("gates");
    header.scene.limits.nis_gates = vec![(&estimator::INNOVATION_HEADING, 25.0)];
    let mut sink = create(&path);
    sink.begin(&header).unwrap();
    for k in 0..300 {
        sink.tick(Tick { k, dt_s: DT_S }).unwrap();
        sink.vector(&estimator::INNOVATION_HEADING, &[0.1, 0.02, 25.5]);
        sink.vector(&estimator::INNOVATION_DEPTH, &[-0.3, 0.5, 0.36]);
        sink.vector(&nav::HEALTH, &[1.0, f64::from(u8::from((100..200).contains(&k))), 0.0, 0.0, 0.0, 0.0]);
    }
    sink.finish(&Properties::new()).unwrap();
    let recording = read(&path).unwrap();
    let heading = &recording.signals[signals::INNOVATION_HEADING.path];
    assert_eq!(heading.names, ["innovation", "gate", "gate"]);
    // The first second is left out: the filter's first doubts would hide the rest.
    assert_eq!((heading.tick[0], heading.at(60).unwrap()), (50, &[0.1, 0.1, -0.1][..]));
    let depth = &recording.signals[signals::INNOVATION_DEPTH.path];
    assert_eq!(depth.names, ["innovation", "3 σ", "3 σ"]);
    assert_eq!(depth.at(60).unwrap(), [-0.3, 1.5, -1.5]);
    assert_eq!(recording.signals[signals::NIS_HEADING.path].at(60).unwrap(), [25.5, 25.0]);
    assert_eq!(recording.signals[signals::NIS_DEPTH.path].at(60).unwrap(), [0.36]);
    let lane = &recording.labels[signals::HEALTH_VELOCITY.path];
    let changes: Vec<_> = lane.iter().map(|label| (label.tick, label.value.as_str())).collect();
    assert_eq!(changes, [(0, "measured"), (100, "dead reckoning"), (200, "measured")]);
}

#[test]
fn the_same_run_makes_the_same_recording_whatever_the_options() {
    let folder = tempfile::tempdir().unwrap();
    let one = record(&folder.path().join("one.rrd"), 700);
    assert_eq!(one, record(&folder.path().join("two.rrd"), 700));

    let path = folder.path().join("three.rrd");
    let mut sink = RerunSink::create(&path, Options { compress: false, ..Default::default() }).unwrap();
    sink.begin(&header("run-7")).unwrap();
    play(&mut sink, 700).unwrap();
    sink.finish(&results()).unwrap();
    let mut three = read(&path).unwrap();
    // Colours of labels are written again in the batch where a new label appears.
    three.rows.clone_from(&one.rows);
    assert_eq!(one, three);
}

#[test]
fn a_change_of_width_is_an_error_at_the_next_tick() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    let mut sink = create(&path);
    sink.begin(&header("width")).unwrap();
    sink.tick(Tick { k: 0, dt_s: DT_S }).unwrap();
    sink.vector(&WIDE, &[1.0, 2.0, 3.0]);
    sink.tick(Tick { k: 1, dt_s: DT_S }).unwrap();
    sink.vector(&WIDE, &[1.0]);
    let error = sink.tick(Tick { k: 2, dt_s: DT_S }).unwrap_err();
    assert_eq!(error.cause, "test/wide changed its width from 3 to 1");
    assert_eq!(error.what, path.display().to_string());
    assert!(sink.finish(&Properties::new()).is_err());
    drop(sink);
    let recording = read(&path).unwrap();
    assert_eq!(recording.signals.get("test/wide").map_or(0, |columns| columns.tick.len()), 1);
}

#[test]
fn a_file_that_exists_is_only_replaced_when_asked_to() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    fs::write(&path, "precious").unwrap();
    let error = RerunSink::create(&path, Options::default()).err().unwrap();
    assert_eq!(error.to_string(), format!("{}: the file exists already", path.display()));
    assert_eq!(fs::read(&path).unwrap(), b"precious");

    let mut sink = RerunSink::create(&path, Options { overwrite: true, ..Default::default() }).unwrap();
    sink.begin(&header("again")).unwrap();
    sink.finish(&Properties::new()).unwrap();
    assert_eq!(read(&path).unwrap().name, "again");
}

#[test]
fn a_directory_that_does_not_exist_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let error = RerunSink::create(&folder.path().join("runs/run.rrd"), Options::default()).err().unwrap();
    assert_eq!(error.cause, format!("the directory {} does not exist", folder.path().join("runs").display()));
    // A file where a directory is expected.
    fs::write(folder.path().join("runs"), "").unwrap();
    let error = RerunSink::create(&folder.path().join("runs/run.rrd"), Options::default()).err().unwrap();
    assert!(error.cause.starts_with("can't create the file: "), "{error}");
}

#[test]
fn a_sink_that_never_began_leaves_no_file_behind() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    let mut sink = create(&path);
    assert_eq!(sink.tick(Tick { k: 0, dt_s: DT_S }).unwrap_err().cause, "the run has not begun");
    drop(sink);
    assert!(!path.exists());
}

#[test]
fn calls_out_of_order_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = create(&folder.path().join("run.rrd"));
    sink.begin(&header("order")).unwrap();
    assert!(sink.begin(&header("order")).is_err());
    sink.tick(Tick { k: 4, dt_s: DT_S }).unwrap();
    assert_eq!(sink.tick(Tick { k: 4, dt_s: DT_S }).unwrap_err().cause, "tick 4 comes after tick 4");
    sink.finish(&Properties::new()).unwrap();
    assert!(sink.finish(&Properties::new()).is_err());

    let mut sink = create(&folder.path().join("early.rrd"));
    sink.begin(&header("early")).unwrap();
    sink.scalar(&SPARSE, 1.0);
    assert_eq!(sink.tick(Tick { k: 0, dt_s: DT_S }).unwrap_err().cause, "test/sparse is shown before the first tick");
}

#[test]
fn a_dropped_sink_leaves_what_was_heard() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    let mut sink = create(&path);
    sink.begin(&header("dropped")).unwrap();
    play(&mut sink, 333).unwrap();
    drop(sink);
    let recording = read(&path).unwrap();
    assert!(recording.complete);
    assert_eq!(recording.signals[tracking::DEPTH.path].tick.len(), 333);
    assert!(!recording.properties.contains_key("result"));
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_reported() {
    let mut sink =
        RerunSink::create(Path::new("/dev/full"), Options { overwrite: true, ..Default::default() }).unwrap();
    // The disk may be heard to be full at any call, and must be at the last.
    let played = sink.begin(&header("full")).and_then(|()| play(&mut sink, 2000));
    let finished = sink.finish(&Properties::new());
    let error = played.and(finished).unwrap_err();
    assert!(error.to_string().contains("/dev/full: ") && error.to_string().contains("No space left"), "{error}");
}

#[test]
fn a_truncated_file_gives_what_there_is() {
    let folder = tempfile::tempdir().unwrap();
    let whole = record(&folder.path().join("whole.rrd"), 600);
    let bytes = fs::read(folder.path().join("whole.rrd")).unwrap();
    let path = folder.path().join("cut.rrd");
    let mut some = 0;
    // Every few thousand bytes, and each of the last ones: message boundaries are nowhere in particular.
    let places = (0..bytes.len()).step_by(bytes.len() / 40 + 1).chain(bytes.len() - 40..bytes.len());
    for length in places {
        fs::write(&path, &bytes[..length]).unwrap();
        if length < 12 {
            assert!(matches!(read(&path), Err(ReadError::Empty { .. })));
            continue;
        }
        let cut = read(&path).unwrap();
        assert!(!cut.complete, "{length}");
        for (name, columns) in &cut.signals {
            let all = &whole.signals[name];
            let n = columns.values.len();
            assert_eq!(columns.values, all.values[..n], "{name} at {length}");
            some += n;
        }
    }
    assert!(some > 0);
    fs::write(&path, &bytes).unwrap();
    assert_eq!(read(&path).unwrap(), whole);
}

#[test]
fn a_damaged_file_never_counts_as_complete_when_its_end_is_gone() {
    let folder = tempfile::tempdir().unwrap();
    record(&folder.path().join("whole.rrd"), 300);
    let bytes = fs::read(folder.path().join("whole.rrd")).unwrap();
    let path = folder.path().join("damaged.rrd");
    for place in (0..bytes.len()).step_by(bytes.len() / 40 + 1) {
        let mut damaged = bytes.clone();
        let end = damaged.len().min(place + 64);
        damaged[place..end].fill(0);
        fs::write(&path, &damaged).unwrap();
        // Whatever it is, it is not a panic.
        drop(read(&path));
    }
    for extra in [&b"x"[..], &[0; 64]] {
        fs::write(&path, [&bytes[..], extra].concat()).unwrap();
        assert!(!read(&path).unwrap().complete);
    }
}
