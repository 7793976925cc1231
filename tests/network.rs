//! Split deployments for real: separate processes, a router, a tether that is cut, stalls or lags, services that are killed.

mod restarts;

use crate::support::{
    CONFIG, Cable, Events, Listener, Place, Process, Proxy, ROV, SERVICES, files_in, following, listening,
};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;
use supertwin_protocol::lease::LeaseAction;
use supertwin_zenoh::Link;
use supertwin_zenoh::session::exposures;

/// A vehicle with its router and its services; guidance may stand elsewhere.
struct Vehicle {
    place: Place,
    trial: String,
    router: Process,
    /// The router's other endpoint.
    tcp: String,
    services: BTreeMap<&'static str, Process>,
}

impl Vehicle {
    fn start(namespace: Option<&str>, address: &str) -> Self {
        let place = Place::new();
        let (router, tcp) = router(&place, namespace, address, &[]);
        let mut vehicle = Self { trial: following(place.path()), place, router, tcp, services: BTreeMap::new() };
        for service in ["estimator", "controller", "plant"] {
            vehicle.serve(service, namespace);
        }
        vehicle
    }

    fn serve(&mut self, service: &'static str, namespace: Option<&str>) {
        let socket = self.place.socket.clone();
        self.serve_at(service, &socket, namespace);
    }

    fn serve_at(&mut self, service: &'static str, endpoint: &str, namespace: Option<&str>) {
        let words = ["serve", service, "--json", "--vehicle", ROV, "--trial", &self.trial, "--connect", endpoint];
        self.services.insert(service, self.place.start_in(namespace, &words));
    }

    /// Kills a service and starts another in its place.
    fn restart(&mut self, service: &'static str) {
        self.services.get_mut(service).expect("runs").kill();
        self.serve(service, None);
    }

    fn listen(&self) -> Listener {
        Listener::open(&self.place.socket, ROV)
    }
}

/// A router on the place's socket and by TCP; where the latter is.
fn router(place: &Place, namespace: Option<&str>, address: &str, more: &[&str]) -> (Process, String) {
    let tcp = format!("tcp/{address}:0");
    let words = ["serve", "router", "--json", "--open-to-everyone", "--listen", &place.socket, "--listen", &tcp];
    let process = place.start_in(namespace, &[&words, more].concat());
    let tcp = listening(&process.json(), "tcp");
    (process, tcp)
}

fn number(value: &Value, path: &str) -> f64 {
    value.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path} in {value}"))
}

fn label(value: &Value, signal: &str) -> String {
    value["data"]["signals"][signal].as_str().unwrap_or_default().to_owned()
}

/// True speed over ground, and true depth.
fn motion(truth: &Value) -> (f64, f64) {
    let v = |axis: &str| number(truth, &format!("/data/velocity/{axis}_m_per_s"));
    ((v("surge").powi(2) + v("sway").powi(2)).sqrt(), number(truth, "/data/depth_m"))
}

/// Until the vehicle follows the net at its speed and depth: true sway near 0.2 m/s, smoothed over two seconds.
fn travels(listener: &Listener) {
    let (mut smooth, mut depth_m) = (0.0, 0.0);
    listener.until("the vehicle to follow the net", |key, value| {
        if key == "plant/truth" {
            smooth += 0.01 * (number(value, "/data/velocity/sway_m_per_s").abs() - smooth);
            depth_m = motion(value).1;
        }
        smooth > 0.12 && (depth_m - 4.0_f64).abs() < 0.3
    });
}

/// Until the controller brakes by itself: by its own ticks when its reference is older than half a second, and not before.
fn until_fallback(listener: &Listener) {
    listener.until_on("telemetry/controller", "the controller to fall back", |value| {
        let reference = &value["data"]["used"]["guidance/reference"][0];
        let [tick, made_at] = [&value["tick"], reference].map(|tick| tick.as_u64().expect("a tick"));
        let (status, age) = (label(value, "controller/status"), tick - made_at);
        assert!(status != "tracking" || age <= 25, "goes on at tick {tick} with a reference of {made_at}");
        assert!(status != "fallback" || age > 25, "gives up at tick {tick} with a reference of {made_at}");
        status == "fallback"
    });
}

