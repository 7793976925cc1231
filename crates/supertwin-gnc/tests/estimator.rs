//! The extended Kalman filter, the estimator block and both net planes: consistency, gates, faults.

use crate::common::{self, H_S, estimator_config, nominal, tick};
use core::f64::consts::PI;
use nalgebra::{Vector3, Vector4};
use supertwin_core::command::EstimatorCommand;
use supertwin_core::frame::ssa;
use supertwin_core::message::{DepthSample, DvlPing, HeadingSample, Measurements, Nav, Thrust, YawRateSample};
use supertwin_core::observe::Snapshot;
use supertwin_core::random::Stream;
use supertwin_core::{Block, Input, Message, Prev, signal};
use supertwin_gnc::ekf::{B, Covariance, Ekf, EkfConfig, NU, PSI, STATES, State, Z};
use supertwin_gnc::estimator::{EstimatorLimits, MeasurementConfig};
use supertwin_gnc::net_plane::{InverseRange, InverseRangeConfig, NetPlaneConfig, RateGated, RateGatedConfig};
use supertwin_gnc::{Estimator, EstimatorInput};
use supertwin_model::SonarArray;

const BEAM_RAD: f64 = 0.436_332_312_998_582_4;

// -------------------------------------------------------------------------------------------------------- the filter

fn ekf() -> Ekf {
    Ekf::new(&estimator_config("paper").ekf, nominal())
}

fn process_noise(config: &EkfConfig) -> State {
    state_wise(&config.process_noise)
}

fn state_wise(values: &supertwin_gnc::ekf::StateWise) -> State {
    let mut v = State::zeros();
    v[Z] = values.depth.get();
    v[PSI] = values.heading.get();
    for i in 0..4 {
        v[NU + i] = values.velocity[i].get();
        v[B + i] = values.disturbance[i].get();
    }
    v
}

/// A state of the size that a run sees.
fn random_state(draw: &mut Stream) -> State {
    let scale = [4.0, 1.0, 0.4, 0.4, 0.2, 0.2, 20.0, 20.0, 20.0, 3.0];
    State::from_fn(|i, _| scale[i] * draw.normal())
}

fn set(ekf: &mut Ekf, x: &State) {
    for i in 0..STATES {
        ekf.set(i, x[i]);
    }
}

