//! Programs in another language, with the published client and nothing of ours, against a running twin.
//!
//! The client comes from PyPI into `target`, once. What a program does is judged by the vehicle's true state.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use supertwin_zenoh::{Client, Clock, Link, SystemClock};

const CONFIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config");
const PROGRAMS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/clients");
/// The same version as our own.
const ZENOH: &str = "eclipse-zenoh==1.10.2";
/// Nothing here takes this long.
const PATIENCE: Duration = Duration::from_secs(30);
const SERVICES: [&str; 4] = ["plant", "estimator", "guidance", "controller"];

/// One twin at a time: each wants the processor for itself.
static TURN: Mutex<()> = Mutex::new(());

// ----------------------------------------------------------------------------------------------------------- programs

/// The interpreter with the client in it, installed when it is not there yet. Not the environment of the viewer's
/// test, which clears it.
fn python() -> PathBuf {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
    let home = target.join("python-clients");
    let binary = home.join("bin/python");
    // Others may do the same now: whoever holds the lock installs, they find it installed.
    let lock = fs::File::create(target.join("python-clients.lock")).unwrap();
    lock.lock().unwrap();
    let installed = home.join("installed");
    if fs::read_to_string(&installed).is_ok_and(|what| what == ZENOH) {
        return binary;
    }
    let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", ZENOH];
    for command in [Command::new("python3").args(["-m", "venv", "--clear"]).arg(&home), Command::new(&binary).args(pip)]
    {
        assert!(command.status().unwrap().success(), "{command:?}");
    }
    fs::write(installed, ZENOH).unwrap();
    binary
}

/// A process with its lines. It ends with its test.
struct Program {
    child: Child,
    lines: Receiver<String>,
    errors: PathBuf,
    clock: SystemClock,
}

