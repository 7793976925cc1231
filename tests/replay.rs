//! Replay for real: what was recorded in one process, in lock step and in real time comes back bit for bit; what was tampered
//! with is found; a what-if is a recording like any other.

use crate::support::{self, CONFIG, Ended, Listener, Place, Process, Proxy, ROV, SERVICES, Tamper};
use crate::support::{following, listening, recording_in};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use supertwin_core::run::Properties;
use supertwin_lab::{Library, trial};
use supertwin_rerun::{Recording, read};

/// Runs `trial` in one process and gives its recording.
fn recorded(place: &Place, trial: &str, more: &[&str]) -> PathBuf {
    place.call(&[&["run", trial, "--out", trial, "--json"], more].concat()).well();
    recording_in(&place.path().join(trial))
}

fn replay(place: &Place, file: &Path, more: &[&str]) -> Ended {
    place.call(&[&["replay", &file.display().to_string(), "--json"], more].concat())
}

/// Verified: each of the four blocks was compared, and nothing differs.
fn verified(place: &Place, file: &Path) -> Value {
    let report = replay(place, file, &["--verify"]).well().json()["verification"].clone();
    assert_eq!(report["equal"], true, "{report}");
    let found = report["blocks"].as_array().expect("blocks").iter().filter_map(|block| block["service"].as_str());
    assert!(found.eq(SERVICES), "{report}");
    report
}

/// Every step of a block was compared.
fn assert_wholly_compared(report: &Value) {
    for block in report["blocks"].as_array().expect("blocks") {
        assert_eq!((&block["steps"], &block["inexact"]), (&block["compared"], &Value::Array(Vec::new())), "{block}");
        assert!(block["steps"].as_u64() > Some(100), "{block}");
    }
}

#[test]
fn recordings_of_one_process_repeat_bit_for_bit() {
    let place = Place::new();
    for (trial, more) in [
        ("paper-agsta", &["--set", "trial.duration_s=40"][..]),
        ("tether-cut", &[]),
        ("hand-over", &["--seed", "3"]),
        ("external", &["--set", "trial.duration_s=40"]),
    ] {
        let file = recorded(&place, trial, more);
        let report = verified(&place, &file);
        assert_wholly_compared(&report);
        assert_eq!(report["hash"], true, "{trial}");
        // The chain from a block on repeats as well.
        for from in ["estimator", "guidance", "controller"] {
            let report = replay(&place, &file, &["--verify", "--from", from]).well().json();
            assert_eq!(report["verification"]["equal"], true, "{trial} from {from}");
        }
    }
}

/// A recording of a short run that was tampered with.
fn tampered(file: &Path, change: impl FnOnce(&mut Tamper)) -> bool {
    support::tampered(file, ["trial.duration_s=30", "trial.score.from_s=5"], 1, change)
}

#[test]
fn what_was_tampered_with_is_found_with_its_tick_and_its_signal() {
    let place = Place::new();
    for (tick, signal, component) in [
        (700, "estimator/nav/pose", "heading"),
        (701, "controller/thrust/requested", "sway"),
        (702, "controller/status", ""),
        (703, "plant/truth/pose", "east"),
        (704, "guidance/reference/mode", ""),
        // What the estimator hears is wrong, so that it is the estimator that differs.
        (705, "plant/measurements/dvl_range", "beam2"),
    ] {
        let file = place.path().join(format!("tampered{tick}.rrd"));
        // A ping comes at every sixth tick or so.
        let mut at = tick;
        while !tampered(&file, |run| run.at = (at, signal)) {
            std::fs::remove_file(&file).expect("is removed");
            at += 1;
        }
        let ended = replay(&place, &file, &["--verify"]);
        assert_eq!(ended.code, Some(1), "{ended:?}");
        let first = ended.json()["verification"]["first"].clone();
        assert_eq!((&first["tick"], &first["signal"]), (&Value::from(at), &Value::from(signal)), "{first}");
        assert_eq!(first["component"], component, "{first}");
        let said = place.call(&["replay", &file.display().to_string(), "--verify"]);
        assert_eq!(said.code, Some(1));
        assert!(said.out.contains(&format!("First difference: tick {at}: {signal}")), "{said:?}");
    }
}

