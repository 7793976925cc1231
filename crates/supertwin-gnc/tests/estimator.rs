//! The extended Kalman filter, the estimator block and both net planes: consistency, gates, faults.

mod block;
mod net_plane;

use crate::common::{H_S, estimator_config, nominal};
use core::f64::consts::PI;
use nalgebra::{Vector3, Vector4};
use supertwin_core::frame::ssa;
use supertwin_core::random::Stream;
use supertwin_gnc::ekf::{B, Covariance, Ekf, EkfConfig, NU, PSI, STATES, State, Z};
use supertwin_gnc::estimator::MeasurementConfig;
use supertwin_model::SonarArray;

const BEAM_RAD: f64 = 0.436_332_312_998_582_4;

/// Ranges to the plane `n · p = distance` with its normal at `bearing` off the bow.
fn ranges(distance_m: f64, bearing_rad: f64) -> [Option<f64>; 4] {
    let normal = Vector3::new(bearing_rad.cos(), bearing_rad.sin(), 0.0);
    SonarArray::new(BEAM_RAD).beams().map(|b| Some(distance_m / normal.dot(&b)))
}

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
        ekf.x[i] = x[i];
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
            let delta = State::ith(j, 1e-6);
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
        let (dense, before) = (ekf.dense_jacobian(H_S), ekf.P);
        ekf.predict(&(draw.normals::<4>() * 50.0), H_S);
        let expected = dense * before * dense.transpose() + Covariance::from_diagonal(&(q * H_S));
        // Entry by entry, relative to the standard deviations of its row and column.
        let std = expected.diagonal().map(f64::sqrt);
        for i in 0..STATES {
            for j in 0..STATES {
                let difference = (ekf.P[(i, j)] - expected[(i, j)]).abs();
                assert!(difference < 1e-13 * std[i] * std[j], "({i}, {j}): {difference}");
            }
        }
        // Fill the matrix: some scalar updates now and then.
        let state = draw.uniform(0.0, 6.0) as usize;
        ekf.update(state, ekf.x[state] + 0.01 * draw.normal(), 1e-3, None);
    }
    assert!(ekf.P[(NU, B)].abs() > 1e-6, "the matrix was full");
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
            assert!((ekf.x[i] - expected[i]).abs() < 1e-12);
        }
        assert!(ssa(ekf.x[PSI] - expected[PSI]).abs() < 1e-12 && (-PI..PI).contains(&ekf.x[PSI]));
        wrapped += u32::from(expected[PSI] >= PI);
        let acceleration = ekf.derivative(&x, &tau).fixed_rows::<4>(NU).into_owned();
        assert_eq!(ekf.acceleration, acceleration);
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
        let (surge, sway, heave) = (100.0 * (0.3 * t).sin(), 80.0 * (0.2 * t).cos(), 60.0 * (0.5 * t).sin());
        let wave = Vector4::new(surge, sway, heave, 8.0 * (0.4 * t).sin());
        ekf.predict(&wave, H_S);
        ekf.update(NU + 3, ekf.x[NU + 3] + 0.007 * draw.normal(), 4.9e-5, None);
        if k % 5 == 0 {
            ekf.update(Z, ekf.x[Z] + 0.02 * draw.normal(), 4e-4, None);
            ekf.update(PSI, ekf.x[PSI] + 0.026 * draw.normal(), 6.9e-4, None);
        }
        // The DVL is silent half of the time, and then tells the impossible.
        if k % 6 == 0 && (k / 3000) % 2 == 0 {
            for i in 0..3 {
                ekf.update(NU + i, ekf.x[NU + i] + 0.04 * draw.normal(), 1.4e-3, None);
            }
        }
        if k % 500 == 0 {
            let p = ekf.P;
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
                let mut e = x - ekf.x;
                e[PSI] = ssa(e[PSI]);
                let inverse = ekf.P.cholesky().expect("positive").inverse();
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
    ekf.x[PSI] = PI - 0.01;
    let innovation = ekf.update(PSI, -PI + 0.01, 1e-3, Some(25.0));
    assert!(innovation.accepted && (innovation.value - 0.02).abs() < 1e-12, "{innovation:?}");
    assert!((-PI..PI).contains(&ekf.x[PSI]));
}

#[test]
fn what_does_not_pass_its_gate_changes_nothing() {
    let mut ekf = ekf();
    ekf.predict(&Vector4::zeros(), H_S);
    let (x, p) = (ekf.x, ekf.P);
    let s = p[(NU, NU)] + 1e-3;
    // Just beyond the gate, and numbers that are none.
    for wild in [(9.001 * s).sqrt() + x[NU], -(9.001 * s).sqrt() + x[NU], 1e200, f64::NAN, f64::INFINITY] {
        let innovation = ekf.update(NU, wild, 1e-3, Some(9.0));
        assert!(!innovation.accepted);
        assert_eq!((&ekf.x, &ekf.P), (&x, &p), "{wild}");
    }
    assert!(!ekf.update(NU, f64::NAN, 1e-3, None).accepted, "not without a gate either");
    assert_eq!((&ekf.x, &ekf.P), (&x, &p));
    let innovation = ekf.update(NU, (8.999 * s).sqrt() + x[NU], 1e-3, Some(9.0));
    assert!(innovation.accepted && (innovation.nis - 8.999).abs() < 1e-9 && ekf.x != x);
}
