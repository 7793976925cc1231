//! Services, routers and operators that go away: who comes back, and what the vehicle does meanwhile.

use super::{Vehicle, label, number, router, stays_bounded, travels};
use crate::support::Events;
use serde_json::{Value, json};
use std::time::Duration;
use supertwin_protocol::lease::LeaseAction;

#[test]
fn each_service_killed_in_turn_rejoins_without_a_hand_and_without_a_jump() {
    let mut vehicle = Vehicle::start(None, "127.0.0.1");
    vehicle.serve("guidance", None);
    let beside = vehicle.listen().listen("plant/truth").listen("telemetry/*").listen("controller/thrust");
    travels(&beside);
    for service in ["guidance", "estimator", "controller"] {
        let (before, _) = beside.until_on("controller/thrust", "the wrench before", |_| true);
        vehicle.restart(service);
        if service == "controller" {
            // The first wrench of the new instance continues from the last of the old one.
            let is_new = |value: &Value| value["source"] != before["source"];
            let (first, _) = beside.until_on("controller/thrust", "the new controller", is_new);
            let [last, newest] = [&before, &first].map(|thrust| &thrust["data"]["allocated"]);
            for axis in ["surge", "sway", "heave"] {
                let jump = number(newest, &format!("/{axis}_n")) - number(last, &format!("/{axis}_n"));
                assert!(jump.abs() < 25.0, "{axis} jumps by {jump} N: {last} then {newest}");
            }
        }
        stays_bounded(&beside, 100);
        beside.until_status("tracking");
        travels(&beside);
    }
    // The plant's death is the twin's: a new truth begins where the trial does, at the tick where the others are.
    let (last, _) = beside.until_on("plant/truth", "truth", |_| true);
    vehicle.restart("plant");
    let (first, _) = beside.until_on("plant/truth", "a new plant", |value| value["source"] != last["source"]);
    assert_eq!(first["run"], last["run"], "the run goes on");
    assert!(first["tick"].as_u64() > last["tick"].as_u64(), "and so does its time");
    beside.until_status("tracking");
    travels(&beside);
}

#[test]
fn a_router_that_restarts_is_found_again() {
    let mut vehicle = Vehicle::start(None, "127.0.0.1");
    vehicle.serve("guidance", None);
    let beside = vehicle.listen().listen("plant/truth").listen("telemetry/controller");
    let told = vehicle.listen().events().listen("health/*");
    travels(&beside);
    vehicle.router.kill();
    // A tool waits for three seconds before it gives up: longer than the controller's patience with a silent guidance.
    vehicle.place.call(&["top", "--connect", &vehicle.place.socket]).refused("no router at");
    (vehicle.router, vehicle.tcp) = router(&vehicle.place, None, "127.0.0.1", &[]);
    beside.fresh();
    let speed = stays_bounded(&beside, 100);
    assert!(speed < 0.6, "{speed} m/s two seconds after the router came back");
    beside.until_status("tracking");
    travels(&beside);

    // The listener lost the router as well, and yet has every event, those of its absence included.
    let mut events = Events::default();
    told.until("the events of the outage", |key, value| {
        events.enter(key, value);
        events.outages() >= 1
    });
    told.complete(&mut events, &["estimator", "guidance", "controller"]);
}

