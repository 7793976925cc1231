//! The command line as a user meets it: real processes, real files, real signals.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use crate::support::{CONFIG, Place, assert_says, files_in, until_written};
use serde_json::json;
use supertwin_rerun::read;

#[test]
fn the_three_trials_of_the_paper_leave_three_recordings_and_the_table() {
    let place = Place::new();
    let table = place.call(&["run"]).well().out;
    assert_says(&table, &["paper IV", "Distance to net [m]", "0.402", "0.681", "0.820", "3 runs, 400 s simulated"]);
    for name in ["paper-gsta", "paper-agsta", "paper-pid"] {
        let recording = read(&place.path().join(format!("runs/0001/{name}-seed1.rrd"))).unwrap();
        assert!(recording.complete, "{name}");
        assert!(recording.properties["run"].contains_key("config"));
    }
    // A second call writes beside the first one, never over it.
    place.call(&["run", "paper-pid"]).well();
    assert!(place.path().join("runs/0002/paper-pid-seed1.rrd").is_file());
}

#[test]
fn json_has_the_promised_shape_and_the_hash_does_not_depend_on_recording() {
    let place = Place::new();
    let arguments = ["run", "paper-agsta", "--seed", "3", "--json"];
    let recorded = place.call(&[&arguments[..], &["--out", "here"]].concat()).well().json();
    let silent = place.call(&[&arguments[..], &["--no-record"]].concat()).well().json();
    let run = &recorded["runs"][0];
    let identity = ["trial", "controller", "seed", "ticks"].map(|name| &run[name]);
    assert_eq!(identity, [&json!("paper-agsta"), &json!("agsta"), &json!(3), &json!(6000)]);
    assert!(run["wall_s"].as_f64().unwrap() > 0.0 && run["real_time_factor"].as_f64().unwrap() > 1.0);
    for kind in ["measured", "true"] {
        for quantity in ["distance_m", "speed_m_per_s", "surge_m_per_s", "sway_m_per_s", "depth_m", "heading_rad"] {
            assert!(run["scores"][kind][quantity].as_f64().unwrap() > 0.0, "{kind} {quantity}");
        }
    }
    let silent = &silent["runs"][0];
    assert_eq!((&run["hash"], &run["scores"]), (&silent["hash"], &silent["scores"]));
    assert!(silent["recording"].is_null());
    let recording = read(&place.path().join(run["recording"].as_str().unwrap())).unwrap();
    assert_eq!(recording.signals["tracking/sway"].tick.len(), 6000, "a row per tick");
}

#[test]
fn seeds_are_counted_up_and_summarised() {
    let place = Place::new();
    let arguments = ["run", "paper-pid", "--seeds", "3", "--no-record"];
    let done = place.call(&[&arguments[..], &["--json"]].concat()).well().json();
    let seeds = done["runs"].as_array().unwrap().iter().map(|run| run["seed"].as_u64().unwrap());
    assert!(seeds.eq([1, 2, 3]), "{done}");
    let table = place.call(&arguments).out;
    assert!(table.contains("over 3 seeds") && table.contains('±'), "{table}");
    assert!(files_in(place.path()).is_empty(), "nothing is written");
}

#[test]
fn bad_input_is_named_exits_with_two_and_writes_nothing() {
    let place = Place::new();
    for (arguments, expected) in [
        ("paper-gstaa", "did you mean `paper-gsta`?"),
        ("nowhere/trial.toml", "nowhere/trial.toml: no such trial"),
        ("--set vehicle.true.rigid_body.mass_kg=-5", "-5: must be positive"),
        ("--set vehicle.true.rigid_body.mass_kg=nan", "must be positive and finite"),
        ("--set environment.current.sped=1", "unknown field `sped`"),
        ("--set vehicle.thruster=[]", "0 thrusters given"),
        ("--set nonsense", "section.path=value"),
        ("paper-pid paper-pid", "asked for twice"),
        ("--seed 1 --seeds 2", "cannot be used with"),
    ] {
        let done = place.call(&[&["run"][..], &arguments.split(' ').collect::<Vec<_>>()].concat()).refused(expected);
        assert!(done.out.is_empty() && files_in(place.path()).is_empty(), "{arguments:?} wrote something");
    }
}

