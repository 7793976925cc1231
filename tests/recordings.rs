//! What a user does with recordings: looks into them, makes them whole, takes them elsewhere.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use crate::support::python;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use supertwin_core::Property;
use supertwin_rerun::{Merge, MergedRun, merge, read, read_selected};

const CONFIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config");

fn supertwin(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_supertwin"));
    command.current_dir(folder).args(["--config", CONFIG]).args(arguments).stdin(Stdio::null()).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// What a call says that must succeed.
fn run_well(folder: &Path, arguments: &[&str]) -> String {
    let done = supertwin(folder, arguments);
    assert!(done.status.success(), "{arguments:?}: {}", text(&done.stderr));
    text(&done.stdout)
}

/// Exit status and standard error of a call that must fail.
fn refused(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let done = supertwin(folder, arguments);
    assert!(!done.status.success() && done.stdout.is_empty(), "{arguments:?}: {}", text(&done.stdout));
    (done.status.code(), text(&done.stderr))
}

fn json(folder: &Path, arguments: &[&str]) -> Value {
    serde_json::from_str(&run_well(folder, &[arguments, &["--json"]].concat())).unwrap()
}

/// A folder with the recordings of a trial, 35 s long.
fn recorded(trial: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    run_well(folder.path(), &["run", trial, "--out", ".", "--set", "trial.duration_s=35"]);
    folder
}

#[test]
fn show_says_what_is_there_and_that_the_scores_are_right() {
    for trial in ["paper-gsta", "paper-agsta", "paper-pid"] {
        let folder = recorded(trial);
        let file = format!("{trial}-seed1.rrd");
        let shown = json(folder.path(), &["show", &file]);
        assert_eq!((&shown["complete"], &shown["last_tick"]), (&true.into(), &1749.into()));
        assert_eq!(shown["name"], format!("{trial}-seed1"));
        assert_eq!(
            (&shown["scores"]["equal"], &shown["scores"]["missing_ticks"]),
            (&true.into(), &0.into()),
            "{trial}"
        );
        assert!(shown["scores"]["ticks"].as_u64().unwrap() >= 300, "{trial}");
        assert_eq!(
            shown["scores"]["recomputed"]["measured"]["depth_m"],
            shown["properties"]["result"]["measured.depth_m"]
        );
        let depth = shown["signals"].as_array().unwrap().iter().find(|line| line["path"] == "tracking/depth").unwrap();
        assert_eq!((&depth["rows"], &depth["missing"]), (&1750.into(), &0.into()));
        assert!((depth["rate_hz"].as_f64().unwrap() - 50.0).abs() < 1e-9);
        assert!(shown["gaps"].as_array().unwrap().is_empty() && !shown["events"].as_array().unwrap().is_empty());
        let table = run_well(folder.path(), &["show", &file]);
        for words in [
            "complete, ticks 0 to 1749",
            "controller/thrust/requested",
            "No gaps",
            "equal to the run's own in every bit",
        ] {
            assert!(table.contains(words), "{words} is missing in\n{table}");
        }
    }
}

#[test]
fn a_recording_that_was_cut_off_is_shown_repaired_and_exported() {
    let folder = recorded("paper-agsta");
    let folder = folder.path();
    let bytes = fs::read(folder.join("paper-agsta-seed1.rrd")).unwrap();
    fs::write(folder.join("cut.rrd"), &bytes[..3 * bytes.len() / 4]).unwrap();
    let shown = json(folder, &["show", "cut.rrd"]);
    assert_eq!((&shown["complete"], &shown["scores"]["recorded"]), (&false.into(), &false.into()));
    let table = run_well(folder, &["show", "cut.rrd"]);
    assert!(table.contains("incomplete") && table.contains("supertwin repair"), "{table}");

    let repaired = json(folder, &["repair", "cut.rrd"]);
    assert_eq!((&repaired["whole"], &repaired["out"]), (&false.into(), &"cut.repaired.rrd".into()));
    let last = repaired["last_tick"].as_i64().unwrap();
    // The cut goes through the last batch: some signals have their last ticks and others not.
    assert!(repaired["signals_that_end_before"].as_u64().unwrap() > 0, "{repaired}");
    assert!(last > 900 && repaired["lost_ticks"] == 1749 - last, "{repaired}");
    assert!(read(&folder.join("cut.repaired.rrd")).unwrap().complete);
    let environment = python::environment();
    let viewer = python::viewer(&environment);
    python::succeed(Command::new(viewer).args(["rrd", "verify"]).arg(folder.join("cut.repaired.rrd")));

    // Not again over what is there, unless told to; and a whole file is left alone.
    let (status, error) = refused(folder, &["repair", "cut.rrd"]);
    assert!(status == Some(2) && error.contains("cut.repaired.rrd: exists already; use --force"), "{error}");
    let again = run_well(folder, &["repair", "cut.rrd", "--force"]);
    assert!(again.contains("signals end before it)") && again.contains("could not be read"), "{again}");
    let whole = run_well(folder, &["repair", "paper-agsta-seed1.rrd", "--out", "never.rrd"]);
    assert!(whole.contains("whole; nothing to repair") && !folder.join("never.rrd").exists());

    let done = supertwin(folder, &["export", "cut.rrd", "--csv", "--signals", "tracking/*"]);
    assert!(done.status.success() && text(&done.stderr).contains("warning: cut.rrd: byte"), "{}", text(&done.stderr));
}

#[test]
fn what_is_no_recording_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("empty.rrd"), "").unwrap();
    fs::write(folder.join("text.rrd"), "something else altogether, long enough for a header").unwrap();
    for verb in [&["show"][..], &["repair"], &["export", "--csv"]] {
        for (file, words) in [("nowhere.rrd", "No such file"), ("text.rrd", "text.rrd: not a recording")] {
            let (status, error) = refused(folder, &[verb, &[file]].concat());
            assert!(status == Some(2) && error.contains(words) && error.contains(file), "{verb:?} {status:?} {error}");
        }
        let (status, error) = refused(folder, &[verb, &["empty.rrd"]].concat());
        // Of an empty recording nothing can be saved, and that is no mistake of the call.
        assert_eq!(status, Some(if verb[0] == "repair" { 1 } else { 2 }), "{error}");
        assert!(error.contains("empty.rrd: the file is empty"), "{error}");
    }
    assert_eq!(fs::read_dir(folder).unwrap().count(), 2, "nothing was written");
}