/// Signals of the four services and of their links.
fn signals(recording: &Recording) -> BTreeMap<&String, (&Vec<i64>, Vec<u64>)> {
    let of_the_run = recording.signals.iter().filter(|(path, _)| !path.starts_with("derived/"));
    let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect();
    of_the_run.map(|(path, columns)| (path, (&columns.tick, bits(&columns.values)))).collect()
}

#[test]
fn a_what_if_is_a_recording_like_any_other() {
    let place = Place::new();
    let file = recorded(&place, "paper-pid", &["--set", "trial.duration_s=40"]);
    let original = read(&file).expect("is read");

    // Nothing changed: the same run.
    let report = replay(&place, &file, &["--out", "same.rrd"]).well().json();
    assert_eq!(report["unchanged"]["equal"], true, "{report}");
    let same = read(&place.path().join("same.rrd")).expect("is read");
    assert!(same.complete && same.labels.keys().eq(original.labels.keys()));
    let (left, right) = (signals(&same), signals(&original));
    assert!(left.keys().eq(right.keys()), "{:?} {:?}", left.keys(), right.keys());
    for (path, columns) in &left {
        assert!(columns == &right[path], "{path}");
    }
    for (path, labels) in original.labels.iter().filter(|(path, _)| !path.starts_with("derived/")) {
        assert_eq!(labels, &same.labels[path], "{path}");
    }
    let scores = |recording: &Recording| {
        let mut result = recording.properties["result"].clone();
        result.retain(|name, _| !["hash", "warnings", "ticks", "complete"].contains(&name.as_str()));
        result
    };
    assert_eq!(scores(&same), scores(&original));

    // Another law: other thrust, the same vehicle.
    let report = replay(&place, &file, &["--controller", "agsta"]).well().json();
    assert_eq!((report["from"].as_str(), report["refused"].as_array().map(Vec::len)), (Some("controller"), Some(0)));
    let most = report["largest_difference_of_the_requested_wrench"][1].as_f64().expect("a number");
    assert!(most > 1.0 && most < 500.0, "{report}");
    let written = PathBuf::from(report["out"].as_str().expect("a path"));
    assert_eq!(written, file.with_extension("replay.rrd"));
    let what_if = read(&written).expect("is read");
    let other = |path: &str| what_if.signals[path].values != original.signals[path].values;
    assert!(other("controller/thrust/force") && !other("estimator/nav/pose") && !other("plant/truth/pose"));
    assert!(what_if.signals.contains_key("controller/k1"), "it adapts");
    let run = &what_if.properties["run"];
    assert_eq!((&run["replay_of"], &run["law"]), (&original.name.as_str().into(), &"agsta".into()));
    assert_eq!(run["replay_changed"], "controller agsta".into());
    assert_eq!(scored_alike(&place, &written)["complete"], true);

    // From the estimator on: what it finds is different, and so is everything behind it.
    let sets = ["--set", "estimator.measurement.dvl.std=0.2", "--out", "dvl.rrd"];
    let report = replay(&place, &file, &sets).well().json();
    assert_eq!(report["from"], "estimator");
    let dvl = read(&place.path().join("dvl.rrd")).expect("is read");
    for path in ["estimator/nav/velocity", "guidance/reference/velocity", "controller/thrust/requested"] {
        assert!(dvl.signals[path].values != original.signals[path].values, "{path}");
    }
    assert!(dvl.signals["plant/measurements/depth"].values == original.signals["plant/measurements/depth"].values);

    // Nothing is ever replaced unasked.
    replay(&place, &file, &["--controller", "agsta"]).refused("exists already");
    replay(&place, &file, &["--controller", "agsta", "--force"]).well();
    replay(&place, &file, &["--out", &file.display().to_string(), "--force"]).refused("is the recording itself");
}

