//! The recorder against a running twin: everything is in the file, whatever happens to the recorder, its disk and its viewers.

use crate::support::{CONFIG, Listener, Place, Process, Proxy, SERVICES, following, listening, python};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{PoisonError, RwLock, RwLockReadGuard};
use supertwin_core::observe::Snapshot;
use supertwin_core::source::Columns;
use supertwin_core::{Property, Tick};
use supertwin_lab::mission::Mission;
use supertwin_lab::{Library, ResolvedTrial, Scores, Twin, rescore, trial};
use supertwin_rerun::{Recording, read};

/// The vehicle's name in these tests.
const ROV: &str = "rov";
/// Held by tests that share the processors; those that need all of a dev build's speed have them for themselves.
static PROCESSORS: RwLock<()> = RwLock::new(());

fn shared() -> RwLockReadGuard<'static, ()> {
    PROCESSORS.read().unwrap_or_else(PoisonError::into_inner)
}

/// The only recording in `folder`, without its further parts.
fn recording_in(folder: &Path) -> PathBuf {
    let files = files_in(folder);
    let firsts: Vec<&PathBuf> = files.iter().filter(|path| !path.display().to_string().contains(".part")).collect();
    assert_eq!(firsts.len(), 1, "{files:?}");
    firsts[0].clone()
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path()).collect();
    files.sort();
    files
}

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

/// A vehicle in real time, with its router.
struct Vehicle {
    place: Place,
    _up: Process,
    tcp: String,
}

impl Vehicle {
    fn up(more: &[&str]) -> Self {
        let place = Place::new();
        let trial = following(place.path());
        let words = ["up", "--json", "--vehicle", ROV, "--trial", &trial, "--listen", &place.socket];
        let up = place.start(&[&words, &["--listen", "tcp/127.0.0.1:0"][..], more].concat());
        let tcp = listening(&up.json(), "tcp");
        Self { place, _up: up, tcp }
    }

    fn record(&self, folder: &str, more: &[&str]) -> Process {
        let words = ["record", "--json", "--vehicle", ROV, "--out", folder, "--connect", &self.place.socket];
        let words: Vec<&str> = if more.contains(&"--connect") { words[..6].to_vec() } else { words.to_vec() };
        self.place.start(&[&words, more].concat())
    }

    fn listen(&self) -> Listener {
        Listener::open(&self.place.socket, ROV)
    }

    fn folder(&self, name: &str) -> PathBuf {
        self.place.path().join(name)
    }
}

/// Numbers of a service's messages that were recorded. On a busy machine a service may leave ticks out, but no number.
fn numbers_of(recording: &Recording, service: &str) -> Vec<i64> {
    let steps = recording.words.get(&format!("step/{service}")).map_or(&[][..], Vec::as_slice);
    let account = |step: &supertwin_rerun::read::Label| serde_json::from_str::<Value>(&step.value).expect("JSON");
    steps.iter().map(|step| account(step)["seq"].as_i64().expect("a number")).collect()
}

/// Waits until `ticks` more have passed at `key`.
fn pass(listener: &Listener, key: &str, ticks: i64) {
    let mut end = None;
    listener.until("ticks to pass", |heard, value| {
        let tick = value["tick"].as_i64().unwrap_or_default();
        heard == key && tick >= *end.get_or_insert(tick + ticks)
    });
}

/// What a recorder that has just been started is called in what it says.
fn source(recorder: &Process) -> String {
    format!("recorder-{}", recorder.json()["recorder"].as_str().expect("a name"))
}

/// Waits until a recorder that has just been started has said that some of its run is in its file.
fn until_saved(listener: &Listener, recorder: &Process) {
    let source = source(recorder);
    listener.until("that something is saved", |key, value| {
        key == "health/recorder" && value["source"] == source && value["steps"].as_u64() > Some(0)
    });
}

/// Waits until `recorder` has said that it writes.
fn until_recording(recorder: &Process) {
    recorder.until("that it records", |line| line.contains("\"recording\"").then_some(()));
}

/// A recorder that is going to be killed.
struct Victim {
    process: Process,
    source: String,
    folder: PathBuf,
    /// The last tick that it said was in its file, once a second.
    said: Vec<i64>,
    /// The plant's tick at which it is killed.
    killed_at: Option<i64>,
}