#[test]
fn export_takes_what_is_asked_for_and_names_what_there_is_not() {
    let folder = recorded("paper-pid");
    let folder = folder.path();
    let file = "paper-pid-seed1.rrd";
    let all = json(folder, &["export", file, "--parquet"]);
    assert_eq!((&all["rows"], &all["out"]), (&1750.into(), &"paper-pid-seed1.parquet".into()));
    assert!(all["columns"].as_u64().unwrap() > 100);
    let some = ["export", file, "--csv", "--signals", "tracking/*", "--signals", "plant/**"];
    run_well(folder, &some);
    let written = fs::read_to_string(folder.join("paper-pid-seed1.csv")).unwrap();
    let header = written.lines().next().unwrap();
    assert!(header.contains("tracking/sway:measured") && header.contains("plant/truth/pose:north"), "{header}");
    assert!(!header.contains("controller/") && written.lines().count() == 1751);
    let recording = read_selected(&folder.join(file), &|path| path == "tracking/sway").unwrap();
    let column = header.split(',').position(|name| name == "tracking/sway:measured").unwrap();
    let values = written.lines().skip(1).map(|line| line.split(',').nth(column).unwrap().parse::<f64>().unwrap());
    assert!(values.eq(recording.signals["tracking/sway"].values.iter().step_by(3).copied()), "number by number");

    let (status, error) = refused(folder, &some);
    assert!(status == Some(2) && error.contains("paper-pid-seed1.csv: exists already; use --force"), "{error}");
    let (status, error) = refused(folder, &["export", file, "--mcap", "--signals", "trackng/*"]);
    assert!(status == Some(2) && error.contains("trackng/*: nothing recorded fits; there are"), "{error}");
    assert!(error.contains("tracking/sway"), "{error}");
    let (status, error) = refused(folder, &["export", file]);
    assert!(status == Some(2) && error.contains("--parquet|--csv|--mcap"), "{error}");
    let mcap = run_well(folder, &["export", file, "--mcap", "--out", "elsewhere.mcap"]);
    assert!(mcap.contains("elsewhere.mcap: ") && mcap.contains(" messages on "), "{mcap}");
}

