//! Several recordings in one file: everything is where it was, at the times that all runs share.

#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use crate::common::{assert_viewer_takes, fresh, header, results};
use rerun::StoreKind;
use rerun::external::re_log_encoding::DecoderApp;
use rerun::log::{Chunk, LogMsg};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use supertwin_core::signal::tracking;
use supertwin_core::{RunHeader, RunSink, Tick};
use supertwin_rerun::merge::{Better, Cell, ScoreRow, Scores};
use supertwin_rerun::{
    COMPARISON, Merge, MergeError, MergedRun, Options, ReadError, Recording, RerunSink, merge, read,
};

/// A run in which the vehicle does what it always does.
fn record(path: &Path) -> Recording {
    crate::common::record(path, Options { batch_ticks: 100, ..Options::default() }, &header("run"), 1500)
}

/// A run that only knows its sway: `offset` beside what is wanted from `event` on.
fn sways(path: &Path, event: u64, offset: f64, ticks: u64) {
    let mut sink = RerunSink::create(path, Options::default()).unwrap();
    sink.begin(&RunHeader { name: "sway".to_owned(), ..RunHeader::default() }).unwrap();
    for k in 0..ticks {
        sink.tick(Tick { k, dt_s: 0.02 }).unwrap();
        let wanted = if k < event { 0.0 } else { 0.001 * (k - event) as f64 };
        supertwin_core::Probe::vector(&mut sink, &tracking::SWAY, &[wanted + offset, wanted, wanted + 2.0 * offset]);
    }
    sink.finish(&results()).unwrap();
}

fn of(name: &str, path: PathBuf, group: usize) -> MergedRun {
    MergedRun { name: name.to_owned(), paths: vec![path], group, ..MergedRun::default() }
}

fn merge_of(groups: &[&str], runs: Vec<MergedRun>) -> Merge {
    let groups: Vec<String> = groups.iter().map(|name| (*name).to_owned()).collect();
    Merge { name: groups.join(" and "), groups, runs, ..Merge::default() }
}

/// Rows of scalars by entity: tick, time in nanoseconds, values.
type Rows = Vec<(i64, i64, Vec<f64>)>;

/// What stands in a merged file.
#[derive(Default)]
struct Content {
    scalars: BTreeMap<String, Rows>,
    entities: BTreeSet<String>,
    texts: BTreeMap<String, String>,
    blueprints: usize,
}

fn content(path: &Path) -> Content {
    let mut content = Content::default();
    let mut ids = BTreeSet::new();
    for message in DecoderApp::decode_lazy(BufReader::new(fs::File::open(path).unwrap())) {
        let message = message.unwrap();
        assert_eq!(message.store_id().application_id().as_str(), COMPARISON);
        if message.store_id().kind() == StoreKind::Blueprint {
            content.blueprints += usize::from(matches!(message, LogMsg::BlueprintActivationCommand(_)));
            continue;
        }
        let LogMsg::ArrowMsg(_, message) = message else { continue };
        let chunk = Chunk::from_arrow_msg(&message).unwrap();
        assert!(ids.insert(chunk.id()), "{} twice", chunk.id());
        let entity = chunk.entity_path().to_string();
        content.entities.insert(entity.clone());
        let words = rerun::TextDocument::descriptor_text().component;
        for text in chunk.iter_slices::<String>(words).flatten() {
            content.texts.insert(entity.clone(), text.as_str().to_owned());
        }
        let scalars = rerun::Scalars::descriptor_scalars().component;
        let times = |timeline: &'static str| chunk.iter_component_indices(timeline.into(), scalars);
        let times = times("sim_time").zip(times("tick"));
        for (((ns, _), (tick, _)), values) in times.zip(chunk.iter_slices::<f64>(scalars)) {
            content.scalars.entry(entity.clone()).or_default().push((tick.as_i64(), ns.as_i64(), values.to_vec()));
        }
    }
    content
}