#[test]
fn a_recorder_that_is_killed_loses_at_most_the_last_second() {
    let vehicle = Vehicle::up(&[]);
    let listener = vehicle.listen().listen("telemetry/plant").listen("health/recorder");
    let mut killed = 0;
    for round in 0..10 {
        let mut victims: Vec<Victim> = (0..5)
            .map(|i| {
                let folder = format!("k{round}-{i}");
                let process = vehicle.record(&folder, &[]);
                Victim {
                    source: source(&process),
                    process,
                    folder: vehicle.folder(&folder),
                    said: Vec::new(),
                    killed_at: None,
                }
            })
            .collect();
        listener.until("all to be killed", |key, value| {
            let tick = value["tick"].as_i64().expect("a tick");
            for (i, victim) in victims.iter_mut().enumerate() {
                if key == "health/recorder" && value["source"] == victim.source && value["steps"].as_u64() > Some(0) {
                    victim.said.push(tick);
                } else if key == "telemetry/plant" && victim.said.len() >= 2 && victim.process.is_up() {
                    // Spread over a second by a fixed rule, so that a failure can be repeated.
                    let at = *victim.killed_at.get_or_insert(tick + (5 * round + i as i64) * 19 % 50);
                    if tick >= at {
                        victim.process.kill();
                    }
                }
            }
            !victims.iter_mut().any(|victim| victim.process.is_up())
        });
        for Victim { folder, said, .. } in victims {
            killed += 1;
            let recording = read(&recording_in(&folder)).expect("what is left can be read");
            // Once a second by its own clock it says what nobody can take from it any more.
            assert!(said.is_sorted_by(|earlier, later| earlier < later), "{said:?}");
            assert!(recording.last_tick() >= said.last().copied(), "{:?} of {said:?}", recording.last_tick());
            let numbers = numbers_of(&recording, "plant");
            let gaps: Vec<_> = numbers.windows(2).filter(|pair| pair[1] != pair[0] + 1).collect();
            // Where history ends and listening begins a message may be missing on a busy machine; then it is said.
            let told = recording.events.iter().any(|event| event.text().contains("messages of telemetry/plant"));
            assert!(!recording.complete && (gaps.is_empty() || told), "{gaps:?}: {:?}", recording.events);
            let (path, whole) = (recording_in(&folder), folder.join("whole.rrd"));
            let words = ["repair", &path.display().to_string(), "--out", &whole.display().to_string(), "--json"];
            vehicle.place.call(&words).well();
            let whole = read(&whole).expect("is read");
            assert!(whole.complete && whole.signals == recording.signals, "{folder:?}");
        }
    }
    assert_eq!(killed, 50);
}

#[test]
fn a_recorder_that_was_cut_off_fetches_what_the_services_kept_and_names_the_rest() {
    let _beside = shared();
    let vehicle = Vehicle::up(&[]);
    let proxy = Proxy::before(&vehicle.tcp);
    let mut recorder = vehicle.record("cut", &["--connect", &proxy.endpoint()]);
    until_recording(&recorder);
    let listener = vehicle.listen().listen("telemetry/plant").events();
    let passes = |ticks| pass(&listener, "telemetry/plant", ticks);
    passes(100);
    proxy.cut(true);
    // Something happens while nobody listens.
    let mut pilot = listener.client("pilot");
    pilot.acquire(20.0).expect("is granted");
    let tick = pilot.command("guidance", "depth_m", serde_json::json!(4.5), None).expect("is scheduled");
    passes(250);
    proxy.cut(false);
    passes(250);
    recorder.signal("TERM");
    recorder.finish().well();
    let recording = read(&recording_in(&vehicle.folder("cut"))).expect("is read");
    assert!(recording.complete, "{:?}", recording.damage);
    let shown = ["plant/truth/pose", "estimator/nav/pose", "guidance/target", "controller/thrust/force"];
    for (service, signal) in SERVICES.iter().zip(shown) {
        // By the numbers of its messages; a service on a busy machine may leave a tick out.
        let missing = &recording.properties["result"][&format!("missing.{service}")];
        let gaps: Vec<_> = recording.events.iter().filter(|event| event.text().contains("telemetry")).collect();
        assert_eq!(*missing, Property::Integer(0), "telemetry of {service} of the outage is there: {gaps:?}");
        let ticks = &recording.signals[signal].tick;
        let gap = ticks.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or_default();
        assert!(gap < 25 && ticks.len() > 500, "{signal}: {} ticks, the largest gap is {gap}", ticks.len());
    }
    let text = |service: &str, words: &str| {
        recording.events.iter().filter(|event| event.service == service && event.text().contains(words)).count()
    };
    let applied = text("guidance", "command applied: {\"depth_m\":{\"constant\":4.5}}");
    assert_eq!(applied, 1, "events of the outage are there: {:?}", recording.events);
    assert!(recording.events.iter().any(|event| event.tick == tick && event.text().contains("4.5")));
    // Nobody keeps the exact messages of the wires; that they are missing is said, wire by wire.
    for wire in ["plant/measurements", "estimator/nav", "guidance/reference", "controller/thrust"] {
        let messages = &recording.wires[wire];
        let missing = messages.windows(2).map(|pair| pair[1].tick - pair[0].tick - 1).max().unwrap_or_default();
        assert!(missing > 100, "{wire}: {missing} messages are missing");
        assert!(text("recorder", &format!("messages of {wire} before")) >= 1, "{wire}: {:?}", recording.events);
    }
}

