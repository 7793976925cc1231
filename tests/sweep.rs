//! Campaigns as a researcher meets them: killed and resumed, cut into parts, on a cluster, with runs that end in NaN.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use crate::support::{CONFIG, Place, Process, assert_says, python, until_written};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use supertwin_rerun::{Column, Table, read};

/// Two controllers, three wave heights, seeds: a campaign that takes a moment.
fn spec(place: &Place, seeds: u64, duration_s: f64) {
    let text = format!(
        "description = \"a test\"\n\
         trials = [\"paper-pid\", \"paper-agsta\"]\n\
         seeds = {{ start = 1, count = {seeds} }}\n\
         [[parameter]]\nname = \"wave_height_m\"\npath = \"environment.waves.significant_height_m\"\n\
         values = [0.2, 0.4, 0.6]\n\
         [[parameter]]\npath = \"trial.duration_s\"\nvalues = [{duration_s:?}]\n"
    );
    fs::write(place.path().join("mine.toml"), text).unwrap();
}

fn table(place: &Place, out: &str) -> Vec<u8> {
    fs::read(place.path().join(out).join("table.parquet")).unwrap()
}

fn report(place: &Place, out: &str) -> String {
    fs::read_to_string(place.path().join(out).join("report.md")).unwrap()
}

fn texts(table: &Table, name: &str) -> Vec<Option<String>> {
    let Some(Column::Text(values)) = table.column(name) else { panic!("{name}: {:?}", table.column(name)) };
    values.clone()
}

fn numbers(table: &Table, name: &str) -> Vec<Option<f64>> {
    let Some(Column::Number(values)) = table.column(name) else { panic!("{name}: {:?}", table.column(name)) };
    values.clone()
}

/// Files below a folder, with their content.
fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let all = glob::glob(&format!("{}/**/*", folder.display())).unwrap().map(Result::unwrap);
    all.filter(|path| path.is_file()).map(|path| (path.clone(), fs::read(path).unwrap())).collect()
}

/// Runs that a folder's journal says are finished.
fn finished(folder: &Path) -> usize {
    let journal = fs::read_to_string(folder.join("journal.jsonl")).unwrap_or_default();
    journal.matches('\n').count().saturating_sub(1)
}

/// Starts a sweep into `out` and waits until its journal has this many finished runs.
fn start(place: &Place, out: &str, runs: usize, more: &[&str]) -> Process {
    let folder = place.path().join(out);
    fs::create_dir_all(&folder).unwrap();
    let mut process = place.start(&[&["sweep", "mine.toml", "--out", out], more].concat());
    until_written(&folder, "finished runs", || {
        assert!(process.is_up(), "ended by itself: {}", process.errors());
        (finished(&folder) >= runs).then_some(())
    });
    process
}

#[test]
fn killed_and_resumed_a_sweep_leaves_the_table_of_an_undisturbed_one() {
    let place = Place::new();
    spec(&place, 20, 100.0);
    place.call(&["sweep", "mine.toml", "--out", "undisturbed"]).well();
    let killed = place.path().join("killed");
    let journal = killed.join("journal.jsonl");
    // Three times, each time when three more runs are finished.
    for _ in 0..3 {
        start(&place, "killed", finished(&killed) + 3, &[]).kill();
        assert!(!killed.join("table.parquet").exists(), "was killed too late to tell anything");
    }
    let done = finished(&killed);
    // A kill in the middle of a line is rare: this is what it leaves.
    let mut torn = fs::read(&journal).unwrap();
    torn.truncate(torn.len() - 40);
    fs::write(&journal, &torn).unwrap();
    let resumed = place.call(&["sweep", "mine.toml", "--out", "killed", "--json"]).well();
    assert!(resumed.err.contains("1 line is unreadable"), "{}", resumed.err);
    let said = resumed.json();
    assert_eq!(said["runs"], 120);
    assert_eq!(said["done_before"], done - 1, "finished runs are not repeated");
    assert_eq!(table(&place, "killed"), table(&place, "undisturbed"));
    assert_eq!(report(&place, "killed"), report(&place, "undisturbed"));
    assert_eq!(finished(&killed), 120, "no run was done twice");

    // Once more: nothing is left to be done, and nothing is written.
    let before = files(&killed);
    let again = place.call(&["sweep", "mine.toml", "--out", "killed", "--json"]).well().json();
    assert_eq!(again["done_before"], 120);
    assert_eq!(files(&killed), before);
}

