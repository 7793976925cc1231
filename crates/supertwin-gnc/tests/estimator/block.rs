//! The estimator block.

use super::{BEAM_RAD, ranges};
use crate::common::{self, H_S, estimator_config, nominal, tick};
use supertwin_core::command::EstimatorCommand;
use supertwin_core::message::{DepthSample, DvlPing, HeadingSample, Measurements, Nav, Thrust, YawRateSample};
use supertwin_core::observe::Snapshot;
use supertwin_core::{Block, Input, Message, Prev, signal};
use supertwin_gnc::estimator::EstimatorLimits;
use supertwin_gnc::{Estimator, EstimatorInput};

fn limits() -> EstimatorLimits {
    common::read(common::file("safety/standard")["estimator"].clone())
}

fn estimator(name: &str) -> Estimator {
    Estimator::new(&estimator_config(name), nominal(), BEAM_RAD, &limits(), H_S)
}

fn ping(velocity: Option<[f64; 3]>, beam_range_m: [Option<f64>; 4]) -> Option<DvlPing> {
    Some(DvlPing { taken_at_s: 0.0, velocity_m_per_s: velocity, beam_range_m })
}

fn depth(depth_m: f64) -> Option<DepthSample> {
    Some(DepthSample { taken_at_s: 0.0, depth_m })
}

fn compass(heading_rad: f64) -> Option<HeadingSample> {
    Some(HeadingSample { taken_at_s: 0.0, heading_rad })
}

fn gyro(yaw_rate_rad_per_s: f64) -> Option<YawRateSample> {
    Some(YawRateSample { taken_at_s: 0.0, yaw_rate_rad_per_s })
}

/// All sensors of a vehicle at rest at 3 m depth, heading 0.4, 3 m from the net.
fn all_at_rest() -> Measurements {
    let dvl = ping(Some([0.0; 3]), ranges(3.0, 0.1));
    Measurements { dvl, depth: depth(3.0), compass: compass(0.4), gyro: gyro(0.0) }
}

fn step(estimator: &mut Estimator, k: u64, measurements: &[Measurements]) -> Nav {
    let idle = Thrust::default();
    estimator.step(tick(k), EstimatorInput { measurements, thrust: Prev(Input::Fresh(&idle)) })
}

/// Runs at rest with every sensor, DVL at 8 Hz and the slow ones at 10 Hz.
fn warmed_up(name: &str) -> (Estimator, u64) {
    let mut estimator = estimator(name);
    for k in 0..500 {
        let all = all_at_rest();
        let (dvl, slow) = (k % 6 == 0, k % 5 == 0);
        let (depth, compass) = (all.depth.filter(|_| slow), all.compass.filter(|_| slow));
        let measurements = Measurements { dvl: all.dvl.filter(|_| dvl), depth, compass, gyro: all.gyro };
        step(&mut estimator, k, &[measurements]);
    }
    (estimator, 500)
}

fn counters(estimator: &Estimator) -> [f64; 3] {
    Snapshot::of(estimator).get(&signal::estimator::COUNTERS).expect("shown").try_into().expect("three")
}

#[test]
fn the_first_measurements_are_believed() {
    let mut estimator = estimator("paper");
    let nav = step(&mut estimator, 0, &[all_at_rest()]);
    assert!((nav.depth_m - 3.0).abs() < 1e-12 && (nav.heading_rad - 0.4).abs() < 1e-12);
    assert!((nav.net.distance_m - 3.0).abs() < 1e-12 && (nav.net.heading_rad - 0.5).abs() < 1e-12);
    assert!(nav.net.valid);
    assert_eq!(nav.health, Default::default());
}