/// What is shown of a recording whose scores are those of its run.
fn scored_alike(place: &Place, file: &Path) -> Value {
    let shown = place.call(&["show", &file.display().to_string(), "--json"]).well().json();
    assert_eq!(shown["scores"]["equal"], true, "{:?}", shown["scores"]);
    shown
}

/// Root-mean-square difference of one component between two recordings after `from`.
fn deviation(a: &Recording, b: &Recording, path: &str, component: usize, from: i64) -> f64 {
    let (a, b) = (&a.signals[path], &b.signals[path]);
    let ticks = a.tick.iter().filter(|tick| **tick >= from);
    let both = ticks.filter_map(|&tick| Some(a.at(tick)?[component] - b.at(tick)?[component]));
    let squares: Vec<f64> = both.map(|x| x * x).collect();
    assert!(squares.len() > 1000, "{path}");
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn a_closed_loop_with_nothing_changed_stays_near_what_was_recorded() {
    let place = Place::new();
    for trial in ["paper-gsta", "paper-agsta", "paper-pid"] {
        let file = recorded(&place, trial, &[]);
        let report = replay(&place, &file, &["--closed-loop"]).well().json();
        assert_eq!((&report["complete"], &report["disturbance_held_ticks"]), (&true.into(), &0.into()), "{report}");
        let written = PathBuf::from(report["out"].as_str().expect("a path"));
        assert_eq!(written, file.with_extension("closed-loop.rrd"));
        let (closed, original) = (read(&written).expect("is read"), read(&file).expect("is read"));
        assert!(closed.complete);
        let off = |path: &str, component: usize| deviation(&closed, &original, path, component, 500);
        let (distance_m, depth_m) = (off("plant/truth/net", 0), off("plant/truth/pose", 2));
        let (sway_m_per_s, surge_n) = (off("plant/truth/velocity", 1), off("controller/thrust/requested", 0));
        let off = format!("{trial}: {distance_m} m {depth_m} m {sway_m_per_s} m/s {surge_n} N");
        assert!(distance_m < 0.5 && depth_m < 0.2 && sway_m_per_s < 0.1, "{off}");
        scored_alike(&place, &written);
        // Another law in the same water.
        let other_law = ["--closed-loop", "--controller", "pid-tuned", "--out", "other"];
        let report = replay(&place, &file, &other_law).well().json();
        assert_eq!(report["changed"][0], "controller pid-tuned");
    }
}

#[test]
fn a_recording_in_lock_step_repeats_bit_for_bit() {
    let place = Place::new();
    let short = ["--set", "trial.duration_s=10", "--set", "trial.score.from_s=2"];
    let words = ["up", "paper-agsta", "--json", "--vehicle", ROV, "--listen", &place.socket, "--pace", "lockstep"];
    place.call(&[&words, &["--record", "net"][..], &short].concat()).well();
    let file = recording_in(&place.path().join("net"));
    let report = verified(&place, &file);
    assert_wholly_compared(&report);
    assert_eq!(report["hash"], true);
    assert_eq!(report["rebuilt"], serde_json::json!({}), "every message has its bytes: {report}");
    let report = replay(&place, &file, &["--controller", "pid", "--out", "pid.rrd"]).well().json();
    assert_eq!(report["unchanged"]["equal"], true);
    scored_alike(&place, Path::new("pid.rrd"));
    // A replay is no original.
    replay(&place, Path::new("pid.rrd"), &["--verify"]).refused("is a replay itself");
}

/// Waits until a service has stepped `ticks` times more, as others hear it.
fn passes(listener: &Listener, service: &str, ticks: u64) {
    let mut heard = 0;
    listener.until_on(&format!("telemetry/{service}"), &format!("{service} to step"), |_| {
        heard += 1;
        heard >= ticks
    });
}

#[test]
fn a_recording_in_real_time_with_a_cut_tether_and_a_killed_controller_repeats_bit_for_bit() {
    let place = Place::new();
    let trial = following(place.path());
    let router = place.start(&["serve", "router", "--json", "--listen", &place.socket, "--listen", "tcp/127.0.0.1:0"]);
    let proxy = Proxy::before(&listening(&router.json(), "tcp"));
    let mut recorder =
        place.start(&["record", "--json", "--once", "--out", "net", "--vehicle", ROV, "--connect", &place.socket]);
    recorder.json();
    let serve = |service: &str, endpoint: &str| place.serve_rov(service, &trial, endpoint, &[]);
    let topside = proxy.endpoint();
    let mut services: BTreeMap<&str, Process> = BTreeMap::new();
    for service in ["estimator", "guidance", "controller", "plant"] {
        services.insert(service, serve(service, if service == "guidance" { &topside } else { &place.socket }));
    }
    let listener = Listener::open(&place.socket, ROV).listen("telemetry/*");
    passes(&listener, "controller", 150);
    let mut pilot = listener.client("pilot");
    pilot.acquire(20.0).expect("is granted");
    pilot.command("guidance", "depth_m", serde_json::json!(4.5), None).expect("is scheduled");
    pilot.command("controller", "parameter", serde_json::json!({"path": "fallback.depth.kp", "value": 1.0}), None).ok();
    passes(&listener, "guidance", 50);
    proxy.cut(true);
    passes(&listener, "controller", 120);
    proxy.cut(false);
    passes(&listener, "guidance", 150);
    services.get_mut("controller").expect("runs").kill();
    passes(&listener, "guidance", 60);
    services.insert("controller", serve("controller", &place.socket));
    passes(&listener, "controller", 150);
    recorder.signal("TERM");
    recorder.finish().well();

    let file = recording_in(&place.path().join("net"));
    let ended = replay(&place, &file, &["--verify"]);
    let report = ended.json()["verification"].clone();
    assert_eq!((ended.code, &report["equal"]), (Some(0), &Value::from(true)), "{report}");
    for block in report["blocks"].as_array().expect("blocks") {
        let starts = if block["service"] == "controller" { 2 } else { 1 };
        assert_eq!(block["instances"], starts, "{block}");
        assert_eq!(block["steps"], block["compared"], "every step, also those of the outage: {block}");
        assert!(block["steps"].as_u64() > Some(400), "{block}");
    }
    // What if another law had been in command, then and after the restart?
    let report = replay(&place, &file, &["--controller", "agsta", "--out", "agsta.rrd"]).well().json();
    assert_eq!(report["unchanged"]["equal"], true);
    let requested = |file: &Path| read(file).expect("is read").signals["controller/thrust/requested"].clone();
    let (what_if, original) = (requested(&place.path().join("agsta.rrd")), requested(&file));
    assert!(what_if.tick == original.tick && what_if.values != original.values);
    scored_alike(&place, Path::new("agsta.rrd"));
}

#[test]
fn recordings_that_can_not_be_replayed_are_named() {
    let place = Place::new();
    // The words that must be said, apart by `|`.
    let refused = |file: &Path, more: &[&str], words: &str| {
        let out: &[&str] = if more.contains(&"--verify") { &[] } else { &["--out", "none.rrd"] };
        let ended = replay(&place, file, &[more, out].concat());
        words.split('|').fold(ended, Ended::refused);
        assert!(!place.path().join("none.rrd").exists(), "nothing is left behind: {words}");
    };
    let unreadable = |file: &Path, words: &str| refused(file, &["--verify"], words);
    unreadable(Path::new("nowhere.rrd"), "nowhere.rrd");
    let text = place.path().join("text.rrd");
    std::fs::write(&text, "not a recording").expect("is written");
    unreadable(&text, "text.rrd|not a recording");

    let without = |name: &str, properties: fn(&mut Properties), words: &str| {
        let file = place.path().join(name);
        tampered(&file, |run| run.properties = properties);
        unreadable(&file, words);
    };
    without("bare.rrd", |run| drop(run.remove("config")), "bare.rrd|property config is not there");
    without("seedless.rrd", |run| drop(run.remove("seed")), "seedless.rrd|property seed is not there");
    let of_another_vehicle = |run: &mut Properties| {
        let library = Library::new(CONFIG, Vec::new());
        let other = trial::load(&library, "bluerov2").expect("is legal").swap_remove(0);
        run.insert("config".to_owned(), other.text.into());
    };
    without("other.rrd", of_another_vehicle, "other.rrd|of another vehicle|6 components|8 thrusters");

    let good = place.path().join("good.rrd");
    tampered(&good, |_| {});
    verified(&place, &good);
    let bytes = std::fs::read(&good).expect("is read");
    let half = place.path().join("half.rrd");
    std::fs::write(&half, &bytes[..bytes.len() * 9 / 10]).expect("is written");
    unreadable(&half, "half.rrd|supertwin repair|can be replayed");
    place.call(&["repair", "half.rrd", "--json"]).well();
    let report = replay(&place, &place.path().join("half.repaired.rrd"), &["--verify"]).well().json();
    assert_eq!(report["verification"]["equal"], true, "what is left repeats");

    // Changes that have no effect here.
    let waves = "environment.waves.significant_height_m=0.3";
    let from_controller = ["--from", "controller", "--set", "estimator.measurement.dvl.std=0.1"];
    refused(&good, &["--set", waves], "concerns the plant|--closed-loop");
    refused(&good, &["--closed-loop", "--set", waves], "takes its place");
    refused(&good, &["--set", "trial.seed=3"], "trial.seed=3|what was recorded");
    refused(&good, &from_controller, "concerns the estimator|--from controller");
    refused(&good, &["--set", "controller.law.pid.kp.surge=1"], "another law");
    refused(&good, &["--set", "estimator.measurement.dvl.std=-1"], "dvl.std|must be positive");
    refused(&good, &["--controller", "agst"], "no such controller|agsta");
    refused(&good, &["--verify", "--set", "guidance.lookahead_m=3"], "cannot be used with");
}

/// A recording from the time when an event was a sentence only (format 1, 2026-11), as it was written then.
fn of_format_1(place: &Place, name: &str, packed: &[u8]) -> PathBuf {
    let mut unpacked = Vec::new();
    flate2::read::GzDecoder::new(packed).read_to_end(&mut unpacked).expect("is packed");
    let file = place.path().join(name);
    std::fs::write(&file, unpacked).expect("is written");
    file
}

#[test]
fn a_recording_of_one_process_from_before_events_were_data_repeats_scores_and_aligns() {
    let place = Place::new();
    let file = of_format_1(&place, "batch.rrd", include_bytes!("fixtures/batch-format-1.rrd.gz"));
    let report = verified(&place, &file);
    assert_wholly_compared(&report);
    let shown = place.call(&["show", &file.display().to_string(), "--json"]).well().json();
    assert_eq!(shown["events"].as_array().map(Vec::len), Some(15), "{shown}");
    let zeros = [("following", 0.4), ("event:gsta-tuned", 1.0), ("fault", 1.2), ("reversed", 1.8)];
    for (event, zero_s) in zeros {
        let compared = place.call(&["compare", &file.display().to_string(), "--align", event, "--json"]).well().json();
        assert_eq!(compared["runs"][0]["zero_s"].as_f64(), Some(zero_s), "{event}: {compared}");
    }
}

#[test]
fn a_recording_of_a_network_from_before_events_were_data_repeats() {
    let place = Place::new();
    let file = of_format_1(&place, "network.rrd", include_bytes!("fixtures/network-format-1.rrd.gz"));
    assert_wholly_compared(&verified(&place, &file));
}