#[test]
fn one_core_two_cores_and_gathered_parts_give_the_same_table() {
    let place = Place::new();
    spec(&place, 3, 30.0);
    place.call(&["sweep", "mine.toml", "--out", "one", "--jobs", "1"]).well();
    place.call(&["sweep", "mine.toml", "--out", "two", "--jobs", "2"]).well();
    for part in ["1/3", "2/3", "3/3"] {
        place.call(&["sweep", "mine.toml", "--out", "parts", "--shard", part]).well();
    }
    let gathered = place.call(&["sweep", "mine.toml", "--gather", "parts", "--out", "whole"]).well();
    assert!(gathered.out.contains("18 runs: 18 complete."), "{}", gathered.out);
    assert_eq!(table(&place, "two"), table(&place, "one"));
    assert_eq!(table(&place, "whole"), table(&place, "one"));
    assert_eq!(report(&place, "whole"), report(&place, "one"));

    let one = Table::read(&place.path().join("one/table.parquet")).unwrap();
    assert_eq!(one.rows(), 18);
    assert_eq!(one.column("run"), Some(&Column::Count((0..18).map(Some).collect())));
    // The numbers are those of `run`.
    let set = ["--set", "environment.waves.significant_height_m=0.4", "--set", "trial.duration_s=30.0"];
    let run = place.call(&[&["run", "paper-agsta", "--seed", "2", "--no-record", "--json"][..], &set].concat()).json();
    let id = texts(&one, "id").iter().position(|id| id.as_deref() == Some("paper-agsta-grid1-seed2")).unwrap();
    assert_eq!(texts(&one, "hash")[id].as_deref(), run["runs"][0]["hash"].as_str());
    let sway = run["runs"][0]["scores"]["measured"]["sway_m_per_s"].as_f64();
    assert_eq!(numbers(&one, "measured.sway_m_per_s")[id], sway);
    assert_eq!(numbers(&one, "wave_height_m")[id], Some(0.4));

    // What is missing or double is named, and nothing is overwritten.
    let gather =
        |parts: &[&str], out: &str| place.call(&[&["sweep", "mine.toml", "--out", out, "--gather"], parts].concat());
    gather(&["parts/table.1-of-3.parquet", "parts/table.3-of-3.parquet"], "few").refused("6 of 18 runs are missing");
    gather(&["parts", "one/table.parquet"], "double").refused("is in parts/table.1-of-3.parquet too");
    gather(&["parts"], "whole").refused("whole/report.md: exists already; use --force");
    gather(&["parts", "--force"], "whole").well();
    fs::create_dir(place.path().join("empty")).unwrap();
    gather(&["empty"], "nothing").refused("no table.K-of-N.parquet there");
    gather(&["mine.toml"], "nothing").refused("mine.toml");
}

#[test]
fn what_changed_since_the_beginning_is_refused() {
    let place = Place::new();
    spec(&place, 1, 25.0);
    place.call(&["sweep", "mine.toml", "--out", "here"]).well();
    let before = files(&place.path().join("here"));
    spec(&place, 2, 25.0);
    place.call(&["sweep", "mine.toml", "--out", "here"]).refused("here/journal.jsonl: was begun with other runs");
    spec(&place, 1, 25.0);
    let set = ["sweep", "mine.toml", "--out", "here", "--set", "vehicle.true.net_buoyancy_n=3"];
    place.call(&set).refused("--set, or --recordings has changed; use another --out, or --force");
    place.call(&["sweep", "mine.toml", "--out", "here", "--recordings", "all"]).refused("was begun with other runs");
    place.call(&["sweep", "fair", "--out", "here"]).refused("belongs to the sweep mine, not to fair");
    // A part of other runs does not get into the whole.
    place.call(&["sweep", "mine.toml", "--out", "part", "--shard", "1/2"]).well();
    spec(&place, 2, 25.0);
    place.call(&["sweep", "mine.toml", "--out", "whole", "--gather", "part"]).refused("has other runs than");
    assert_eq!(files(&place.path().join("here")), before, "nothing was touched");
    let anew = place.call(&["sweep", "mine.toml", "--out", "here", "--force", "--json"]).well().json();
    assert_eq!((anew["runs"].as_u64(), anew["done_before"].as_u64()), (Some(12), Some(0)));
    // A table without a journal is somebody's.
    fs::create_dir(place.path().join("theirs")).unwrap();
    fs::write(place.path().join("theirs/table.parquet"), "theirs").unwrap();
    place.call(&["sweep", "mine.toml", "--out", "theirs"]).refused("theirs/table.parquet: exists already");
    assert_eq!(table(&place, "theirs"), b"theirs");
}

