//! Stale inputs, cut wires, silent sensors, hand-overs: the vehicle stays bounded and goes on by itself (T13).

use crate::common::kept::{Keeper, keep};
use crate::common::{load, outcome};
use supertwin_core::run::Properties;
use supertwin_core::signal::{link, nav, reference, thrust, tracking, truth};
use supertwin_core::source::RecordedRun;
use supertwin_core::{Event, Severity, Signal};
use supertwin_lab::{ResolvedTrial, run};

fn kept(trial: &ResolvedTrial) -> RecordedRun {
    keep(trial, 1).0
}

/// Rows of a signal in a span of time.
fn between<'a>(run: &'a RecordedRun, signal: &Signal, from_s: f64, to_s: f64) -> Vec<&'a [f64]> {
    let columns = &run.signals[signal.path];
    let inside = |(_, k): &(usize, &i64)| (from_s..to_s).contains(&(**k as f64 * 0.02));
    columns.tick.iter().enumerate().filter(inside).filter_map(|(row, _)| columns.row(row)).collect()
}

/// Mean of a value of every row.
fn mean(rows: &[&[f64]], value: impl Fn(&[f64]) -> f64) -> f64 {
    rows.iter().map(|row| value(row)).sum::<f64>() / rows.len() as f64
}

#[test]
fn a_cut_reference_makes_the_vehicle_brake_and_hold_and_it_resumes_by_itself() {
    let run = kept(&load("tether-cut", &[]));
    // Cut from 40 to 50 s while travelling at 0.2 m/s: braked two seconds after the half second of patience.
    let before = between(&run, &tracking::SWAY, 35.0, 40.0);
    assert!(before.iter().all(|row| (row[0] - 0.2).abs() < 0.15), "travels before the cut");
    // Waves still move it to and fro by a decimetre per second; it travels no more.
    let during = between(&run, &tracking::SWAY, 44.0, 50.0);
    let speed = mean(&during, |row| row[2]);
    assert!(speed.abs() < 0.03, "mean true sway {speed} m/s during the cut");
    assert!(during.iter().all(|row| row[2].abs() < 0.2), "and never at its former speed");
    let speed = mean(&between(&run, &tracking::SWAY, 54.0, 60.0), |row| row[0]);
    assert!((speed - 0.2).abs() < 0.05, "travels again after the cut: {speed}");
    for row in between(&run, &truth::POSE, 40.0, 52.0) {
        assert!((row[2] - 4.0).abs() < 0.4, "depth {} during the cut", row[2]);
    }
    let texts: Vec<String> = run.events.iter().map(Event::text).collect();
    let fallback = run.events.iter().find(|event| event.text() == "fallback").expect("an event says so");
    assert_eq!((fallback.service.as_ref(), fallback.severity), ("controller", Severity::Warning));
    assert!((fallback.tick as f64 * 0.02 - 40.5).abs() < 0.1, "after its half second: tick {}", fallback.tick);
    assert!(texts.iter().filter(|text| *text == "tracking").count() >= 2, "and again when it is over: {texts:?}");
}

#[test]
fn t13_a_dvl_silent_for_five_seconds_makes_no_nan_and_keeps_the_wrench_bounded() {
    let trial = load("tether-cut", &[]);
    let run = kept(&trial);
    for row in between(&run, &thrust::REQUESTED, 70.0, 80.0) {
        assert!(row.iter().all(|force| force.is_finite() && force.abs() < 300.0), "{row:?}");
    }
    let health = |from_s, to_s| between(&run, &nav::HEALTH, from_s, to_s);
    assert!(health(71.5, 75.0).iter().all(|row| row[1] == 1.0), "health must say dead reckoning");
    assert!(health(76.0, 80.0).iter().all(|row| row[1] == 0.0), "and recover");
    let variance = |from_s, to_s| between(&run, &nav::VARIANCE, from_s, to_s)[0][2];
    let (start, end) = (variance(70.3, 70.4), variance(74.9, 75.0));
    assert!(end > 5.0 * start, "the variance of surge must grow: {start} to {end}");
    for name in ["paper-gsta", "paper-agsta", "paper-pid"] {
        let mut silenced = load(name, &[]);
        let step = trial.trial.mission.iter().find(|step| step.at_s.get() == 70.0).expect("the fault").clone();
        silenced.trial.mission.push(step);
        let scores = outcome(&silenced, 1).scores;
        let most = scores.requested_max;
        assert!(most.to_array().iter().all(|force| *force < 400.0), "{name}: {most:?}");
        assert!(scores.true_max.distance_m < 3.0, "{name}: {:?}", scores.true_max);
    }
}

/// The fair trial with one controller, as long as asked, with a step more.
fn with_step(controller: &str, duration_s: f64, step: &str) -> ResolvedTrial {
    let controllers = format!("trial.controllers=[{controller:?}]");
    let mut trial = load("fair", &[&controllers, &format!("trial.duration_s={duration_s:?}")]);
    trial.trial.mission.push(toml::from_str(step).expect("a legal step"));
    trial
}

fn with_cut(wire: &str) -> RecordedRun {
    let step = format!("at_s = 40.0\ncommand.link.withhold = {{ wire = \"{wire}\", for_s = 3.0 }}");
    kept(&with_step("gsta-tuned", 60.0, &step))
}

