//! The adaptation of k1: test T4.

use super::{ALPHA_TOL, EPSILON, LAMBDA, RATES, agsta, agsta_with, k1, random_errors, twisting};
use crate::common::{self, H_S, axes, errors, input, law, nominal};
use nalgebra::Vector4;
use supertwin_core::random::Stream;
use supertwin_gnc::control::LawInput;

#[test]
fn t4_inside_its_tolerance_k1_is_constant_to_the_bit() {
    for start in [[0.0; 4], [15.0, 0.1, 7.7, 2.3]] {
        // With constant errors at rest σ = x1: just inside the tolerance, on both sides.
        for side in [1.0, -1.0] {
            let mut law = agsta_with(&["adaptation", "k1_initial"], axes(start));
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
        for _ in 0..5000 {
            law.step(&input(&error));
        }
        let t_s = 5000.0 * H_S;
        for (k1, printed) in k1(&law).into_iter().zip(RATES) {
            let rate = k1 / t_s;
            assert!((rate - printed).abs() < 5e-4, "{rate} per s against {printed}");
        }
        let exact = [2.5f64.sqrt(), 2.5f64.sqrt(), 1.5f64.sqrt(), 0.5f64.sqrt()];
        for (k1, rate) in k1(&law).into_iter().zip(exact) {
            assert!((k1 - rate * t_s).abs() < 1e-9, "{k1} against {}", rate * t_s);
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
    let error = errors([0.1; 4], 0.0, 0.0);
    for _ in 0..6000 {
        law.step(&input(&error));
    }
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
    let mut law = agsta_with(&["adaptation", "k1_cap"], axes(caps));
    let error = errors([1.0; 4], 0.0, 0.0);
    for _ in 0..5000 {
        law.step(&input(&error));
        assert!((0..4).all(|i| k1(&law)[i] <= caps[i]));
    }
    assert_eq!(k1(&law), caps);
}

#[test]
fn t4_a_cap_below_its_start_is_refused_by_name() {
    let mut table = common::file("controllers/agsta-capped");
    table["law"]["agsta"]["adaptation"]["k1_initial"] = axes([0.0, 60.0, 0.0, 0.0]).into();
    let config: supertwin_gnc::ControllerConfig = table.try_into().expect("parses");
    let refusal = config.law.build(&nominal()).expect_err("58 < 60");
    assert_eq!(refusal, "law.agsta.adaptation.k1_cap = 58 (sway): must not be below k1_initial = 60");
}

#[test]
fn t4_a_leak_lets_k1_decay_towards_its_start() {
    let mut table = common::file("controllers/agsta");
    table["law"]["agsta"]["adaptation"]["k1_initial"] = axes([3.0; 4]).into();
    let adaptation = table["law"]["agsta"]["adaptation"].as_table_mut().expect("a table");
    adaptation.insert("leak_per_s".to_owned(), 0.05.into());
    let config: supertwin_gnc::ControllerConfig = table.try_into().expect("parses");
    let mut law = config.law.build(&nominal()).expect("legal");
    let outside = errors([1.0; 4], 0.0, 0.0);
    for _ in 0..1000 {
        law.step(&input(&outside));
    }
    let inside = errors([0.0; 4], 0.0, 0.0);
    // The lead filter takes the jump of the error for an acceleration: until that is over, σ is still outside.
    for _ in 0..200 {
        law.step(&input(&inside));
    }
    let high = k1(&law);
    for _ in 0..1000 {
        law.step(&input(&inside));
    }
    let decay = (1.0f64 - 0.05 * H_S).powi(1000);
    assert!((decay - (-1.0f64).exp()).abs() < 1e-3, "20 s at 0.05 per s are one time constant");
    for (k1, high) in k1(&law).into_iter().zip(high) {
        assert!(high > 5.0);
        assert!((k1 - 3.0 - (high - 3.0) * decay).abs() < 1e-9, "{k1} after {high}");
    }
    // With the leak the growth levels off at start + rate/leak.
    for _ in 0..50_000 {
        law.step(&input(&outside));
    }
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
    let mut law = agsta_with(&["anti_windup"], "none");
    let error = errors([1.0; 4], 0.0, 0.0);
    law.step(&LawInput { limited: [true; 4], ..input(&error) });
    assert!((0..4).all(|i| k1(&law)[i] > 0.0 && twisting(&law).z[i] < 0.0));
}

#[test]
fn a_hand_over_keeps_adapted_gains_and_a_reset_forgets_them() {
    let mut law = law("agsta");
    let error = errors([1.0; 4], 0.0, 0.0);
    for _ in 0..500 {
        law.step(&input(&error));
    }
    let adapted = k1(&law);
    law.start_from(&input(&error), &Vector4::new(10.0, 0.0, -3.0, 1.0));
    assert_eq!(k1(&law), adapted);
    law.reset();
    assert_eq!(k1(&law), [0.0; 4]);
    assert_eq!(twisting(&law).z, Vector4::zeros());
    assert!(agsta(&law).twisting.k2[0] < 2.001);
}