/// When and why an operator is missed and is back is tested to the tick on a clock that can be set; this is the same with
/// processes, whatever they take.
#[test]
fn an_operator_who_lets_go_is_missed_and_may_come_back() {
    let mut vehicle = Vehicle::start(None, "127.0.0.1");
    vehicle.serve("guidance", None);
    let beside = vehicle.listen().listen("telemetry/guidance").events();
    let lost = |stopped: bool| json!({ "kind": "operator_lost", "setpoints_stopped": stopped });
    let until_event =
        |what: &str, event: Value| beside.until_on("event/guidance", what, |value| value["data"]["what"] == event).1;
    let until_present = |what: &str| until_event(what, json!({ "kind": "operator_present" }));
    let until_reason = |wanted: &str| {
        let is_it = |value: &Value| value["data"]["what"]["what"] == "reason" && value["data"]["what"]["to"] == wanted;
        beside.until_on("event/guidance", wanted, is_it)
    };
    until_reason("commanded");
    let mut pilot = beside.client("pilot");
    pilot.acquire(60.0).expect("is granted");
    let mut let_go = beside.clock.now();
    for sample in 0..20 {
        let_go = beside.clock.now();
        pilot.stream("speed_m_per_s", Some(0.1 + 0.001 * f64::from(sample))).expect("is sent");
        (0..3).for_each(|_| beside.fresh());
    }
    beside.until_on("telemetry/guidance", "the stream's last value but for its delay", |value| {
        let speed = || value["data"]["signals"]["guidance/reference/setpoint"][1].as_f64().expect("a speed");
        label(value, "guidance/reason") == "commanded" && (0.115..0.12).contains(&speed())
    });
    let held = until_event("the deadman", lost(true));
    assert!(held - let_go >= Duration::from_millis(500), "half a second of patience");
    until_reason("operator_lost");
    pilot.stream("speed_m_per_s", Some(0.2)).expect("is sent");
    until_present("the operator to be back");
    until_reason("commanded");
    pilot.stream("speed_m_per_s", None).expect("is sent");
    let mut end = None;
    beside.until("40 ticks to pass", |key, value| {
        let is_lost = key == "event/guidance" && value["data"]["what"] == lost(true);
        assert!(!is_lost, "a stream that was ended needs no hand");
        let tick = value["tick"].as_u64().expect("a tick");
        key == "telemetry/guidance" && tick >= *end.get_or_insert(tick + 40)
    });
    // A lease that runs out without being given back is an operator who is lost.
    let mut other = beside.client("other");
    assert!(other.acquire(5.0).expect_err("pilot has it").to_string().contains("pilot holds the authority"));
    pilot.lease(LeaseAction::Renew, 0.5).expect("is renewed");
    until_event("the lease to run out", lost(false));
    until_reason("operator_lost");
    other.acquire(60.0).expect("nobody has it any more");
    until_present("an operator again");
    until_reason("commanded");
    assert!(other.command("guidance", "depth_m", json!(99.0), None).expect_err("too deep").to_string().contains("99"));
}

#[test]
fn an_emergency_outlives_its_controller_and_a_lease_that_dies_with_it_makes_the_vehicle_hold() {
    let mut vehicle = Vehicle::start(None, "127.0.0.1");
    vehicle.serve("guidance", None);
    let beside = vehicle.listen().listen("telemetry/controller").listen("telemetry/guidance");
    beside.until_status("tracking");
    beside.client("passer-by").command("controller", "neutral", json!(true), None).expect("needs no authority");
    beside.until_status("emergency_neutral");

    let (last, _) = beside.until_on("telemetry/controller", "telemetry", |_| true);
    vehicle.restart("controller");
    let mut steps = 0;
    beside.until_on("telemetry/controller", "fifty steps of the new controller", |value| {
        if value["source"] != last["source"] {
            let forces = value["data"]["signals"]["controller/thrust/force"].as_array().expect("forces");
            assert!(forces.iter().all(|force| force.as_f64() == Some(0.0)), "no force at step {steps}: {forces:?}");
            assert_eq!(label(value, "controller/status"), "emergency_neutral");
            steps += 1;
        }
        steps == 50
    });
    let mut pilot = beside.client("pilot");
    pilot.acquire(30.0).expect("is granted");
    pilot.command("controller", "neutral", json!(false), None).expect("the holder may end it");
    beside.until_status("tracking");

    vehicle.restart("controller");
    let until_reason = |what: &str, wanted: &str| {
        beside.until_on("telemetry/guidance", what, |value| label(value, "guidance/reason") == wanted)
    };
    until_reason("guidance to miss the operator", "operator_lost");
    pilot.acquire(30.0).expect("the new controller knows of no lease");
    until_reason("the operator to be back", "commanded");
}
