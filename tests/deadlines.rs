//! What a vehicle promises within a time, by a clock that the test moves: deadman, leases, inputs that grow old, requests
//! that come too late. All services stand in this process and on this thread; each has an engine of its own, so that it
//! can fall silent.

use crate::support::{CONFIG, Place, SERVICES, following};
use serde_json::{Value, json};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use supertwin_lab::Library;
use supertwin_operations::placement::{HostedService, Placement, PlacementOptions};
use supertwin_protocol::{Clock, keys};
use supertwin_zenoh::{Engine, Link, Mailbox, Pace, Session};
use zenoh::Wait;
use zenoh::pubsub::Subscriber;

const TICK_MS: u64 = 20;
/// How old a reference or a navigation may be, and how long a stream may pause, by `config/safety/standard.toml`.
const LIMIT_MS: u64 = 500;
/// A token as a client proposes it.
const TOKEN: &str = "0123456789abcdef0123456789abcdef";

/// A clock that stands still until it is set.
#[derive(Default)]
struct SetClock(AtomicU64);

impl Clock for SetClock {
    fn now(&self) -> Duration {
        Duration::from_nanos(self.unix_ns())
    }
    fn unix_ns(&self) -> u64 {
        self.0.load(Ordering::SeqCst)
    }
}

/// The four services; tick k begins at k times 20 ms.
struct Vehicle {
    clock: Arc<SetClock>,
    session: Session,
    engines: Vec<(&'static str, Engine)>,
    /// Who does nothing and hears nothing.
    silent: Option<&'static str>,
    events: Arc<Mutex<Vec<Value>>>,
    _listens: Subscriber<()>,
}

impl Vehicle {
    /// Under way, at tick 50.
    fn start() -> Self {
        let place = Place::new();
        let options = PlacementOptions {
            trial: following(place.path()),
            pace: Pace::RealTime(1.0),
            mission: true,
            patience: Duration::MAX,
            one_process: true,
            ..PlacementOptions::default()
        };
        let placement = Placement::new(options, &Library::new(CONFIG, Vec::new())).expect("is legal");
        assert_eq!(placement.tick_s() * 1e3, TICK_MS as f64);
        // Nobody else: messages go from one service to the other within this process, before `put` returns.
        let session = Link { mode: Some("peer"), ..Link::default() }.open().expect("needs no network");
        let events = Arc::new(Mutex::new(Vec::new()));
        let heard = Arc::clone(&events);
        let listens = session.declare_subscriber(keys::event("*")).callback(move |sample| {
            let event: Value = serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON");
            heard.lock().expect("not poisoned").push(event["data"].clone());
        });
        let listens = listens.wait().expect("lives");
        let clock = Arc::new(SetClock::default());
        let shared: Arc<dyn Clock> = Arc::<SetClock>::clone(&clock);
        let hosted =
            [HostedService::Plant, HostedService::Estimator, HostedService::Guidance, HostedService::Controller];
        let engine = |service| {
            let (mailbox, stop) = (Arc::new(Mailbox::default()), Arc::new(AtomicBool::new(false)));
            placement.host(&[service], &session, &mailbox, &shared, &stop).expect("keys are free")
        };
        let engines = SERVICES.into_iter().zip(hosted.map(engine)).collect();
        let mut vehicle = Self { clock, session, engines, silent: None, events, _listens: listens };
        vehicle.until_ms(50 * TICK_MS);
        vehicle.happened();
        vehicle
    }

    fn now_ms(&self) -> u64 {
        self.clock.unix_ns() / 1_000_000
    }

    /// The engines of those who are not silent.
    fn awake(&mut self) -> impl Iterator<Item = &mut Engine> {
        let silent = self.silent;
        self.engines.iter_mut().filter(move |(service, _)| Some(*service) != silent).map(|(_, engine)| engine)
    }

    /// Everybody does what there is to do at this moment.
    fn settle(&mut self) {
        let now = self.clock.now();
        while self.awake().any(|engine| engine.round(now)) {}
    }

