//! Programs in another language, with the published client and nothing of ours, against a running twin.
//!
//! The client comes from PyPI into `target`, once. What a program does is judged by the vehicle's true state.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use crate::support::python::environment_with;
use crate::support::{Events, Listener, Place, Process, Proxy, SERVICES, listening};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Command;
use supertwin_protocol::lease::LeaseAction;
use supertwin_zenoh::Client;

const PROGRAMS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/clients");
/// The same version as our own.
const ZENOH: &str = "eclipse-zenoh==1.10.2";

// ----------------------------------------------------------------------------------------------------------- programs

/// The interpreter with the client in it, installed when it is not there yet.
fn python() -> PathBuf {
    environment_with("python-clients", &[ZENOH]).join("bin/python")
}

/// A twin in a process of its own, no faster than real: ticks that are late are not sent, and at five times real time a busy
/// machine loses so many of them that the vehicle brakes or no longer knows its velocity, as it promises to.
struct Twin {
    process: Process,
    said: Value,
    place: Place,
}

impl Twin {
    fn up(more: &[&str]) -> Self {
        let place = Place::new();
        let arguments = ["up", "--no-mission", "--json", "--trial", "external", "--listen", &place.socket];
        let process = place.start(&[&arguments, more].concat());
        Self { said: process.json(), process, place }
    }

    /// One of the programs, connected.
    fn client(&self, program: &str, arguments: &[&str]) -> Process {
        self.client_by(&self.place.socket, program, arguments)
    }

    fn client_by(&self, endpoint: &str, program: &str, arguments: &[&str]) -> Process {
        let mut command = self.place.command(&python().display().to_string());
        command.arg(format!("{PROGRAMS}/{program}.py")).args(arguments).args(["--connect", endpoint]);
        Process::start(command.env("PYTHONDONTWRITEBYTECODE", "1"))
    }

    /// A client in our own language.
    fn operator(&self, name: &str) -> Client {
        Listener::open(&self.place.socket, "argus-mini").client(name)
    }

    /// Everything that is said on `keys`, and all events and states.
    fn listen(&self, keys: &[&str]) -> Monitor {
        let mut arguments = vec!["--json"];
        keys.iter().for_each(|key| arguments.extend(["--also", key]));
        Monitor(self.client("monitor", &arguments))
    }
}

/// The monitor, whose lines are `{"key": …, "body": …}`.
struct Monitor(Process);

impl Monitor {
    /// Until `wanted` makes something of a message.
    fn until<T>(&self, what: &str, mut wanted: impl FnMut(&str, &Value) -> Option<T>) -> T {
        self.0.until(what, |line| {
            let line: Value = serde_json::from_str(line).unwrap();
            wanted(line["key"].as_str().unwrap(), &line["body"])
        })
    }

    /// The next account of each service.
    fn accounts(&self) -> BTreeMap<String, Value> {
        let mut accounts = BTreeMap::new();
        self.until("the accounts of all four", |key, body| {
            let service = key.strip_prefix("health/").filter(|_| body.is_object())?;
            accounts.insert(service.to_owned(), body.clone());
            (accounts.len() == 4).then_some(())
        });
        accounts
    }

    /// All messages on `key` that have not been read yet, for so many seconds of the simulation, as `(simulation time, data)`.
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
        let done = Process::start(&mut command).finish();
        let named = |option: &str| done.out.contains(option);
        assert!(done.code == Some(0) && named("--connect") && named("--vehicle"), "{program}: {done:?}");
    }
}