#[test]
fn the_analytic_jacobian_is_that_of_central_differences() {
    let mut draw = Stream::new(1, "jacobian");
    let mut ekf = ekf();
    let mut worst: f64 = 0.0;
    for _ in 0..500 {
        let x = random_state(&mut draw);
        let tau = draw.normals::<4>() * 50.0;
        set(&mut ekf, &x);
        let h = 0.02;
        // F = I + h ∂f/∂x.
        let analytic = (ekf.dense_jacobian(h) - Covariance::identity()) / h;
        for j in 0..STATES {
            let mut delta = State::zeros();
            delta[j] = 1e-6;
            let column = (ekf.derivative(&(x + delta), &tau) - ekf.derivative(&(x - delta), &tau)) / 2e-6;
            worst = worst.max((analytic.column(j) - column).amax());
        }
    }
    println!("largest difference of the Jacobians {worst:.1e}");
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn the_sparse_product_is_the_dense_one() {
    let mut draw = Stream::new(2, "sparse");
    let q = process_noise(&estimator_config("paper").ekf);
    let mut ekf = ekf();
    for _ in 0..300 {
        set(&mut ekf, &random_state(&mut draw));
        let (dense, before) = (ekf.dense_jacobian(H_S), *ekf.P());
        ekf.predict(&(draw.normals::<4>() * 50.0), H_S);
        let expected = dense * before * dense.transpose() + Covariance::from_diagonal(&(q * H_S));
        // Entry by entry, relative to the standard deviations of its row and column.
        let std = expected.diagonal().map(f64::sqrt);
        for i in 0..STATES {
            for j in 0..STATES {
                let difference = (ekf.P()[(i, j)] - expected[(i, j)]).abs();
                assert!(difference < 1e-13 * std[i] * std[j], "({i}, {j}): {difference}");
            }
        }
        // Fill the matrix: some scalar updates now and then.
        let state = draw.uniform(0.0, 6.0) as usize;
        ekf.update(state, ekf.x()[state] + 0.01 * draw.normal(), 1e-3, None);
    }
    assert!(ekf.P()[(NU, B)].abs() > 1e-6, "the matrix was full");
}

#[test]
fn the_prediction_is_one_euler_step_with_the_heading_wrapped() {
    let mut draw = Stream::new(3, "euler");
    let mut ekf = ekf();
    let mut wrapped = 0;
    for _ in 0..300 {
        let mut x = random_state(&mut draw);
        x[PSI] = PI - 1e-3 * draw.uniform(0.0, 1.0);
        x[NU + 3] = draw.uniform(-0.3, 0.3);
        let tau = draw.normals::<4>() * 50.0;
        set(&mut ekf, &x);
        let expected = x + ekf.derivative(&x, &tau) * H_S;
        ekf.predict(&tau, H_S);
        for i in (0..STATES).filter(|i| *i != PSI) {
            assert!((ekf.x()[i] - expected[i]).abs() < 1e-12);
        }
        assert!(ssa(ekf.x()[PSI] - expected[PSI]).abs() < 1e-12 && (-PI..PI).contains(&ekf.x()[PSI]));
        wrapped += u32::from(expected[PSI] >= PI);
        let acceleration = ekf.derivative(&x, &tau).fixed_rows::<4>(NU).into_owned();
        assert_eq!(*ekf.acceleration(), acceleration);
    }
    assert!(wrapped > 30);
}

#[test]
fn the_covariance_stays_symmetric_and_positive_over_a_long_run() {
    let mut draw = Stream::new(4, "long");
    let mut ekf = ekf();
    let mut smallest = f64::INFINITY;
    for k in 0..100_000 {
        let t = f64::from(k) * H_S;
        let wave = Vector4::new(
            100.0 * (0.3 * t).sin(),
            80.0 * (0.2 * t).cos(),
            60.0 * (0.5 * t).sin(),
            8.0 * (0.4 * t).sin(),
        );
        ekf.predict(&wave, H_S);
        ekf.update(NU + 3, ekf.x()[NU + 3] + 0.007 * draw.normal(), 4.9e-5, None);
        if k % 5 == 0 {
            ekf.update(Z, ekf.x()[Z] + 0.02 * draw.normal(), 4e-4, None);
            ekf.update(PSI, ekf.x()[PSI] + 0.026 * draw.normal(), 6.9e-4, None);
        }
        // The DVL is silent half of the time, and then tells the impossible.
        if k % 6 == 0 && (k / 3000) % 2 == 0 {
            for i in 0..3 {
                ekf.update(NU + i, ekf.x()[NU + i] + 0.04 * draw.normal(), 1.4e-3, None);
            }
        }
        if k % 500 == 0 {
            let p = *ekf.P();
            let std = p.diagonal().map(f64::sqrt);
            let correlation = Covariance::from_fn(|i, j| p[(i, j)] / (std[i] * std[j]));
            assert!((correlation - correlation.transpose()).amax() < 1e-12, "symmetric at {k}");
            smallest = smallest.min(correlation.symmetric_eigenvalues().min());
        }
        assert!(ekf.is_sane());
    }
    println!("smallest eigenvalue of the correlation matrix in 2000 s: {smallest:.2e}");
    assert!(smallest > 1e-6, "{smallest}");
}

/// Averages of NEES over seeds at each checked second, and of the NIS per sensor: DVL, depth, compass, gyro.
struct Consistency {
    nees: Vec<f64>,
    nis: [f64; 4],
    nis_count: [u32; 4],
}

/// 50 runs of 20 s of the filter's own model with its own noise; the filter is told `noise_share` of its variances.
fn consistency(noise_share: f64) -> Consistency {
    const SEEDS: u64 = 50;
    let config = estimator_config("paper");
    let trust: MeasurementConfig = config.measurement;
    let std = [trust.dvl.std.get(), trust.depth.std.get(), trust.compass.std.get(), trust.gyro.std.get()];
    let told = std.map(|std| noise_share * std * std);
    let q = process_noise(&config.ekf);
    let p0 = state_wise(&config.ekf.initial_variance);
    let mut result = Consistency { nees: vec![0.0; 4], nis: [0.0; 4], nis_count: [0; 4] };
    for seed in 0..SEEDS {
        let mut noise = Stream::new(seed, "consistency");
        let mut ekf = Ekf::new(&config.ekf, nominal());
        let mut x = noise.normals::<STATES>().component_mul(&p0.map(f64::sqrt));
        let kick = (q * H_S).map(f64::sqrt);
        for k in 1..=1000u32 {
            let t = f64::from(k) * H_S;
            let tau = Vector4::new(40.0 * (0.5 * t).sin(), 50.0, 20.0 * (0.3 * t).cos(), 3.0 * (0.7 * t).sin());
            x += ekf.derivative(&x, &tau) * H_S + noise.normals::<STATES>().component_mul(&kick);
            x[PSI] = ssa(x[PSI]);
            ekf.predict(&tau, H_S);
            let mut take = |ekf: &mut Ekf, sensor: usize, state: usize| {
                let measured = x[state] + std[sensor] * noise.normal();
                let innovation = ekf.update(state, measured, told[sensor], None);
                assert!(innovation.accepted);
                result.nis[sensor] += innovation.nis;
                result.nis_count[sensor] += 1;
            };
            take(&mut ekf, 3, NU + 3);
            if k.is_multiple_of(5) {
                take(&mut ekf, 1, Z);
                take(&mut ekf, 2, PSI);
            }
            if k.is_multiple_of(6) {
                for i in 0..3 {
                    take(&mut ekf, 0, NU + i);
                }
            }
            if k.is_multiple_of(250) {
                let mut e = x - ekf.x();
                e[PSI] = ssa(e[PSI]);
                let inverse = ekf.P().cholesky().expect("positive").inverse();
                result.nees[k as usize / 250 - 1] += e.dot(&(inverse * e)) / SEEDS as f64;
            }
        }
    }
    for sensor in 0..4 {
        result.nis[sensor] /= f64::from(result.nis_count[sensor]);
    }
    result
}

/// Half the width of the two-sided 99 % band of a mean of `n` independent chi-square variables of one degree.
fn band(n: f64) -> f64 {
    2.576 * (2.0 / n).sqrt()
}

#[test]
fn on_its_own_model_the_filter_is_consistent() {
    // NEES: 50 seeds × 10 states are 500 degrees of freedom at each of four times; 99 % of such means lie in 1 ± 0.163.
    // NIS: the innovations of a consistent filter are white, so all of a sensor's count: 2.6 σ of their mean.
    let seen = consistency(1.0);
    for (i, nees) in seen.nees.iter().enumerate() {
        println!("NEES/10 at {} s: {:.3} (1 ± {:.3})", 5 * (i + 1), nees / 10.0, band(500.0));
        assert!((nees / 10.0 - 1.0).abs() < band(500.0), "{}", nees / 10.0);
    }
    for (sensor, name) in ["DVL", "depth", "compass", "gyro"].into_iter().enumerate() {
        let n = f64::from(seen.nis_count[sensor]);
        println!("mean NIS of {name}: {:.4} (1 ± {:.4})", seen.nis[sensor], band(n));
        assert!((seen.nis[sensor] - 1.0).abs() < band(n), "{name}: {} of {n}", seen.nis[sensor]);
    }
}

#[test]
fn a_filter_that_trusts_its_sensors_too_much_is_found_out() {
    // The same test with a quarter of the true variances: both bands are left, so they mean something.
    let seen = consistency(0.25);
    assert!(seen.nees.iter().all(|nees| nees / 10.0 > 1.0 + band(500.0)), "{:?}", seen.nees);
    for sensor in 0..4 {
        assert!(seen.nis[sensor] > 1.0 + band(f64::from(seen.nis_count[sensor])), "{:?}", seen.nis);
    }
}

#[test]
fn a_heading_across_the_seam_is_a_small_innovation() {
    let mut ekf = ekf();
    ekf.set(PSI, PI - 0.01);
    let innovation = ekf.update(PSI, -PI + 0.01, 1e-3, Some(25.0));
    assert!(innovation.accepted && (innovation.value - 0.02).abs() < 1e-12, "{innovation:?}");
    assert!((-PI..PI).contains(&ekf.x()[PSI]));
}

#[test]
fn what_does_not_pass_its_gate_changes_nothing() {
    let mut ekf = ekf();
    ekf.predict(&Vector4::zeros(), H_S);
    let (x, p) = (*ekf.x(), *ekf.P());
    let s = p[(NU, NU)] + 1e-3;
    // Just beyond the gate, and numbers that are none.
    for wild in [(9.001 * s).sqrt() + x[NU], -(9.001 * s).sqrt() + x[NU], 1e200, f64::NAN, f64::INFINITY] {
        let innovation = ekf.update(NU, wild, 1e-3, Some(9.0));
        assert!(!innovation.accepted);
        assert_eq!((ekf.x(), ekf.P()), (&x, &p), "{wild}");
    }
    assert!(!ekf.update(NU, f64::NAN, 1e-3, None).accepted, "not without a gate either");
    assert_eq!((ekf.x(), ekf.P()), (&x, &p));
    let innovation = ekf.update(NU, (8.999 * s).sqrt() + x[NU], 1e-3, Some(9.0));
    assert!(innovation.accepted && (innovation.nis - 8.999).abs() < 1e-9 && *ekf.x() != x);
}

// --------------------------------------------------------------------------------------------------------- the block

fn limits() -> EstimatorLimits {
    common::file("safety/standard")["estimator"].clone().try_into().expect("limits")
}

fn estimator(name: &str) -> Estimator {
    Estimator::new(&estimator_config(name), nominal(), BEAM_RAD, &limits(), H_S)
}

/// Ranges to the plane `n · p = distance` with its normal at `bearing` off the bow.
fn ranges(distance_m: f64, bearing_rad: f64) -> [Option<f64>; 4] {
    let normal = Vector3::new(bearing_rad.cos(), bearing_rad.sin(), 0.0);
    SonarArray::new(BEAM_RAD).beams().map(|b| Some(distance_m / normal.dot(&b)))
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
    Measurements {
        dvl: ping(Some([0.0; 3]), ranges(3.0, 0.1)),
        depth: depth(3.0),
        compass: compass(0.4),
        gyro: gyro(0.0),
    }
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
        let measurements = Measurements {
            dvl: if k % 6 == 0 { all.dvl } else { None },
            depth: if k % 5 == 0 { all.depth } else { None },
            compass: if k % 5 == 0 { all.compass } else { None },
            gyro: all.gyro,
        };
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
            let measurements = Measurements {
                dvl: ping(Some([bad; 3]), [Some(bad); 4]),
                depth: depth(bad),
                compass: compass(bad),
                gyro: gyro(bad),
            };
            let (mut with, mut without) = (estimator.clone(), estimator.clone());
            // Ten of them: twenty pings without a good beam would make the plane filter begin afresh, as they should.
            for i in 0..10 {
                let (a, b) =
                    (step(&mut with, k + i, core::slice::from_ref(&measurements)), step(&mut without, k + i, &[]));
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
    let nothing = Measurements { depth: depth(f64::NAN), compass: compass(f64::NAN), ..Measurements::default() };
    // What is no number is no reading: nothing has been seen, and health says so from the first step on.
    for k in 0..=60 {
        let nav = step(&mut estimator, k, core::slice::from_ref(&nothing));
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
        let measurements = if k % 6 == 0 { vec![all_at_rest()] } else { Vec::new() };
        nav = estimator
            .step(tick(k), EstimatorInput { measurements: &measurements, thrust: Prev(Input::Fresh(&thrust)) });
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

// ---------------------------------------------------------------------------------------------- the plane, rate-gated

fn rate_gated() -> RateGated {
    let NetPlaneConfig::RateGated(config) = estimator_config("paper").net_plane else { panic!("paper.toml") };
    let config: RateGatedConfig = config;
    RateGated::new(&config, SonarArray::new(BEAM_RAD))
}

fn dvl(beam_range_m: [Option<f64>; 4]) -> DvlPing {
    DvlPing { taken_at_s: 0.0, velocity_m_per_s: None, beam_range_m }
}

#[test]
fn the_rate_gated_plane_low_passes_with_its_gains() {
    let mut plane = rate_gated();
    assert_eq!(plane.estimate(), None);
    assert!(plane.update(&dvl(ranges(3.0, 0.0)), 0.2));
    let first = plane.estimate().expect("a plane");
    assert!((first.distance_m - 3.0).abs() < 1e-12 && (first.heading_rad - 0.2).abs() < 1e-12);
    // A jump inside the gate: 0.35 of it in distance, 0.25 in heading.
    assert!(plane.update(&dvl(ranges(3.4, 0.3)), 0.2));
    let second = plane.estimate().expect("a plane");
    assert!((second.distance_m - (3.0 + 0.35 * 0.4)).abs() < 1e-12, "{}", second.distance_m);
    assert!((second.heading_rad - (0.2 + 0.25 * 0.3)).abs() < 1e-12, "{}", second.heading_rad);
    // It reports the variance of one fit: 0.0228 m at 3 m (T6), 0.0231 rad.
    assert!((first.distance_variance_m2.sqrt() - 0.0228).abs() < 2e-4);
    assert!((first.heading_variance_rad2.sqrt() - 0.0231).abs() < 4e-4);
}

#[test]
fn a_jump_is_refused_five_times_and_then_believed() {
    // In distance, and in heading.
    for jump in [ranges(3.9, 0.0), ranges(3.0, 0.6)] {
        let mut plane = rate_gated();
        plane.update(&dvl(ranges(3.0, 0.0)), 0.0);
        for refused in 1..=5 {
            assert!(!plane.update(&dvl(jump), 0.0));
            assert_eq!(plane.state(), (plane.estimate().expect("kept").distance_m, 0.0, refused));
        }
        assert!(plane.update(&dvl(jump), 0.0), "released");
        assert_eq!(plane.state().2, 0);
        let (d, psi, _) = plane.state();
        assert!((d - 3.0).abs() > 0.1 || psi.abs() > 0.1, "and believed: {d}, {psi}");
    }
}

#[test]
fn fish_leak_when_they_stay_longer_than_the_release() {
    let burst = |pings: u32| {
        let mut plane = rate_gated();
        let mut fish = ranges(3.0, 0.0);
        fish[0] = fish[0].map(|range| 0.5 * range);
        for _ in 0..10 {
            plane.update(&dvl(ranges(3.0, 0.0)), 0.0);
        }
        let mut worst: f64 = 0.0;
        for _ in 0..pings {
            plane.update(&dvl(fish), 0.0);
            worst = worst.max((plane.state().0 - 3.0).abs());
        }
        worst
    };
    assert_eq!(burst(5), 0.0, "a short burst is kept out");
    // 0.35 · (3 − 1.82) on the sixth ping, and more on every sixth after it.
    assert!((burst(6) - 0.35 * (3.0 - 1.82)).abs() < 0.005, "{}", burst(6));
    assert!(burst(16) > burst(6), "2 s of fish at 8 Hz leak twice");
}

#[test]
fn a_ping_with_a_missing_beam_or_a_plane_behind_changes_nothing() {
    let mut plane = rate_gated();
    plane.update(&dvl(ranges(3.0, 0.1)), 0.0);
    let before = plane.estimate();
    for i in 0..4 {
        for bad in [None, Some(f64::NAN), Some(0.0), Some(-1.0), Some(f64::INFINITY)] {
            let mut ping = ranges(3.0, 0.1);
            ping[i] = bad;
            assert!(!plane.update(&dvl(ping), 0.0));
            assert_eq!(plane.estimate(), before);
        }
    }
    plane.restart();
    assert_eq!(plane.estimate(), None);
}

// --------------------------------------------------------------------------------------------- the plane, inverse range

fn inverse_range_with(gate: f64) -> InverseRange {
    let mut table = common::file("estimators/plane-filter");
    table["net_plane"]["inverse_range"]["gate"] = gate.into();
    let config: supertwin_gnc::EstimatorConfig = table.try_into().expect("legal");
    let NetPlaneConfig::InverseRange(config) = config.net_plane else { panic!("plane-filter.toml") };
    let config: InverseRangeConfig = config;
    InverseRange::new(&config, SonarArray::new(BEAM_RAD))
}

fn inverse_range() -> InverseRange {
    inverse_range_with(9.0)
}

const STILL: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);

/// One ping period at rest.
fn rest(plane: &mut InverseRange) {
    for _ in 0..6 {
        plane.predict(&STILL, 0.0, H_S);
    }
}

#[test]
fn the_plane_filter_converges_to_an_exact_plane() {
    let mut plane = inverse_range();
    assert_eq!(plane.estimate(0.0), None);
    assert!(plane.update(&dvl(ranges(3.3, 0.3))));
    for _ in 0..100 {
        rest(&mut plane);
        assert!(plane.update(&dvl(ranges(3.0, 0.2))));
    }
    let net = plane.estimate(1.0).expect("a plane");
    assert!((net.distance_m - 3.0).abs() < 1e-6, "{}", net.distance_m);
    assert!((net.heading_rad - 1.2).abs() < 1e-6);
    assert!(net.distance_variance_m2 > 0.0 && net.distance_variance_m2 < 0.05 * 0.05);
    assert!(net.heading_variance_rad2 > 0.0 && net.heading_variance_rad2 < 0.05 * 0.05);
}

#[test]
fn three_beams_are_enough_to_begin_and_two_are_not() {
    for dead in 0..4 {
        let mut ping = ranges(3.0, 0.2);
        ping[dead] = None;
        let mut plane = inverse_range();
        assert!(plane.update(&dvl(ping)));
        let net = plane.estimate(1.0).expect("a plane");
        assert!((net.distance_m - 3.0).abs() < 1e-9 && (net.heading_rad - 1.2).abs() < 1e-9, "{net:?}");
        ping[(dead + 1) % 4] = None;
        assert!(!inverse_range().update(&dvl(ping)));
    }
}

#[test]
fn one_blocked_beam_is_refused_and_the_others_are_used() {
    for blocked in 0..4 {
        // A fish at 0.9 of the range is inside the gate of 3 σ.
        for share in [0.35, 0.5, 0.8] {
            let mut plane = inverse_range();
            for _ in 0..20 {
                plane.update(&dvl(ranges(3.0, 0.0)));
                rest(&mut plane);
            }
            let mut fish = ranges(3.0, 0.0);
            fish[blocked] = fish[blocked].map(|range| share * range);
            // A burst of 2 s.
            for _ in 0..16 {
                assert!(plane.update(&dvl(fish)));
                let accepted: [bool; 4] = core::array::from_fn(|i| i != blocked);
                assert_eq!(plane.report().accepted, accepted, "beam {blocked} at {share}");
                rest(&mut plane);
            }
            let net = plane.estimate(0.0).expect("a plane");
            assert!((net.distance_m - 3.0).abs() < 1e-3, "{}", net.distance_m);
            assert!(net.heading_rad.abs() < 1e-3, "the rate-gated fit is 0.55 rad off here: {}", net.heading_rad);
            assert!(plane.report().parity_per_m.abs() > 0.03);
        }
    }
}

#[test]
fn missing_beams_are_left_out() {
    let mut plane = inverse_range();
    plane.update(&dvl(ranges(3.0, 0.0)));
    rest(&mut plane);
    let mut two = ranges(3.0, 0.0);
    (two[1], two[3]) = (None, Some(f64::NAN));
    assert!(plane.update(&dvl(two)));
    assert_eq!(plane.report().accepted, [true, false, true, false]);
    assert!(!plane.update(&dvl([None; 4])));
    assert!((plane.estimate(0.0).expect("a plane").distance_m - 3.0).abs() < 1e-9);
}

#[test]
fn after_twenty_pings_without_a_good_beam_it_begins_afresh() {
    let mut plane = inverse_range();
    for _ in 0..10 {
        plane.update(&dvl(ranges(3.0, 0.0)));
    }
    // Another net, much farther: every beam is outside its gate.
    for bad in 1..=20 {
        assert!(!plane.update(&dvl(ranges(6.0, 0.1))), "ping {bad}");
        assert_eq!(plane.report().accepted, [false; 4]);
        assert!((plane.estimate(0.0).expect("kept").distance_m - 3.0).abs() < 1e-9);
    }
    assert!(plane.update(&dvl(ranges(6.0, 0.1))), "the twenty-first is taken");
    let net = plane.estimate(0.0).expect("a plane");
    assert!((net.distance_m - 6.0).abs() < 1e-12 && (net.heading_rad - 0.1).abs() < 1e-12);
}

#[test]
fn it_does_not_begin_with_a_fish_in_the_ping() {
    let mut plane = inverse_range();
    let mut fish = ranges(3.0, 0.0);
    fish[2] = fish[2].map(|range| 0.6 * range);
    for _ in 0..50 {
        assert!(!plane.update(&dvl(fish)), "parity tells");
        assert_eq!(plane.estimate(0.0), None);
    }
    assert!(plane.update(&dvl(ranges(3.0, 0.0))));
}

#[test]
fn the_plane_stays_between_its_bounds() {
    let distance = |true_m: f64| {
        let mut plane = inverse_range();
        plane.update(&dvl(ranges(true_m, 0.0)));
        plane.estimate(0.0).expect("a plane").distance_m
    };
    // |a| from 0.1 to 2.5 per metre: 10 m to 0.4 m.
    for (true_m, seen_m) in [(0.2, 0.4), (0.5, 0.5), (9.0, 9.0), (40.0, 10.0)] {
        assert!((distance(true_m) - seen_m).abs() < 1e-12, "{true_m}: {}", distance(true_m));
    }
    // Prediction keeps to them too: backing off for a long time, and running into the net.
    for (speed, bound_m) in [(-0.5, 10.0), (0.5, 0.4)] {
        let mut plane = inverse_range();
        plane.update(&dvl(ranges(3.0, 0.0)));
        for _ in 0..5000 {
            plane.predict(&Vector3::new(speed, 0.0, 0.0), 0.0, H_S);
        }
        assert!((plane.estimate(0.0).expect("a plane").distance_m - bound_m).abs() < 1e-9);
    }
}

/// The plane in the body frame of a vehicle that has moved for `t` with constant `v` (body) and `r`, by geometry.
fn moved_plane(v: &Vector3<f64>, r: f64, t: f64) -> Vector3<f64> {
    // Net: n · p = 3 in NED with n at bearing 0.2 and a slope; the vehicle starts at the origin, heading 0.
    let n = Vector3::new(0.2f64.cos() * 0.1f64.cos(), 0.2f64.sin() * 0.1f64.cos(), 0.1f64.sin());
    // Position: the integral of Rz(r t) v.
    let (s, c) = (r * t).sin_cos();
    let p = if r.abs() < 1e-12 {
        v * t
    } else {
        Vector3::new((v.x * s - v.y * (1.0 - c)) / r, (v.x * (1.0 - c) + v.y * s) / r, v.z * t)
    };
    let distance = 3.0 - n.dot(&p);
    // n in body axes: Rzᵀ n.
    Vector3::new(c * n.x + s * n.y, -s * n.x + c * n.y, n.z) / distance
}

#[test]
fn the_prediction_moves_the_plane_as_geometry_does() {
    let cases = [
        (Vector3::new(0.2, 0.0, 0.0), 0.0),
        (Vector3::new(0.0, 0.3, 0.0), 0.0),
        (Vector3::new(0.0, 0.0, 0.2), 0.0),
        (Vector3::zeros(), 0.15),
        (Vector3::new(0.1, -0.2, 0.05), -0.1),
    ];
    for (v, r) in cases {
        // Four seconds; forward Euler, so the error halves with the step and goes to the exact motion.
        let error = |steps: u32| {
            let h_s = 4.0 / f64::from(steps);
            let mut plane = inverse_range();
            let start = moved_plane(&v, r, 0.0);
            let range = SonarArray::new(BEAM_RAD).beams().map(|b| Some(1.0 / b.dot(&start)));
            assert!(plane.update(&dvl(range)));
            for _ in 0..steps {
                plane.predict(&v, r, h_s);
            }
            (plane.a() - moved_plane(&v, r, 4.0)).norm()
        };
        let (coarse, fine, finest) = (error(200), error(400), error(40_000));
        println!("plane under {v:?}, {r}: error at 50 Hz {coarse:.1e} per m");
        // 1e-3 per metre are 9 mm at 3 m.
        assert!(coarse < 1e-3, "{v:?}, {r}: {coarse}");
        assert!(coarse < 1e-12 || (1.9..2.1).contains(&(coarse / fine)), "first order: {coarse}, {fine}");
        assert!(finest < 1e-5, "and it converges to geometry: {finest}");
    }
}

#[test]
fn the_variances_of_the_plane_filter_are_consistent() {
    // Its own model with its own noise: a' with process noise, ranges with 1.3 · 0.05 m. 50 seeds × 8 times two seconds
    // apart (the filter forgets in a few pings): 400 degrees of freedom each, 99 % band 1 ± 0.182.
    let q = [4e-4, 8e-4, 8e-4];
    let (v, r) = (Vector3::new(0.02, 0.1, 0.0), 0.02);
    let array = SonarArray::new(BEAM_RAD);
    let mut ratio = [0.0; 2];
    let mut n = 0.0;
    for seed in 0..50 {
        let mut noise = Stream::new(seed, "plane");
        // The gate wide open: it would cut the tails of the very distribution that is tested.
        let mut plane = inverse_range_with(1e6);
        let mut a = Vector3::new(1.0 / 3.0, 0.05 * noise.normal(), 0.03 * noise.normal());
        for k in 0..800 {
            if k > 0 {
                let turn = Vector3::new(r * a.y, -r * a.x, 0.0);
                a += (turn + a * a.dot(&v)) * H_S;
                a += Vector3::from_fn(|i, _| (q[i] * H_S).sqrt() * noise.normal());
                plane.predict(&v, r, H_S);
            }
            if k % 6 == 0 {
                let range = array.beams().map(|b| Some(1.0 / b.dot(&a) + 1.3 * 0.05 * noise.normal()));
                plane.update(&dvl(range));
            }
            if k % 100 == 99 {
                let net = plane.estimate(0.0).expect("a plane");
                let (d, psi) = (1.0 / a.norm(), a.y.atan2(a.x));
                ratio[0] += (net.distance_m - d).powi(2) / net.distance_variance_m2;
                ratio[1] += ssa(net.heading_rad - psi).powi(2) / net.heading_variance_rad2;
                n += 1.0;
            }
        }
    }
    let [distance, heading] = ratio.map(|sum| sum / n);
    println!("plane filter: normalised squared errors {distance:.3}, {heading:.3} (1 ± {:.3})", band(n));
    assert!((distance - 1.0).abs() < band(n) && (heading - 1.0).abs() < band(n), "{distance}, {heading}");
}