#[test]
fn a_comparison_is_not_shown_as_if_it_were_a_run() {
    let folder = recorded("paper-pid");
    let folder = folder.path();
    let run =
        MergedRun { name: "a".to_owned(), paths: vec![folder.join("paper-pid-seed1.rrd")], ..MergedRun::default() };
    let one = Merge { name: "one".to_owned(), groups: vec!["a".to_owned()], runs: vec![run], ..Merge::default() };
    merge(&one, &folder.join("merged.rrd"), false).unwrap();
    for verb in [&["show"][..], &["repair"], &["export", "--csv"]] {
        let (status, error) = refused(folder, &[verb, &["merged.rrd"]].concat());
        assert_eq!(status, Some(2), "{error}");
        assert!(error.contains("merged.rrd: a comparison, not a recording of a run; open it with `rerun merged.rrd`"));
    }
}

/// How recordings are read, with Python among others.
const PAGE: &str = include_str!("../docs/src/how-to/recordings.md");

#[test]
fn the_python_program_of_the_book_works_as_it_stands_there() {
    let folder = tempfile::tempdir().unwrap();
    run_well(folder.path(), &["run", "paper-agsta", "--set", "trial.duration_s=20"]);
    let (_, program) = PAGE.split_once("```python\nfrom rerun").unwrap();
    let program = format!("from rerun{}", program.split_once("```").unwrap().0);
    assert_eq!(program.trim().lines().count(), 5);
    let printed: f64 = python::say(folder.path(), &program, &[]).trim().parse().unwrap();
    let recording = read(&folder.path().join("runs/0001/paper-agsta-seed1.rrd")).unwrap();
    let depth = recording.signals["tracking/depth"].values.chunks_exact(3);
    assert_eq!(printed, depth.map(|row| (row[0] - row[1]).abs()).fold(0.0, f64::max));
}

/// A folder of runs as a table, and a signal of all of them: the program of the same page.
const BROWSE: &str = include_str!("support/browse.py");

#[test]
fn a_folder_of_recordings_is_a_table_with_the_properties_as_columns() {
    let folder = tempfile::tempdir().unwrap();
    run_well(folder.path(), &["run", "fair", "--seeds", "2", "--set", "trial.duration_s=24"]);
    let runs = folder.path().join("runs/0001");
    assert!(PAGE.contains(BROWSE.trim()), "the book shows another program");
    let printed = python::say(folder.path(), BROWSE, &[]);
    let (table, largest) = printed.trim_end().rsplit_once('\n').unwrap();
    let largest: BTreeMap<String, f64> = serde_json::from_str(largest).unwrap();
    let mut by_controller = BTreeMap::<String, Vec<f64>>::new();
    for file in fs::read_dir(&runs).unwrap() {
        let path = file.unwrap().path();
        let recording = read(&path).unwrap();
        let sway = recording.signals["tracking/sway"].values.chunks_exact(3);
        let most = sway.map(|row| (row[0] - row[1]).abs()).fold(0.0, f64::max);
        assert!((largest[&recording.name] - most).abs() < 1e-9, "{}", recording.name);
        let (run, result) = (&recording.properties["run"], &recording.properties["result"]);
        match (&run["controller"], &result["measured.sway_m_per_s"]) {
            (Property::Text(name), Property::Number(score)) => {
                by_controller.entry(name.clone()).or_default().push(*score);
            }
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(largest.len(), by_controller.values().map(Vec::len).sum::<usize>());
    for (controller, scores) in by_controller {
        let line = table.lines().find(|line| line.split_whitespace().next() == Some(&controller)).unwrap();
        let numbers: Vec<f64> = line.split_whitespace().skip(1).map(|number| number.parse().unwrap()).collect();
        let mean = scores.iter().sum::<f64>() / scores.len() as f64;
        assert!((numbers[0] - mean).abs() < 1e-5 && numbers[2] == scores.len() as f64, "{line}");
    }
}