#[test]
fn a_depth_is_reached_and_one_beyond_the_limits_is_refused() {
    let twin = Twin::up(&[]);
    let truth = twin.listen(&["plant/truth"]);
    let done = twin.client("set_depth", &["3.0"]).finish().well();
    assert!(done.out.contains("\nreached"), "{done:?}");
    let tick = done.out.split_whitespace().last().unwrap().parse::<u64>().unwrap();
    truth.until("the tick at which it is there", |_, body| (body["tick"].as_u64()? >= tick).then_some(()));
    let depths = truth.record("plant/truth", 15.0);
    let late = &depths[depths.len() / 2..];
    let depth = mean(late.iter().map(|(_, truth)| number(truth, "depth_m")));
    assert!((depth - 3.0).abs() < 0.25, "the vehicle is at {depth} m");

    let refused = twin.client("set_depth", &["30"]).finish();
    let why = "depth_m = 30: must lie between 0 and 14";
    assert!(refused.code == Some(1) && refused.err.contains(why), "{refused:?}");
    // The lease was given back both times: another one may have it at once.
    assert!(twin.operator("anna").acquire(5.0).unwrap().granted);
}

#[test]
fn the_program_of_the_tutorial_works_as_it_stands_there() {
    let twin = Twin::up(&[]);
    let telemetry = twin.listen(&["telemetry/guidance"]);
    let page = include_str!("../docs/src/tutorials/network.md");
    let (_, program) = page.split_once("```python\nimport json, zenoh").unwrap();
    let (program, _) = program.split_once("```").unwrap();
    let shown = "unixsock-stream//tmp/supertwin/router.sock";
    assert!(program.contains(shown));
    let program = format!("import json, zenoh{}", program.replace(shown, &twin.place.socket));
    // A second time as well: its numbers begin anew with its lease.
    for _ in 0..2 {
        let done = Process::start(Command::new(python()).args(["-c", &program])).finish();
        assert!(done.code == Some(0) && done.out.matches("scheduled").count() == 2, "{done:?}");
    }
    let depth_m = telemetry.until("the new depth", |key, body| {
        let target = body["data"]["signals"]["guidance/target"][0].as_f64()?;
        (key == "telemetry/guidance" && target > 2.9).then_some(target)
    });
    assert_eq!(depth_m, 3.0, "guidance wants what the program asked for");
}