#[test]
fn a_run_that_ends_in_nan_is_a_row() {
    let place = Place::new();
    let text = "description = \"a test\"\ntrials = [\"paper-pid\"]\nseeds = { start = 1, count = 2 }\n\
        recordings = \"on-fail\"\n\
        [[parameter]]\npath = \"vehicle.true.linear_damping.surge_n_s_per_m\"\nvalues = [70.0, 1e300]\n\
        [[parameter]]\npath = \"trial.duration_s\"\nvalues = [25.0]\n";
    fs::write(place.path().join("nan.toml"), text).unwrap();
    let done = place.call(&["sweep", "nan.toml", "--out", "here"]);
    assert_eq!(done.code, Some(1), "{done:?}");
    assert_says(&done.out, &["4 runs: 2 complete, 2 invalid.", "paper-pid-grid1-seed1: invalid: tick "]);
    let table = Table::read(&place.path().join("here/table.parquet")).unwrap();
    let verdicts: Vec<_> = texts(&table, "verdict").into_iter().flatten().collect();
    assert_eq!(verdicts, ["complete", "complete", "invalid", "invalid"]);
    assert!(texts(&table, "error")[2].as_ref().unwrap().ends_with("is NaN or infinite"));
    let depth = numbers(&table, "measured.depth_m");
    assert!(depth[0].is_some() && depth[2].is_none());
    assert!(report(&place, "here").contains("is NaN or infinite"));
    // Only what failed is recorded.
    let kept = texts(&table, "recording");
    assert_eq!(kept[0], None);
    assert_eq!(kept[2].as_deref(), Some("recordings/paper-pid-grid1-seed1.rrd"));
    assert_eq!(fs::read_dir(place.path().join("here/recordings")).unwrap().count(), 2);
    let recording = read(&place.path().join("here").join(kept[2].as_ref().unwrap())).unwrap();
    assert!(recording.events.iter().any(|event| event.text().contains("is NaN or infinite")));
}

#[test]
fn limits_put_a_verdict_to_every_run() {
    let place = Place::new();
    let limits = "description = \"a test\"\n[[limit]]\nmetric = \"measured.sway_m_per_s\"\nmax = 0.08\n";
    let text = "description = \"a test\"\ntrials = [\"paper-pid\", \"paper-agsta\"]\nseeds = { start = 1, count = 2 }\n\
        limits = \"limits.toml\"\nrecordings = \"on-fail\"\n";
    fs::write(place.path().join("limits.toml"), limits).unwrap();
    fs::write(place.path().join("limited.toml"), text).unwrap();
    let done = place.call(&["sweep", "limited.toml", "--out", "here"]);
    assert_eq!(done.code, Some(1), "{done:?}");
    assert_says(&done.out, &["4 runs: 2 fail, 2 pass.", "paper-pid-seed1: fail: measured.sway_m_per_s = 0."]);
    let table = Table::read(&place.path().join("here/table.parquet")).unwrap();
    assert_eq!(texts(&table, "verdict").into_iter().flatten().collect::<Vec<_>>(), ["fail", "fail", "pass", "pass"]);
    assert!(texts(&table, "error")[1].as_ref().unwrap().ends_with(": must be at most 0.08"));
    let kept = texts(&table, "recording");
    assert_eq!((kept[0].as_deref(), &kept[2]), (Some("recordings/paper-pid-seed1.rrd"), &None));
    assert_eq!(texts(&table, "hash")[0].as_ref().unwrap().len(), 16);
    // Other limits are another campaign; limits of what a run's scores do not have are a mistake.
    fs::write(place.path().join("limits.toml"), limits.replace("0.08", "0.2")).unwrap();
    place.call(&["sweep", "limited.toml", "--out", "here"]).refused("was begun with other runs");
    fs::write(place.path().join("limits.toml"), limits.replace("measured.sway_m_per_s", "nis.depth")).unwrap();
    let limited = place.call(&["sweep", "limited.toml", "--out", "there"]);
    limited.refused("limited.toml:4:10: limits: nis.depth is no score");
}

#[test]
fn ctrl_c_ends_a_sweep_that_goes_on_later() {
    let place = Place::new();
    spec(&place, 20, 40.0);
    let mut process = start(&place, "here", 2, &["--recordings", "all"]);
    process.signal("INT");
    process.finish().ends(130, "of 120 runs are finished and kept; the same call goes on from there");
    assert!(!place.path().join("here/table.parquet").exists());
    // Recordings are of finished runs.
    let recordings = files(&place.path().join("here/recordings"));
    assert_eq!(recordings.len(), finished(&place.path().join("here")));
    assert!(recordings.iter().all(|(path, _)| read(path).unwrap().complete));
}