#[test]
fn runs_that_are_shifted_to_their_event_are_compared_there() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    // The same happens 3 s later, 0.25 m/s further to starboard.
    sways(&file("early.rrd"), 500, 0.125, 1500);
    sways(&file("late.rrd"), 650, 0.375, 1500);
    let at = |run: MergedRun, ticks: i64, against| MergedRun { offset_ns: -ticks * 20_000_000, against, ..run };
    let (early, late) = (of("early", file("early.rrd"), 0), of("late", file("late.rrd"), 1));
    let runs = vec![at(early, 500, None), at(late, 650, Some(0))];
    let out = file("merged.rrd");
    let two = Merge { aligned_on: "the ramp".to_owned(), ..merge_of(&["first", "second"], runs) };
    let merged = merge(&two, &out, false).unwrap();
    assert_eq!((merged.runs, merged.every_ticks, merged.bytes), (2, 1, fs::metadata(&out).unwrap().len()));
    assert!(merged.damage.is_empty() && merged.empty.is_empty());

    let content = content(&out);
    assert_eq!(content.blueprints, 1);
    let (early, late) = (&content.scalars["/runs/early/tracking/sway"], &content.scalars["/runs/late/tracking/sway"]);
    let ends = |rows: &Rows| (rows.len(), rows[0].0, rows[0].1, rows[rows.len() - 1].0);
    assert_eq!(ends(early), (1500, -500, -10_000_000_000, 999));
    assert_eq!(ends(late), (1500, -650, -13_000_000_000, 849));
    // On the common ticks they differ by the offset alone, exactly.
    let difference = &content.scalars["/compare/difference/sway/second"];
    assert_eq!(ends(difference), (1350, -500, -10_000_000_000, 849));
    assert!(difference.iter().all(|(.., values)| (values[0] - 0.25).abs() < 1e-12));
    let error = &content.scalars["/compare/error/sway/first"];
    assert!(error.len() == 1500 && error.iter().all(|(.., values)| (values[0] - 0.125).abs() < 1e-12));
    for (path, value) in [("rms", 0.375), ("true_rms", 0.75)] {
        let rms = &content.scalars[&format!("/compare/{path}/sway/second")];
        assert!(rms.len() > 250 && rms.iter().all(|(.., values)| (values[0] - value).abs() < 1e-9), "{path}");
    }
    let rms = &content.scalars["/compare/difference/rms_sway/second"];
    assert!(rms.iter().all(|(.., values)| (values[0] - 0.25).abs() < 1e-9));
    // The reference is the same for both, so it is there once.
    assert_eq!(ends(&content.scalars["/compare/reference/sway/1"]).0, 1500);
    assert!(!content.entities.contains("/compare/reference/sway/2"));
    // Of what only the baseline could have, nothing is drawn.
    assert!(content.entities.contains("/compare/difference/sway/first"));
    assert!(!content.entities.contains("/compare/difference/depth/first"));
    assert!(content.texts["/compare/scores/text"].contains("0 s is: the ramp."));
}

#[test]
fn a_group_shows_its_median_and_its_limits() {
    let folder = tempfile::tempdir().unwrap();
    let mut runs = Vec::new();
    for i in 0..10 {
        let file = folder.path().join(format!("{i}.rrd"));
        sways(&file, 0, 0.1 * i as f64, 200);
        // Each against the run of the other group with its number.
        runs.push(MergedRun { against: (i % 2 == 1).then(|| i - 1), ..of(&format!("run {i}"), file, i % 2) });
    }
    let out = folder.path().join("merged.rrd");
    let merged = merge(&merge_of(&["even", "odd"], runs), &out, false).unwrap();
    assert_eq!(merged.runs, 10);
    let content = content(&out);
    let near = |rows: &Rows, wanted: [f64; 3]| {
        rows.len() == 200 && rows.iter().all(|row| row.2.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-9))
    };
    assert!(near(&content.scalars["/compare/error/sway/even"], [0.4, 0.08, 0.72]));
    assert!(near(&content.scalars["/compare/error/sway/odd"], [0.5, 0.18, 0.82]));
    assert!(near(&content.scalars["/compare/difference/sway/odd"], [0.1, 0.1, 0.1]));
    assert!(content.entities.contains("/runs/run\\ 7/tracking/sway"));
    assert!(content.texts["/compare/scores/text"].contains("its median"));
}

