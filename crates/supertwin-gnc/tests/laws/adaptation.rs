//! The adaptation of k1: test T4.

use super::{ALPHA_TOL, EPSILON, LAMBDA, RATES, k1, random_errors, twisting};
use crate::common::{H_S, axes, errors, input, law, law_config_with, law_with, nominal};
use nalgebra::Vector4;
use supertwin_core::random::Stream;
use supertwin_gnc::control::{Law, LawInput, TrackingError};

fn steps(law: &mut Law, count: u32, error: &TrackingError) {
    for _ in 0..count {
        law.step(&input(error));
    }
}

#[test]
fn t4_inside_its_tolerance_k1_is_constant_to_the_bit() {
    for start in [[0.0; 4], [15.0, 0.1, 7.7, 2.3]] {
        // With constant errors at rest σ = x1: just inside the tolerance, on both sides.
        for side in [1.0, -1.0] {
            let mut law = law_with("agsta", "adaptation.k1_initial", axes(start));
            let error = errors(ALPHA_TOL.map(|tol| side * 0.999 * tol), 0.0, 0.0);
            for _ in 0..3000 {
                law.step(&input(&error));
                assert_eq!(k1(&law).map(f64::to_bits), start.map(f64::to_bits));
            }
            assert_eq!(law.sample().sigma, Some(error.x1.into()));
            assert_eq!(law.sample().alpha_tol, Some(ALPHA_TOL));
        }
    }
}

#[test]
fn t4_outside_its_tolerance_k1_grows_linearly_at_the_printed_rates() {
    for side in [1.0, -1.0] {
        let mut law = law("agsta");
        // The tolerance itself counts as outside: |σ| ≥ α_tol.
        let error = errors(ALPHA_TOL.map(|tol| side * tol), 0.0, 0.0);
        steps(&mut law, 5000, &error);
        let t_s = 5000.0 * H_S;
        for ((k1, printed), squared) in k1(&law).into_iter().zip(RATES).zip([2.5f64, 2.5, 1.5, 0.5]) {
            let (rate, exact) = (k1 / t_s, squared.sqrt() * t_s);
            assert!((rate - printed).abs() < 5e-4, "{rate} per s against {printed}");
            assert!((k1 - exact).abs() < 1e-9, "{k1} against {exact}");
        }
    }
}

#[test]
fn t4_k1_never_falls_without_a_leak_and_k2_is_algebraic_at_every_step() {
    let mut law = law("agsta");
    let mut draw = Stream::new(4, "errors");
    let mut last = k1(&law);
    let mut grown = [0; 4];
    for _ in 0..5000 {
        let error = random_errors(&mut draw);
        law.step(&input(&error));
        let t = twisting(&law);
        for i in 0..4 {
            let outside = t.sigma[i].abs() >= ALPHA_TOL[i];
            assert!(t.k1[i] >= last[i]);
            assert_eq!(t.k1[i] > last[i], outside, "axis {i} grows exactly when it is outside");
            grown[i] += u32::from(outside);
            let algebraic = 2.0 * EPSILON[i] * t.k1[i] + LAMBDA[i] + 4.0 * EPSILON[i] * EPSILON[i];
            assert!((t.k2[i] - algebraic).abs() <= 1e-15 * algebraic, "axis {i}: {} against {algebraic}", t.k2[i]);
        }
        last = k1(&law);
    }
    assert!(grown.iter().all(|n| (500..4500).contains(n)), "both cases were seen: {grown:?}");
}

#[test]
fn t4_k2_before_the_first_step_is_algebraic_too() {
    let law = law("agsta");
    for i in 0..4 {
        assert!((twisting(&law).k2[i] - LAMBDA[i] - 4.0 * EPSILON[i] * EPSILON[i]).abs() < 1e-15);
    }
}

/// Eq. (20) as printed, with a dot: surge k2 grows by 2 per second (control.md, section 1.3 (iv): 240 after 120 s).
#[test]
fn t4_the_integrated_second_gain_runs_away() {
    let mut law = law("agsta-literal-k2");
    steps(&mut law, 6000, &errors([0.1; 4], 0.0, 0.0));
    let k2 = twisting(&law).k2;
    for i in 0..4 {
        let slope = LAMBDA[i] + 4.0 * EPSILON[i] * EPSILON[i];
        assert!((k2[i] - slope * (1.0 + 120.0)).abs() < 1e-8, "axis {i}: {}", k2[i]);
    }
    assert!((k2[0] - 242.0).abs() < 1e-3, "2 at the start and 240 more: {}", k2[0]);
}

