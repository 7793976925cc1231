//! The twin beside a real vehicle. A second plant plays the vehicle and its driver.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use crate::support::{Listener, Place, Process};
use serde_json::Value;
use std::collections::BTreeMap;

/// What one plant said of where it is, by tick.
type Truths = BTreeMap<u64, Value>;

fn serve(place: &Place, service: &str, more: &[&str]) -> Process {
    let arguments = ["serve", service, "--json", "--trial", "fair", "--connect", &place.socket];
    place.start(&[&arguments[..], more].concat())
}

/// Enters a truth of the vehicle or of its shadow; whether it was one.
fn enter(key: &str, value: &Value, vehicle: &mut Truths, shadow: &mut Truths) -> bool {
    let of = match key {
        "plant/truth" => vehicle,
        "shadow/plant/truth" => shadow,
        _ => return false,
    };
    of.insert(value["tick"].as_u64().unwrap(), value["data"].clone());
    true
}

/// Enters truths of both until `enough`.
fn compare(listener: &Listener, vehicle: &mut Truths, shadow: &mut Truths, enough: impl Fn(&Truths, &Truths) -> bool) {
    let is_enough = |key: &str, value: &Value| enter(key, value, vehicle, shadow) && enough(vehicle, shadow);
    listener.until("the truths of both", is_enough);
}

#[test]
fn a_shadow_takes_the_thrust_of_its_vehicle_and_never_speaks_in_its_place() {
    let place = Place::new();
    let router = place.start(&["serve", "router", "--json", "--listen", &place.socket]);
    router.json();
    let shadow = serve(&place, "shadow", &[]);
    assert_eq!(shadow.json()["serving"], "shadow");
    let mut recorder = place.start(&["record", "--json", "--connect", &place.socket, "--out", "recorded"]);
    recorder.json();
    let listener = Listener::open(&place.socket, "argus-mini").listen("**");
    // The same trial and seed: what the shadow's model does not know of this vehicle is nothing.
    let others: Vec<Process> =
        ["estimator", "guidance", "controller"].iter().map(|service| serve(&place, service, &[])).collect();
    others.iter().for_each(|process| drop(process.json()));
    let plant = serve(&place, "plant", &["--run", "dive"]);
    plant.json();

    let (mut vehicle, mut twin) = (Truths::new(), Truths::new());
    let common = |vehicle: &Truths, twin: &Truths| vehicle.keys().filter(|tick| twin.contains_key(tick)).count();
    let mut writers: BTreeMap<String, String> = BTreeMap::new();
    let mut residual = None;
    listener.until("the truths of both, and what is between them", |key, value| {
        let source = value["source"].as_str().unwrap_or_default();
        if ["plant/measurements", "shadow/plant/measurements", "telemetry/shadow", "health/shadow"].contains(&key) {
            let writer = writers.entry(key.to_owned()).or_insert_with(|| source.to_owned());
            assert_eq!(writer, source, "two write {key}");
        }
        if key == "telemetry/shadow" {
            residual = value["data"]["signals"]["shadow/residual"].as_array().cloned();
            assert!(value["data"]["signals"].as_object().unwrap().keys().all(|path| path.starts_with("shadow/")));
        }
        let is_truth = enter(key, value, &mut vehicle, &mut twin);
        is_truth && common(&vehicle, &twin) > 200 && residual.is_some() && writers.len() == 4
    });
    for (key, writer) in &writers {
        let its = if key == "plant/measurements" { "plant-" } else { "shadow-" };
        assert!(writer.starts_with(its), "{key} is written by {writer}");
    }
    let both: Vec<(&Value, &Value)> =
        vehicle.iter().filter_map(|(tick, truth)| Some((truth, twin.get(tick)?))).collect();
    let number = |truth: &Value, what: &str| truth[what].as_f64().unwrap();
    let moved = both.iter().map(|(truth, _)| (number(truth, "depth_m") - number(both[0].0, "depth_m")).abs());
    assert!(moved.fold(0.0, f64::max) > 0.05, "the vehicle has not moved: there is nothing to follow");
    for what in ["north_m", "east_m", "depth_m", "heading_rad"] {
        let apart =
            both.iter().map(|(truth, twin)| (number(truth, what) - number(twin, what)).abs()).fold(0.0, f64::max);
        assert!(apart < 0.05, "{what}: {apart} apart");
    }
    let depth_m = residual.unwrap()[0].as_f64().unwrap();
    assert!(depth_m.abs() < 0.5, "sensor noise and waves only: {depth_m}");

    // Those who look see it, and a recording keeps what it said.
    let listed = place.call(&["list", "--json", "--connect", &place.socket]).well().out;
    assert!(listed.contains("shadow"), "{listed}");
    recorder.signal("INT");
    assert_eq!(recorder.finish().code, Some(0));
    let file = std::fs::read_dir(place.path().join("recorded")).unwrap().next().unwrap().unwrap().path();
    let recording = supertwin_rerun::read(&file).unwrap();
    for key in ["shadow/plant/measurements", "shadow/plant/truth", "plant/measurements"] {
        assert!(recording.wires.get(key).is_some_and(|messages| messages.len() > 100), "{key} is not recorded");
    }
    drop((shadow, plant, others, router));
}

#[test]
fn a_shadow_that_comes_later_starts_from_its_trial_and_says_how_far_off_it_is() {
    let place = Place::new();
    let twin = place.start(&["up", "--json", "--trial", "fair", "--rtf", "2", "--listen", &place.socket]);
    twin.json();
    let listener = Listener::open(&place.socket, "argus-mini").listen("**");
    let (mut vehicle, mut shadow) = (Truths::new(), Truths::new());
    compare(&listener, &mut vehicle, &mut shadow, |vehicle, _| vehicle.len() > 100);
    let late = serve(&place, "shadow", &["--rtf", "2", "--set", "trial.start.depth_m=6"]);
    late.json();
    let first = vehicle.last_key_value().map(|(tick, _)| *tick).unwrap();
    compare(&listener, &mut vehicle, &mut shadow, |_, shadow| shadow.len() > 50);
    assert!(shadow.first_key_value().is_some_and(|(tick, _)| *tick >= first), "it follows the vehicle's ticks");
    let has_residual = |value: &Value| value["data"]["signals"]["shadow/residual"].is_array();
    let (residual, _) = listener.until_on("telemetry/shadow", "the residual", has_residual);
    let depth_m = residual["data"]["signals"]["shadow/residual"][0].as_f64().unwrap();
    assert!(depth_m < -1.0, "the vehicle is near the surface and its shadow is not: {depth_m}");
}

#[test]
fn a_shadow_in_lock_step_is_refused() {
    let place = Place::new();
    place.call(&["serve", "shadow", "--pace", "lockstep"]).refused("a shadow follows the vehicle's time");
}