impl Program {
    fn start(command: &mut Command, errors: PathBuf) -> Self {
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(fs::File::create(&errors).unwrap());
        let mut child = command.spawn().unwrap_or_else(|error| panic!("{command:?}: {error}"));
        let stdout = BufReader::new(child.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in stdout.lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Self { child, lines, errors, clock: SystemClock::start() }
    }

    /// Reads lines until `wanted` makes something of one.
    fn until<T>(&self, what: &str, mut wanted: impl FnMut(&str) -> Option<T>) -> T {
        let deadline = self.clock.now() + PATIENCE;
        loop {
            match self.lines.recv_timeout(deadline.saturating_sub(self.clock.now())) {
                Ok(line) => {
                    if let Some(found) = wanted(&line) {
                        return found;
                    }
                }
                Err(RecvTimeoutError::Timeout) => panic!("{what} never came; {}", self.complaints()),
                Err(RecvTimeoutError::Disconnected) => panic!("ended before {what}; {}", self.complaints()),
            }
        }
    }

    /// The line that contains `words`.
    fn line_with(&self, words: &str) -> String {
        self.until(words, |line| line.contains(words).then(|| line.to_owned()))
    }

    fn complaints(&self) -> String {
        fs::read_to_string(&self.errors).unwrap_or_default()
    }

    /// Waits for its end: its other lines and its status.
    fn finish(mut self) -> (Vec<String>, ExitStatus) {
        let deadline = self.clock.now() + PATIENCE;
        let mut said = Vec::new();
        loop {
            match self.lines.recv_timeout(deadline.saturating_sub(self.clock.now())) {
                Ok(line) => said.push(line),
                Err(RecvTimeoutError::Disconnected) => return (said, self.child.wait().unwrap()),
                Err(RecvTimeoutError::Timeout) => panic!("does not end: {said:?}; {}", self.complaints()),
            }
        }
    }

    fn signal(&self, name: &str) {
        assert!(Command::new("kill").args([name, &self.child.id().to_string()]).status().unwrap().success());
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A twin in a process of its own.
struct Twin {
    program: Program,
    listening: Vec<String>,
    folder: tempfile::TempDir,
    clients: std::cell::Cell<usize>,
    _turn: MutexGuard<'static, ()>,
}

impl Twin {
    fn up(arguments: &[&str]) -> Self {
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        let folder = tempfile::tempdir().unwrap();
        let socket = format!("unixsock-stream/{}", folder.path().join("r.sock").display());
        let mut command = Command::new(env!("CARGO_BIN_EXE_supertwin"));
        command.args(["--config", CONFIG, "up", "--no-mission", "--json", "--trial", "external", "--listen", &socket]);
        let program = Program::start(command.args(arguments), folder.path().join("twin.err"));
        let started: Value = program.until("the first line", |line| serde_json::from_str(line).ok());
        let listening = started["listening"].as_array().unwrap();
        let listening = listening.iter().map(|place| place.as_str().unwrap().to_owned()).collect();
        Self { program, listening, folder, clients: 0.into(), _turn: turn }
    }

    fn socket(&self) -> &str {
        self.listening.iter().find(|place| place.starts_with("unixsock")).unwrap()
    }

    /// One of the programs, connected.
    fn client(&self, program: &str, arguments: &[&str]) -> Program {
        self.client_by(self.socket(), program, arguments)
    }

    fn client_by(&self, endpoint: &str, program: &str, arguments: &[&str]) -> Program {
        self.clients.set(self.clients.get() + 1);
        let mut command = Command::new(python());
        command.arg(format!("{PROGRAMS}/{program}.py")).args(arguments).args(["--connect", endpoint]);
        command.env("PYTHONDONTWRITEBYTECODE", "1");
        Program::start(&mut command, self.folder.path().join(format!("{program}-{}.err", self.clients.get())))
    }

    /// A client in our own language.
    fn operator(&self, name: &str) -> Client {
        let link = Link {
            connect: vec![self.socket().to_owned()],
            mode: Some("client"),
            patience_ms: 3000,
            ..Link::default()
        };
        Client::new(link.open().unwrap(), "argus-mini", name, Arc::new(SystemClock::start()))
    }

    /// Everything that is said on `keys`, and all events and states.
    fn listen(&self, keys: &[&str]) -> Listener {
        let mut arguments = vec!["--json"];
        keys.iter().for_each(|key| arguments.extend(["--also", key]));
        Listener(self.client("monitor", &arguments))
    }

    fn is_up(&mut self) -> bool {
        self.program.child.try_wait().unwrap().is_none()
    }
}

/// The monitor, whose lines are `{"key": …, "body": …}`.
struct Listener(Program);

impl Listener {
    /// Until `wanted` makes something of a message.
    fn until<T>(&self, what: &str, mut wanted: impl FnMut(&str, &Value) -> Option<T>) -> T {
        self.0.until(what, |line| {
            let line: Value = serde_json::from_str(line).unwrap();
            wanted(line["key"].as_str().unwrap(), &line["body"])
        })
    }

    /// All messages on `key` from now on, for so many seconds of the simulation, as `(simulation time, data)`.
    fn record(&self, key: &str, for_s: f64) -> Vec<(f64, Value)> {
        let (mut found, mut end) = (Vec::new(), None);
        self.until(key, |of, body| {
            let t = body["sim_time_s"].as_f64().filter(|_| of == key)?;
            found.push((t, body["data"].clone()));
            (t >= *end.get_or_insert(t + for_s)).then_some(())
        });
        found
    }
}

fn number(value: &Value, name: &str) -> f64 {
    value[name].as_f64().unwrap_or_else(|| panic!("no {name} in {value}"))
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    values.sum::<f64>() / n
}

/// An angle between −π and π.
fn wrapped(angle: f64) -> f64 {
    let turn = core::f64::consts::TAU;
    angle - turn * (angle / turn).round()
}

// -------------------------------------------------------------------------------------------------------------- tests

#[test]
fn every_program_explains_itself() {
    for program in ["set_depth", "mission", "monitor", "external_pid", "hostile"] {
        let mut command = Command::new(python());
        command.args([&format!("{PROGRAMS}/{program}.py"), "--help"]).env("PYTHONDONTWRITEBYTECODE", "1");
        let done = command.output().unwrap();
        let said = String::from_utf8_lossy(&done.stdout);
        assert!(done.status.success() && said.contains("--connect") && said.contains("--vehicle"), "{program}: {said}");
    }
}

#[test]
fn a_depth_is_reached_and_one_beyond_the_limits_is_refused() {
    let twin = Twin::up(&["--rtf", "5"]);
    let truth = twin.listen(&["plant/truth"]);
    let (said, status) = twin.client("set_depth", &["3.0"]).finish();
    assert!(status.success() && said.iter().any(|line| line.starts_with("reached")), "{said:?}");
    let depths = truth.record("plant/truth", 15.0);
    let late = &depths[depths.len() / 2..];
    let depth = mean(late.iter().map(|(_, truth)| number(truth, "depth_m")));
    assert!((depth - 3.0).abs() < 0.25, "the vehicle is at {depth} m");

    let refused = twin.client("set_depth", &["30"]);
    let errors = refused.errors.clone();
    let (_, status) = refused.finish();
    let why = fs::read_to_string(errors).unwrap();
    assert!(status.code() == Some(1) && why.contains("depth_m = 30: must lie between 0 and 14"), "{status} {why}");
    // The lease was given back both times: another one may have it at once.
    assert!(twin.operator("anna").acquire(5.0).unwrap().granted);
}

#[test]
fn the_program_in_the_readme_works_as_it_stands_there() {
    let twin = Twin::up(&["--rtf", "5"]);
    let telemetry = twin.listen(&["telemetry/guidance"]);
    let readme = include_str!("../README.md");
    let (_, program) = readme.split_once("```python\nimport json, zenoh").unwrap();
    let (program, _) = program.split_once("```").unwrap();
    let shown = "unixsock-stream//tmp/supertwin/router.sock";
    assert!(program.contains(shown));
    let program = format!("import json, zenoh{}", program.replace(shown, twin.socket()));
    // A second time as well: its numbers begin anew with its lease.
    for _ in 0..2 {
        let done = Command::new(python()).args(["-c", &program]).output().unwrap();
        let said = String::from_utf8_lossy(&done.stdout);
        assert!(done.status.success() && said.matches("scheduled").count() == 2, "{said} {done:?}");
    }
    let depth_m = telemetry.until("the new depth", |key, body| {
        let target = body["data"]["signals"]["guidance/target"][0].as_f64()?;
        (key == "telemetry/guidance" && target > 2.9).then_some(target)
    });
    assert_eq!(depth_m, 3.0, "guidance wants what the program asked for");
}

#[test]
fn a_mission_goes_along_the_net_and_back_and_ends_at_rest() {
    let twin = Twin::up(&["--rtf", "5"]);
    let truth = twin.listen(&["plant/truth"]);
    let began = truth.record("plant/truth", 0.0)[0].0;
    let (said, status) = twin.client("mission", &["--depth", "2.5", "--leg", "20"]).finish();
    assert!(status.success(), "{said:?}");
    let at = |words: &str| {
        let line = said.iter().find(|line| line.contains(words)).unwrap_or_else(|| panic!("{words}: {said:?}"));
        line.split_whitespace().next().unwrap().parse::<f64>().unwrap()
    };
    let (starboard, port, stopping, stopped) = (at("starboard"), at("port"), at("stopping"), at("stopped"));
    let seen = truth.record("plant/truth", stopped + 8.0 - began);
    let between = |from: f64, to: f64| seen.iter().filter(move |(t, _)| (from..to).contains(t)).map(|(_, truth)| truth);
    // The vehicle faces the net from inside: to starboard is clockwise around the cage, seen from above.
    let along_m = |from: f64, to: f64| {
        let places: Vec<&Value> = between(from, to).collect();
        let bearing = |truth: &Value| number(truth, "east_m").atan2(number(truth, "north_m"));
        let radius = number(places[0], "north_m").hypot(number(places[0], "east_m"));
        radius * wrapped(bearing(places[places.len() - 1]) - bearing(places[0]))
    };
    let (out, back) = (along_m(starboard, port), along_m(port, stopping));
    assert!(out > 1.5 && back < -1.5, "{out} m to starboard, then {back} m");
    for truth in between(starboard + 5.0, stopping) {
        let distance = number(truth, "net_distance_m");
        assert!((1.5..5.0).contains(&distance), "{distance} m from the net");
    }
    let end: Vec<&Value> = between(stopped + 3.0, f64::INFINITY).collect();
    for axis in ["surge_m_per_s", "sway_m_per_s", "heave_m_per_s"] {
        let speed = mean(end.iter().map(|truth| number(&truth["velocity"], axis)));
        assert!(speed.abs() < 0.06, "{axis} is {speed} at the end");
    }
    let depth = mean(end.iter().map(|truth| number(truth, "depth_m")));
    assert!((depth - 2.5).abs() < 0.3, "at {depth} m at the end");
}

#[test]
fn a_controller_in_another_language_steers_the_vehicle() {
    let twin = Twin::up(&["--rtf", "2"]);
    let listener = twin.listen(&["plant/truth", "telemetry/controller"]);
    let (said, status) = twin.client("set_depth", &["1.8"]).finish();
    assert!(status.success(), "{said:?}");
    let outside = |flags: [f64; 4]| {
        listener.until(&format!("{flags:?} from outside"), |key, body| {
            (key == "telemetry/controller" && body["data"]["signals"]["controller/external"] == json!(flags))
                .then_some(())
        });
    };

    let pid = twin.client("external_pid", &["--axes", "yaw"]);
    pid.line_with("steering yaw");
    outside([0.0, 0.0, 0.0, 1.0]);
    let mut anna = twin.operator("anna");
    assert!(anna.acquire(60.0).unwrap().granted);
    let heading = number(&listener.record("plant/truth", 0.0)[0].1, "heading_rad");
    let wanted = wrapped(heading + 0.6);
    anna.command("guidance", "heading_rad", json!(wanted), None).unwrap();
    let off = |truth: &Value| wrapped(number(truth, "heading_rad") - wanted).abs();
    listener.until("the new heading", |key, body| (key == "plant/truth" && off(&body["data"]) < 0.05).then_some(()));
    // A third of the step at most, in waves and with a controller whose ticks are late on a busy machine.
    let held = listener.record("plant/truth", 9.0);
    let error = mean(held[held.len() * 2 / 3..].iter().map(|(_, truth)| off(truth)));
    assert!(error < 0.2, "the heading is off by {error} rad");

    // Without the program the vehicle's own substitute goes on.
    drop(pid);
    outside([0.0; 4]);
    let pid = twin.client("external_pid", &["--axes", "surge,sway,heave,yaw"]);
    pid.line_with("steering surge");
    outside([1.0; 4]);
    anna.command("guidance", "depth_m", json!(2.4), None).unwrap();
    let depth = |truth: &Value| number(truth, "depth_m");
    listener.until("the new depth", |key, body| (key == "plant/truth" && depth(&body["data"]) > 2.3).then_some(()));
    let held = listener.record("plant/truth", 8.0);
    let held = &held[held.len() / 2..];
    let reached = mean(held.iter().map(|(_, truth)| depth(truth)));
    assert!((reached - 2.4).abs() < 0.25, "the vehicle is at {reached} m");
    let error = mean(held.iter().map(|(_, truth)| off(truth)));
    assert!(error < 0.2, "the heading is off by {error} rad");
}

/// What nobody may change without authority.
fn settings(operator: &Client) -> BTreeMap<String, Value> {
    let mut found = BTreeMap::new();
    for service in SERVICES {
        found.insert(format!("parameters of {service}"), operator.parameter(service, "").unwrap_or_default());
    }
    for name in ["guidance/mode", "guidance/depth_m", "guidance/direction", "controller/law", "controller/neutral"] {
        // A state that was never set has no answer.
        let key = operator.key(&format!("state/{name}"));
        let known = matches!(name, "guidance/mode" | "guidance/depth_m");
        found.insert(name.to_owned(), if known { operator.ask(&key, None::<&()>).unwrap() } else { Value::Null });
    }
    found
}

#[test]
fn hostile_clients_change_nothing_crash_nothing_and_leave_a_trace() {
    let mut twin = Twin::up(&["--rtf", "1"]);
    let listener = twin.listen(&["plant/truth", "guidance/reference", "health/*"]);
    let mut anna = twin.operator("anna");
    let token = anna.acquire(60.0).unwrap().token.unwrap();
    anna.command("guidance", "depth_m", json!(1.6), None).unwrap();
    let apply_tick = anna.command("guidance", "mode", json!("depth_heading_hold"), None).unwrap();
    let reference = |at_least: u64| {
        listener.until("a reference", |key, body| {
            let ours = key == "guidance/reference" && body["source"].as_str()?.starts_with("guidance-");
            (ours && body["tick"].as_u64()? >= at_least).then(|| body["data"].clone())
        })
    };
    let begin = reference(apply_tick);
    assert_eq!(begin["mode"], "depth_heading_hold");
    let before = settings(&anna);

    // The attacks, while the twin is watched.
    let (lines, status) = twin.client("hostile", &["--holder", "anna"]).finish();
    assert!(status.success() && lines.len() == 12, "{lines:?}");
    for line in &lines {
        let report: Value = serde_json::from_str(line).unwrap();
        let count = |what: &str| report[what].as_u64().unwrap_or(0);
        assert_eq!(count("granted"), 0, "{line}");
        match report["attack"].as_str().unwrap() {
            // Nobody is there, or a key that nobody serves.
            "wrong_vehicle" => assert_eq!((count("asked"), count("refused")), (4, 0), "{line}"),
            "garbage_requests" => assert!(count("refused") + 1 >= count("asked"), "{line}"),
            "command_flood" => assert!(count("per_s") > 500 && count("refused") == 1, "{line}"),
            _ => assert_eq!(count("refused"), count("asked"), "{line}"),
        }
    }

    // The holder is clumsy, too: numbers come again, with the same and with other contents.
    let key = anna.key("command/guidance/net_distance_m");
    let ask = |seq: u64, value: f64| {
        anna.ask(&key, Some(&json!({ "client": "anna", "seq": seq, "token": token, "value": value })))
    };
    let first = ask(1000, 3.0).unwrap();
    assert_eq!(ask(1000, 3.0).unwrap(), first, "the same request has the same answer");
    for (seq, value) in [(1000, 5.0), (999, 5.0), (0, 5.0)] {
        let refusal = ask(seq, value).unwrap_err().to_string();
        assert!(refusal.contains("must be greater than 1000"), "{refusal}");
    }

    // A request that is wrong, but has the right token in it: the token must not come up in an event.
    let wrong = json!({ "client": "anna", "token": token, "seq": 1001, "value": 1.0, "extra": "x".repeat(3000) });
    assert!(anna.ask(&key, Some(&wrong)).unwrap_err().to_string().contains("unknown field"));

    // Nothing has changed.
    assert_eq!(settings(&anna), before);
    let end = reference(first["apply_tick"].as_u64().unwrap() + 5);
    for name in ["mode", "net_distance_m", "speed_m_per_s"] {
        assert_eq!(end[name], begin[name], "{name}");
    }
    assert!(
        (number(&end, "depth_m") - 1.6).abs() < 0.1
            && (number(&end, "heading_rad") - number(&begin, "heading_rad")).abs() < 1e-9
    );
    let truth = listener.record("plant/truth", 1.0);
    let depth = mean(truth.iter().map(|(_, truth)| number(truth, "depth_m")));
    assert!((depth - 1.6).abs() < 0.4, "the vehicle is at {depth} m");

    // All four are there and were in time, and each has counted what it refused.
    let mut health: BTreeMap<String, Value> = BTreeMap::new();
    listener.until("the health of all four", |key, body| {
        let service = key.strip_prefix("health/").filter(|_| body.is_object())?;
        health.insert(service.to_owned(), body.clone());
        (health.len() == 4).then_some(())
    });
    for (service, health) in &health {
        let count = |what: &str| health[what].as_u64().unwrap();
        let late = count("deadline_misses") + count("skipped") + count("late_triggers");
        assert!(count("steps") > 300 && late * 5 < count("steps"), "{service}: {health}");
        assert!(count("refused") > 0 && count("not_finite") == 0, "{service}: {health}");
        for (wire, input) in health["inputs"].as_object().unwrap() {
            let traced = input["rejected"].as_u64().unwrap() > 0;
            let rivals = input["rivals"].as_u64().unwrap() > 0 || wire == "controller/wrench_request";
            assert!(traced && rivals && input["takeovers"] == 0, "{service} {wire}: {input}");
        }
    }
    assert!(health["guidance"]["commands"]["refused"].as_u64().unwrap() > 1000);
    assert!(health["guidance"]["setpoints"][1].as_u64().unwrap() > 1000, "streams were refused");
    assert!(health["controller"]["refused"].as_u64().unwrap() > 30, "leases were refused");
    assert!(twin.is_up());

    // Their events say so; the command that came twice has applied once; and the holder still commands.
    ask(1001, 3.5).unwrap();
    let again = twin.listen(&[]);
    let mut refused: BTreeMap<String, usize> = BTreeMap::new();
    let (mut applied, mut last) = (0, false);
    again.until("the last command", |key, body| {
        let text = key.strip_prefix("event/").and(body["data"]["text"].as_str())?;
        assert!(!text.contains(&token) && text.len() < 500, "{text}");
        if text.starts_with("refused: ") {
            *refused.entry(body["data"]["service"].as_str()?.to_owned()).or_default() += 1;
        }
        applied += usize::from(text.starts_with("command applied") && text.ends_with("anna seq 1000"));
        last |= body["data"]["service"] == "guidance" && text.ends_with("anna seq 1001");
        // Each service's events are in order, those of different services are not.
        (last && refused.len() == 4).then_some(())
    });
    assert_eq!((applied, refused.len()), (1, 4), "{refused:?}");
}

// ------------------------------------------------------------------------------------------------- a network to be cut

/// A line that can be cut: everything to its own address goes on to another one.
struct Tether {
    address: String,
    cut: Arc<AtomicBool>,
    open: Arc<Mutex<Vec<TcpStream>>>,
}

impl Tether {
    fn to(target: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let (cut, open) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(Vec::<TcpStream>::new())));
        let (is_cut, streams, target) = (Arc::clone(&cut), Arc::clone(&open), target.to_owned());
        std::thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let Ok(far) = TcpStream::connect(&target) else { continue };
                let mut streams = streams.lock().unwrap();
                if is_cut.load(Ordering::SeqCst) {
                    continue;
                }
                for (from, to) in [(&near, &far), (&far, &near)] {
                    let (mut from, mut to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    streams.push(from.try_clone().unwrap());
                    std::thread::spawn(move || {
                        // Ends when either side does.
                        let _ = std::io::copy(&mut from, &mut to).and_then(|_| to.flush());
                        let _ = to.shutdown(Shutdown::Both);
                    });
                }
            }
        });
        Self { address, cut, open }
    }

    fn cut(&self) {
        let mut open = self.open.lock().unwrap();
        self.cut.store(true, Ordering::SeqCst);
        for stream in open.drain(..) {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    fn mend(&self) {
        self.cut.store(false, Ordering::SeqCst);
    }
}

/// Numbers of the events that arrived, by source.
#[derive(Clone, Debug, Default)]
struct Heard(BTreeMap<String, Vec<u64>>);

impl Heard {
    /// Enters a line of the monitor; returns what the event says, if it is one.
    fn line(&mut self, line: &str) -> String {
        let line: Value = serde_json::from_str(line).unwrap();
        if !line["key"].as_str().unwrap().starts_with("event/") {
            return String::new();
        }
        let event = &line["body"];
        let source = event["source"].as_str().unwrap().to_owned();
        self.0.entry(source).or_default().push(event["seq"].as_u64().unwrap());
        event["data"]["text"].as_str().unwrap().to_owned()
    }
}

#[test]
fn a_listener_that_was_cut_off_gets_every_event_once_and_in_order() {
    let twin = Twin::up(&["--rtf", "1", "--listen", "tcp/127.0.0.1:0"]);
    let router = twin.listening.iter().find_map(|place| place.strip_prefix("tcp/")).unwrap();
    let tether = Tether::to(router);
    let far = Listener(twin.client_by(&format!("tcp/{}", tether.address), "monitor", &["--json"]));
    let near = twin.listen(&["health/plant"]);
    let mut anna = twin.operator("anna");
    assert!(anna.acquire(60.0).unwrap().granted);

    let mut heard = Heard::default();
    let hear =
        |heard: &mut Heard, words: &str| far.0.until(words, |line| heard.line(line).ends_with(words).then_some(()));
    let seconds = |n: usize| {
        let mut left = n;
        near.until("the heartbeat of the plant", |key, _| {
            left -= usize::from(key == "health/plant");
            (left == 0).then_some(())
        });
    };
    let mut talk = |n: u64| -> u64 {
        for _ in 0..n {
            anna.command("guidance", "speed_m_per_s", json!(0.2), None).unwrap();
        }
        n
    };
    let mut sent = talk(3);
    hear(&mut heard, &format!("by anna seq {sent}"));

    tether.cut();
    sent += talk(100);
    seconds(3);
    let cut_off = heard.clone();
    let so_far = far.0.lines.try_iter().filter(|line| heard.line(line).ends_with(&format!("anna seq {sent}"))).count();
    assert_eq!(so_far, 0, "it was not cut off: {cut_off:?}");
    tether.mend();
    sent += talk(1);
    hear(&mut heard, &format!("by anna seq {sent}"));

    // One that does not read for a while.
    far.0.signal("-STOP");
    sent += talk(100);
    seconds(3);
    far.0.signal("-CONT");
    sent += talk(1);
    hear(&mut heard, &format!("by anna seq {sent}"));

    // A last word that nothing follows is not lost either.
    tether.cut();
    sent += talk(1);
    seconds(1);
    tether.mend();
    hear(&mut heard, &format!("by anna seq {sent}"));

    let got = &heard.0;
    assert!(got.len() >= 3, "{:?}", got.keys());
    for (source, numbers) in got {
        let complete: Vec<u64> = (1..=numbers.len() as u64).collect();
        assert_eq!(*numbers, complete, "{source}");
    }
    let guidance = got.iter().find(|(source, _)| source.starts_with("guidance-")).unwrap().1.len();
    // Each is scheduled and applied.
    assert!(guidance as u64 >= 2 * sent, "{guidance} events for {sent} commands");
}