#[test]
fn everything_is_there_when_it_is_asked_for_and_a_run_may_be_there_twice() {
    let (folder, file) = fresh();
    let one = record(&file);
    let twice = |all| {
        let runs = vec![of("a", file.clone(), 0), MergedRun { against: Some(0), ..of("b", file.clone(), 1) }];
        Merge { all, ..merge_of(&["a", "b"], runs) }
    };
    let (small, large) = (folder.path().join("small.rrd"), folder.path().join("large.rrd"));
    merge(&twice(false), &small, false).unwrap();
    merge(&twice(true), &large, false).unwrap();
    let (little, all) = (content(&small), content(&large));
    for path in one.rows.keys() {
        let entity = |run: &str| format!("/runs/{run}/{path}");
        assert!(all.entities.contains(&entity("a")) && all.entities.contains(&entity("b")), "{path}");
        let Some(columns) = one.signals.get(path) else { continue };
        for run in ["a", "b"] {
            let rows = &all.scalars[&entity(run)];
            assert!(rows.iter().map(|row| row.0).eq(columns.tick.iter().copied()), "{path}");
            assert!(rows.iter().flat_map(|row| &row.2).eq(columns.values.iter()), "{path}");
        }
    }
    // What the dashboard shows is the same in both, and enough of it for both to differ by nothing.
    for (entity, rows) in &little.scalars {
        assert_eq!(all.scalars.get(entity), Some(rows), "{entity}");
    }
    let differences = || little.scalars.iter().filter(|(entity, _)| entity.starts_with("/compare/difference/"));
    assert_eq!(differences().count(), 24);
    for (entity, rows) in differences() {
        assert!(!rows.is_empty() && rows.iter().all(|row| row.2 == [0.0]), "{entity}");
    }
    for entity in ["net", "path/a", "vehicle/b"] {
        assert!(little.entities.contains(&format!("/compare/scene/{entity}")), "{entity}");
    }
    assert!(little.entities.contains("/runs/b/guidance/reference/mode"));
    assert!(fs::metadata(&small).unwrap().len() < fs::metadata(&large).unwrap().len());
}

#[test]
fn a_damaged_recording_is_compared_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    record(&file("whole.rrd"));
    let bytes = fs::read(file("whole.rrd")).unwrap();
    fs::write(file("cut.rrd"), &bytes[..bytes.len() / 2]).unwrap();
    let runs = vec![of("whole", file("whole.rrd"), 0), MergedRun { against: Some(0), ..of("cut", file("cut.rrd"), 1) }];
    let merged = merge(&merge_of(&["whole", "cut"], runs), &file("merged.rrd"), false).unwrap();
    assert!(merged.damage.iter().any(|damage| damage.path == file("cut.rrd")), "{:?}", merged.damage);
    let content = content(&file("merged.rrd"));
    let rows = content.scalars["/compare/difference/sway/cut"].len();
    assert!((300..1400).contains(&rows), "{rows}");
}