#[test]
fn t4_a_cap_is_reached_and_never_passed() {
    let caps = [50.0, 58.0, 80.0, 28.0];
    let mut law = law_with("agsta", "adaptation.k1_cap", axes(caps));
    let error = errors([1.0; 4], 0.0, 0.0);
    for _ in 0..5000 {
        law.step(&input(&error));
        assert!((0..4).all(|i| k1(&law)[i] <= caps[i]));
    }
    assert_eq!(k1(&law), caps);
}

#[test]
fn t4_a_cap_below_its_start_is_refused_by_name() {
    let start = ("adaptation.k1_initial", axes([0.0, 60.0, 0.0, 0.0]));
    let refusal = law_config_with("agsta-capped", [start]).build(&nominal()).expect_err("58 < 60");
    assert_eq!(refusal, "law.agsta.adaptation.k1_cap = 58 (sway): must not be below k1_initial = 60");
}

#[test]
fn t4_a_leak_lets_k1_decay_towards_its_start() {
    let changes: [(_, toml::Value); 2] =
        [("adaptation.k1_initial", axes([3.0; 4]).into()), ("adaptation.leak_per_s", 0.05.into())];
    let mut law = law_config_with("agsta", changes).build(&nominal()).expect("legal");
    let (outside, inside) = (errors([1.0; 4], 0.0, 0.0), errors([0.0; 4], 0.0, 0.0));
    steps(&mut law, 1000, &outside);
    // The lead filter takes the jump of the error for an acceleration: until that is over, σ is still outside.
    steps(&mut law, 200, &inside);
    let high = k1(&law);
    steps(&mut law, 1000, &inside);
    let decay = (1.0f64 - 0.05 * H_S).powi(1000);
    assert!((decay - (-1.0f64).exp()).abs() < 1e-3, "20 s at 0.05 per s are one time constant");
    for (k1, high) in k1(&law).into_iter().zip(high) {
        assert!(high > 5.0);
        assert!((k1 - 3.0 - (high - 3.0) * decay).abs() < 1e-9, "{k1} after {high}");
    }
    // With the leak the growth levels off at start + rate/leak.
    steps(&mut law, 50_000, &outside);
    for (k1, rate) in k1(&law).into_iter().zip(RATES) {
        assert!((k1 - 3.0 - rate / 0.05).abs() < 0.02, "{k1}");
    }
}

#[test]
fn t4_a_limited_axis_freezes_integrator_and_adaptation_and_the_others_go_on() {
    for name in ["agsta", "agsta-implicit", "agsta-literal-k2", "agsta-capped"] {
        let mut law = law(name);
        let error = errors([1.0; 4], 0.0, 0.0);
        law.step(&input(&error));
        let before = law.clone();
        let limited = [false, true, false, true];
        law.step(&LawInput { limited, ..input(&error) });
        let (was, is) = (twisting(&before), twisting(&law));
        for (i, waits) in limited.into_iter().enumerate() {
            for (a, b) in [(was.k1[i], is.k1[i]), (was.k2[i], is.k2[i]), (was.z[i], is.z[i])] {
                assert_eq!(a.to_bits() == b.to_bits(), waits, "{name}, axis {i}: {a} and {b}");
            }
        }
    }
}

#[test]
fn t4_without_anti_windup_a_limited_axis_goes_on() {
    let mut law = law_with("agsta", "anti_windup", "none");
    let error = errors([1.0; 4], 0.0, 0.0);
    law.step(&LawInput { limited: [true; 4], ..input(&error) });
    assert!((0..4).all(|i| k1(&law)[i] > 0.0 && twisting(&law).z[i] < 0.0));
}

#[test]
fn a_hand_over_keeps_adapted_gains_and_a_reset_forgets_them() {
    let mut law = law("agsta");
    let error = errors([1.0; 4], 0.0, 0.0);
    steps(&mut law, 500, &error);
    let adapted = k1(&law);
    law.start_from(&input(&error), &Vector4::new(10.0, 0.0, -3.0, 1.0));
    assert_eq!(k1(&law), adapted);
    law.reset();
    assert_eq!(k1(&law), [0.0; 4]);
    assert_eq!(twisting(&law).z, Vector4::zeros());
    assert!(twisting(&law).k2[0] < 2.001);
}