/// Depth stays near 4 m and nobody is faster than twice the desired speed, waves included, for so many ticks. All truth
/// that was sent is seen. What happens in half a second of which a plant that was late has sent nothing does not count.
fn stays_bounded(listener: &Listener, ticks: u64) -> f64 {
    let (mut passed, mut before, mut fastest_at_the_end) = (0, None, 0.0_f64);
    listener.until_on("plant/truth", "the ticks to pass", |value| {
        let [tick, seq] = ["tick", "seq"].map(|name| value[name].as_u64().expect("a number"));
        if let Some((last_tick, last_seq)) = before.replace((tick, seq)) {
            assert_eq!(seq, last_seq + 1, "truth is lost before tick {tick}");
            passed += Some(tick - last_tick).filter(|ticks| *ticks < 25).unwrap_or(0);
        }
        let (speed, depth_m) = motion(value);
        assert!(speed < 0.6, "speed {speed} m/s at tick {tick}");
        assert!((depth_m - 4.0).abs() < 0.8, "depth {depth_m} m at tick {tick}");
        assert!(number(value, "/data/net_distance_m") > 1.0, "too near the net at tick {tick}");
        if passed + 25 > ticks {
            fastest_at_the_end = fastest_at_the_end.max(speed);
        }
        passed >= ticks
    });
    fastest_at_the_end
}

/// What was sent, received and missed on a wire agrees, by the receiver's account.
fn ledger(listener: &Listener, service: &str, wire: &str) -> Value {
    let heard = |value: &Value| value["inputs"][wire]["received"].as_u64() > Some(0);
    let (health, _) = listener.until_on(&format!("health/{service}"), "health", heard);
    let account = health["inputs"][wire].clone();
    let count = |name: &str| account[name].as_u64().expect("a count");
    let [first, last] = [0, 1].map(|i| account["seq"][i].as_u64().expect("a number"));
    assert_eq!(count("received") + count("missing"), last - first + 1, "{service} on {wire}: {account}");
    account
}

