//! A viewer that attacks: floods, and what the vehicle makes of them.

use super::Locked;
use crate::support::{Listener, Process, ROV, SERVICES, following};
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use supertwin_protocol::access::Verb;
use supertwin_protocol::lease::LeaseAction;
use supertwin_protocol::role::Role;
use supertwin_protocol::{Clock, SystemClock, keys};
use supertwin_zenoh::access_control::probe::Seen;

/// A vehicle that follows the net behind a locked router, four times as fast as real: a second has 200 laps.
struct Vehicle {
    locked: Locked,
    beside: Listener,
    _services: Vec<Process>,
}

impl Vehicle {
    fn start() -> Self {
        let locked = Locked::start();
        let trial = following(locked.place.path());
        let serve = |service: &str| locked.place.serve_rov(service, &trial, &locked.place.socket, &["--rtf", "2"]);
        let services: Vec<Process> = ["estimator", "guidance", "controller", "plant"].map(serve).into();
        let beside = Listener::open(&locked.place.socket, ROV).listen("health/plant").listen("telemetry/controller");
        let vehicle = Self { locked, beside, _services: services };
        vehicle.beside.until_status("tracking");
        vehicle
    }

    /// The plant's account after so many more of them; the times of its last 512 laps, five seconds, are then nearly all of the
    /// meantime.
    fn health(&self, after: usize) -> Value {
        let mut left = after;
        let heard = self.beside.until_on("health/plant", "the plant's health", |_| {
            left -= 1;
            left == 0
        });
        heard.0
    }
}

type Once = Box<dyn FnMut(u64) + Send>;

/// Something done over and over by a thread; what is returned ends it and says how often it was done.
fn begin(mut once: Once) -> impl FnOnce() -> u64 {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let thread = std::thread::spawn(move || {
        let mut times = 0;
        while !flag.load(Ordering::Relaxed) {
            once(times);
            times += 1;
        }
        times
    });
    move || {
        stop.store(true, Ordering::Relaxed);
        thread.thread().unpark();
        thread.join().expect("no panic")
    }
}

/// What a viewer may think of. Each has a session of its own.
fn floods(vehicle: &Vehicle) -> [(&'static str, Once); 7] {
    use zenoh::Wait;
    let key = |key: &str| format!("{}/{key}", keys::namespace(ROV));
    let session = || vehicle.locked.session(Role::Observer);
    let put = |on: &str, size: usize| -> Once {
        let (session, key, payload) = (session(), key(on), vec![b'x'; size]);
        Box::new(move |_| session.put(key.clone(), payload.clone()).wait().expect("lives"))
    };
    let ask = |on: &str| -> Once {
        let (session, key) = (session(), key(on));
        let unread = || zenoh::handlers::RingChannel::new(1);
        Box::new(move |_| drop(session.get(key.clone()).with(unread()).wait().expect("lives")))
    };
    let churn = || -> Once {
        let (session, root) = (session(), key("event"));
        Box::new(move |i| {
            drop(session.declare_subscriber(format!("{root}/{}", i % 1000)).callback(drop).wait().expect("lives"));
            drop(session.declare_queryable(format!("{root}/{}", i % 1000)).callback(drop).wait().expect("lives"));
            drop(session.liveliness().declare_token(format!("{root}/{}", i % 1000)).wait().expect("lives"));
        })
    };
    let unread = || -> Once {
        use zenoh::query::{ConsolidationMode, ReplyKeyExpr};
        let (session, key, mut kept) = (session(), key("event/*/@adv/**"), Vec::new());
        Box::new(move |_| {
            if kept.len() < 1000 {
                // Nobody reads, so that the whole link stands still: the answers wait at the router.
                let get =
                    session.get(key.clone()).accept_replies(ReplyKeyExpr::Any).consolidation(ConsolidationMode::None);
                kept.push(get.with(zenoh::handlers::FifoChannel::new(1)).wait().expect("lives"));
            } else {
                // Until the attack is ended.
                std::thread::park();
            }
        })
    };
    [
        ("navigation, as fast as it goes", put("estimator/nav", 200)),
        ("messages of 900 kB", put("guidance/reference", 900_000)),
        ("commands, as fast as it goes", ask("command/controller/neutral")),
        ("questions for states, answers unread", ask("state/**")),
        ("questions for histories, answers unread", ask("event/*/@adv/**")),
        ("subscribers, queryables, tokens", churn()),
        ("histories, and a link that nobody reads", unread()),
    ]
}

#[test]
fn a_viewer_can_neither_steer_nor_blind_nor_exhaust_a_vehicle() {
    let vehicle = Vehicle::start();
    let clock = SystemClock::start();
    let operator = vehicle.locked.session(Role::Operator);
    let mut anna = supertwin_zenoh::Client::new(operator, ROV, "anna", Arc::new(clock));
    anna.acquire(60.0).expect("nobody else has it");
    let mut seen = vehicle.locked.witness();
    let us = |health: &Value| [0, 1, 2].map(|i| health["loop_us"][i].as_f64().expect("a number"));
    let (mut report, quiet) = (Vec::new(), us(&vehicle.health(4)));
    let mut add = |what: &str, loop_us: [f64; 3], per_s: f64| {
        report.push(json!({ "what": what, "loop_us": loop_us, "per_s": per_s.round() }));
    };
    add("undisturbed", quiet, 0.0);
    for (what, once) in floods(&vehicle) {
        let (before, began) = (vehicle.health(1), clock.now());
        let end = begin(once);
        let after = vehicle.health(4);
        // He who may command is obeyed meanwhile, and so is a cry for help; and the vehicle has not stood still.
        anna.lease(LeaseAction::Renew, 60.0).unwrap_or_else(|error| panic!("{what}: {error}"));
        let set = anna.command("guidance", "depth_m", json!(4.0), None);
        set.unwrap_or_else(|error| panic!("{what}: {error}"));
        let took_s = (clock.now() - began).as_secs_f64();
        add(what, us(&after), end() as f64 / took_s);
        let steps = |health: &Value| health["steps"].as_u64().expect("a count");
        assert!(steps(&after) > steps(&before) + 100, "{what}: {before} {after}");
    }
    // Nothing of it came anywhere: what only the viewer would have sent was neither taken nor refused, for nobody saw it.
    let top = vehicle.locked.place.call(&["top", "--json", "--connect", &vehicle.locked.place.socket]).well().json();
    let lines = top["services"].as_array().expect("services");
    for service in SERVICES {
        let line = lines.iter().find(|line| line["service"] == service).expect("is up");
        for (wire, account) in line["health"]["inputs"].as_object().expect("inputs") {
            assert_eq!((&account["rejected"], &account["rivals"]), (&json!(0), &json!(0)), "{service} {wire}");
        }
    }
    let observer = vehicle.locked.session(Role::Observer);
    for (key, verb) in [("estimator/nav", Verb::Put), ("alive/operator/anna", Verb::Liveliness)] {
        let full = format!("{}/{key}", keys::namespace(ROV));
        let attempt = seen.attempt_on(&observer, &full, key.starts_with("alive"), verb).expect("sessions live");
        assert_eq!(attempt, Seen::Nothing, "{verb} {key}");
    }
    let held = anna.lease(LeaseAction::Status, 0.0).expect("the keeper answers");
    assert_eq!(held.holder.as_deref(), Some("anna"));
    // For whoever wants the numbers of this machine.
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("loop-under-attack.json");
    std::fs::write(file, serde_json::to_string_pretty(&report).expect("JSON")).expect("is written");
}
