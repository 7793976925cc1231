//! The operator's tools as an operator meets them: real services in their own process, real calls, real signals.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use crate::support::{Ended, Place, Process, SERVICES, assert_says};
use serde_json::Value;

fn list(value: &Value) -> &Vec<Value> {
    value.as_array().unwrap()
}

/// What the operator's tools need of a place.
impl Place {
    fn up(&self, more: &[&str]) -> Process {
        self.started(&[&["up", "--no-mission", "--listen", &self.socket][..], more].concat())
    }

    fn router(&self) -> Process {
        self.started(&["serve", "router", "--listen", &self.socket])
    }

    fn serve(&self, service: &str) -> Process {
        self.started(&["serve", service, "--no-mission", "--connect", &self.socket])
    }

    /// A process that says a line when it is up.
    fn started(&self, arguments: &[&str]) -> Process {
        let process = self.start(&[arguments, &["--json"]].concat());
        process.json();
        process
    }

    /// A tool at the router here.
    fn tool(&self, arguments: &[&str]) -> Process {
        self.start(&[arguments, &["--connect", &self.socket]].concat())
    }

    fn ask(&self, arguments: &[&str]) -> Ended {
        self.tool(arguments).finish()
    }

    /// What a tool says that ends with `code`.
    fn json(&self, code: i32, arguments: &[&str]) -> Value {
        let done = self.ask(&[arguments, &["--json"]].concat());
        assert_eq!(done.code, Some(code), "{arguments:?}: {done:?}");
        done.json()
    }

    /// Findings of the doctor that are not well, as `check: what`.
    fn doctor(&self, code: i32, more: &[&str]) -> Vec<String> {
        let found = self.json(code, &[&["doctor"], more].concat());
        let bad = list(&found).iter().filter(|finding| finding["verdict"] != "ok");
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
    let ticks: Vec<_> = list(&done["commands"]).iter().map(|one| one["applied_tick"].as_u64().unwrap()).collect();
    assert!(ticks.len() == 4 && ticks.iter().all(|tick| *tick == ticks[0]), "one tick for all: {ticks:?}");

    assert_eq!(place.json(0, &["get", "controller.law.agsta.beta"])["surge"], 4.0);
    assert!(place.json(0, &["get", "guidance"])["limits"]["depth_m"].is_array());
    assert_eq!(place.json(0, &["get", "depth_m"])["value"]["ramp"]["to"], 4.0);
    let all = place.json(0, &["get"]);
    assert_eq!(all["states"]["guidance"]["mode"]["value"], "depth_heading_hold");
    assert_eq!(all["parameters"]["controller"]["law"]["agsta"]["beta"]["surge"], 4.0);
    let table = place.ask(&["get"]).out;
    assert_says(&table, &["authority: nobody", "controller.law.agsta.beta.surge", "depth_heading_hold"]);

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
        let said = place.ask(arguments).ends(code, expected).err;
        assert!(!said.contains(".rs"), "{arguments:?}: {said}");
    }
}

#[test]
fn a_command_that_does_not_apply_in_time_is_no_success() {
    let place = Place::new();
    // A witness that never comes: the ring stands still, and answers.
    let _up = place.up(&["--pace", "lockstep", "--witness", "nobody"]);
    let late = place.json(1, &["set", "depth_m", "5", "--wait", "0.3"]);
    assert_eq!(late["commands"][0]["status"], "scheduled");

    let events = place.tool(&["echo", "event/guidance"]);
    let mut set = place.tool(&["set", "depth_m", "4", "--wait", "60"]);
    events.until("the command", |line| line.contains(": depth_m 4 by ").then_some(()));
    set.signal("INT");
    set.finish().ends(130, "interrupted: depth_m 4 applies at tick");
    assert!(place.json(0, &["get", "lease"])["holder"].is_null(), "the authority was given back");
}