#[test]
fn guidance_topside_of_a_cut_tether_the_vehicle_brakes_and_holds_by_itself() {
    let cable = Cable::lay();
    let (vehicle_side, topside) = cable.as_ref().map(|cable| (&*cable.vehicle, &*cable.topside)).unzip();
    let address = cable.as_ref().map_or("127.0.0.1".to_owned(), Cable::address);
    let mut vehicle = Vehicle::start(vehicle_side, &address);
    let beside = vehicle.listen().listen("plant/truth").listen("telemetry/controller").listen("health/*");
    let sent = vehicle.listen().listen("estimator/nav");
    let proxy = cable.is_none().then(|| Proxy::before(&vehicle.tcp));
    let endpoint = proxy.as_ref().map_or(vehicle.tcp.clone(), Proxy::endpoint);
    vehicle.serve_at("guidance", &endpoint, topside);
    let plug = |plugged: bool| {
        // One of the two carries the tether.
        cable.iter().for_each(|cable| cable.plug(plugged));
        proxy.iter().for_each(|proxy| proxy.cut(!plugged));
    };
    let far = ["--json", "--vehicle", ROV, "--connect", &endpoint];
    let call = |words: &[&str]| vehicle.place.start_in(topside, &[words, &far].concat());
    let speed = |value: &str| call(&["set", "speed_m_per_s", value]);
    let listener = call(&["echo", "event/*"]);
    travels(&beside);
    assert_eq!(speed("0.15").finish().well().json()["commands"][0]["status"], "applied");

    plug(false);
    let mut unheard = speed("0.25");
    until_fallback(&beside);
    // The plant has nothing to say by itself: somebody on the vehicle gives a thruster the gain that it has.
    let mut diver = beside.client("diver");
    diver.acquire(30.0).expect("is granted");
    diver.command("plant", "thruster_gain", json!({ "thruster": 1, "gain": 1.0 }), None).expect("is scheduled");
    diver.lease(LeaseAction::Release, 0.0).expect("is given back");
    let at_rest = stays_bounded(&beside, 150);
    assert!(at_rest < 0.35, "brakes: {at_rest} m/s, waves included");
    unheard.finish().refused(&format!("no router at {endpoint}"));
    plug(true);
    beside.until_status("tracking");
    travels(&beside);
    let state = call(&["get", "speed_m_per_s"]).finish().well().json();
    assert_eq!(state["value"]["constant"], 0.15, "what could not be said has changed nothing: {state}");
    assert_eq!(speed("0.2").finish().well().json()["commands"][0]["status"], "applied");

    let account = ledger(&beside, "guidance", "estimator/nav");
    let missing = account["missing"].as_u64().expect("a count");
    assert!(missing >= 100, "three seconds and the way back are missing: {missing}");
    // The same from the other side: what was really sent in that range, and did not arrive.
    let [first, last] = [0, 1].map(|i| account["seq"][i].as_u64().expect("a number"));
    let mut numbers = Vec::new();
    sent.until("the newest that guidance had", |_, value| {
        numbers.push(value["seq"].as_u64().expect("a number"));
        numbers.last() >= Some(&last)
    });
    assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "the listener on the vehicle missed nothing");
    assert!(numbers[0] <= 1 || first >= numbers[0], "and was there before guidance");
    let sent_to_guidance = numbers.iter().copied().filter(|number| (first..=last).contains(number)).count() as u64;
    assert_eq!(sent_to_guidance - account["received"].as_u64().expect("a count"), missing);

    // Whoever listened topside was cut off as well, and yet has every event, those of the cut included.
    let mut events = Events::default();
    let applied = |words: &'static str| move |text: &&String| text.contains("applied") && text.contains(words);
    listener.until("the events of the cut and of what came after it", |line| {
        let said: Value = serde_json::from_str(line).expect("JSON");
        events.enter(said["key"].as_str().expect("a key"), &said["value"]);
        let has = |words| events.texts.iter().any(|text| applied(words)(&text));
        (events.outages() >= 1 && has("thruster_gain") && has(r#"{"constant":0.2}"#)).then_some(())
    });
    events.are_complete(&SERVICES);
    let obeyed = events.texts.iter().filter(applied("speed_m_per_s")).count();
    assert_eq!(obeyed, 2, "{:?}", events.texts);
}

#[test]
fn a_tether_that_is_cut_stalls_and_lags_by_proxy() {
    let mut vehicle = Vehicle::start(None, "127.0.0.1");
    let proxy = Proxy::before(&vehicle.tcp);
    vehicle.serve_at("guidance", &proxy.endpoint(), None);
    let beside = vehicle.listen().listen("plant/truth").listen("telemetry/controller").listen("health/*");
    let topside = Listener::open(&proxy.endpoint(), ROV).events().listen("health/*");
    travels(&beside);

    for outage in [Proxy::cut, Proxy::stall] {
        outage(&proxy, true);
        until_fallback(&beside);
        stays_bounded(&beside, 150);
        outage(&proxy, false);
        beside.until_status("tracking");
        travels(&beside);
    }

    proxy.delay(Duration::from_millis(200));
    stays_bounded(&beside, 200);
    proxy.delay(Duration::ZERO);
    beside.until_status("tracking");
    travels(&beside);
    ledger(&beside, "controller", "guidance/reference");
    let topside_account = ledger(&beside, "guidance", "estimator/nav");
    assert!(topside_account["missing"].as_u64() > Some(0), "the cut took something: {topside_account}");

    // Topside was cut off as well, and yet has every event of the vehicle's own services.
    let mut events = Events::default();
    topside.until("the events of both outages", |key, value| {
        events.enter(key, value);
        events.outages() >= 2
    });
    topside.complete(&mut events, &["estimator", "controller"]);
}

#[test]
fn two_vehicles_on_one_router_do_not_hear_each_other_and_a_fleet_client_sees_both() {
    let place = Place::new();
    let trial = following(place.path());
    let (_router, _) = router(&place, None, "127.0.0.1", &[]);
    let up = |vehicle: &str, seed: &str| {
        let words =
            ["up", "--json", "--trial", &trial, "--vehicle", vehicle, "--seed", seed, "--connect", &place.socket];
        let process = place.start(&words);
        assert_eq!(process.json()["vehicle"], vehicle);
        process
    };
    let _vehicles = [up("ann", "1"), up("bob", "2")];
    let fleet = Listener::open(&place.socket, "*").listen("health/controller").listen("event/guidance");
    let mut sources: BTreeMap<String, String> = BTreeMap::new();
    let mut deep = Vec::new();
    let mut client = Listener::open(&place.socket, "ann").client("fleet");
    client.acquire(20.0).expect("is granted");
    client.command("guidance", "depth_m", json!(5.0), None).expect("is scheduled");
    fleet.until("both vehicles' health, twice", |key, value| {
        if key.contains("event") && value["data"]["what"]["command"]["by"]["client"] == "fleet" {
            deep.push(key.to_owned());
        }
        if key.contains("health") && value["tick"].as_u64() > Some(100) {
            let inputs = &value["inputs"]["estimator/nav"];
            assert_eq!(inputs["rivals"], 0, "{key}: {inputs}");
            assert_eq!(inputs["duplicates"], 0, "{key}: {inputs}");
            sources.insert(key.to_owned(), inputs["source"].as_str().expect("a source").to_owned());
        }
        sources.len() == 2
    });
    let sources: Vec<String> = sources.into_values().collect();
    assert_ne!(sources[0], sources[1], "each controller hears its own estimator");
    assert!(deep.iter().all(|key| key.contains("/ann/")), "only ann was commanded: {deep:?}");
    assert!(!deep.is_empty());
}

#[test]
fn verify_says_yes_to_the_ring_and_a_service_that_comes_later_ends_a_lock_step_run() {
    let place = Place::new();
    // The same bits.
    place.call(&["verify", "paper-gsta", "--duration", "1.5", "--json"]).well();

    let trial = following(place.path());
    let (_router, _) = router(&place, None, "127.0.0.1", &[]);
    let start = |service: &str| place.serve_rov(service, &trial, &place.socket, &["--pace", "lockstep"]);
    let beside = Listener::open(&place.socket, ROV).listen("plant/measurements");
    let mut services: Vec<Process> = ["plant", "estimator", "guidance", "controller"].map(start).into();
    beside.until("the ring to run", |_, value| value["tick"].as_u64() > Some(20));
    services[1].kill();
    start("estimator").finish().ends(1, "nobody can join");
    for service in [0, 2, 3] {
        assert_eq!(services[service].finish().code, Some(1), "and the others end with it");
    }
}

#[test]
fn a_thin_tether_thins_telemetry_and_nothing_else() {
    let place = Place::new();
    let trial = following(place.path());
    let file = format!("{CONFIG}/zenoh/thin-tether-router.json5");
    let (_router, tcp) = router(&place, None, "127.0.0.1", &["--zenoh", &file]);
    let up = place.start(&["up", "--json", "--trial", &trial, "--vehicle", ROV, "--connect", &place.socket]);
    up.json();
    let keys = ["telemetry/*", "plant/truth", "estimator/nav", "guidance/reference", "controller/thrust"];
    let count = |listener: &Listener| {
        let mut silent: Vec<&str> = keys.to_vec();
        listener.until("every key", |key, _| {
            silent.retain(|pattern| !key.starts_with(pattern.trim_end_matches('*')));
            silent.is_empty()
        });
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        // Two hundred ticks are four seconds.
        let mut first = None;
        listener.until("200 ticks", |key, value| {
            *counts.entry(key.to_owned()).or_default() += 1;
            let tick = value["tick"].as_u64().unwrap_or(0);
            key == "estimator/nav" && tick >= *first.get_or_insert(tick) + 200
        });
        counts
    };
    let listen = |endpoint: &str| keys.iter().fold(Listener::open(endpoint, ROV), |listener, key| listener.listen(key));
    let (near, far) = (count(&listen(&place.socket)), count(&listen(&tcp)));
    for key in ["telemetry/plant", "telemetry/controller", "plant/truth"] {
        assert!(near[key] > 190, "{key} on the vehicle: {near:?}");
        assert!((15..=26).contains(&far[key]), "{key} topside, at 5 Hz for four seconds: {far:?}");
    }
    for key in ["estimator/nav", "guidance/reference", "controller/thrust"] {
        assert!(far[key] > 190, "{key} topside: {far:?}");
    }
    let topside = Listener::open(&tcp, ROV).events();
    let mut pilot = topside.client("pilot");
    pilot.acquire(10.0).expect("is granted");
    let tick = pilot.command("guidance", "depth_m", json!(4.5), None).expect("is scheduled");
    let (event, _) = topside.until_on("event/guidance", "the command's event", |value| {
        let what = &value["data"]["what"];
        what["kind"] == "command_applied" && what["command"]["by"]["client"] == "pilot"
    });
    assert_eq!(event["tick"].as_u64(), Some(tick), "at the tick that was promised");
}

#[test]
fn every_shipped_zenoh_file_is_legal_and_exposes_nothing() {
    let mut files = files_in(&Path::new(CONFIG).join("zenoh"));
    files.retain(|file| file.extension().is_none_or(|extension| extension != "md"));
    for file in &files {
        let link = Link { file: Some(file.clone()), ..Link::default() };
        link.config().unwrap_or_else(|error| panic!("{error}"));
        let settings = link.settings().expect("legal");
        assert!(exposures(&settings).is_empty(), "{}: {:?}", file.display(), exposures(&settings));
    }
    assert!(files.len() >= 5, "only {files:?}");
}
