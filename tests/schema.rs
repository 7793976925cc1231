//! The schemas that `supertwin schema` writes: what flows fits them, and what does not fit is what services refuse.
//!
//! Judged by somebody else's reader of JSON Schema, in Python.
#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use crate::support::{Listener, Place, python};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use supertwin_core::message::{Message, Nav};
use supertwin_protocol::command_queue::Answer;
use supertwin_zenoh::ClientError;

/// Reads schemas from a folder, checks that they are schemas, and that each line `[expected, name, payload]` fits its
/// schema or does not, as expected. Prints how many of each name were as expected.
const JUDGE: &str = r#"
import collections, json, pathlib, sys
from jsonschema import Draft202012Validator
validators = {}
for path in pathlib.Path(sys.argv[1]).iterdir():
    schema = json.loads(path.read_text())
    Draft202012Validator.check_schema(schema)
    validators[path.name.removesuffix(".schema.json")] = Draft202012Validator(schema)
count = collections.Counter()
for line in open(sys.argv[2]):
    expected, name, payload = json.loads(line)
    error = next(validators[name].iter_errors(payload), None)
    if (error is None) != expected:
        sys.exit(f"{name}: {error.message if error else 'fits'} at {list(error.path) if error else ''}: {line[:500]}")
    count[name] += 1
print(json.dumps(count))
"#;

/// Payloads for the judge.
struct Evidence<'a> {
    place: &'a Place,
    lines: Vec<Value>,
}

impl<'a> Evidence<'a> {
    fn new(place: &'a Place) -> Self {
        place.call(&["schema", "--save", "schemas"]).well();
        Self { place, lines: Vec::new() }
    }

    fn fits(&mut self, name: &str, payload: Value) {
        self.lines.push(Value::Array(vec![true.into(), name.into(), payload]));
    }

    /// How many payloads of each name were as expected.
    fn judge(self) -> BTreeMap<String, usize> {
        let text: String = self.lines.iter().map(|line| format!("{line}\n")).collect();
        fs::write(self.place.path().join("evidence"), text).unwrap();
        let said = python::say(self.place.path(), JUDGE, &["schemas", "evidence"]);
        serde_json::from_str(&said).unwrap()
    }
}

/// Which schema a key has: the one that names most of it.
struct Names(Vec<(String, String)>);

impl Names {
    fn new(place: &Place) -> Self {
        let listed = place.call(&["schema", "--json"]).well().json();
        let text = |one: &Value, what: &str| one[what].as_str().unwrap().to_owned();
        let all = listed.as_array().unwrap().iter().map(|one| (text(one, "key"), text(one, "name")));
        Self(all.filter(|(key, _)| key != "**" && !key.starts_with("command/")).collect())
    }

    fn of(&self, key: &str) -> &str {
        let words: Vec<&str> = key.split('/').collect();
        let fits = |pattern: &str| {
            let pattern: Vec<&str> = pattern.split('/').collect();
            pattern.len() == words.len() && pattern.iter().zip(&words).all(|(p, w)| *p == "*" || p == w)
        };
        let found = self.0.iter().filter(|(pattern, _)| fits(pattern));
        let best = found.min_by_key(|(pattern, _)| pattern.matches('*').count());
        &best.unwrap_or_else(|| panic!("{key} has no schema")).1
    }
}

/// What the service has answered; the client has taken it apart.
fn refused(seq: u64, refusal: &ClientError) -> Value {
    let ClientError::Refused(reason) = refusal else { panic!("{refusal}") };
    serde_json::to_value(Answer::Refused { seq, reason: reason.clone() }).unwrap()
}