#[test]
fn a_recorder_that_is_started_again_goes_on_in_a_second_part() {
    let _beside = shared();
    let vehicle = Vehicle::up(&[]);
    let listener = vehicle.listen().listen("telemetry/plant").listen("health/recorder");
    let passes = || pass(&listener, "telemetry/plant", 100);
    let mut first = vehicle.record("parts", &[]);
    until_saved(&listener, &first);
    first.kill();
    passes();
    let mut second = vehicle.record("parts", &[]);
    until_saved(&listener, &second);
    passes();
    second.signal("INT");
    second.finish().well();
    let files = files_in(&vehicle.folder("parts"));
    assert!(files.len() == 2 && files[0].display().to_string().ends_with(".part2.rrd"), "{files:?}");
    for file in &files {
        let part = supertwin_rerun::read_parts(std::slice::from_ref(file), &|_| true).expect("is read");
        assert!(part.properties["run"].contains_key("config"), "{file:?} is complete in itself");
    }
    let both = read(&recording_in(&vehicle.folder("parts"))).expect("is read");
    let known: BTreeSet<i64> = numbers_of(&both, "plant").into_iter().collect();
    let (first, last) = (known.first().expect("some"), known.last().expect("some"));
    assert_eq!(known.len() as i64, last - first + 1, "the second asked for what the services kept");
}

#[test]
fn parts_are_closed_by_time_and_each_is_complete_in_itself() {
    // Five times real time is as much as a dev build of the recorder can do by itself.
    let _alone = PROCESSORS.write().unwrap_or_else(PoisonError::into_inner);
    let vehicle = Vehicle::up(&["--rtf", "5"]);
    let mut recorder = vehicle.record("long", &["--part-min", "0.03"]);
    for _ in 0..3 {
        recorder.until("that a part is closed", |line| line.contains("\"closed\"").then_some(()));
    }
    // The last part begins here, and should have something in it.
    pass(&vehicle.listen().listen("telemetry/controller"), "telemetry/controller", 100);
    recorder.signal("TERM");
    recorder.finish().well();
    let files = files_in(&vehicle.folder("long"));
    assert!(files.len() >= 4, "{files:?}");
    for file in &files {
        let part = supertwin_rerun::read_parts(std::slice::from_ref(file), &|_| true).expect("is read");
        assert!(part.complete, "{:?}", part.damage);
        assert!(part.properties["run"].contains_key("config"), "{file:?}");
        let names = &part.signals["controller/sigma"].names;
        assert!(names.len() == 4 && names[0].starts_with("surge"), "{file:?}: {names:?}");
        let (modes, targets) = (&part.labels["guidance/reference/mode"], &part.signals["guidance/target"]);
        assert_eq!(modes[0].tick, targets.tick[0], "{file:?} knows the mode from its beginning");
    }
    let all = read(&recording_in(&vehicle.folder("long"))).expect("is read");
    let numbers = numbers_of(&all, "plant");
    let gaps: Vec<_> = numbers.windows(2).filter(|pair| pair[1] != pair[0] + 1).collect();
    assert!(all.parts == files.len() && numbers.len() > 100 && gaps.is_empty(), "{} parts, {gaps:?}", all.parts);
}