#[test]
fn two_sweeps_do_not_write_into_one_folder() {
    let place = Place::new();
    spec(&place, 20, 500.0);
    let mut first = start(&place, "here", 1, &[]);
    let second = place.call(&["sweep", "mine.toml", "--out", "here"]);
    assert!(first.is_up(), "was too fast to tell anything");
    second.refused("here/journal.jsonl: another sweep is writing here now");
    first.kill();
}

#[test]
fn bad_sweeps_are_named_with_their_line_and_write_nothing() {
    let place = Place::new();
    spec(&place, 1, 25.0);
    let text = fs::read_to_string(place.path().join("mine.toml")).unwrap();
    let cases = [
        (text.replace("values = [0.2", "valeus = [0.2"), "bad.toml:7:1: parameter"),
        (text.replace("values = [0.2", "valeus = [0.2"), "did you mean `values`?"),
        (text.replace("waves.signif", "waves.singif"), "bad.toml:4:1: parameter wave_height_m"),
        (text.replace("[0.2, 0.4, 0.6]", "[0.2, -0.4]"), "-0.4: must be"),
        (text.replace("\"wave_height_m\"", "\"hash\""), "parameter hash: the table has a column of this name"),
        (text.replace("paper-pid", "paper-pdi"), "did you mean `paper-pid`?"),
    ];
    for (text, expected) in cases {
        fs::write(place.path().join("bad.toml"), text).unwrap();
        place.call(&["sweep", "bad.toml"]).refused(expected);
        assert!(!place.path().join("runs").exists(), "{expected}: wrote something");
    }
    place.call(&["sweep", "far"]).refused("did you mean `fair`?");
    place.call(&["sweep", "fair", "--shard", "3/2"]).refused("must be K/N with K from 1 to N");
    place.call(&["sweep", "fair", "--shard", "1/2", "--gather", "x"]).refused("cannot be used with");
    fs::write(place.path().join("file"), "").unwrap();
    place.call(&["sweep", "mine.toml", "--out", "file/below"]).refused("file/below");
    // `check` finds the same.
    fs::create_dir(place.path().join("sweeps")).unwrap();
    fs::copy(place.path().join("bad.toml"), place.path().join("sweeps/bad.toml")).unwrap();
    place.call(&["check", "sweeps/bad.toml"]).refused("did you mean `paper-pid`?");
    let shipped = format!("{CONFIG}/sweeps/fair.toml");
    assert!(place.call(&["check", &shipped]).well().out.contains("best_of"));
}

/// The packages of `tests/clients/sweep_dask.py`, and of a query like the one in the book.
const PACKAGES: [&str; 2] = ["distributed==2026.8.0", "duckdb==2.0.1"];

#[test]
fn a_dask_cluster_gives_the_table_of_one_machine_and_duckdb_reads_it() {
    let place = Place::new();
    spec(&place, 3, 30.0);
    place.call(&["sweep", "mine.toml", "--out", "alone"]).well();
    let environment = python::environment_with("sweep-venv", &PACKAGES);
    let client = Path::new(CONFIG).join("../tests/clients/sweep_dask.py");
    let arguments = ["mine.toml", "--out", "shared", "--parts", "3", "--supertwin", env!("CARGO_BIN_EXE_supertwin")];
    let python = environment.join("bin/python");
    let call = || {
        let mut command = place.command(python.to_str().unwrap());
        Process::start(command.arg(&client).args(arguments).args(["--config", CONFIG])).finish()
    };
    let said = call().well().out;
    let whole = "18 runs, {'complete': 18}: table in shared/table.parquet";
    assert_says(&said, &["part 1/3 on one of 2 workers: 6 runs", "3 of 3 parts", whole]);
    assert_eq!(table(&place, "shared"), table(&place, "alone"));
    let again = call();
    assert!(again.err.contains("exists already; use --force"), "{again:?}");

    // A query like the one in the book.
    let query = r#"
import duckdb
print(duckdb.sql('''
    SELECT controller, wave_height_m, count(*) AS runs, round(avg("measured.sway_m_per_s"), 3) AS sway
    FROM 'shared/table.parquet' WHERE verdict = 'complete' GROUP BY ALL ORDER BY ALL
''').fetchall())
"#;
    let rows = python::say_in(&environment, place.path(), query, &[]);
    assert_eq!(rows.matches("('agsta', ").count() + rows.matches("('pid', ").count(), 6, "{rows}");
    let sways: Value = place.call(&["sweep", "mine.toml", "--out", "alone", "--json"]).json();
    let mean = sways["configurations"][0]["scores"]["measured.sway_m_per_s"]["mean"].as_f64().unwrap();
    assert!(rows.contains(&format!("('pid', 0.2, 3, {})", (mean * 1000.0).round() / 1000.0)), "{rows} and {mean}");
}
