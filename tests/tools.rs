//! The operator's tools as an operator meets them: real services in their own process, real calls, real signals.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Output, Stdio};
use tempfile::TempDir;

const CONFIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config");
const SERVICES: [&str; 4] = ["plant", "estimator", "guidance", "controller"];

fn supertwin(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_supertwin"));
    for name in ["SUPERTWIN_CONNECT", "SUPERTWIN_ZENOH", "SUPERTWIN_VEHICLE"] {
        command.env_remove(name);
    }
    command.current_dir(folder).args(["--config", CONFIG]).args(arguments).stdin(Stdio::null());
    command
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A process that says a line when it is up, and is killed when the test is over.
struct Up {
    child: Child,
    out: BufReader<ChildStdout>,
    first: Value,
}

impl Up {
    fn start(folder: &Path, arguments: &[&str]) -> Self {
        let mut child = supertwin(folder, arguments).stdout(Stdio::piped()).spawn().unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        out.read_line(&mut line).unwrap();
        let first = serde_json::from_str(&line).unwrap_or_else(|_| panic!("{arguments:?} said {line:?}"));
        Self { child, out, first }
    }

    fn signal(&self, name: &str) {
        assert!(Command::new("kill").args([name, &self.child.id().to_string()]).status().unwrap().success());
    }
}

impl Drop for Up {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A folder with a router's socket in it.
struct Place {
    folder: TempDir,
    socket: String,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = format!("unixsock-stream/{}/r.sock", folder.path().display());
        Self { folder, socket }
    }

    fn up(&self, more: &[&str]) -> Up {
        let arguments = ["up", "--no-mission", "--trial", "paper-agsta", "--listen", self.socket.as_str(), "--json"];
        Up::start(self.folder.path(), &[&arguments[..], more].concat())
    }

    fn serve(&self, service: &str) -> Up {
        let arguments =
            ["serve", service, "--no-mission", "--trial", "paper-agsta", "--connect", self.socket.as_str(), "--json"];
        Up::start(self.folder.path(), &arguments)
    }

    fn call(&self, arguments: &[&str]) -> Output {
        supertwin(self.folder.path(), &[arguments, &["--connect", &self.socket]].concat()).output().unwrap()
    }

    /// Standard output as JSON of a call that ended with `code`.
    fn json(&self, code: i32, arguments: &[&str]) -> Value {
        let done = self.call(&[arguments, &["--json"]].concat());
        let said = text(&done.stderr);
        assert_eq!(done.status.code(), Some(code), "{arguments:?}: {said}{}", text(&done.stdout));
        serde_json::from_slice(&done.stdout).unwrap_or_else(|cause| panic!("{arguments:?}: {cause}: {said}"))
    }

    /// Findings of the doctor that are not well, as `check: what`.
    fn doctor(&self, code: i32, more: &[&str]) -> Vec<String> {
        let found = self.json(code, &[&["doctor"], more].concat());
        let found = found.as_array().unwrap().clone();
        let bad = found.iter().filter(|finding| finding["verdict"] != "ok");
        bad.map(|finding| {
            assert!(finding["remedy"].as_str().is_some_and(|remedy| remedy.len() > 10), "{finding}");
            format!("{}: {}", finding["check"].as_str().unwrap(), finding["what"].as_str().unwrap())
        })
        .collect()
    }
}

#[test]
fn commands_apply_are_acknowledged_and_leave_the_authority_free() {
    let place = Place::new();
    let _up = place.up(&[]);
    let done = place.json(0, &["set", "depth_m", "5"]);
    let command = &done["commands"][0];
    assert_eq!((&done["vehicle"], &command["status"]), (&"argus-mini".into(), &"applied".into()));
    assert!(command["applied_tick"].as_u64() >= command["apply_tick"].as_u64() && command["applied_tick"].is_u64());

    let several = ["mode", "depth_heading_hold", "depth_m", r#"{"ramp":{"to":4,"over_s":20}}"#, "heading_rad", "-0.5"];
    let parameter = ["controller.law.agsta.beta.surge", "4"];
    let done = place.json(0, &[&["set"], &several[..], &parameter[..]].concat());
    let ticks: Vec<u64> =
        done["commands"].as_array().unwrap().iter().map(|one| one["applied_tick"].as_u64().unwrap()).collect();
    assert!(ticks.len() == 4 && ticks.iter().all(|tick| *tick == ticks[0]), "one tick for all: {ticks:?}");

    assert_eq!(place.json(0, &["get", "controller.law.agsta.beta"])["surge"], 4.0);
    assert!(place.json(0, &["get", "guidance"])["limits"]["depth_m"].is_array());
    assert_eq!(place.json(0, &["get", "depth_m"])["value"]["ramp"]["to"], 4.0);
    let all = place.json(0, &["get"]);
    assert_eq!(all["states"]["guidance"]["mode"]["value"], "depth_heading_hold");
    assert_eq!(all["parameters"]["controller"]["law"]["agsta"]["beta"]["surge"], 4.0);
    let table = text(&place.call(&["get"]).stdout);
    for words in ["authority: nobody", "controller.law.agsta.beta.surge", "depth_heading_hold"] {
        assert!(table.contains(words), "{words} is missing in\n{table}");
    }

    // What is refused says why, whether it stands alone or among others, and gives the authority back.
    let refused = place.json(1, &["set", "depth_m", "99", "speed_m_per_s", "0.3"]);
    assert_eq!(refused["commands"][0]["status"], "refused");
    assert!(refused["commands"][0]["reason"].as_str().unwrap().contains("between 0 and 14"), "{refused}");
    assert_eq!(refused["commands"][1]["status"], "applied");
    assert!(place.json(0, &["get", "lease"])["holder"].is_null());

    for (code, arguments, expected) in [
        (1, &["set", "law", "pidd"][..], "pidd"),
        (1, &["set", "controller.law.nope", "1"][..], "nope"),
        (1, &["get", "guidance.nope"][..], "no parameter nope"),
        (1, &["get", "law"][..], "no such command has applied yet"),
        (1, &["get", "deepness"][..], "nothing has this name"),
        (2, &["set", "deep", "5"][..], "must be one of mode, depth_m"),
        (2, &["set", "depth_m", "5", "mode"][..], "has no value"),
        (2, &["set", "depth_m", "{5"][..], "is no JSON"),
        (2, &["echo", "a//b"][..], "KEY a//b: Invalid Key Expr"),
    ] {
        let done = place.call(arguments);
        let said = text(&done.stderr);
        assert_eq!(done.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(expected) && !said.contains(".rs"), "{arguments:?}: {said}");
    }
}

#[test]
fn a_command_that_does_not_apply_in_time_is_no_success() {
    let place = Place::new();
    // A witness that never comes: the ring stands still, and answers.
    let _up = place.up(&["--pace", "lockstep", "--witness", "nobody"]);
    let late = place.json(1, &["set", "depth_m", "5", "--wait", "0.3"]);
    assert_eq!(late["commands"][0]["status"], "scheduled");

    let arguments = ["echo", "event/guidance", "--json", "--connect", place.socket.as_str()];
    let mut events = Up::start(place.folder.path(), &arguments);
    let mut command = supertwin(place.folder.path(), &["set", "depth_m", "4", "--wait", "60"]);
    let set = command.args(["--connect", &place.socket]).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = String::new();
    while !said.contains(": depth_m 4 by ") {
        said.clear();
        assert!(events.out.read_line(&mut said).unwrap() > 0, "echo ended");
    }
    assert!(Command::new("kill").args(["-INT", &set.id().to_string()]).status().unwrap().success());
    let done = set.wait_with_output().unwrap();
    assert_eq!(done.status.code(), Some(130), "{}", text(&done.stderr));
    assert!(text(&done.stderr).contains("interrupted: depth_m 4 applies at tick"), "{}", text(&done.stderr));
    assert!(place.json(0, &["get", "lease"])["holder"].is_null(), "the authority was given back");
}

#[test]
fn emergencies_faults_and_restarts_are_commands_too() {
    let place = Place::new();
    let _up = place.up(&[]);
    let done = place.json(0, &["set", "neutral", "true"]);
    assert_eq!(done["commands"][0]["status"], "applied");
    let events = text(&place.call(&["echo", "event/controller", "--for", "1"]).stdout);
    assert!(events.contains(r#"command applied: {"neutral":true}"#) && !events.contains("has the authority"));
    let faults = ["estimator", "restart", "dvl_silent_for_s", "2", "thruster_gain", r#"{"thruster":1,"gain":0.5}"#];
    let done = place.json(0, &[&["set", "neutral", "false"], &faults[..]].concat());
    assert!(done["commands"].as_array().unwrap().iter().all(|one| one["status"] == "applied"), "{done}");
    let soon = place.json(0, &["set", "depth_m", "3", "--no-wait"]);
    assert_eq!(soon["commands"][0]["status"], "scheduled");
}

#[test]
fn what_flows_is_listed_shown_and_measured() {
    let place = Place::new();
    let mut up = place.up(&[]);
    let run = up.first["run"].as_str().unwrap().to_owned();

    let listed = place.json(0, &["list"]);
    let vehicle = &listed["vehicles"][0];
    let services: Vec<&str> =
        vehicle["services"].as_array().unwrap().iter().map(|one| one["service"].as_str().unwrap()).collect();
    assert_eq!(services, ["controller", "estimator", "guidance", "plant"]);
    let keys = vehicle["keys"].as_array().unwrap();
    let nav = keys.iter().find(|flow| flow["key"] == "estimator/nav").unwrap();
    assert!(nav["writers"][0].as_str().unwrap().starts_with("estimator-"), "{nav}");

    let done = place.call(&["echo", "estimator/nav", "--count", "3", "--json"]);
    let lines: Vec<Value> = text(&done.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((done.status.code(), lines.len()), (Some(0), 3));
    assert_eq!(lines[2]["key"], "supertwin/argus-mini/estimator/nav");
    assert!(lines[2]["value"]["tick"].as_u64() > lines[0]["value"]["tick"].as_u64());

    // Events of before the listener came are shown first, in the order in which they happened.
    let done = place.call(&["echo", "event/**", "--count", "4", "--json"]);
    let ticks: Vec<u64> = text(&done.stdout)
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap()["value"]["tick"].as_u64().unwrap())
        .collect();
    assert!(ticks.len() == 4 && ticks[0] == 0 && ticks.is_sorted(), "{ticks:?}");

    let rates = place.json(0, &["hz", "estimator/*", "--for", "2"]);
    let nav = &rates["keys"][0];
    let rate_hz = nav["rate_hz"].as_f64().unwrap();
    assert!((30.0..70.0).contains(&rate_hz), "{nav}");
    assert!(nav["jitter_ms"].is_f64() && nav["bytes_per_s"].as_f64().unwrap() > 1000.0, "{nav}");
    assert_eq!((nav["duplicates"].as_u64(), nav["rivals"].as_u64()), (Some(0), Some(0)), "{nav}");
    let silent = place.call(&["hz", "nobody/here", "--for", "0.2"]);
    assert_eq!(silent.status.code(), Some(1));
    assert!(text(&silent.stderr).contains("nothing was heard"));

    let snapshot = place.json(0, &["top"]);
    let lines = snapshot["services"].as_array().unwrap();
    assert_eq!(lines.len(), 4);
    for line in lines {
        assert_eq!((&line["status"], line["health"]["run"].as_str()), (&"up".into(), Some(run.as_str())), "{line}");
        assert!(line["rate_hz"].as_f64().unwrap() > 10.0, "{line}");
    }
    let table = text(&place.call(&["top"]).stdout);
    assert!(SERVICES.iter().all(|service| table.contains(service)) && table.contains("step p50/p99"), "{table}");

    // What a user stops has done what it should.
    let listener = ["echo", "estimator/nav", "--json", "--connect", place.socket.as_str()];
    let mut echo = Up::start(place.folder.path(), &listener);
    echo.signal("-INT");
    let status = echo.child.wait().unwrap();
    assert_eq!((status.code(), echo.first["key"].is_string()), (Some(0), true));

    let call = format!(
        "'{}' --config '{CONFIG}' echo estimator/nav --connect {} | head -1",
        env!("CARGO_BIN_EXE_supertwin"),
        place.socket
    );
    let done = Command::new("sh").arg("-c").arg(call).output().unwrap();
    assert!(done.stderr.is_empty() && text(&done.stdout).lines().count() == 1, "{}", text(&done.stderr));

    up.signal("-INT");
    let mut rest = String::new();
    while up.out.read_line(&mut rest).unwrap() > 0 {}
    assert_eq!(up.child.wait().unwrap().code(), Some(0));
}

#[test]
fn the_vehicle_is_the_only_one_or_has_to_be_named() {
    let place = Place::new();
    let _router = Up::start(place.folder.path(), &["serve", "router", "--listen", &place.socket, "--json"]);
    let nobody = place.call(&["get"]);
    assert_eq!(nobody.status.code(), Some(1));
    assert!(text(&nobody.stderr).contains("start one with `supertwin up`"), "{}", text(&nobody.stderr));
    assert_eq!(place.json(0, &["list"])["vehicles"], Value::Array(Vec::new()));

    let one = ["serve", "estimator", "--json", "--connect", place.socket.as_str(), "--vehicle"];
    let _anna = Up::start(place.folder.path(), &[&one[..], &["anna"]].concat());
    assert_eq!(place.json(0, &["get"])["vehicle"], "anna");
    let _ben = Up::start(place.folder.path(), &[&one[..], &["ben"]].concat());
    let which = place.call(&["get"]);
    assert_eq!(which.status.code(), Some(2));
    assert!(text(&which.stderr).contains("anna, ben are up: say which"), "{}", text(&which.stderr));
    assert_eq!(place.json(0, &["get", "--vehicle", "ben"])["vehicle"], "ben");
}

#[test]
fn the_doctor_finds_nothing_when_all_is_well_and_a_second_controller_when_there_is_one() {
    let place = Place::new();
    let _up = place.up(&[]);
    assert_eq!(place.doctor(0, &[]), Vec::<String>::new());
    let said = text(&place.call(&["doctor"]).stdout);
    for words in ["ok       router", "ok       clock: the vehicle's is", "ok       versions"] {
        assert!(said.contains(words), "{words} is missing in\n{said}");
    }
    let _rival = place.serve("controller");
    let found = place.doctor(1, &[]);
    assert!(found.iter().any(|text| text.contains("write the same keys") && text.contains("controller-")), "{found:?}");
    assert!(found.iter().any(|text| text.contains("controller/thrust: somebody writes it beside")), "{found:?}");
    // Also who measures the wire sees both.
    let rates = place.json(0, &["hz", "controller/thrust", "--for", "1"]);
    assert_eq!(rates["keys"][0]["writers"].as_array().unwrap().len(), 2, "{rates}");
}

#[test]
fn the_doctor_finds_what_is_missing_and_a_service_that_went_is_gone() {
    let place = Place::new();
    let found = place.doctor(1, &[]);
    assert!(found.len() == 1 && found[0].starts_with("router: no router at unixsock-stream/"), "{found:?}");

    let router = Up::start(place.folder.path(), &["serve", "router", "--listen", &place.socket, "--json"]);
    let found = place.doctor(1, &[]);
    assert_eq!(found, ["services: none is up"]);

    let plant = place.serve("plant");
    let _estimator = place.serve("estimator");
    let found = place.doctor(1, &[]);
    assert!(found.contains(&"services: guidance of argus-mini is missing".to_owned()), "{found:?}");
    assert!(found.contains(&"services: controller of argus-mini is missing".to_owned()), "{found:?}");
    assert!(!found.iter().any(|text| text.starts_with("access")), "{found:?}");

    let arguments = ["top", "--json", "--count", "1000", "--connect", place.socket.as_str()];
    let mut top = Up::start(place.folder.path(), &arguments);
    let status = |snapshot: &Value, service: &str| {
        let line = snapshot["services"].as_array().unwrap().iter().find(|line| line["service"] == service).cloned();
        line.unwrap()["status"].as_str().unwrap().to_owned()
    };
    assert_eq!(status(&top.first, "plant"), "up");
    drop(plant);
    let gone = loop {
        let mut line = String::new();
        assert!(top.out.read_line(&mut line).unwrap() > 0, "top ended");
        let snapshot: Value = serde_json::from_str(&line).unwrap();
        if status(&snapshot, "plant") != "up" {
            break snapshot;
        }
    };
    assert_eq!((status(&gone, "plant").as_str(), status(&gone, "estimator").as_str()), ("gone", "up"));
    drop(router);
}

#[test]
fn the_doctor_finds_settings_that_are_dangerous_or_can_not_be_used() {
    let place = Place::new();
    let _up = place.up(&[]);
    let file = |name: &str, body: &str| {
        let path = place.folder.path().join(name);
        std::fs::write(&path, body).unwrap();
        path.display().to_string()
    };
    let discovery = file("d.json5", "{ mode: 'client', scouting: { multicast: { enabled: true } } }");
    let found = place.doctor(1, &["--zenoh", &discovery]);
    assert!(found.len() == 1 && found[0].contains("discovery by multicast is on"), "{found:?}");

    // A router's own file is examined without becoming that router.
    let exposed = file("r.json5", "{ mode: 'router', listen: { endpoints: ['tcp/0.0.0.0:7447'] } }");
    let found = place.doctor(1, &["--zenoh", &exposed]);
    assert_eq!(found, ["listeners: listens on tcp/0.0.0.0:7447, beyond loopback and without TLS"]);

    let named = |path: &str| format!("{{ transport: {{ link: {{ tls: {{ root_ca_certificate: '{path}' }} }} }} }}");
    let found = place.doctor(1, &["--zenoh", &file("c.json5", &named("/nowhere/ca.pem"))]);
    assert_eq!(found.len(), 1, "{found:?}");
    for words in ["certificates: /nowhere/ca.pem", "No such file", "transport/link/tls/root_ca_certificate"] {
        assert!(found[0].contains(words), "{words} is missing in {found:?}");
    }
    let found = place.doctor(1, &["--zenoh", &file("p.json5", &named(&discovery))]);
    assert!(found[0].contains("is no PEM file"), "{found:?}");

    let found = place.doctor(1, &["--zenoh", &file("t.json5", "{ scoutin: {} }")]);
    assert!(found.len() == 1 && found[0].contains("t.json5") && found[0].contains("scoutin"), "{found:?}");
}

#[test]
fn the_doctor_finds_keys_that_may_not_be_read() {
    let place = Place::new();
    let path = place.folder.path().join("acl.json5");
    let liveliness = "{ mode: 'router', access_control: { enabled: true, default_permission: 'deny',
        rules: [{ id: 'alive', permission: 'allow', flows: ['ingress', 'egress'], key_exprs: ['supertwin/*/alive/**'],
            messages: ['liveliness_token', 'liveliness_query', 'declare_liveliness_subscriber'] }],
        subjects: [{ id: 'all', link_protocols: ['unixsock-stream'] }],
        policies: [{ id: 'p', rules: ['alive'], subjects: ['all'] }] } }";
    std::fs::write(&path, liveliness).unwrap();
    let _up = place.up(&["--zenoh", path.to_str().unwrap()]);
    let found = place.doctor(1, &[]);
    for service in SERVICES {
        let text = format!("access: {service} is alive, but neither health nor state of it can be read");
        assert!(found.contains(&text), "{found:?}");
    }
}

#[test]
fn every_tool_has_examples_and_exit_states_in_its_help() {
    let place = Place::new();
    for verb in ["set", "get", "list", "echo", "hz", "top", "doctor"] {
        let help = text(&place.call(&[verb, "--help"]).stdout);
        assert!(help.contains("Examples:") && help.contains("Exit status"), "{verb}: {help}");
        assert!(help.contains("--json") && help.contains("--connect"), "{verb}: {help}");
    }
    // Without a router every tool says so, and what to do.
    for arguments in [&["list"][..], &["top"][..], &["set", "depth_m", "5"][..]] {
        let done = place.call(arguments);
        assert_eq!(done.status.code(), Some(2), "{arguments:?}");
        assert!(text(&done.stderr).contains("start one with `supertwin up`"), "{}", text(&done.stderr));
    }
}
