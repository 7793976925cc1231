//! Stale inputs, cut wires, silent sensors, hand-overs: the vehicle stays bounded and goes on by itself (T13).

use crate::common::{Listener, load, outcome};
use supertwin_core::run::Properties;
use supertwin_core::{Event, Severity, signal};
use supertwin_lab::{ResolvedTrial, run};

fn heard(trial: &ResolvedTrial, path: &'static str) -> Listener {
    let mut listener = Listener::to(path);
    run(trial, 1, &mut listener, Some(&Properties::new()), |_| true).expect("runs without NaN");
    listener
}

fn between(listener: &Listener, from_s: f64, to_s: f64) -> Vec<&[f64]> {
    let inside = |k: u64| (from_s..to_s).contains(&(k as f64 * 0.02));
    listener.rows.iter().filter(|(k, _)| inside(*k)).map(|(_, row)| row.as_slice()).collect()
}

#[test]
fn a_cut_reference_makes_the_vehicle_brake_and_hold_and_it_resumes_by_itself() {
    let trial = load("tether-cut", &[]);
    let velocity = heard(&trial, signal::tracking::SWAY.path);
    // Cut from 40 to 50 s while travelling at 0.2 m/s: braked two seconds after the half second of patience.
    let before = between(&velocity, 35.0, 40.0);
    assert!(before.iter().all(|row| (row[0] - 0.2).abs() < 0.15), "travels before the cut");
    // Waves still move it to and fro by a decimetre per second; it travels no more.
    let during = between(&velocity, 44.0, 50.0);
    let mean = during.iter().map(|row| row[2]).sum::<f64>() / during.len() as f64;
    assert!(mean.abs() < 0.03, "mean true sway {mean} m/s during the cut");
    assert!(during.iter().all(|row| row[2].abs() < 0.2), "and never at its former speed");
    let resumed = between(&velocity, 54.0, 60.0);
    let mean = resumed.iter().map(|row| row[0]).sum::<f64>() / resumed.len() as f64;
    assert!((mean - 0.2).abs() < 0.05, "travels again after the cut: {mean}");
    let depth = heard(&trial, signal::truth::POSE.path);
    for row in between(&depth, 40.0, 52.0) {
        assert!((row[2] - 4.0).abs() < 0.4, "depth {} during the cut", row[2]);
    }
    let texts: Vec<String> = depth.events.iter().map(Event::text).collect();
    let fallback = depth.events.iter().find(|event| event.text() == "fallback").expect("an event says so");
    assert_eq!((fallback.service.as_ref(), fallback.severity), ("controller", Severity::Warning));
    assert!((fallback.tick as f64 * 0.02 - 40.5).abs() < 0.1, "after its half second: tick {}", fallback.tick);
    assert!(texts.iter().filter(|text| *text == "tracking").count() >= 2, "and again when it is over: {texts:?}");
}

#[test]
fn t13_a_dvl_silent_for_five_seconds_makes_no_nan_and_keeps_the_wrench_bounded() {
    let trial = load("tether-cut", &[]);
    let requested = heard(&trial, signal::thrust::REQUESTED.path);
    for row in between(&requested, 70.0, 80.0) {
        assert!(row.iter().all(|force| force.is_finite() && force.abs() < 300.0), "{row:?}");
    }
    let health = heard(&trial, signal::nav::HEALTH.path);
    let silent = between(&health, 71.5, 75.0);
    assert!(silent.iter().all(|row| row[1] == 1.0), "health must say dead reckoning");
    assert!(between(&health, 76.0, 80.0).iter().all(|row| row[1] == 0.0), "and recover");
    let variance = heard(&trial, signal::nav::VARIANCE.path);
    let (start, end) = (between(&variance, 70.3, 70.4)[0][2], between(&variance, 74.9, 75.0)[0][2]);
    assert!(end > 5.0 * start, "the variance of surge must grow: {start} to {end}");
    for name in ["paper-gsta", "paper-agsta", "paper-pid"] {
        let mut silenced = load(name, &[]);
        let step = trial.trial.mission.iter().find(|step| step.at_s.get() == 70.0).expect("the fault").clone();
        silenced.trial.mission.push(step);
        let scores = outcome(&silenced, 1).scores;
        assert!(
            scores.requested_max.to_array().iter().all(|force| *force < 400.0),
            "{name}: {:?}",
            scores.requested_max
        );
        assert!(scores.true_max.distance_m < 3.0, "{name}: {:?}", scores.true_max);
    }
}

