//! A controller of somebody else in command, and PID.

use super::random_errors;
use crate::common::{H_S, axes, errors, file, input, law, law_config_with, law_with, nominal};
use nalgebra::Vector4;
use supertwin_core::message::WrenchRequest;
use supertwin_core::observe::Snapshot;
use supertwin_core::random::Stream;
use supertwin_core::signal;
use supertwin_gnc::control::LawInput;

// ---------------------------------------------------------------------------------------------------------- external

#[test]
fn axes_that_are_asked_for_are_the_request_and_the_others_are_the_substitute() {
    let mut external = law("external");
    let mut alone = law("pid-tuned");
    let request = WrenchRequest { surge_n: Some(12.5), yaw_nm: Some(-3.25), ..WrenchRequest::default() };
    let mut draw = Stream::new(9, "external");
    for _ in 0..300 {
        let error = random_errors(&mut draw);
        let tau = external.step(&LawInput { request: Some(&request), ..input(&error) });
        let own = alone.step(&input(&error));
        assert_eq!([tau[0], tau[3]], [12.5, -3.25]);
        assert_eq!([tau[1].to_bits(), tau[2].to_bits()], [own[1].to_bits(), own[2].to_bits()]);
    }
    let outside = Snapshot::of(&external);
    assert_eq!(outside.get(&signal::controller::EXTERNAL), Some(&[1.0, 0.0, 0.0, 1.0][..]));
}

#[test]
fn without_a_request_the_substitute_steers() {
    let (mut external, mut alone) = (law("external"), law("pid-tuned"));
    let mut draw = Stream::new(10, "external");
    for _ in 0..300 {
        let error = random_errors(&mut draw);
        assert_eq!(external.step(&input(&error)), alone.step(&input(&error)));
    }
}

#[test]
fn an_axis_that_comes_back_to_the_substitute_continues_from_the_last_wrench() {
    let mut external = law("external");
    let request = WrenchRequest { surge_n: Some(40.0), heave_n: Some(-25.0), ..WrenchRequest::default() };
    let partly = WrenchRequest { heave_n: Some(-25.0), ..WrenchRequest::default() };
    let error = errors([0.05, -0.03, 0.1, 0.02], 0.01, 0.0);
    let mut last = Vector4::zeros();
    for _ in 0..500 {
        last = external.step(&LawInput { request: Some(&request), ..input(&error) });
    }
    // One axis comes back, then the request goes stale altogether.
    for request in [Some(&partly), None] {
        let now = external.step(&LawInput { request, ..input(&error) });
        assert!((now - last).amax() < 1e-9, "{now} after {last}");
        for _ in 0..10 {
            last = external.step(&LawInput { request, ..input(&error) });
        }
    }
    // From here on the substitute's integral moves the wrench: no axis is stuck.
    let own = external.step(&input(&error));
    assert!((0..4).all(|i| own[i] != last[i]), "{own} after {last}");
}

#[test]
fn a_number_that_is_none_in_a_request_leaves_the_axis_to_the_substitute() {
    let (mut external, mut clean) = (law("external"), law("external"));
    let good = WrenchRequest { yaw_nm: Some(2.0), ..WrenchRequest::default() };
    let [surge_n, sway_n, heave_n] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY].map(Some);
    let bad = WrenchRequest { surge_n, sway_n, heave_n, ..good.clone() };
    let mut draw = Stream::new(11, "external");
    for _ in 0..100 {
        let error = random_errors(&mut draw);
        let a = external.step(&LawInput { request: Some(&bad), ..input(&error) });
        let b = clean.step(&LawInput { request: Some(&good), ..input(&error) });
        assert_eq!(a, b);
        assert!(a.iter().all(|force| force.is_finite()));
    }
}

#[test]
fn external_cannot_be_its_own_substitute() {
    let own = ("substitute", file("controllers/external")["law"].clone());
    let refusal = law_config_with("external", [own]).build(&nominal()).expect_err("a law of its own");
    assert_eq!(refusal, "law.external.substitute = external: must be a law of the vehicle's own");
}

// --------------------------------------------------------------------------------------------------------------- PID

#[test]
fn pid_equals_a_computation_by_hand() {
    let mut law = law("pid-tuned");
    let (kp, ki, kd) = ([300.0, 300.0, 250.0, 40.0], [60.0, 60.0, 25.0, 12.0], [0.0, 0.0, 120.0, 20.0]);
    let mut integral = [0.0; 4];
    let mut draw = Stream::new(12, "pid");
    for _ in 0..200 {
        let error = random_errors(&mut draw);
        let tau = law.step(&input(&error));
        for i in 0..4 {
            integral[i] += H_S * error.x1[i];
            let by_hand = -kp[i] * error.x1[i] - ki[i] * integral[i] - kd[i] * error.velocity[i];
            assert!((tau[i] - by_hand).abs() < 1e-10, "axis {i}: {} against {by_hand}", tau[i]);
        }
    }
}

#[test]
fn pid_differentiates_surge_and_sway_through_its_filter() {
    let mut law = law_with("pid", "kd", axes([30.0, 20.0, 0.0, 0.0]));
    // A ramp of 0.1 m/s²: after many time constants of 0.3 s the filtered derivative is exactly the slope.
    let mut tau = Vector4::zeros();
    let n = 1000;
    for k in 0..n {
        let e = 0.1 * f64::from(k) * H_S;
        tau = law.step(&input(&errors([e, -e, 0.0, 0.0], 0.0, 0.0)));
    }
    let e = 0.1 * f64::from(n - 1) * H_S;
    let integral = (0..n).map(|k| 0.1 * f64::from(k) * H_S * H_S).sum::<f64>();
    // (y − ξ)/Tf of the exact discretisation: slope · h/(Tf (1 − e^{−h/Tf})).
    let slope = 0.1 * H_S / (0.3 * (1.0 - (-H_S / 0.3f64).exp()));
    assert!((tau[0] + 200.0 * e + 5.0 * integral + 30.0 * slope).abs() < 1e-9, "{}", tau[0]);
    assert!((tau[1] - 200.0 * e - 5.0 * integral - 20.0 * slope).abs() < 1e-9, "{}", tau[1]);
}

#[test]
fn a_limited_axis_stops_the_pid_integral_unless_anti_windup_is_off() {
    let error = errors([0.1; 4], 0.0, 0.0);
    let limited = [true, false, true, false];
    for (anti_windup, waits) in [("freeze", true), ("none", false)] {
        let mut law = law_with("pid", "anti_windup", anti_windup);
        for _ in 0..50 {
            law.step(&LawInput { limited, ..input(&error) });
        }
        let shown = Snapshot::of(&law);
        let integral = shown.get(&signal::controller::INTEGRAL).expect("shown");
        for i in 0..4 {
            let expected = if waits && limited[i] { 0.0 } else { 50.0 * H_S * 0.1 };
            assert!((integral[i] - expected).abs() < 1e-12, "{anti_windup}, axis {i}: {}", integral[i]);
        }
    }
}