#[test]
fn what_can_not_be_merged_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    sways(&file("run.rrd"), 0, 0.1, 300);
    let with =
        |paths: &[&str]| merge_of(paths, paths.iter().enumerate().map(|(i, path)| of(path, file(path), i)).collect());
    let out = file("out.rrd");
    fs::write(file("text.rrd"), "something else altogether, long enough for a header").unwrap();
    let refused = |paths: &[&str], out: &Path| merge(&with(paths), out, false).unwrap_err();
    assert!(matches!(refused(&["run.rrd", "nowhere.rrd"], &out), MergeError::Read(ReadError::File { .. })));
    assert!(matches!(refused(&["run.rrd", "text.rrd"], &out), MergeError::Read(ReadError::Foreign { .. })));
    let error = refused(&["run.rrd"], &file("no such folder/out.rrd")).to_string();
    assert!(error.contains("no such folder/out.rrd: "), "{error}");
    // Of a recording without signals there is nothing to compare.
    let mut sink = RerunSink::create(&file("bare.rrd"), Options::default()).unwrap();
    sink.begin(&RunHeader { name: "bare".to_owned(), ..RunHeader::default() }).unwrap();
    sink.finish(&results()).unwrap();
    drop(sink);
    assert!(refused(&["bare.rrd"], &out).to_string().contains("in none of the recordings"));
    assert!(!out.exists());
    let merged = merge(&with(&["run.rrd", "bare.rrd"]), &out, false).unwrap();
    assert_eq!(merged.empty, ["bare.rrd"]);

    // What is there stays, unless told otherwise; and it is not taken for a recording of a run.
    fs::write(file("precious.rrd"), "precious").unwrap();
    let error = refused(&["run.rrd"], &file("precious.rrd")).to_string();
    assert!(error.contains("precious.rrd: exists already; use --force"), "{error}");
    assert_eq!(fs::read(file("precious.rrd")).unwrap(), b"precious");
    merge(&with(&["run.rrd"]), &file("precious.rrd"), true).unwrap();
    let error = read(&file("precious.rrd")).unwrap_err();
    assert!(matches!(error, ReadError::Comparison { .. }), "{error}");
    assert!(error.to_string().contains("a comparison, not a recording of a run"), "{error}");
    assert!(matches!(refused(&["precious.rrd"], &file("again.rrd")), MergeError::Read(ReadError::Comparison { .. })));
    let left: BTreeSet<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["bare.rrd", "out.rrd", "precious.rrd", "run.rrd", "text.rrd"].map(Into::into).into());
}

#[test]
fn scores_stand_in_a_text_and_in_bars() {
    let (folder, file) = fresh();
    sways(&file, 0, 0.1, 300);
    let runs = vec![of("a", file.clone(), 0), of("b", file, 1)];
    let cell = |value| Some(Cell { value, plus_minus: None });
    let row = |name: &str, title: &str, chart| ScoreRow {
        name: name.to_owned(),
        title: title.to_owned(),
        unit: "m/s".to_owned(),
        cells: vec![cell(0.05), cell(0.1)],
        better: Better::Lower,
        chart,
    };
    let scores = Scores {
        verdicts: vec!["**a** is better".to_owned()],
        rows: vec![row("sway", "Sway", true), row("surge", "Surge", false)],
        ..Scores::default()
    };
    let out = folder.path().join("merged.rrd");
    merge(&Merge { scores, ..merge_of(&["a", "b"], runs) }, &out, false).unwrap();
    let content = content(&out);
    let text = &content.texts["/compare/scores/text"];
    assert!(text.contains("- **a** is better\n") && text.contains("| Sway [m/s] | **0.050** | 0.100 |"), "{text}");
    let bars: Vec<_> = content.entities.iter().filter(|entity| entity.starts_with("/compare/scores/metric/")).collect();
    assert_eq!(bars, ["/compare/scores/metric/sway/a", "/compare/scores/metric/sway/b"]);
}

#[test]
fn the_viewer_takes_the_merged_file_for_whole() {
    let (folder, file) = fresh();
    record(&file);
    let runs = vec![of("a", file.clone(), 0), of("b", file, 1)];
    let out = folder.path().join("merged.rrd");
    merge(&Merge { all: true, ..merge_of(&["a", "b"], runs) }, &out, false).unwrap();
    assert_viewer_takes(&out);
}