#[test]
fn whatever_a_running_vehicle_says_and_hears_fits_its_schema() {
    let place = Place::new();
    let names = Names::new(&place);
    let mut evidence = Evidence::new(&place);
    let arguments = ["up", "--no-mission", "--json", "--trial", "external", "--rtf", "4", "--listen", &place.socket];
    let twin = place.start(&arguments);
    twin.json();
    let listener = Listener::open(&place.socket, "argus-mini").listen("**");
    let anna = listener.client("anna");
    let token = "0123456789abcdef0123456789abcdef";
    let lease = |action: &str| json!({ "client": "anna", "action": action, "for_s": 30.0, "token": token });
    let mut seq = 0;
    let mut ask = |key: &str, value: Value| {
        seq += 1;
        let request = json!({ "client": "anna", "seq": seq, "token": token, "value": value });
        let answer = anna.ask(&anna.key(key), Some(&request));
        evidence.fits("request", request);
        let fits = answer.is_ok();
        evidence.fits("answer", answer.unwrap_or_else(|refusal| refused(seq, &refusal)));
        if let ["command", service, name] = key.split('/').collect::<Vec<_>>()[..] {
            let command = if value.is_null() { json!(name) } else { json!({ name: value }) };
            evidence.lines.push(json!([fits, format!("{service}_command"), command]));
        }
        fits
    };
    let mut leases = Vec::new();
    for action in ["acquire", "renew", "status"] {
        leases.push((lease(action), anna.ask(&anna.key("authority/lease"), Some(&lease(action))).unwrap()));
    }
    for (key, value) in [
        ("command/guidance/mode", json!("depth_heading_hold")),
        ("command/guidance/depth_m", json!(3)),
        ("command/guidance/depth_m", json!({ "ramp": { "to": 4.0, "over_s": 5.0 } })),
        ("command/guidance/heading_rad", json!({ "sine": { "mean": 0.5, "amplitude": 0.1, "period_s": 9.0 } })),
        ("command/guidance/direction", json!("port")),
        ("command/estimator/restart", Value::Null),
        ("command/controller/neutral", json!(false)),
        ("command/plant/dvl_silent_for_s", json!(0.5)),
        ("command/plant/thruster_gain", json!({ "thruster": 1, "gain": 0.9 })),
        ("param/guidance/lookahead_m", json!(2.5)),
    ] {
        assert!(ask(key, value.clone()), "{key} {value}");
    }
    // What is refused for its shape does not fit.
    for (key, value) in [
        ("command/guidance/mode", json!("sideways")),
        ("command/guidance/depth_m", json!({ "ramp": { "to": 4.0 } })),
        ("command/guidance/depth_m", json!("deep")),
        ("command/plant/thruster_gain", json!({ "thruster": -1, "gain": 0.9 })),
        ("command/controller/nonsense", json!(true)),
    ] {
        assert!(!ask(key, value.clone()), "{key} {value}");
    }
    for (request, reply) in leases {
        assert_eq!(reply["holder"], "anna", "{reply}");
        evidence.fits("lease_request", request);
        evidence.fits("lease_reply", reply);
    }
    for key in ["state/guidance/run", "state/plant/signals", "state/guidance/mode", "state/controller/now"] {
        evidence.fits(names.of(key), anna.ask(&anna.key(key), None::<&()>).unwrap());
    }
    evidence.fits("pong", anna.ask(&anna.key("clock/ping"), None::<&()>).unwrap());
    let mut operator = listener.client("anna");
    for depth_m in [Some(3.1), Some(3.2), None] {
        operator.stream("depth_m", depth_m).unwrap();
    }

    // Everything that flows, until all of it has been there.
    let mut wanted = BTreeSet::from(["measurements", "truth", "nav", "reference", "thrust", "telemetry"]);
    wanted.extend(["event", "health", "applied", "lease_state", "setpoint"]);
    let mut heard = 0;
    listener.until("one of each", |key, value| {
        let name = names.of(key);
        evidence.fits(name, value.clone());
        wanted.remove(name);
        heard += 1;
        wanted.is_empty() && heard > 2000
    });
    drop(twin);
    let count = evidence.judge();
    assert!(count.values().sum::<usize>() > 2000 && count["telemetry"] > 300, "{count:?}");
    assert!(count.len() >= 20, "{count:?}");
}

#[test]
fn every_message_of_a_recorded_lock_step_run_fits_its_schema() {
    let place = Place::new();
    let names = Names::new(&place);
    let mut evidence = Evidence::new(&place);
    let arguments = ["up", "--json", "--trial", "fair", "--duration", "6", "--pace", "lockstep", "--record", "here"];
    place.call(&[&arguments[..], &["--listen", &place.socket]].concat()).well();
    let file = fs::read_dir(place.path().join("here")).unwrap().next().unwrap().unwrap().path();
    let recording = supertwin_rerun::read(&file).unwrap();
    assert!(recording.complete, "{:?}", recording.damage);
    for (key, messages) in &recording.wires {
        for message in messages {
            evidence.fits(names.of(key), serde_json::from_slice(&message.bytes).unwrap());
        }
    }
    for (service, commands) in &recording.commands {
        for command in commands {
            let command: Value = serde_json::from_str(&command.value).unwrap();
            for one in command.as_array().cloned().unwrap_or_else(|| vec![command.clone()]) {
                evidence.fits(&format!("{service}_command"), one);
            }
        }
    }

    // What does not fit is what a service refuses to read.
    let nav = &recording.wires[Nav::KEY][0].bytes;
    let good: Value = serde_json::from_slice(nav).unwrap();
    type Change = fn(&mut Value);
    let changes: [Change; 6] = [
        |bad| bad["tick"] = json!(-1),
        |bad| bad["data"]["depth_m"] = Value::Null,
        |bad| bad["data"]["depth_m"] = json!("3.5"),
        |bad| bad["data"]["depth_cm"] = json!(3.5),
        |bad| drop(bad["data"].as_object_mut().unwrap().remove("velocity")),
        |bad| bad["data"]["variance"]["velocity"] = json!([0.0, 0.0, 0.0]),
    ];
    for change in changes {
        let mut bad = good.clone();
        change(&mut bad);
        assert!(supertwin_protocol::decode::<Nav>(bad.to_string().as_bytes()).is_err(), "{bad}");
        evidence.lines.push(json!([false, "nav", bad]));
    }
    let count = evidence.judge();
    for name in ["measurements", "nav", "reference", "thrust"] {
        assert!(count.get(name).is_some_and(|n| *n >= 300), "{name}: {count:?}");
    }
}

#[test]
fn the_verb_lists_prints_and_writes() {
    let place = Place::new();
    let list = place.call(&["schema"]).well().out;
    assert!(list.contains("estimator/nav") && list.contains("command/*/*") && list.lines().count() >= 20, "{list}");
    let nav = place.call(&["schema", "nav"]).well().json();
    assert_eq!(nav["$defs"]["Nav"]["properties"]["depth_m"]["unit"], "m");
    let several = place.call(&["schema", "nav", "event", "--json"]).well().json();
    assert_eq!(several[1]["schema"]["title"], "event");

    place.call(&["schema", "navigation"]).refused("navigation: is no message; there are ");
    place.call(&["schema", "nav", "--save", "there"]).well();
    let file = place.path().join("there/nav.schema.json");
    let written: Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    assert_eq!(written, nav);
    place.call(&["schema", "nav", "--save", "there"]).refused("nav.schema.json: exists already; use --force");
    place.call(&["schema", "nav", "--save", "there", "--force"]).well();
    assert!(Path::new(&file).is_file());
}