#[test]
fn a_wild_value_is_gated_counted_and_otherwise_as_if_it_had_not_come() {
    let (estimator, k) = warmed_up("paper");
    let cases = [
        (Measurements { dvl: ping(Some([5.0, -4.0, 3.0]), [None; 4]), ..Measurements::default() }, 3.0),
        (Measurements { compass: compass(2.9), ..Measurements::default() }, 1.0),
    ];
    for (wild, refused) in cases {
        let (mut with, mut without) = (estimator.clone(), estimator.clone());
        let before = counters(&with);
        let (a, b) = (step(&mut with, k, &[wild]), step(&mut without, k, &[]));
        assert_eq!(a, b);
        let after = counters(&with);
        assert_eq!([after[0] - before[0], after[1] - before[1]], [0.0, refused]);
    }
}

#[test]
fn measurements_that_are_no_numbers_change_nothing_but_the_counters() {
    for name in ["paper", "plane-filter"] {
        let (estimator, k) = warmed_up(name);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let dvl = ping(Some([bad; 3]), [Some(bad); 4]);
            let measurements = [Measurements { dvl, depth: depth(bad), compass: compass(bad), gyro: gyro(bad) }];
            let (mut with, mut without) = (estimator.clone(), estimator.clone());
            // Ten of them: twenty pings without a good beam would make the plane filter begin afresh, as they should.
            for i in 0..10 {
                let (a, b) = (step(&mut with, k + i, &measurements), step(&mut without, k + i, &[]));
                assert_eq!(a, b, "{name}, {bad}: identical to the bit");
                assert!(a.is_finite());
            }
            assert_eq!(counters(&with)[1] - counters(&without)[1], 10.0 * 6.0);
            // And afterwards it goes on as if nothing had been.
            let (a, b) = (step(&mut with, k + 10, &[all_at_rest()]), step(&mut without, k + 10, &[all_at_rest()]));
            assert_eq!(a, b);
        }
    }
}

#[test]
fn before_the_first_reading_numbers_that_are_none_do_not_count_as_one() {
    let mut estimator = estimator("paper");
    let nothing = [Measurements { depth: depth(f64::NAN), compass: compass(f64::NAN), ..Measurements::default() }];
    // What is no number is no reading: nothing has been seen, and health says so from the first step on.
    for k in 0..=60 {
        let nav = step(&mut estimator, k, &nothing);
        assert!(nav.is_finite());
        let health = nav.health;
        assert_eq!([health.depth_lost, health.heading_lost, health.dead_reckoning], [true; 3], "tick {k}");
        assert!(!nav.net.valid);
    }
    let nav = step(&mut estimator, 61, &[all_at_rest()]);
    assert!((nav.depth_m - 3.0).abs() < 1e-6 && !nav.health.depth_lost, "the first number is believed");
}

#[test]
fn a_number_that_went_bad_inside_restarts_the_filter_and_says_so() {
    let (mut estimator, k) = warmed_up("paper");
    for (i, poison) in [f64::NAN, f64::INFINITY, 1e200].into_iter().enumerate() {
        let k = k + 10 * i as u64;
        let bad = Thrust { allocated: [poison, poison, 0.0, 0.0].into(), ..Thrust::default() };
        let input = EstimatorInput { measurements: &[all_at_rest()], thrust: Prev(Input::Fresh(&bad)) };
        let mut nav = estimator.step(tick(k), input);
        if nav.is_finite() && !nav.health.restarted {
            // 1e200 N is finite for one step; the next one is not.
            nav = step(&mut estimator, k + 1, &[all_at_rest()]);
        }
        assert!(nav.is_finite(), "{poison}: {nav:?}");
        assert!(nav.health.restarted, "{poison}");
        assert_eq!(counters(&estimator)[2], i as f64 + 1.0);
        let nav = step(&mut estimator, k + 2, &[all_at_rest()]);
        assert!(!nav.health.restarted && (nav.depth_m - 3.0).abs() < 1e-6, "and begins again with what it measures");
    }
}

