//! What a user does with recordings: looks into them, makes them whole, takes them elsewhere.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use crate::support::{Ended, Place, assert_says, python};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::process::Command;
use supertwin_core::Property;
use supertwin_rerun::{Merge, MergedRun, merge, read, read_selected};

/// A call that must be refused with these words, without a result.
fn refused(place: &Place, arguments: &[&str], words: &str) -> Ended {
    let done = place.call(arguments).refused(words);
    assert!(done.out.is_empty(), "{arguments:?}: {done:?}");
    done
}

fn json(place: &Place, arguments: &[&str]) -> Value {
    place.call(&[arguments, &["--json"]].concat()).well().json()
}

/// A place with the recordings of a trial, 35 s long.
fn recorded(trial: &str) -> Place {
    let place = Place::new();
    place.call(&["run", trial, "--out", ".", "--set", "trial.duration_s=35"]).well();
    place
}

#[test]
fn show_says_what_is_there_and_that_the_scores_are_right() {
    for trial in ["paper-gsta", "paper-agsta", "paper-pid"] {
        let place = recorded(trial);
        let file = format!("{trial}-seed1.rrd");
        let shown = json(&place, &["show", &file]);
        assert_eq!((&shown["complete"], &shown["last_tick"]), (&true.into(), &1749.into()));
        assert_eq!(shown["name"], format!("{trial}-seed1"));
        let scores = &shown["scores"];
        assert_eq!((&scores["equal"], &scores["missing_ticks"]), (&true.into(), &0.into()), "{trial}");
        assert!(scores["ticks"].as_u64().unwrap() >= 300, "{trial}");
        assert_eq!(scores["recomputed"]["measured"]["depth_m"], shown["properties"]["result"]["measured.depth_m"]);
        let depth = shown["signals"].as_array().unwrap().iter().find(|line| line["path"] == "tracking/depth").unwrap();
        assert_eq!((&depth["rows"], &depth["missing"]), (&1750.into(), &0.into()));
        assert!((depth["rate_hz"].as_f64().unwrap() - 50.0).abs() < 1e-9);
        assert!(shown["gaps"].as_array().unwrap().is_empty() && !shown["events"].as_array().unwrap().is_empty());
        let table = place.call(&["show", &file]).well().out;
        let equal = "equal to the run's own in every bit";
        assert_says(&table, &["complete, ticks 0 to 1749", "controller/thrust/requested", "No gaps", equal]);
    }
}

#[test]
fn a_recording_that_was_cut_off_is_shown_repaired_and_exported() {
    let place = recorded("paper-agsta");
    let folder = place.path();
    let bytes = fs::read(folder.join("paper-agsta-seed1.rrd")).unwrap();
    fs::write(folder.join("cut.rrd"), &bytes[..3 * bytes.len() / 4]).unwrap();
    let shown = json(&place, &["show", "cut.rrd"]);
    assert_eq!((&shown["complete"], &shown["scores"]["recorded"]), (&false.into(), &false.into()));
    let table = place.call(&["show", "cut.rrd"]).well().out;
    assert!(table.contains("incomplete") && table.contains("supertwin repair"), "{table}");

    let repaired = json(&place, &["repair", "cut.rrd"]);
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
    refused(&place, &["repair", "cut.rrd"], "cut.repaired.rrd: exists already; use --force");
    let again = place.call(&["repair", "cut.rrd", "--force"]).well().out;
    assert!(again.contains("signals end before it)") && again.contains("could not be read"), "{again}");
    let whole = place.call(&["repair", "paper-agsta-seed1.rrd", "--out", "never.rrd"]).well().out;
    assert!(whole.contains("whole; nothing to repair") && !folder.join("never.rrd").exists());

    let done = place.call(&["export", "cut.rrd", "--csv", "--signals", "tracking/*"]).well();
    assert!(done.err.contains("warning: cut.rrd: byte"), "{done:?}");
}

#[test]
fn what_is_no_recording_is_refused_by_name() {
    let place = Place::new();
    let folder = place.path();
    fs::write(folder.join("empty.rrd"), "").unwrap();
    fs::write(folder.join("text.rrd"), "something else altogether, long enough for a header").unwrap();
    for verb in [&["show"][..], &["repair"], &["export", "--csv"]] {
        for (file, words) in [("nowhere.rrd", "No such file"), ("text.rrd", "text.rrd: not a recording")] {
            let done = refused(&place, &[verb, &[file]].concat(), words);
            assert!(done.err.contains(file), "{verb:?} {done:?}");
        }
        let done = place.call(&[verb, &["empty.rrd"]].concat());
        // Of an empty recording nothing can be saved, and that is no mistake of the call.
        assert_eq!(done.code, Some(if verb[0] == "repair" { 1 } else { 2 }), "{done:?}");
        assert!(done.err.contains("empty.rrd: the file is empty") && done.out.is_empty(), "{done:?}");
    }
    assert_eq!(fs::read_dir(folder).unwrap().count(), 2, "nothing was written");
}

