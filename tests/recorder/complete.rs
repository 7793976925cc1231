//! A recording over the network is complete, and equals that of one process.

use super::{ROV, recording_in, shared};
use crate::support::{CONFIG, Place, Process, SERVICES};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use supertwin_core::observe::Snapshot;
use supertwin_core::source::Columns;
use supertwin_core::{Property, Tick};
use supertwin_lab::mission::Mission;
use supertwin_lab::{Library, ResolvedTrial, Scores, Twin, rescore, trial};
use supertwin_rerun::{Recording, read};

/// Every leaf of a JSON tree with its path.
fn leaves(path: &str, value: &Value, found: &mut BTreeMap<String, Value>) {
    match value {
        Value::Object(fields) => {
            fields.iter().for_each(|(name, value)| leaves(&format!("{path}.{name}"), value, found));
        }
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(i, value)| leaves(&format!("{path}.{i}"), value, found));
        }
        _ => {
            found.insert(path.to_owned(), value.clone());
        }
    }
}

/// Where each field of each message stands in a recording: message, field, signal, component. Fields that are the same
/// four axes, or the same list, stand in one line with `*`.
const FIELDS: &[(&str, &str, &str, &[&str])] = &[
    ("plant/measurements", "depth", "plant/measurements/depth", &["depth_m"]),
    ("plant/measurements", "depth", "plant/measurements/depth_taken_at", &["taken_at_s"]),
    ("plant/measurements", "compass", "plant/measurements/heading", &["heading_rad"]),
    ("plant/measurements", "compass", "plant/measurements/heading_taken_at", &["taken_at_s"]),
    ("plant/measurements", "gyro", "plant/measurements/yaw_rate", &["yaw_rate_rad_per_s"]),
    ("plant/measurements", "gyro", "plant/measurements/yaw_rate_taken_at", &["taken_at_s"]),
    ("plant/measurements", "dvl", "plant/measurements/dvl_taken_at", &["taken_at_s"]),
    ("plant/measurements", "dvl.velocity_m_per_s", "plant/measurements/dvl_velocity", &["0", "1", "2"]),
    ("plant/measurements", "dvl.beam_range_m", "plant/measurements/dvl_range", &["0", "1", "2", "3"]),
    ("plant/truth", "", "plant/truth/pose", &["north_m", "east_m", "depth_m", "heading_rad"]),
    ("plant/truth", "velocity", "plant/truth/velocity", RATES),
    ("plant/truth", "water_velocity", "plant/truth/water_velocity", RATES),
    ("plant/truth", "current_m_per_s", "plant/truth/current", &["0", "1", "2"]),
    ("plant/truth", "", "plant/truth/net", &["net_distance_m", "net_heading_rad"]),
    ("plant/truth", "disturbance", "plant/truth/disturbance", FORCES),
    ("plant/truth", "wrench", "plant/truth/wrench", FORCES),
    ("plant/truth", "thruster_force_n", "plant/truth/thruster_force", &["0", "1", "2", "3", "4", "5"]),
    ("estimator/nav", "", "estimator/nav/pose", &["depth_m", "heading_rad"]),
    ("estimator/nav", "velocity", "estimator/nav/velocity", RATES),
    ("estimator/nav", "acceleration", "estimator/nav/acceleration", ACCELERATIONS),
    ("estimator/nav", "disturbance", "estimator/nav/disturbance", FORCES),
    (
        "estimator/nav",
        "variance",
        "estimator/nav/variance",
        &[
            "depth_m2",
            "heading_rad2",
            "velocity.0",
            "velocity.1",
            "velocity.2",
            "velocity.3",
            "disturbance.0",
            "disturbance.1",
            "disturbance.2",
            "disturbance.3",
        ],
    ),
    (
        "estimator/nav",
        "net",
        "estimator/nav/net",
        &["distance_m", "heading_rad", "distance_variance_m2", "heading_variance_rad2"],
    ),
    (
        "estimator/nav",
        "",
        "estimator/nav/health",
        &[
            "net.valid",
            "health.dead_reckoning",
            "health.depth_lost",
            "health.heading_lost",
            "health.thrust_unknown",
            "health.restarted",
        ],
    ),
    ("guidance/reference", "", "guidance/reference/mode", &["mode"]),
    (
        "guidance/reference",
        "",
        "guidance/reference/velocity",
        &["surge_m_per_s", "sway_m_per_s", "surge_m_per_s2", "sway_m_per_s2"],
    ),
    ("guidance/reference", "", "guidance/reference/depth", &["depth_m", "depth_m_per_s", "depth_m_per_s2"]),
    (
        "guidance/reference",
        "",
        "guidance/reference/heading",
        &["heading_rad", "heading_rad_per_s", "heading_rad_per_s2"],
    ),
    ("guidance/reference", "", "guidance/reference/setpoint", &["net_distance_m", "speed_m_per_s"]),
    ("controller/thrust", "force_n", "controller/thrust/force", &["0", "1", "2", "3", "4", "5"]),
    ("controller/thrust", "requested", "controller/thrust/requested", FORCES),
    ("controller/thrust", "allocated", "controller/thrust/allocated", FORCES),
    ("controller/thrust", "limited", "controller/thrust/limited", &["surge", "sway", "heave", "yaw"]),
    ("controller/thrust", "", "controller/thrust/emergency_neutral", &["emergency_neutral"]),
];
const RATES: &[&str] = &["surge_m_per_s", "sway_m_per_s", "heave_m_per_s", "yaw_rad_per_s"];
const ACCELERATIONS: &[&str] = &["surge_m_per_s2", "sway_m_per_s2", "heave_m_per_s2", "yaw_rad_per_s2"];
const FORCES: &[&str] = &["surge_n", "sway_n", "heave_n", "yaw_nm"];