fn with_cut(wire: &str, for_s: f64) -> ResolvedTrial {
    let mut trial = load("fair", &["trial.controllers=[\"gsta-tuned\"]", "trial.duration_s=60.0"]);
    let text = format!("at_s = 40.0\ncommand.link.withhold = {{ wire = \"{wire}\", for_s = {for_s:?} }}");
    trial.trial.mission.push(toml::from_str(&text).expect("a legal step"));
    trial
}

#[test]
fn every_wire_can_be_cut_for_three_seconds_and_the_run_stays_bounded() {
    for wire in ["measurements", "nav", "reference", "thrust"] {
        let trial = with_cut(wire, 3.0);
        let pose = heard(&trial, signal::truth::POSE.path);
        let lost = heard(&trial, signal::link::WITHHELD.path).rows.last().expect("rows").1.clone();
        assert_eq!(lost.iter().sum::<f64>(), 150.0, "{wire}: three seconds of messages are counted as lost");
        for row in between(&pose, 40.0, 60.0) {
            assert!((row[2] - 4.0).abs() < 0.8, "{wire}: depth {}", row[2]);
        }
        let distance = heard(&trial, signal::tracking::DISTANCE.path);
        for row in between(&distance, 40.0, 60.0) {
            assert!((1.0..6.0).contains(&row[2]), "{wire}: true distance {}", row[2]);
        }
        assert!(between(&distance, 55.0, 60.0).iter().all(|row| (row[2] - 3.0).abs() < 1.2), "{wire}: recovered");
    }
}

#[test]
fn without_navigation_the_thrusters_are_neutral() {
    let trial = with_cut("nav", 3.0);
    let force = heard(&trial, signal::thrust::FORCE.path);
    for row in between(&force, 40.6, 43.0) {
        assert!(row.iter().all(|force| *force == 0.0), "{row:?}");
    }
    assert!(between(&force, 43.2, 45.0).iter().any(|row| row.iter().any(|force| *force != 0.0)));
}

#[test]
fn a_lost_thrust_wire_stops_the_propellers_and_the_estimator_knows() {
    let trial = with_cut("thrust", 3.0);
    let made = heard(&trial, signal::truth::WRENCH.path);
    for row in between(&made, 42.0, 43.0) {
        assert!(row.iter().all(|force| force.abs() < 0.5), "{row:?}");
    }
    let health = heard(&trial, signal::nav::HEALTH.path);
    assert!(between(&health, 40.6, 43.0).iter().all(|row| row[4] == 1.0), "thrust_unknown");
}

#[test]
fn handing_over_to_another_law_does_not_jump() {
    let trial = load("hand-over", &[]);
    let requested = heard(&trial, signal::thrust::REQUESTED.path);
    let steps = |from_s: f64, to_s: f64| {
        let rows = between(&requested, from_s, to_s);
        let jumps = rows.windows(2).map(|pair| (0..3).map(|i| (pair[1][i] - pair[0][i]).abs()).fold(0.0, f64::max));
        jumps.fold(0.0, f64::max)
    };
    // The hand-over is at 50 s; PID alone moves the wrench by this much from tick to tick elsewhere.
    let usual = steps(45.0, 49.99);
    let hand_over = steps(49.97, 50.03);
    assert!(hand_over <= usual.max(8.0), "hand-over {hand_over} N, usual {usual} N");
    let sway = heard(&trial, signal::tracking::SWAY.path);
    let error = |from_s, to_s| {
        let rows = between(&sway, from_s, to_s);
        rows.iter().map(|row| (row[0] - row[1]).abs()).sum::<f64>() / rows.len() as f64
    };
    assert!(error(55.0, 70.0) < 0.7 * error(35.0, 50.0), "and the better law takes effect");
}