    /// Time passes, from one deadline to the next.
    fn until_ms(&mut self, end_ms: u64) {
        let end = Duration::from_millis(end_ms);
        loop {
            self.settle();
            let now = self.clock.now();
            if now >= end {
                break;
            }
            let next = self.awake().filter_map(|engine| engine.deadline()).min().map_or(end, |next| next.min(end));
            assert!(next > now, "somebody could have done something and has not");
            self.clock.0.store(next.as_nanos() as u64, Ordering::SeqCst);
        }
    }

    fn pass_ms(&mut self, ms: u64) {
        self.until_ms(self.now_ms() + ms);
    }

    /// Asks, and lets everybody have what comes of it.
    fn ask(&mut self, key: &str, body: Option<&Value>) -> Result<Value, String> {
        let question = self.session.get(key).payload(body.map(Value::to_string).unwrap_or_default());
        let replies = question.wait().expect("lives");
        self.settle();
        let answer = match replies.recv().expect("somebody answers").into_result() {
            Ok(sample) => Ok(serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON")),
            Err(error) => Err(String::from_utf8_lossy(&error.payload().to_bytes()).into_owned()),
        };
        self.settle();
        answer
    }

    fn lease(&mut self, client: &str, action: &str, for_s: f64) -> Result<Value, String> {
        let body = json!({ "client": client, "action": action, "for_s": for_s, "token": TOKEN });
        self.ask(keys::LEASE, Some(&body))
    }

    /// Commands a depth; the tick at which it applies.
    fn command(&mut self, seq: u64, depth_m: f64, at_tick: Option<u64>) -> Result<u64, String> {
        let body = json!({ "client": "pilot", "seq": seq, "token": TOKEN, "value": depth_m, "at_tick": at_tick });
        let answer = self.ask(&keys::command("guidance", "depth_m"), Some(&body));
        answer.map(|answer| answer["apply_tick"].as_u64().expect("a tick"))
    }

    /// A sample of a stream; without a value the stream ends.
    fn stream(&mut self, seq: u64, speed_m_per_s: Option<f64>) {
        let sample = json!({ "client": "pilot", "token": TOKEN, "seq": seq, "value": speed_m_per_s });
        self.session.put(keys::setpoint("speed_m_per_s"), sample.to_string()).wait().expect("lives");
        self.settle();
    }

    /// What has happened since the last call, in short and by tick.
    fn happened(&mut self) -> Vec<(u64, String)> {
        // Whoever has answered has told his events before.
        let silent = self.silent;
        for service in SERVICES.into_iter().filter(|service| silent != Some(service)) {
            self.ask(&keys::state(service, "now"), None).expect("answers");
        }
        let events = core::mem::take(&mut *self.events.lock().expect("not poisoned"));
        let text = |event: &Value| {
            let what = &event["what"];
            match what["kind"].as_str().expect("a kind") {
                "state_changed" => format!("{} {}", what["what"], what["to"]).replace('"', ""),
                "operator_lost" => format!("operator_lost, stream: {}", what["setpoints_stopped"]),
                "setpoint_refused" => format!("setpoint_refused: {}", what["reason"]),
                kind => kind.to_owned(),
            }
        };
        let of = |event: &Value| format!("{}: {}", event["service"].as_str().expect("a service"), text(event));
        let mut events: Vec<_> =
            events.iter().map(|event| (event["tick"].as_u64().expect("a tick"), of(event))).collect();
        events.sort();
        events
    }
}

/// Texts with the tick at which each of them is said.
fn at(tick: u64, texts: &[impl AsRef<str>]) -> Vec<(u64, String)> {
    texts.iter().map(|text| (tick, text.as_ref().to_owned())).collect()
}

#[test]
fn the_deadman_acts_when_a_stream_has_paused_for_longer_than_its_time_and_not_before() {
    let mut vehicle = Vehicle::start();
    vehicle.lease("pilot", "acquire", 60.0).expect("nobody has it");
    vehicle.happened();
    let mut seq = 0;
    // With a tick and between two.
    for offset_ms in [0, 1, 19] {
        vehicle.pass_ms(offset_ms);
        for _ in 0..4 {
            seq += 1;
            vehicle.stream(seq, Some(0.1));
            vehicle.pass_ms(LIMIT_MS);
        }
        assert_eq!(vehicle.happened(), [], "it may pause for as long as that");
        // What comes too late keeps nobody alive: a number that was there already, and one before it.
        for late in [seq, seq - 1] {
            vehicle.stream(late, Some(0.3));
        }
        let next = vehicle.now_ms() / TICK_MS + 1;
        vehicle.until_ms(next * TICK_MS - 1);
        let refused = format!("guidance: setpoint_refused: \"seq = {seq}: must be greater than {seq}\"");
        assert_eq!(vehicle.happened(), at(next, &[&refused]), "the second of a second is only counted");
        vehicle.until_ms(next * TICK_MS);
        let holds = ["mode depth_heading_hold", "operator_lost, stream: true", "reason operator_lost"];
        assert_eq!(vehicle.happened(), at(next, &holds.map(|text| format!("guidance: {text}"))));
        seq += 1;
        vehicle.stream(seq, Some(0.1));
        vehicle.until_ms((next + 1) * TICK_MS);
        let goes_on = ["mode follow_net", "operator_present", "reason commanded"];
        assert_eq!(vehicle.happened(), at(next + 1, &goes_on.map(|text| format!("guidance: {text}"))));
    }
    seq += 1;
    vehicle.stream(seq, None);
    vehicle.pass_ms(10 * LIMIT_MS);
    assert_eq!(vehicle.happened(), [], "a stream that was ended needs no hand");
}

#[test]
fn a_lease_runs_out_at_its_time_and_its_holder_commands_until_then_and_no_longer() {
    let mut vehicle = Vehicle::start();
    vehicle.lease("pilot", "acquire", 2.0).expect("nobody has it");
    vehicle.pass_ms(1990);
    // The last moment but one; by then nobody has noticed anything.
    vehicle.lease("pilot", "renew", 3.0).expect("is still his");
    let end_ms = vehicle.now_ms() + 3000;
    let refused = vehicle.lease("other", "acquire", 5.0).expect_err("the pilot has it");
    assert!(refused.contains("pilot holds the authority"), "{refused}");
    vehicle.until_ms(end_ms - 1);
    let apply_tick = vehicle.command(1, 4.5, None).expect("is in command");
    let told: Vec<String> = vehicle.happened().into_iter().map(|(_, text)| text).collect();
    assert_eq!(told, ["controller: lease_taken", "controller: lease_refused", "guidance: command_scheduled"]);
    vehicle.until_ms(end_ms);
    for error in [vehicle.command(2, 5.0, None).map(drop), vehicle.lease("pilot", "renew", 5.0).map(drop)] {
        assert!(error.as_ref().is_err_and(|error| error.contains("nobody holds the authority")), "{error:?}");
    }
    // The first tick that begins after the end: guidance holds by itself, and what was promised before is kept.
    let next = end_ms / TICK_MS + 1;
    vehicle.until_ms(apply_tick * TICK_MS);
    let lost = [
        "controller: lease_expired",
        "controller: lease_refused",
        "guidance: command_refused",
        "guidance: mode depth_heading_hold",
        "guidance: operator_lost, stream: false",
        "guidance: reason operator_lost",
    ];
    assert_eq!(vehicle.happened(), [at(next, &lost), at(apply_tick, &["guidance: command_applied"])].concat());
    // A service tells of refusals once a second.
    vehicle.pass_ms(1000);
    vehicle.stream(3, Some(0.1));
    let refused = "guidance: setpoint_refused: \"nobody holds the authority: acquire it first (authority/lease)\"";
    assert_eq!(vehicle.happened(), at(vehicle.now_ms() / TICK_MS + 1, &[refused]));
    // The next one is there from the next tick on; who gives it back is not lost.
    vehicle.lease("other", "acquire", 5.0).expect("nobody has it any more");
    vehicle.pass_ms(TICK_MS);
    let taken = ["controller: lease_taken", "guidance: mode follow_net", "guidance: operator_present"];
    let next = vehicle.now_ms() / TICK_MS;
    assert_eq!(vehicle.happened(), [at(next, &taken), at(next, &["guidance: reason commanded"])].concat());
    vehicle.lease("other", "release", 0.0).expect("is his");
    vehicle.pass_ms(10_000);
    assert_eq!(vehicle.happened(), at(next + 1, &["controller: lease_returned"]));
}

/// Whoever needs a message that does not come acts when it is older than it may be, and not before; and he is back with the
/// first that comes again.
#[test]
fn who_falls_silent_is_missed_at_his_time_and_not_before() {
    let mut vehicle = Vehicle::start();
    let limit = LIMIT_MS / TICK_MS;
    for (service, missed, back) in [
        ("guidance", &["controller: status fallback"][..], &["controller: status tracking"][..]),
        (
            "estimator",
            &["controller: status nav_stale", "guidance: reason nav_stale"],
            &["controller: status tracking", "guidance: reason commanded"],
        ),
        (
            "controller",
            &["estimator: thrust unknown", "plant: thrust lost"],
            &["estimator: thrust known", "plant: thrust found"],
        ),
    ] {
        let last = vehicle.now_ms() / TICK_MS;
        vehicle.silent = Some(service);
        vehicle.until_ms((last + limit + 1) * TICK_MS - 1);
        assert_eq!(vehicle.happened(), [], "{service}: is old, but not too old");
        vehicle.pass_ms(2 * LIMIT_MS);
        assert_eq!(vehicle.happened(), at(last + limit + 1, missed), "{service}: is missed once");
        vehicle.silent = None;
        let next = vehicle.now_ms() / TICK_MS + 1;
        vehicle.pass_ms(2 * LIMIT_MS);
        let mut told = vehicle.happened();
        // What waited for him meanwhile is old, and that much of it is missing, he says himself.
        told.retain(|(_, text)| !text.contains("message"));
        assert_eq!(told, at(next, back), "{service}: is back");
    }
}

/// However much comes, a service takes so much of it and then does its step.
#[test]
fn a_flood_keeps_nobody_from_stepping() {
    let mut vehicle = Vehicle::start();
    let next = vehicle.now_ms() / TICK_MS + 1;
    for _ in 0..5000 {
        vehicle.session.put(keys::setpoint("depth_m"), "garbage").wait().expect("lives");
    }
    let question = |_| vehicle.session.get(keys::command("guidance", "mode")).payload("garbage").wait().expect("lives");
    let questions: Vec<_> = (0..500).map(question).collect();
    let now = Duration::from_millis(next * TICK_MS);
    vehicle.clock.0.store(now.as_nanos() as u64, Ordering::SeqCst);
    // Nobody has flooded the owner of time and the estimator.
    let steps_after = |engine: &mut Engine| (1..).find(|_| engine.round(now)).expect("steps some time");
    assert_eq!([0, 1].map(|i| steps_after(&mut vehicle.engines[i].1)), [1, 1]);
    // The navigation came last: behind a thousand, for which there is room, and of which so many are taken at once.
    let guidance = &mut vehicle.engines[2].1;
    let rounds = steps_after(guidance);
    assert!(rounds <= 4, "{rounds}");
    // The rest has been dropped, and whoever has asked knows at once; the others are answered in the end.
    for _ in 0..8 {
        guidance.round(now);
    }
    assert_eq!(questions.iter().filter(|replies| replies.recv().is_ok()).count(), 64);
}

#[test]
fn a_command_applies_at_its_tick_and_one_for_a_tick_that_is_over_is_refused() {
    let mut vehicle = Vehicle::start();
    vehicle.lease("pilot", "acquire", 60.0).expect("nobody has it");
    vehicle.happened();
    let next = vehicle.now_ms() / TICK_MS + 1;
    let late = vehicle.command(1, 5.0, Some(next - 1)).expect_err("that tick is over");
    assert!(late.contains(&format!("at_tick = {}: is over; the next tick is {next}", next - 1)), "{late}");
    assert_eq!(vehicle.command(2, 5.0, Some(next + 10)), Ok(next + 10));
    vehicle.until_ms((next + 10) * TICK_MS - 1);
    let scheduled = "guidance: command_scheduled".to_owned();
    assert_eq!(vehicle.happened(), [(next, "guidance: command_refused".to_owned()), (next, scheduled)]);
    vehicle.until_ms((next + 10) * TICK_MS);
    assert_eq!(vehicle.happened(), [(next + 10, "guidance: command_applied".to_owned())]);
}