/// The same numbers, bit for bit, at the same ticks.
fn same(path: &str, a: &Columns, b: &Columns) {
    assert_eq!((&a.names, a.width), (&b.names, b.width), "{path}");
    assert!(
        a.tick == b.tick && a.time_ns == b.time_ns,
        "{path}: other ticks: {} and {} rows",
        a.tick.len(),
        b.tick.len()
    );
    let bits = |columns: &Columns| columns.values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert!(bits(a) == bits(b), "{path}: other values");
}

/// Every field of a message that was made at `tick` equals the signal that shows it.
fn is_shown(recording: &Recording, key: &str, tick: i64, message: &Value, seen: &mut BTreeSet<String>) {
    let mut found = BTreeMap::new();
    leaves("", message, &mut found);
    found.retain(|_, value| !value.is_null());
    for (_, place, signal, components) in FIELDS.iter().filter(|field| field.0 == key) {
        for (i, component) in components.iter().enumerate() {
            let name = if place.is_empty() { format!(".{component}") } else { format!(".{place}.{component}") };
            let Some(value) = found.remove(&name) else { continue };
            if let Value::String(text) = &value {
                let labels = &recording.labels[*signal];
                let at = labels.partition_point(|label| label.tick <= tick);
                assert_eq!(&labels[at - 1].value, text, "{key} {name} at {tick}");
            } else {
                let sent = value.as_bool().map_or(value.as_f64(), |flag| Some(f64::from(u8::from(flag))));
                let row = recording.signals[*signal].at(tick).unwrap_or_else(|| panic!("{signal} at {tick}"));
                // Signals are canonical: there is one zero.
                assert_eq!(Some(row[i] + 0.0), sent.map(|sent| sent + 0.0), "{key} {name} at {tick}");
            }
            seen.insert(format!("{key}{name}"));
        }
    }
    assert!(found.is_empty(), "{key}: no signal shows {:?}", found.keys());
}

/// The same of every exact message.
fn messages_are_shown(recording: &Recording, seen: &mut BTreeSet<String>) {
    for key in ["plant/measurements", "estimator/nav", "guidance/reference", "controller/thrust"] {
        for message in &recording.wires[key] {
            let envelope: Value = serde_json::from_slice(&message.bytes).expect("JSON");
            is_shown(recording, key, message.tick, &envelope["data"], seen);
        }
    }
}

/// Properties of a recording that are scores.
fn scores(recording: &Recording) -> BTreeMap<&String, &Property> {
    let names: Vec<String> = Scores::default().properties().into_keys().collect();
    recording.properties["result"].iter().filter(|(name, _)| names.contains(name) || *name == "hash").collect()
}