#[test]
fn every_wire_can_be_cut_for_three_seconds_and_the_run_stays_bounded() {
    for wire in ["measurements", "nav", "reference", "thrust"] {
        let run = with_cut(wire);
        let lost = *between(&run, &link::WITHHELD, 0.0, f64::INFINITY).last().expect("rows");
        assert_eq!(lost.iter().sum::<f64>(), 150.0, "{wire}: three seconds of messages are counted as lost");
        for row in between(&run, &truth::POSE, 40.0, 60.0) {
            assert!((row[2] - 4.0).abs() < 0.8, "{wire}: depth {}", row[2]);
        }
        let distance = |from_s| between(&run, &tracking::DISTANCE, from_s, 60.0);
        for row in distance(40.0) {
            assert!((1.0..6.0).contains(&row[2]), "{wire}: true distance {}", row[2]);
        }
        assert!(distance(55.0).iter().all(|row| (row[2] - 3.0).abs() < 1.2), "{wire}: recovered");
    }
}

#[test]
fn without_navigation_the_thrusters_are_neutral() {
    let run = with_cut("nav");
    for row in between(&run, &thrust::FORCE, 40.6, 43.0) {
        assert!(row.iter().all(|force| *force == 0.0), "{row:?}");
    }
    assert!(between(&run, &thrust::FORCE, 43.2, 45.0).concat().iter().any(|force| *force != 0.0));
}

#[test]
fn a_lost_thrust_wire_stops_the_propellers_and_the_estimator_knows() {
    let run = with_cut("thrust");
    for row in between(&run, &truth::WRENCH, 42.0, 43.0) {
        assert!(row.iter().all(|force| force.abs() < 0.5), "{row:?}");
    }
    assert!(between(&run, &nav::HEALTH, 40.6, 43.0).iter().all(|row| row[4] == 1.0), "thrust_unknown");
}

#[test]
fn handing_over_to_another_law_does_not_jump() {
    let run = kept(&load("hand-over", &[]));
    let steps = |from_s: f64, to_s: f64| {
        let rows = between(&run, &thrust::REQUESTED, from_s, to_s);
        let jumps = rows.windows(2).map(|pair| (0..3).map(|i| (pair[1][i] - pair[0][i]).abs()).fold(0.0, f64::max));
        jumps.fold(0.0, f64::max)
    };
    // The hand-over is at 50 s; PID alone moves the wrench by this much from tick to tick elsewhere.
    let usual = steps(45.0, 49.99);
    let hand_over = steps(49.97, 50.03);
    assert!(hand_over <= usual.max(8.0), "hand-over {hand_over} N, usual {usual} N");
    let error = |from_s, to_s| mean(&between(&run, &tracking::SWAY, from_s, to_s), |row| (row[0] - row[1]).abs());
    assert!(error(55.0, 70.0) < 0.7 * error(35.0, 50.0), "and the better law takes effect");
}

#[test]
fn without_an_operator_guidance_holds_and_goes_on_when_there_is_one() {
    let run = kept(&with_step("gsta-tuned", 70.0, "at_s = 40.0\ncommand.link.operator_lost_for_s = 10.0"));
    let velocity = |from_s, to_s| between(&run, &reference::VELOCITY, from_s, to_s);
    assert!(velocity(44.0, 50.0).iter().all(|row| row[1].abs() < 0.01), "held");
    assert!(velocity(55.0, 60.0).iter().all(|row| row[1] > 0.1), "and travels again");
    assert!(run.events.iter().any(|event| event.text() == "operator_lost"));
}

#[test]
fn an_external_controller_steers_the_axes_it_asks_for_and_hands_them_back() {
    let step = "at_s = 30.0\ncommand.link.wrench_request = { request = { sway_n = 25.0 }, for_s = 5.0 }";
    let run = kept(&with_step("external", 60.0, step));
    let requested = |from_s, to_s| between(&run, &thrust::REQUESTED, from_s, to_s);
    assert!(requested(30.0, 35.0).iter().all(|row| row[1] == 25.0), "sway is the external controller's");
    assert!(requested(30.0, 35.0).iter().any(|row| row[2] != 0.0), "heave stays with the substitute");
    assert!(requested(36.0, 40.0).iter().all(|row| row[1] != 25.0), "half a second later sway is handed back");
}

#[test]
fn a_vehicle_that_is_too_deep_can_be_called_back_by_a_ramp() {
    let deep = ["trial.controllers=[\"gsta-tuned\"]", "trial.start.depth_m=20.0", "trial.duration_s=60.0"];
    let step = "at_s = 1.0\ncommand.guidance.depth_m = { ramp = { to = 4.0, over_s = 20.0 } }";
    let mut trial = load("fair", &deep);
    trial.trial.mission.push(toml::from_str(step).expect("a legal step"));
    trial.trial.mission.retain(|step| step.at_s.get() > 0.5 || !format!("{:?}", step.command).contains("DepthM"));
    let (run, outcome) = keep(&trial, 1);
    assert!(outcome.refused.is_empty(), "{:?}", outcome.refused);
    // At its largest rate of 0.22 m/s the reference has risen by more than twelve metres.
    let last = *between(&run, &tracking::DEPTH, 0.0, 60.0).last().expect("rows");
    assert!(last[1] < 8.0, "{last:?}");
}

#[test]
fn a_run_that_breaks_says_what_broke_in_its_recording() {
    // A tick of one second is far beyond the stability of the loop.
    let trial = load("paper-pid", &["trial.tick_s=1.0"]);
    let mut keeper = Keeper::default();
    let error = run(&trial, 1, &mut keeper, Some(&Properties::new()), |_| true).expect_err("NaN");
    let last = keeper.run.events.last().expect("an event");
    assert_eq!((last.severity, last.text()), (Severity::Error, error.to_string()));
    assert_eq!(keeper.run.properties["result"]["complete"], 0u64.into());
}

#[test]
fn a_command_after_the_end_is_named_as_never_applied() {
    let run = kept(&load("paper-pid", &["trial.duration_s=30.0"]));
    let last = run.events.last().expect("an event");
    assert!(last.text().contains("never applied, 71 s is after the end"), "{last:?}");
    assert_eq!(run.properties["result"]["warnings"], 1u64.into());
}