#[test]
fn recordings_are_never_replaced_without_force() {
    let place = Place::new();
    let arguments = ["run", "paper-pid", "--out", "here", "--set", "trial.duration_s=25"];
    place.call(&arguments).well();
    let path = place.path().join("here/paper-pid-seed1.rrd");
    let before = std::fs::read(&path).unwrap();
    place.call(&arguments).refused("exists already; use --force");
    assert_eq!(std::fs::read(&path).unwrap(), before);
    place.call(&[&arguments[..], &["--force"]].concat()).well();
}

#[test]
fn an_output_folder_that_can_not_be_used_is_a_clear_error() {
    let place = Place::new();
    std::fs::write(place.path().join("file"), "").unwrap();
    for out in ["file/below", "/proc/here"] {
        let done = place.call(&["run", "paper-pid", "--out", out]).refused("can't create the folder for recordings");
        assert!(done.err.contains(out), "{done:?}");
    }
}

#[test]
fn a_full_disk_is_a_clear_error() {
    // A limit on the size of files stands in for the disk; with the signal ignored, the write itself fails.
    let place = Place::new();
    let done = place.shell("trap '' XFSZ; ulimit -f 400; supertwin run paper-pid --out here");
    assert!(done.refused("here/paper-pid-seed1.rrd").err.contains("File too large"));
    let rest = read(&place.path().join("here/paper-pid-seed1.rrd")).unwrap();
    assert!(!rest.complete, "what was written before stays readable");
}

#[cfg(unix)]
#[test]
fn ctrl_c_closes_the_recording() {
    let place = Place::new();
    let arguments = ["run", "paper-agsta", "--out", "here", "--set", "trial.duration_s=1000000"];
    let folder = place.path().join("here");
    std::fs::create_dir(&folder).unwrap();
    let path = folder.join("paper-agsta-seed1.rrd");
    let mut process = place.start(&arguments);
    // It is under way when more is on the disk than the dashboards, which come first.
    until_written(&folder, "run that is under way", || {
        assert!(process.is_up(), "ended by itself");
        std::fs::metadata(&path).ok().filter(|file| file.len() > 4_000_000)
    });
    process.signal("INT");
    process.finish().ends(130, "interrupted");
    let recording = read(&path).unwrap();
    assert!(recording.complete, "the footer is there");
    let rows = &recording.signals["tracking/depth"].tick;
    assert!(rows.len() > 1000 && rows.windows(2).all(|pair| pair[1] == pair[0] + 1), "every tick up to the end");
    assert_eq!(format!("{:?}", recording.properties["result"]["complete"]), "Integer(0)");
}

#[test]
fn check_prints_what_was_understood_with_units() {
    let place = Place::new();
    let vehicle = format!("{CONFIG}/vehicles/argus-mini.toml");
    let said = place.call(&["check", &vehicle]).out;
    assert_says(&said, &["true.rigid_body.mass_kg", "90.0 kg", "120.0 N s/m", "propulsion.delay_s", "0.1 s"]);
    assert!(place.call(&["check"]).well().out.lines().count() > 30);
    let trial = format!("{CONFIG}/trials/paper-pid.toml");
    let tree = place.call(&["check", &trial, "--json"]).well().json();
    assert_eq!(tree[&trial]["controller pid"]["law"]["pid"]["kp"]["surge"].as_f64(), Some(200.0));

    std::fs::create_dir(place.path().join("vehicles")).unwrap();
    let broken = std::fs::read_to_string(&vehicle).unwrap().replacen("mass_kg = 90.0", "mass_kg = -90.0", 1);
    std::fs::write(place.path().join("vehicles/broken.toml"), broken).unwrap();
    let refused = place.call(&["check", "vehicles/broken.toml"]);
    refused.refused("vehicles/broken.toml:14:11: true.rigid_body.mass_kg: -90: must be positive");
}

#[test]
fn a_closed_pipe_is_no_error() {
    let done = Place::new().shell("supertwin check | head -1");
    assert!(!done.err.contains("panicked"), "{}", done.err);
    assert_eq!(done.out.lines().count(), 1);
}