#[test]
fn a_recording_over_the_network_is_complete_and_equals_that_of_one_process() {
    let _beside = shared();
    let mut fields_seen = BTreeSet::new();
    for name in ["paper-gsta", "paper-agsta", "paper-pid"] {
        let place = Place::new();
        let short = ["--set", "trial.duration_s=20", "--set", "trial.score.from_s=5"];
        place.call(&[&["run", name, "--out", "batch", "--json"], &short[..]].concat()).well();
        let batch = read(&recording_in(&place.path().join("batch"))).expect("is read");

        let _router = place.start(&["serve", "router", "--json", "--listen", &place.socket]);
        let mut recorder =
            place.start(&["record", "--json", "--once", "--out", "net", "--vehicle", ROV, "--connect", &place.socket]);
        let services: Vec<Process> = SERVICES
            .iter()
            .map(|service| {
                let words = ["serve", service, "--json", "--vehicle", ROV, "--connect", &place.socket, "--trial", name];
                let lock_step = ["--pace", "lockstep", "--witness", "recorder"];
                place.start(&[&words, &lock_step[..], &short[..]].concat())
            })
            .collect();
        recorder.finish().well();
        for mut service in services {
            service.finish().well();
        }
        let net = read(&recording_in(&place.path().join("net"))).expect("is read");
        assert!(net.complete && batch.complete);

        // Every quantity that a block shows, at every tick, with the same bits.
        let library = Library::new(CONFIG, Vec::new());
        let resolved: ResolvedTrial = trial::load(&library, name).expect("is legal").swap_remove(0);
        let mut twin = Twin::new(&resolved, resolved.trial.seed).expect("is built");
        let mut shown = BTreeSet::new();
        let mut mission = Mission::new(&resolved.trial.mission, 0.02);
        for k in 0..200 {
            let tick = Tick { k, dt_s: 0.02 };
            while let Some(command) = mission.due(tick) {
                twin.command(tick, command).expect("is legal");
            }
            twin.step(tick);
            // Nobody needs the truth's exact messages; what is shown of it is all there is of it.
            let truth = serde_json::to_value(twin.truth()).expect("JSON");
            is_shown(&net, "plant/truth", k.cast_signed(), &truth, &mut fields_seen);
            let snapshot = Snapshot::of(&twin);
            shown.extend(snapshot.vectors.iter().map(|(signal, _)| signal.path));
            shown.extend(snapshot.labels.iter().map(|(signal, _)| signal.path));
        }
        // Wires are cut by the mission of a batch run only; over the network they are cut for real.
        shown.remove("link/withheld");
        assert!(shown.len() > 40, "{shown:?}");
        for path in shown {
            match net.signals.get(path) {
                Some(columns) => same(path, columns, &batch.signals[path]),
                None => assert_eq!(net.labels[path], batch.labels[path], "{path}"),
            }
        }
        for (path, columns) in batch.signals.iter().filter(|(path, _)| *path != "link/withheld") {
            // Curves that are drawn beside others follow from them; constants among them have as many rows as batches.
            if path.starts_with("derived/") {
                assert!(net.signals.contains_key(path), "{path}");
            } else {
                same(path, &net.signals[path], columns);
            }
        }
        assert_eq!(net.signals["tracking/depth"].tick, (0..1000).collect::<Vec<_>>(), "every tick");
        messages_are_shown(&net, &mut fields_seen);
        // Scores from the file alone are those of the run.
        assert_eq!(scores(&net), scores(&batch), "{name}");
        assert!(scores(&net).len() > 50);
        assert_eq!(rescore(&net).expect("can be scored").scores, rescore(&batch).expect("can be scored").scores);
        for service in SERVICES {
            assert_eq!(net.words[&format!("step/{service}")].len(), 1000, "the account of each step of {service}");
        }
    }
    let listed: BTreeSet<String> = FIELDS
        .iter()
        .flat_map(|(key, place, _, components)| {
            components.iter().map(move |component| {
                if place.is_empty() { format!("{key}.{component}") } else { format!("{key}.{place}.{component}") }
            })
        })
        .collect();
    assert_eq!(fields_seen, listed, "every field has been there at least once");
}
