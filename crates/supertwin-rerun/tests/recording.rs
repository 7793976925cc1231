//! What goes into a recording comes out of it.

#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use crate::common::{self, DT_S, fresh, header, play, results};
use crate::keeper::Keeper;
use std::fs;
use std::path::Path;
use supertwin_core::run::Properties;
use supertwin_core::signal::{estimator, nav, reference, thrust, tracking};
use supertwin_core::{Probe, Property, RunSink, Severity, Signal, Tick};
use supertwin_rerun::{Clocks, Options, Recording, RerunSink, read, signals};

static WIDE: Signal = Signal { path: "test/wide", components: &["a", "b", "c"], units: &["m", "s"], about: "" };
static SPARSE: Signal = Signal { path: "test/sparse", components: &[], units: &["m"], about: "" };
static NEVER: Signal = Signal { path: "test/never", components: &["t1"], units: &["N"], about: "" };

fn options() -> Options {
    Options { batch_ticks: 128, ..Options::default() }
}

/// A recording that has begun.
fn begun(path: &Path, name: &str) -> RerunSink {
    let mut sink = RerunSink::create(path, options()).unwrap();
    sink.begin(&header(name)).unwrap();
    sink
}

/// Closes a recording and reads it.
fn closed(mut sink: RerunSink, path: &Path) -> Recording {
    sink.finish(&Properties::new()).unwrap();
    read(path).unwrap()
}

fn tick(k: u64) -> Tick {
    Tick { k, dt_s: DT_S }
}

/// A recording of the run that is made up.
fn record(ticks: u64) -> Recording {
    let (_folder, path) = fresh();
    common::record(&path, options(), &header("run-7"), ticks)
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|x| x.to_bits()).collect()
}

#[test]
fn what_came_after_its_tick_was_written_stands_at_its_tick() {
    static STATE: Signal = Signal { path: "test/state", components: &[], units: &[], about: "" };
    let (_folder, path) = fresh();
    let mut sink = begun(&path, "run-7");
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
    let recording = closed(sink, &path);
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
    let (_folder, path) = fresh();
    let recording = common::record(&path, options(), &header("run-7"), 1601);
    let mut keeper = Keeper::default();
    play(&mut keeper, 1601).unwrap();
    assert!(recording.complete);
    assert_eq!(recording.name, "run-7");
    for (path, kept) in &keeper.run.signals {
        let columns = &recording.signals[path];
        assert_eq!((&columns.tick, bits(&columns.values)), (&kept.tick, bits(&kept.values)), "{path}");
    }
    let shown = keeper.run.signals.values().map(|columns| columns.tick.len()).sum::<usize>();
    assert_eq!(shown, 17 * 1601 - 1601 + 161);
    let is_derived = |path: &String| signals::SIGNALS.iter().any(|derived| *path == derived.path);
    let heard = recording.signals.iter().filter(|(path, _)| !is_derived(path));
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
    let (_folder, path) = fresh();
    let mut sink = begun(&path, "sparse");
    for k in 5..1000 {
        sink.tick(tick(k)).unwrap();
        if k % 7 == 0 {
            sink.scalar(&SPARSE, -(k as f64));
        }
        sink.vector(&NEVER, &[]);
        sink.vector(&WIDE, &[f64::NAN, -0.0]);
    }
    let recording = closed(sink, &path);
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
    let recording = record(1200);
    let mode = &recording.labels[reference::MODE.path];
    let changes: Vec<_> = mode.iter().map(|label| (label.tick, label.time_ns, label.value.as_str())).collect();
    let holding = (100, 2_000_000_000, "depth_heading_hold");
    assert_eq!(changes, [(0, 0, "neutral"), holding, (1001, 20_020_000_000, "follow_net")]);
}

#[test]
fn events_come_back_with_service_and_severity() {
    let recording = record(1600);
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
    let recording = record(10);
    assert_eq!(recording.properties["run"], header("").properties);
    assert_eq!(recording.properties["run"]["seed"], Property::Integer(u64::MAX));
    assert_eq!(recording.properties["result"], results());
}

#[test]
fn there_is_a_picture() {
    let recording = record(1000);
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
    let (_folder, path) = fresh();
    let mut sink = begun(&path, "stairs");
    for k in 0..400 {
        sink.tick(tick(k)).unwrap();
        let up_and_down = if k % 2 == 0 { 0.0 } else { 3.0 };
        // The last axis rises at one tick only, from batch to batch.
        sink.vector(&thrust::REQUESTED, &[up_and_down, k as f64, -2.0, if k < 128 { 0.0 } else { 7.0 }]);
    }
    let chattering = &closed(sink, &path).signals[signals::CHATTERING.path];
    assert!(chattering.tick.iter().copied().eq((0..400).step_by(5)));
    for (tick, expected) in [
        (0, [0.0; 4]),
        // Half a second: half of its steps.
        (25, [75.0, 25.0, 0.0, 0.0]),
        (125, [150.0, 50.0, 0.0, 0.0]),
        (130, [150.0, 50.0, 0.0, 7.0]),
        (175, [150.0, 50.0, 0.0, 7.0]),
        (180, [150.0, 50.0, 0.0, 0.0]),
    ] {
        assert_eq!(chattering.at(tick).unwrap(), expected, "tick {tick}");
    }
}