fn with_step(base: &[&str], step: &str) -> ResolvedTrial {
    let mut trial = load("fair", base);
    trial.trial.mission.push(toml::from_str(step).expect("a legal step"));
    trial
}

#[test]
fn without_an_operator_guidance_holds_and_goes_on_when_there_is_one() {
    let base = &["trial.controllers=[\"gsta-tuned\"]", "trial.duration_s=70.0"];
    let trial = with_step(base, "at_s = 40.0\ncommand.link.operator_lost_for_s = 10.0");
    let velocity = heard(&trial, signal::reference::VELOCITY.path);
    assert!(between(&velocity, 44.0, 50.0).iter().all(|row| row[1].abs() < 0.01), "held");
    assert!(between(&velocity, 55.0, 60.0).iter().all(|row| row[1] > 0.1), "and travels again");
    assert!(velocity.events.iter().any(|event| event.text() == "operator_lost"));
}

#[test]
fn an_external_controller_steers_the_axes_it_asks_for_and_hands_them_back() {
    let base = &["trial.controllers=[\"external\"]", "trial.duration_s=60.0"];
    let step = "at_s = 30.0\ncommand.link.wrench_request = { request = { sway_n = 25.0 }, for_s = 5.0 }";
    let requested = heard(&with_step(base, step), signal::thrust::REQUESTED.path);
    assert!(between(&requested, 30.0, 35.0).iter().all(|row| row[1] == 25.0), "sway is the external controller's");
    assert!(between(&requested, 30.0, 35.0).iter().any(|row| row[2] != 0.0), "heave stays with the substitute");
    assert!(
        between(&requested, 36.0, 40.0).iter().all(|row| row[1] != 25.0),
        "half a second later sway is handed back"
    );
}

#[test]
fn a_vehicle_that_is_too_deep_can_be_called_back_by_a_ramp() {
    let base = &["trial.controllers=[\"gsta-tuned\"]", "trial.start.depth_m=20.0", "trial.duration_s=60.0"];
    let step = "at_s = 1.0\ncommand.guidance.depth_m = { ramp = { to = 4.0, over_s = 20.0 } }";
    let mut trial = with_step(base, step);
    trial.trial.mission.retain(|step| step.at_s.get() > 0.5 || !format!("{:?}", step.command).contains("DepthM"));
    let run = outcome(&trial, 1);
    assert!(run.refused.is_empty(), "{:?}", run.refused);
    let depth = heard(&trial, signal::tracking::DEPTH.path);
    // At its largest rate of 0.22 m/s the reference has risen by more than twelve metres.
    assert!(depth.rows.last().is_some_and(|(_, row)| row[1] < 8.0), "{:?}", depth.rows.last());
}

#[test]
fn a_run_that_breaks_says_what_broke_in_its_recording() {
    // A tick of one second is far beyond the stability of the loop.
    let trial = load("paper-pid", &["trial.tick_s=1.0"]);
    let mut listener = Listener::to(signal::tracking::DEPTH.path);
    let error = run(&trial, 1, &mut listener, Some(&Properties::new()), |_| true).expect_err("NaN");
    let last = listener.events.last().expect("an event");
    assert_eq!((last.severity, last.text()), (Severity::Error, error.to_string()));
    assert_eq!(listener.results.expect("finished")["complete"], 0u64.into());
}

#[test]
fn a_command_after_the_end_is_named_as_never_applied() {
    let trial = load("paper-pid", &["trial.duration_s=30.0"]);
    let listener = heard(&trial, signal::tracking::DEPTH.path);
    let last = listener.events.last().expect("an event");
    assert!(last.text().contains("never applied, 71 s is after the end"), "{last:?}");
    assert_eq!(listener.results.expect("finished")["warnings"], 1u64.into());
}