#[test]
fn restart_by_command_forgets_everything() {
    let (mut estimator, k) = warmed_up("plane-filter");
    estimator.command(tick(k), &EstimatorCommand::Restart).expect("always");
    let nav = step(&mut estimator, k, &[]);
    assert!(nav.health.restarted && !nav.net.valid);
    assert_eq!((nav.depth_m, nav.disturbance.to_array()), (0.0, [0.0; 4]));
    // Nothing has been seen since the restart, and health says so.
    let mut silent = estimator.clone();
    for i in 1..=60 {
        let health = step(&mut silent, k + i, &[]).health;
        assert!(!health.restarted, "said once");
        assert_eq!([health.depth_lost, health.heading_lost, health.dead_reckoning], [true; 3], "{i} after it");
    }
    let nav = step(&mut estimator, k + 1, &[all_at_rest()]);
    assert!(!nav.health.restarted && nav.net.valid && (nav.depth_m - 3.0).abs() < 1e-3, "{nav:?}");
}

#[test]
fn without_the_dvl_the_velocity_is_dead_reckoning_and_its_variance_grows() {
    let (mut estimator, k) = warmed_up("paper");
    // The last ping came at tick 498; the limit is 1 s, 50 ticks.
    let mut last: Option<Nav> = None;
    for i in 0..1500 {
        let all = all_at_rest();
        let nav = step(&mut estimator, k + i, &[Measurements { dvl: None, ..all }]);
        assert_eq!(nav.health.dead_reckoning, k + i - 498 > 50, "tick {}", k + i);
        assert!(!nav.health.depth_lost && !nav.health.heading_lost);
        if let Some(last) = &last {
            for axis in [0, 1] {
                assert!(nav.variance.velocity[axis] > last.variance.velocity[axis], "axis {axis} at {i}");
            }
        }
        last = Some(nav);
    }
    // Heave is still seen through the depth, yaw rate through the gyro.
    let nav = last.expect("many steps");
    assert!(nav.variance.velocity[2] < 0.01 && nav.variance.velocity[3] < 1e-4, "{:?}", nav.variance);
    assert!(nav.variance.velocity[0] > 0.05);
    let back = step(&mut estimator, k + 1500, &[all_at_rest()]);
    assert!(!back.health.dead_reckoning && back.variance.velocity[0] < 0.002);
}

#[test]
fn before_the_first_step_no_sensor_has_been_seen() {
    let states =
        |out: Option<&Nav>| estimator("paper").notices(out).iter().take(4).map(|it| it.state).collect::<Vec<_>>();
    assert_eq!(states(None), ["lost"; 4]);
    let (mut warm, k) = warmed_up("paper");
    assert_eq!(states(Some(&step(&mut warm, k, &[]))), ["found"; 4]);
}

#[test]
fn lost_sensors_are_named() {
    let (mut estimator, k) = warmed_up("paper");
    let mut nav = Nav::default();
    for i in 0..60 {
        nav = step(&mut estimator, k + i, &[]);
    }
    assert!(nav.health.dead_reckoning && nav.health.depth_lost && nav.health.heading_lost);
    assert!(nav.net.valid, "the net lasts for 3 s");
    for i in 60..160 {
        nav = step(&mut estimator, k + i, &[]);
    }
    assert!(!nav.net.valid);
    assert!(nav.net.distance_m > 0.0, "the last distance is still shown");
    let only_depth = Measurements { depth: depth(3.0), ..Measurements::default() };
    nav = step(&mut estimator, k + 160, &[only_depth]);
    assert!(!nav.health.depth_lost && nav.health.dead_reckoning && nav.health.heading_lost);
}

