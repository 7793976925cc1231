//! The recorder against a running twin: everything is in the file, whatever happens to the recorder, its disk and its viewers.

mod complete;

use crate::support::{Listener, Place, Process, Proxy, ROV, SERVICES};
use crate::support::{files_in, following, free_port, listening, python, recording_in};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::{PoisonError, RwLock, RwLockReadGuard};
use supertwin_core::Property;
use supertwin_rerun::{Recording, read};

/// Held by tests that share the processors; those that need all of a dev build's speed have them for themselves.
static PROCESSORS: RwLock<()> = RwLock::new(());

fn shared() -> RwLockReadGuard<'static, ()> {
    PROCESSORS.read().unwrap_or_else(PoisonError::into_inner)
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

    fn record(&self, folder: &str, router: &str, more: &[&str]) -> Process {
        let words = ["record", "--json", "--vehicle", ROV, "--out", folder, "--connect", router];
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
    listener.until_on(key, "ticks to pass", |value| {
        let tick = value["tick"].as_i64().unwrap_or_default();
        tick >= *end.get_or_insert(tick + ticks)
    });
}

/// What a recorder that has just been started is called in what it says.
fn source(recorder: &Process) -> String {
    format!("recorder-{}", recorder.json()["recorder"].as_str().expect("a name"))
}

/// Waits until a recorder that has just been started has said that some of its run is in its file.
fn until_saved(listener: &Listener, recorder: &Process) {
    let source = source(recorder);
    let is_saved = |value: &Value| value["source"] == source && value["steps"].as_u64() > Some(0);
    listener.until_on("health/recorder", "that something is saved", is_saved);
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
    /// The plant's ticks at which its file is looked at; at the last of them it is killed.
    moments: Vec<i64>,
    /// Its file as it was then, and the last tick that it had said.
    left: Vec<(PathBuf, i64)>,
}

#[test]
fn a_recorder_that_is_killed_loses_at_most_the_last_second() {
    let vehicle = Vehicle::up(&[]);
    let listener = vehicle.listen().listen("telemetry/plant").listen("health/recorder");
    let victim = |i: usize| {
        let folder = format!("k{i}");
        let process = vehicle.record(&folder, &vehicle.place.socket, &[]);
        let source = source(&process);
        let folder = vehicle.folder(&folder);
        Victim { process, source, folder, said: Vec::new(), moments: Vec::new(), left: Vec::new() }
    };
    let mut victims: Vec<Victim> = (0..5).map(victim).collect();
    listener.until("all to be killed", |key, value| {
        let tick = value["tick"].as_i64().expect("a tick");
        for (i, victim) in victims.iter_mut().enumerate().filter(|(_, victim)| victim.left.len() < 10) {
            if key == "health/recorder" && value["source"] == victim.source && value["steps"].as_u64() > Some(0) {
                victim.said.push(tick);
            } else if key == "telemetry/plant" && victim.said.len() >= 2 {
                if victim.moments.is_empty() {
                    // Spread over a second by a fixed rule, so that a failure can be repeated.
                    let phase = |round: usize| tick + ((5 * round + i) * 19 % 50) as i64;
                    victim.moments = (0..10).map(phase).collect();
                    victim.moments.sort_unstable();
                }
                if tick < victim.moments[victim.left.len()] {
                    continue;
                }
                // What a process has written stays when it is killed: a copy of the file is what a kill would leave now.
                let copy = victim.folder.with_extension(format!("{}.rrd", victim.left.len()));
                if victim.left.len() == 9 {
                    victim.process.kill();
                }
                std::fs::copy(recording_in(&victim.folder), &copy).expect("is copied");
                victim.left.push((copy, *victim.said.last().expect("something")));
            }
        }
        victims.iter().all(|victim| victim.left.len() == 10)
    });
    let mut killed = 0;
    for Victim { said, left, .. } in &victims {
        // Once a second by its own clock it says what nobody can take from it any more; that nothing came is no step back.
        assert!(said.is_sorted(), "{said:?}");
        for (i, (file, said)) in left.iter().enumerate() {
            killed += 1;
            let recording = read(file).expect("what is left can be read");
            assert!(recording.last_tick() >= Some(*said), "{:?} of {said}", recording.last_tick());
            let numbers = numbers_of(&recording, "plant");
            let gaps: Vec<_> = numbers.windows(2).filter(|pair| pair[1] != pair[0] + 1).collect();
            // Where history ends and listening begins a message may be missing on a busy machine; then it is said.
            let told = recording.events.iter().any(|event| event.text().contains("messages of telemetry/plant"));
            assert!(!recording.complete && (gaps.is_empty() || told), "{gaps:?}: {:?}", recording.events);
            // The shortest and the longest of each: whatever is left can be made whole.
            if [0, 9].contains(&i) {
                let whole = file.with_extension("whole.rrd");
                supertwin_rerun::repair(file, &whole, false).expect("is repaired");
                let whole = read(&whole).expect("is read");
                assert!(whole.complete && whole.signals == recording.signals, "{file:?}");
            }
        }
    }
    assert_eq!(killed, 50);
}

#[test]
fn a_recorder_that_was_cut_off_fetches_what_the_services_kept_and_names_the_rest() {
    let _beside = shared();
    let vehicle = Vehicle::up(&[]);
    let proxy = Proxy::before(&vehicle.tcp);
    let mut recorder = vehicle.record("cut", &proxy.endpoint(), &[]);
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
    let mut first = vehicle.record("parts", &vehicle.place.socket, &[]);
    until_saved(&listener, &first);
    first.kill();
    passes();
    let mut second = vehicle.record("parts", &vehicle.place.socket, &[]);
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
    let mut recorder = vehicle.record("long", &vehicle.place.socket, &["--part-min", "0.03"]);
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
    let is_alarm = |value: &Value| value["data"]["what"]["kind"] == "recording_failed";
    let (alarm, _) = listener.until_on("event/recorder", "the alarm", is_alarm);
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
    let viewer = Process::start(command.args([url, "--port", &free_port().to_string(), "--save"]).arg(&got));
    up.finish().well();
    drop(viewer);
    let [seen, kept] = [got, recording_in(&place.path().join("live"))].map(|file| read(&file).expect("is read"));
    let of = |recording: &Recording| recording.signals["plant/truth/pose"].clone();
    assert!(kept.complete && of(&seen).tick.len() > 200, "{} ticks were seen", of(&seen).tick.len());
    for (row, tick) in of(&seen).tick.iter().enumerate() {
        assert_eq!(of(&seen).row(row), of(&kept).at(*tick), "tick {tick}");
    }
    assert_eq!(numbers_of(&kept, "plant").windows(2).filter(|pair| pair[1] != pair[0] + 1).count(), 0);
}