#[test]
fn emergencies_faults_and_restarts_are_commands_too() {
    let place = Place::new();
    let _up = place.up(&[]);
    let done = place.json(0, &["set", "neutral", "true"]);
    assert_eq!(done["commands"][0]["status"], "applied");
    place.tool(&["echo", "event/controller"]).until("the emergency", |line| {
        assert!(!line.contains("has the authority"), "{line}");
        line.contains(r#"command applied: {"neutral":true}"#).then_some(())
    });
    let faults = ["estimator", "restart", "dvl_silent_for_s", "2", "thruster_gain", r#"{"thruster":1,"gain":0.5}"#];
    let done = place.json(0, &[&["set", "neutral", "false"], &faults[..]].concat());
    assert!(done["commands"].as_array().unwrap().iter().all(|one| one["status"] == "applied"), "{done}");
    let soon = place.json(0, &["set", "depth_m", "3", "--no-wait"]);
    assert_eq!(soon["commands"][0]["status"], "scheduled");
}

#[test]
fn what_flows_is_listed_shown_and_measured() {
    let place = Place::new();
    let mut up = place.up(&["--run", "this"]);

    let listed = place.json(0, &["list"]);
    let vehicle = &listed["vehicles"][0];
    let services: Vec<_> = list(&vehicle["services"]).iter().map(|one| &one["service"]).collect();
    assert_eq!(services, ["controller", "estimator", "guidance", "plant"]);
    let nav = list(&vehicle["keys"]).iter().find(|flow| flow["key"] == "estimator/nav").unwrap();
    assert!(nav["writers"][0].as_str().unwrap().starts_with("estimator-"), "{nav}");

    let done = place.ask(&["echo", "estimator/nav", "--count", "3", "--json"]);
    let lines: Vec<Value> = done.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((done.code, lines.len()), (Some(0), 3));
    assert_eq!(lines[2]["key"], "supertwin/argus-mini/estimator/nav");
    assert!(lines[2]["value"]["tick"].as_u64() > lines[0]["value"]["tick"].as_u64());

    // Events of before the listener came are shown first, in the order in which they happened.
    let done = place.ask(&["echo", "event/**", "--count", "4", "--json"]);
    let past: Vec<Value> = done.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    // Services in one process need not be at the same tick.
    let happened = past.iter().map(|event| event["value"]["clock_ns"].as_u64().unwrap());
    assert!(past.len() == 4 && past[0]["value"]["tick"] == 0 && happened.is_sorted(), "{past:?}");

    let rates = place.json(0, &["hz", "estimator/*", "--for", "2"]);
    let nav = &rates["keys"][0];
    // By its own count, however busy the machine is: the first and the last may have come at any time of the two seconds.
    let [rate_hz, messages] = ["rate_hz", "messages"].map(|name| nav[name].as_f64().unwrap());
    assert!(messages > 20.0 && rate_hz >= (messages - 1.0) / rates["for_s"].as_f64().unwrap(), "{rates}");
    assert!(nav["jitter_ms"].is_f64() && nav["bytes_per_s"].as_f64().unwrap() > 1000.0, "{nav}");
    assert_eq!((nav["duplicates"].as_u64(), nav["rivals"].as_u64()), (Some(0), Some(0)), "{nav}");
    place.ask(&["hz", "nobody/here", "--for", "0.2"]).ends(1, "nothing was heard");

    let snapshot = place.json(0, &["top"]);
    assert_eq!(list(&snapshot["services"]).len(), 4);
    for line in list(&snapshot["services"]) {
        assert_eq!((&line["status"], line["health"]["run"].as_str()), (&"up".into(), Some("this")), "{line}");
        assert!(line["rate_hz"].as_f64().unwrap() > 10.0, "{line}");
    }
    let table = place.ask(&["top"]).out;
    assert!(SERVICES.iter().all(|service| table.contains(service)) && table.contains("step p50/p99"), "{table}");

    // What a user stops has done what it should.
    let mut echo = place.tool(&["echo", "estimator/nav", "--json"]);
    assert!(echo.json()["key"].is_string());
    echo.signal("INT");
    assert_eq!(echo.finish().code, Some(0));

    let done = place.shell(&format!("supertwin echo estimator/nav --connect {} | head -1", place.socket));
    assert!(done.err.is_empty() && done.out.lines().count() == 1, "{done:?}");

    up.signal("INT");
    assert_eq!(up.finish().code, Some(0));
}

#[test]
fn the_vehicle_is_the_only_one_or_has_to_be_named() {
    let place = Place::new();
    let _router = place.router();
    place.ask(&["get"]).ends(1, "start one with `supertwin up`");
    assert_eq!(place.json(0, &["list"])["vehicles"], Value::Array(Vec::new()));

    let one = ["serve", "estimator", "--connect", &place.socket, "--vehicle"];
    let _anna = place.started(&[&one[..], &["anna"]].concat());
    assert_eq!(place.json(0, &["get"])["vehicle"], "anna");
    let _ben = place.started(&[&one[..], &["ben"]].concat());
    place.ask(&["get"]).refused("anna, ben are up: say which");
    assert_eq!(place.json(0, &["get", "--vehicle", "ben"])["vehicle"], "ben");
}

#[test]
fn the_doctor_finds_nothing_when_all_is_well_and_a_second_controller_when_there_is_one() {
    let place = Place::new();
    let _up = place.up(&[]);
    assert_eq!(place.doctor(0, &[]), Vec::<String>::new());
    let said = place.ask(&["doctor"]).out;
    assert_says(&said, &["ok       router", "ok       clock: the vehicle's is", "ok       versions"]);
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

    let router = place.router();
    let found = place.doctor(1, &[]);
    assert_eq!(found, ["services: none is up"]);

    let plant = place.serve("plant");
    let _estimator = place.serve("estimator");
    let found = place.doctor(1, &[]);
    assert!(found.contains(&"services: guidance of argus-mini is missing".to_owned()), "{found:?}");
    assert!(found.contains(&"services: controller of argus-mini is missing".to_owned()), "{found:?}");
    assert!(!found.iter().any(|text| text.starts_with("access")), "{found:?}");

    let top = place.tool(&["top", "--json", "--count", "1000"]);
    let snapshot = || {
        let services = list(&top.json()["services"]).clone();
        let status = |service| services.iter().find(|line| line["service"] == service).unwrap()["status"].clone();
        ["plant", "estimator"].map(status)
    };
    assert_eq!(snapshot()[0], "up");
    drop(plant);
    let gone = std::iter::repeat_with(snapshot).find(|[plant, _]| plant != "up").unwrap();
    assert_eq!(gone, ["gone", "up"]);
    drop(router);
}

#[test]
fn the_doctor_finds_settings_that_are_dangerous_or_can_not_be_used() {
    let place = Place::new();
    let _up = place.up(&[]);
    let file = |name: &str, body: &str| {
        std::fs::write(place.path().join(name), body).unwrap();
        place.path().join(name).display().to_string()
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
    let words = ["certificates: /nowhere/ca.pem", "No such file", "transport/link/tls/root_ca_certificate"];
    assert_says(&found[0], &words);
    let found = place.doctor(1, &["--zenoh", &file("p.json5", &named(&discovery))]);
    assert!(found[0].contains("is no PEM file"), "{found:?}");

    let found = place.doctor(1, &["--zenoh", &file("t.json5", "{ scoutin: {} }")]);
    assert!(found.len() == 1 && found[0].contains("t.json5") && found[0].contains("scoutin"), "{found:?}");
}

#[test]
fn the_doctor_finds_keys_that_may_not_be_read() {
    let place = Place::new();
    let liveliness = "{ mode: 'router', access_control: { enabled: true, default_permission: 'deny',
        rules: [{ id: 'alive', permission: 'allow', flows: ['ingress', 'egress'], key_exprs: ['supertwin/*/alive/**'],
            messages: ['liveliness_token', 'liveliness_query', 'declare_liveliness_subscriber'] }],
        subjects: [{ id: 'all', link_protocols: ['unixsock-stream'] }],
        policies: [{ id: 'p', rules: ['alive'], subjects: ['all'] }] } }";
    std::fs::write(place.path().join("acl.json5"), liveliness).unwrap();
    let _up = place.up(&["--zenoh", "acl.json5"]);
    let found = place.doctor(1, &[]);
    for service in SERVICES {
        let text = format!("access: {service} is alive, but neither health nor state of it can be read");
        assert!(found.contains(&text), "{found:?}");
    }
}

#[test]
fn without_a_router_every_tool_says_so_and_what_to_do() {
    let place = Place::new();
    for arguments in [&["list"][..], &["top"][..], &["set", "depth_m", "5"][..]] {
        let done = place.ask(arguments);
        let told = done.code == Some(2) && done.err.contains("start one with `supertwin up`");
        assert!(told, "{arguments:?}: {done:?}");
    }
}