#[test]
fn export_takes_what_is_asked_for_and_names_what_there_is_not() {
    let place = recorded("paper-pid");
    let folder = place.path();
    let file = "paper-pid-seed1.rrd";
    let all = json(&place, &["export", file, "--parquet"]);
    assert_eq!((&all["rows"], &all["out"]), (&1750.into(), &"paper-pid-seed1.parquet".into()));
    assert!(all["columns"].as_u64().unwrap() > 100);
    let some = ["export", file, "--csv", "--signals", "tracking/*", "--signals", "plant/**"];
    place.call(&some).well();
    let written = fs::read_to_string(folder.join("paper-pid-seed1.csv")).unwrap();
    let header = written.lines().next().unwrap();
    assert!(header.contains("tracking/sway:measured") && header.contains("plant/truth/pose:north"), "{header}");
    assert!(!header.contains("controller/") && written.lines().count() == 1751);
    let recording = read_selected(&folder.join(file), &|path| path == "tracking/sway").unwrap();
    let column = header.split(',').position(|name| name == "tracking/sway:measured").unwrap();
    let values = written.lines().skip(1).map(|line| line.split(',').nth(column).unwrap().parse::<f64>().unwrap());
    assert!(values.eq(recording.signals["tracking/sway"].values.iter().step_by(3).copied()), "number by number");

    refused(&place, &some, "paper-pid-seed1.csv: exists already; use --force");
    let unknown = ["export", file, "--mcap", "--signals", "trackng/*"];
    let done = refused(&place, &unknown, "trackng/*: nothing recorded fits; there are");
    assert!(done.err.contains("tracking/sway"), "{done:?}");
    refused(&place, &["export", file], "--parquet|--csv|--mcap");
    let mcap = place.call(&["export", file, "--mcap", "--out", "elsewhere.mcap"]).well().out;
    assert!(mcap.contains("elsewhere.mcap: ") && mcap.contains(" messages on "), "{mcap}");
}

#[test]
fn a_comparison_is_not_shown_as_if_it_were_a_run() {
    let place = recorded("paper-pid");
    let folder = place.path();
    let paths = vec![folder.join("paper-pid-seed1.rrd")];
    let run = MergedRun { name: "a".to_owned(), paths, ..MergedRun::default() };
    let one = Merge { name: "one".to_owned(), groups: vec!["a".to_owned()], runs: vec![run], ..Merge::default() };
    merge(&one, &folder.join("merged.rrd"), false).unwrap();
    for verb in [&["show"][..], &["repair"], &["export", "--csv"]] {
        let words = "merged.rrd: a comparison, not a recording of a run; open it with `rerun merged.rrd`";
        refused(&place, &[verb, &["merged.rrd"]].concat(), words);
    }
}

/// How recordings are read, with Python among others.
const PAGE: &str = include_str!("../docs/src/how-to/recordings.md");

#[test]
fn the_python_program_of_the_book_works_as_it_stands_there() {
    let place = Place::new();
    place.call(&["run", "paper-agsta", "--set", "trial.duration_s=20"]).well();
    let (_, program) = PAGE.split_once("```python\nfrom rerun").unwrap();
    let program = format!("from rerun{}", program.split_once("```").unwrap().0);
    assert_eq!(program.trim().lines().count(), 5);
    let printed: f64 = python::say(place.path(), &program, &[]).trim().parse().unwrap();
    let recording = read(&place.path().join("runs/0001/paper-agsta-seed1.rrd")).unwrap();
    let depth = recording.signals["tracking/depth"].values.chunks_exact(3);
    assert_eq!(printed, depth.map(|row| (row[0] - row[1]).abs()).fold(0.0, f64::max));
}

/// A folder of runs as a table, and a signal of all of them: the program of the same page.
const BROWSE: &str = include_str!("support/browse.py");

#[test]
fn a_folder_of_recordings_is_a_table_with_the_properties_as_columns() {
    let place = Place::new();
    place.call(&["run", "fair", "--seeds", "2", "--set", "trial.duration_s=24"]).well();
    let runs = place.path().join("runs/0001");
    assert!(PAGE.contains(BROWSE.trim()), "the book shows another program");
    let printed = python::say(place.path(), BROWSE, &[]);
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