#[test]
fn thrust_that_is_too_old_counts_as_none() {
    let (estimator, k) = warmed_up("paper");
    let thrust = Thrust { allocated: [60.0, -30.0, 20.0, 4.0].into(), ..Thrust::default() };
    let with = |input: Input<&Thrust>| {
        let mut estimator = estimator.clone();
        estimator.step(tick(k), EstimatorInput { measurements: &[], thrust: Prev(input) })
    };
    let fresh = with(Input::Fresh(&thrust));
    assert!(!fresh.health.thrust_unknown && fresh.acceleration.surge_m_per_s2 > 0.3);
    let held = with(Input::Held { value: &thrust, made_at: k - 25 });
    assert_eq!(held, fresh, "0.5 s old is not too old");
    for lost in [Input::Held { value: &thrust, made_at: k - 26 }, Input::Missing] {
        let nav = with(lost);
        assert!(nav.health.thrust_unknown);
        let idle = Thrust::default();
        let mut zero = with(Input::Fresh(&idle));
        zero.health.thrust_unknown = true;
        assert_eq!(nav, zero, "taken as zero");
    }
    // At the very first tick nobody can know.
    let mut first = self::estimator("paper");
    let nav = first.step(tick(0), EstimatorInput { measurements: &[], thrust: Prev(Input::Missing) });
    assert!(!nav.health.thrust_unknown);
}

#[test]
fn measurements_of_one_tick_are_taken_in_their_order() {
    // The first compass reading is believed, the second one is far outside the gate of the first.
    let reading = |heading_rad: f64| Measurements { compass: compass(heading_rad), ..Measurements::default() };
    for (first, second) in [(0.0, 2.0), (2.0, 0.0)] {
        let nav = step(&mut estimator("paper"), 0, &[reading(first), reading(second)]);
        assert!((nav.heading_rad - first).abs() < 1e-12, "{}", nav.heading_rad);
    }
    // Two readings in one message batch or in two: the same filter.
    let (estimator, k) = warmed_up("paper");
    let (a, b) = (Measurements { depth: depth(3.05), ..Measurements::default() }, all_at_rest());
    let together = Measurements { depth: depth(3.05), ..Measurements::default() };
    let (mut one, mut two) = (estimator.clone(), estimator);
    assert_eq!(step(&mut one, k, &[a, b.clone()]), step(&mut two, k, &[together, b]));
}

#[test]
fn a_constant_disturbance_is_found() {
    // The vehicle does not move although 25 N push it: something pushes back.
    let mut estimator = estimator("paper");
    let thrust = Thrust { allocated: [25.0, -15.0, 12.0, 2.0].into(), ..Thrust::default() };
    let mut nav = Nav::default();
    for k in 0..6000 {
        let all = [all_at_rest()];
        let measurements = if k % 6 == 0 { &all[..] } else { &[] };
        nav = estimator.step(tick(k), EstimatorInput { measurements, thrust: Prev(Input::Fresh(&thrust)) });
    }
    let b = nav.disturbance.to_array();
    for (found, pushed) in b.into_iter().zip([25.0, -15.0, 12.0, 2.0]) {
        // It keeps 1 to 3 % for itself: the model lets b decay within 200 s.
        let share = -found / pushed;
        assert!((0.96..1.0).contains(&share), "{b:?}");
    }
    assert!(nav.acceleration.vector().amax() < 1e-2, "{:?}", nav.acceleration);
}

#[test]
fn innovations_are_shown_when_something_arrived_and_only_then() {
    let (mut estimator, k) = warmed_up("paper");
    step(&mut estimator, k, &[]);
    let silent = Snapshot::of(&estimator);
    let innovations = [
        &signal::estimator::INNOVATION_DVL,
        &signal::estimator::INNOVATION_DEPTH,
        &signal::estimator::INNOVATION_HEADING,
        &signal::estimator::INNOVATION_YAW_RATE,
    ];
    assert!(innovations.iter().all(|signal| silent.get(signal).is_none()));
    step(&mut estimator, k + 1, &[all_at_rest()]);
    let heard = Snapshot::of(&estimator);
    assert!(innovations.iter().all(|signal| heard.get(signal).is_some()));
    assert!(heard.get(&signal::estimator::NET_PLANE_PARITY).expect("shown")[0].abs() < 1e-12);
}