#[test]
fn innovations_stand_between_their_gates_and_flags_become_lanes() {
    let (_folder, path) = fresh();
    let mut header = header("gates");
    header.scene.limits.nis_gates = vec![(&estimator::INNOVATION_HEADING, 25.0)];
    let mut sink = RerunSink::create(&path, options()).unwrap();
    sink.begin(&header).unwrap();
    for k in 0..300 {
        sink.tick(tick(k)).unwrap();
        sink.vector(&estimator::INNOVATION_HEADING, &[0.1, 0.02, 25.5]);
        sink.vector(&estimator::INNOVATION_DEPTH, &[-0.3, 0.5, 0.36]);
        sink.vector(&nav::HEALTH, &[1.0, f64::from(u8::from((100..200).contains(&k))), 0.0, 0.0, 0.0, 0.0]);
    }
    let recording = closed(sink, &path);
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
    let one = record(700);
    assert_eq!(one, record(700));
    let (_folder, path) = fresh();
    let mut three = common::record(&path, Options { compress: false, ..Options::default() }, &header("run-7"), 700);
    // Colours of labels are written again in the batch where a new label appears.
    three.rows.clone_from(&one.rows);
    assert_eq!(one, three);
}

#[test]
fn a_change_of_width_is_an_error_at_the_next_tick() {
    let (_folder, path) = fresh();
    let mut sink = begun(&path, "width");
    sink.tick(tick(0)).unwrap();
    sink.vector(&WIDE, &[1.0, 2.0, 3.0]);
    sink.tick(tick(1)).unwrap();
    sink.vector(&WIDE, &[1.0]);
    let error = sink.tick(tick(2)).unwrap_err();
    assert_eq!(error.cause, "test/wide changed its width from 3 to 1");
    assert_eq!(error.what, path.display().to_string());
    assert!(sink.finish(&Properties::new()).is_err());
    drop(sink);
    let recording = read(&path).unwrap();
    assert_eq!(recording.signals.get("test/wide").map_or(0, |columns| columns.tick.len()), 1);
}

#[test]
fn a_file_that_exists_is_only_replaced_when_asked_to() {
    let (_folder, path) = fresh();
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
    let runs = folder.path().join("runs");
    let refused = || RerunSink::create(&runs.join("run.rrd"), Options::default()).err().unwrap();
    assert_eq!(refused().cause, format!("the directory {} does not exist", runs.display()));
    // A file where a directory is expected.
    fs::write(&runs, "").unwrap();
    let error = refused();
    assert!(error.cause.starts_with("can't create the file: "), "{error}");
}

#[test]
fn a_sink_that_never_began_leaves_no_file_behind() {
    let (_folder, path) = fresh();
    let mut sink = RerunSink::create(&path, options()).unwrap();
    assert_eq!(sink.tick(tick(0)).unwrap_err().cause, "the run has not begun");
    drop(sink);
    assert!(!path.exists());
}

#[test]
fn calls_out_of_order_are_errors() {
    let (_folder, path) = fresh();
    let mut sink = begun(&path, "order");
    assert!(sink.begin(&header("order")).is_err());
    sink.tick(tick(4)).unwrap();
    assert_eq!(sink.tick(tick(4)).unwrap_err().cause, "tick 4 comes after tick 4");
    sink.finish(&Properties::new()).unwrap();
    assert!(sink.finish(&Properties::new()).is_err());

    let mut sink = begun(&path.with_file_name("early.rrd"), "early");
    sink.scalar(&SPARSE, 1.0);
    assert_eq!(sink.tick(tick(0)).unwrap_err().cause, "test/sparse is shown before the first tick");
}

#[test]
fn a_dropped_sink_leaves_what_was_heard() {
    let (_folder, path) = fresh();
    let mut sink = begun(&path, "dropped");
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
    let mut sink = RerunSink::create(Path::new("/dev/full"), Options { overwrite: true, ..options() }).unwrap();
    // The disk may be heard to be full at any call, and must be at the last.
    let played = sink.begin(&header("full")).and_then(|()| play(&mut sink, 2000));
    let finished = sink.finish(&Properties::new());
    let error = played.and(finished).unwrap_err();
    assert!(error.to_string().contains("/dev/full: ") && error.to_string().contains("No space left"), "{error}");
}