#[test]
fn a_full_disk_is_an_alarm_and_what_was_written_stays_readable() {
    let _beside = shared();
    let vehicle = Vehicle::up(&["--rtf", "5"]);
    let listener = vehicle.listen().events();
    // A file may not grow beyond 6 MB: what a full disk does to it, without a disk.
    let line = format!(
        "trap '' XFSZ; ulimit -f 12000; exec supertwin record --json --vehicle {ROV} --out full --connect {}",
        vehicle.place.socket
    );
    let recorder = vehicle.place.start_shell(&line);
    until_recording(&recorder);
    let (alarm, _) = listener.until("the alarm", |key, value| {
        key == "event/recorder" && value["data"]["what"]["kind"] == "recording_failed"
    });
    assert_eq!(alarm["data"]["severity"], "error");
    // It tries again by itself, in another part.
    recorder.until("that it records again", |line| line.contains("part2").then_some(()));
    drop(recorder);
    let left = supertwin_rerun::read_parts(&[recording_in(&vehicle.folder("full"))], &|_| true).expect("is read");
    assert!(left.signals["plant/truth/pose"].tick.len() > 300, "{:?}", left.damage);
}

#[test]
fn two_vehicles_are_recorded_by_one_recorder() {
    let _beside = shared();
    let place = Place::new();
    let _router = place.start(&["serve", "router", "--json", "--listen", &place.socket]);
    let trial = following(place.path());
    let up = |vehicle: &str| {
        let words = ["up", "--json", "--vehicle", vehicle, "--trial", &trial, "--connect", &place.socket];
        place.start(&[&words, &["--duration", "6"][..]].concat())
    };
    let mut recorder = place.start(&["serve", "recorder", "--json", "--out", "two", "--connect", &place.socket]);
    let ups = [up("a"), up("b")];
    for _ in 0..2 {
        until_recording(&recorder);
    }
    for mut up in ups {
        up.finish().well();
    }
    recorder.signal("TERM");
    recorder.finish().well();
    for file in files_in(&place.path().join("two")) {
        let recording = read(&file).expect("is read");
        let ticks = recording.signals["plant/truth/pose"].tick.len();
        assert!(recording.complete && (250..=300).contains(&ticks), "{file:?}: {ticks}");
    }
    assert_eq!(files_in(&place.path().join("two")).len(), 2);
}

#[test]
fn a_live_view_is_served_beside_the_recording_and_says_how_to_open_it() {
    let _beside = shared();
    // Where it is not there yet it takes longer to install than the run takes.
    let environment = python::environment();
    let place = Place::new();
    let trial = following(place.path());
    let words = ["up", "--json", "--vehicle", ROV, "--trial", &trial, "--listen", &place.socket, "--duration", "8"];
    let mut up = place.start(&[&words, &["--record", "live", "--live", "0", "--live-web", "0"][..]].concat());
    let said = up.json();
    let (url, page) = (said["live"].as_str().expect("a URL"), said["page"].as_str().expect("a page"));
    assert!(said["tunnel"].as_str().expect("a command").starts_with("ssh -N -L "));
    // The page is Rerun's web viewer, and it is told where to look.
    let web =
        python::say(place.path(), "import sys, urllib.request as u; print(u.urlopen(sys.argv[1]).read())", &[page]);
    assert!(web.contains("re_viewer") && page.contains("proxy"), "{page}: {web:.300}");
    let got = place.path().join("got.rrd");
    let mut command = place.command(python::viewer(&environment).to_str().expect("a path"));
    // It listens as well; its usual port may be taken.
    let port = std::net::TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr()).expect("a port").port();
    let viewer = Process::start(command.args([url, "--port", &port.to_string(), "--save"]).arg(&got));
    up.finish().well();
    drop(viewer);
    let (seen, kept) =
        (read(&got).expect("is read"), read(&recording_in(&place.path().join("live"))).expect("is read"));
    let of = |recording: &Recording| recording.signals["plant/truth/pose"].clone();
    assert!(kept.complete && of(&seen).tick.len() > 200, "{} ticks were seen", of(&seen).tick.len());
    for (row, tick) in of(&seen).tick.iter().enumerate() {
        assert_eq!(of(&seen).row(row), of(&kept).at(*tick), "tick {tick}");
    }
    assert_eq!(numbers_of(&kept, "plant").windows(2).filter(|pair| pair[1] != pair[0] + 1).count(), 0);
}