#[test]
fn a_mission_goes_along_the_net_and_back_and_ends_at_rest() {
    let twin = Twin::up(&[]);
    let truth = twin.listen(&["plant/truth"]);
    let began = truth.record("plant/truth", 0.0)[0].0;
    let done = twin.client("mission", &["--depth", "2.5", "--leg", "20"]).finish().well();
    let at = |words: &str| {
        let line = done.out.lines().find(|line| line.contains(words)).unwrap_or_else(|| panic!("{words}: {done:?}"));
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
    let twin = Twin::up(&[]);
    let listener = twin.listen(&["plant/truth", "telemetry/controller"]);
    twin.client("set_depth", &["1.8"]).finish().well();
    let outside = |flags: [f64; 4]| {
        listener.until(&format!("{flags:?} from outside"), |key, body| {
            (key == "telemetry/controller" && body["data"]["signals"]["controller/external"] == json!(flags))
                .then_some(())
        });
    };

    let pid = twin.client("external_pid", &["--axes", "yaw"]);
    pid.until("it steers", |line| line.contains("steering yaw").then_some(()));
    outside([0.0, 0.0, 0.0, 1.0]);
    let mut anna = twin.operator("anna");
    assert!(anna.acquire(60.0).unwrap().granted);
    let heading = number(&listener.record("plant/truth", 0.0)[0].1, "heading_rad");
    let wanted = wrapped(heading + 0.6);
    anna.command("guidance", "heading_rad", json!(wanted), None).unwrap();
    let off = |truth: &Value| wrapped(number(truth, "heading_rad") - wanted);
    // Waves of 5 s turn the vehicle to and fro: over two of them that averages out.
    let holds = |held: &[(f64, Value)]| {
        let error = mean(held.iter().map(|(_, truth)| off(truth)));
        let swing = mean(held.iter().map(|(_, truth)| (off(truth) - error).powi(2))).sqrt();
        assert!(error.abs() < 0.1 && swing < 0.15, "the heading is off by {error} rad and swings by {swing} rad");
    };
    let near = |truth: &Value| off(truth).abs() < 0.05;
    listener.until("the new heading", |key, body| (key == "plant/truth" && near(&body["data"])).then_some(()));
    listener.record("plant/truth", 6.0);
    holds(&listener.record("plant/truth", 10.0));

    // Without the program the vehicle's own substitute goes on.
    drop(pid);
    outside([0.0; 4]);
    let pid = twin.client("external_pid", &["--axes", "surge,sway,heave,yaw"]);
    pid.until("it steers", |line| line.contains("steering surge").then_some(()));
    outside([1.0; 4]);
    anna.lease(LeaseAction::Renew, 60.0).unwrap();
    anna.command("guidance", "depth_m", json!(2.4), None).unwrap();
    let depth = |truth: &Value| number(truth, "depth_m");
    listener.until("the new depth", |key, body| (key == "plant/truth" && depth(&body["data"]) > 2.3).then_some(()));
    listener.record("plant/truth", 4.0);
    let held = listener.record("plant/truth", 10.0);
    let reached = mean(held.iter().map(|(_, truth)| depth(truth)));
    assert!((reached - 2.4).abs() < 0.25, "the vehicle is at {reached} m");
    holds(&held);
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
    let mut twin = Twin::up(&[]);
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
    let quiet = listener.accounts();

    // The attacks, while the twin is watched.
    let mut hostile = twin.client("hostile", &["--holder", "anna"]);
    let mut flood = 0;
    for _ in 0..12 {
        let report = hostile.json();
        // However long they take, the holder holds on; in the flood there may be no room for it, and then there is later.
        drop(anna.lease(LeaseAction::Renew, 60.0));
        let (line, count) = (report.to_string(), |what: &str| report[what].as_u64().unwrap_or(0));
        assert_eq!(count("granted"), 0, "{line}");
        match report["attack"].as_str().unwrap() {
            // Nobody is there, or a key that nobody serves.
            "wrong_vehicle" => assert_eq!((count("asked"), count("refused")), (4, 0), "{line}"),
            "garbage_requests" => assert!(count("refused") + 1 >= count("asked"), "{line}"),
            "command_flood" => {
                assert_eq!(count("refused"), 1, "{line}");
                flood = count("asked");
            }
            _ => assert_eq!(count("refused"), count("asked"), "{line}"),
        }
    }
    assert_eq!(hostile.finish().well().out, "");

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

    // All four are there, none has lost a tick without counting it, and each has counted what it refused.
    let health = listener.accounts();
    for (service, health) in &health {
        let count = |what: &str| health[what].as_u64().unwrap();
        let [ticks, steps, skipped] =
            ["tick", "steps", "skipped"].map(|what| count(what) - number(&quiet[service], what) as u64);
        assert!(
            ticks > 300 && steps > 100 && steps + skipped == ticks,
            "{service}: {health}, before: {}",
            quiet[service]
        );
        // The owner of time makes all its steps, whether they are in time or late.
        assert!(service != "plant" || skipped == 0, "{health}");
        // None of the attack is done within a step: half of them take less than a tick, however busy the machine is.
        assert!(number(health, "tick_s") * 1e6 > health["step_us"][0].as_f64().unwrap(), "{service}: {health}");
        assert!(count("refused") > 0 && count("not_finite") == 0, "{service}: {health}");
        for (wire, input) in health["inputs"].as_object().unwrap() {
            let traced = input["rejected"].as_u64().unwrap() > 0;
            let rivals = input["rivals"].as_u64().unwrap() > 0 || wire == "controller/wrench_request";
            assert!(traced && rivals && input["takeovers"] == 0, "{service} {wire}: {input}");
        }
    }
    // What was asked in the flood was refused, as much as the mailbox has room for at the least, or found no room; either is
    // counted.
    let [refused, no_room] =
        [&health["guidance"]["commands"]["refused"], &health["guidance"]["overflow"][1]].map(|n| n.as_u64().unwrap());
    assert!(refused > 64 && refused + no_room >= flood, "{flood} asked, {refused} refused, {no_room} no room");
    assert!(health["guidance"]["setpoints"][1].as_u64().unwrap() > 1000, "streams were refused");
    assert!(health["controller"]["refused"].as_u64().unwrap() > 30, "leases were refused");
    assert!(twin.process.is_up());

    // Their events say so; the command that came twice has applied once; and the holder still commands.
    ask(1001, 3.5).unwrap();
    let again = twin.listen(&[]);
    let mut refused: BTreeMap<String, usize> = BTreeMap::new();
    let (mut applied, mut last) = (0, false);
    again.until("the last command", |key, body| {
        let text = key.strip_prefix("event/").and(body["data"]["text"].as_str())?;
        assert!(!text.contains(&token) && text.len() < 500, "{text}");
        let what = &body["data"]["what"];
        if what["so_far"].is_u64() {
            *refused.entry(body["data"]["service"].as_str()?.to_owned()).or_default() += 1;
        }
        let ours = |seq: u64| {
            what["kind"] == "command_applied" && what["command"]["by"] == json!({ "client": "anna", "seq": seq })
        };
        applied += usize::from(ours(1000));
        last |= ours(1001);
        // Each service's events are in order, those of different services are not.
        (last && refused.len() == 4).then_some(())
    });
    assert_eq!((applied, refused.len()), (1, 4), "{refused:?}");
}

#[test]
fn a_listener_that_was_cut_off_gets_every_event_once_and_in_order() {
    let twin = Twin::up(&["--listen", "tcp/127.0.0.1:0"]);
    let tether = Proxy::before(&listening(&twin.said, "tcp"));
    let far = Monitor(twin.client_by(&tether.endpoint(), "monitor", &["--json"]));
    let near = twin.listen(&["health/plant"]);
    let mut anna = twin.operator("anna");
    assert!(anna.acquire(60.0).unwrap().granted);

    let mut heard = Events::default();
    let hear = |heard: &mut Events, words: &str| {
        far.until(words, |key, body| heard.enter(key, body)?.ends_with(words).then_some(()));
    };
    let seconds = |n: usize| {
        let mut left = n;
        near.until("the heartbeat of the plant", |key, _| {
            left -= usize::from(key == "health/plant");
            (left == 0).then_some(())
        });
    };
    let mut talk = |n: u64| -> u64 {
        anna.lease(LeaseAction::Renew, 60.0).unwrap();
        for _ in 0..n {
            anna.command("guidance", "speed_m_per_s", json!(0.2), None).unwrap();
        }
        n
    };
    let mut sent = talk(3);
    hear(&mut heard, &format!("by anna seq {sent}"));

    tether.cut(true);
    sent += talk(100);
    seconds(3);
    // What was on its way before the cut may still come.
    let last = format!("anna seq {sent}");
    let came = far.0.pending().filter(|line| {
        let line: Value = serde_json::from_str(line).unwrap();
        heard.enter(line["key"].as_str().unwrap(), &line["body"]).is_some_and(|said| said.ends_with(&last))
    });
    assert_eq!(came.count(), 0, "it was not cut off");
    tether.cut(false);
    sent += talk(1);
    hear(&mut heard, &format!("by anna seq {sent}"));

    // One that does not read for a while.
    far.0.signal("STOP");
    sent += talk(100);
    seconds(3);
    far.0.signal("CONT");
    sent += talk(1);
    hear(&mut heard, &format!("by anna seq {sent}"));

    // A last word that nothing follows is not lost either.
    tether.cut(true);
    sent += talk(1);
    seconds(1);
    tether.cut(false);
    hear(&mut heard, &format!("by anna seq {sent}"));

    heard.are_complete(&["estimator", "guidance", "controller"]);
    let guidance = heard.texts.iter().filter(|text| text.starts_with("guidance: ")).count() as u64;
    // Each is scheduled and applied.
    assert!(guidance >= 2 * sent, "{guidance} events for {sent} commands");
}
