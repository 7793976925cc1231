//! The control laws on all four axes, from their real parameter files; oracles: control.md, tests T4 and T14.

mod adaptation;
mod external;

use crate::common::{H_S, axes, errors, input, law, law_config, law_config_with, law_with, nominal};
use nalgebra::Vector4;
use supertwin_core::Capability;
use supertwin_core::observe::Snapshot;
use supertwin_core::random::Stream;
use supertwin_gnc::control::super_twisting::SuperTwisting;
use supertwin_gnc::control::surface::{Surface, SurfaceConfig};
use supertwin_gnc::control::{Law, LawInput, TrackingError};

/// `α_tol` of table II.
const ALPHA_TOL: [f64; 4] = [0.2, 0.2, 0.15, 0.2];
/// `ε` of table II.
const EPSILON: [f64; 4] = [1e-4, 1e-4, 1e-5, 1e-3];
/// `λ` of table II.
const LAMBDA: [f64; 4] = [2.0, 2.0, 0.01, 1.0];
/// `ω √(γ/2)` of table II, as control.md prints it.
const RATES: [f64; 4] = [1.581, 1.581, 1.225, 0.707];

/// Every controller file.
const FILES: &str = "agsta agsta-acceleration-free agsta-capped agsta-implicit agsta-literal-acceleration \
                     agsta-literal-k2 bluerov2-pid external gsta gsta-implicit gsta-tuned pid pid-tuned";

fn twisting(law: &Law) -> &SuperTwisting {
    match law {
        Law::Gsta(gsta) => &gsta.twisting,
        Law::Agsta(agsta) => &agsta.twisting,
        other => panic!("{} has no integrator z", other.name()),
    }
}

fn k1(law: &Law) -> [f64; 4] {
    law.sample().k1.expect("a law with gains")
}

/// Random errors of the size that a run sees.
fn random_errors(draw: &mut Stream) -> TrackingError {
    let x1 = [0.2 * draw.normal(), 0.2 * draw.normal(), 0.3 * draw.normal(), 0.3 * draw.normal()];
    let mut error = errors(x1, 0.1 * draw.normal(), 0.1 * draw.normal());
    error.model_acceleration = draw.normals::<4>() * 0.05;
    error
}

fn random_wrench(draw: &mut Stream) -> Vector4<f64> {
    draw.normals::<4>().component_mul(&Vector4::new(60.0, 60.0, 40.0, 8.0))
}

fn lead(time_constant_s: f64) -> SurfaceConfig {
    SurfaceConfig::LeadFilter { time_constant_s: time_constant_s.try_into().expect("positive") }
}

// ----------------------------------------------------------------------------------------------- T14 and the surface

/// The heave velocity that puts `σ_z` on zero at this depth error; σ is affine in it.
fn heave_rate_on_the_surface(surface: &Surface, z: f64, h_s: f64) -> f64 {
    let sigma = |w: f64| surface.clone().step(&errors([0.0, 0.0, z, 0.0], w, 0.0), h_s)[2];
    let (at_0, at_1) = (sigma(0.0), sigma(1.0));
    -at_0 / (at_1 - at_0)
}

#[test]
fn t14_on_the_heave_surface_the_error_obeys_its_characteristic_polynomial() {
    // (1 + 2 Tf) z'' + (2 + Tf) z' + z = 0 from z = 1: under-damped for 0 < Tf < 4, a double pole at −1 for Tf → 0.
    for tf in [0.1, 0.3, 1.0] {
        let h_s = 1e-4;
        let mut surface = Surface::new(&lead(tf));
        // The filter starts at the first velocity error: no acceleration yet, so σ = z + 2w = 0 gives w = −½.
        let (mut z, mut w) = (1.0, -0.5);
        surface.step(&errors([0.0, 0.0, z, 0.0], w, 0.0), h_s);
        let a = (2.0 + tf) / (2.0 * (1.0 + 2.0 * tf));
        let b = (1.0 / (1.0 + 2.0 * tf) - a * a).sqrt();
        assert!(b > 0.0, "a pair of complex poles");
        let exact = |t: f64| (-a * t).exp() * ((b * t).cos() + (a - 0.5) / b * (b * t).sin());
        let mut worst: f64 = 0.0;
        for k in 1..=80_000 {
            // Heun's rule for z' = w.
            let ahead = heave_rate_on_the_surface(&surface, z + h_s * w, h_s);
            z += 0.5 * h_s * (w + ahead);
            w = heave_rate_on_the_surface(&surface, z, h_s);
            let sigma = surface.step(&errors([0.0, 0.0, z, 0.0], w, 0.0), h_s);
            assert!(sigma[2].abs() < 1e-9, "on the surface");
            worst = worst.max((z - exact(f64::from(k) * h_s)).abs());
        }
        println!("T14 Tf = {tf}: largest distance from the analytic solution over 8 s: {worst:.1e} m");
        assert!(worst < 2e-4, "Tf = {tf}: {worst}");
        assert!(z.abs() < 0.05, "and it converges: {z}");
    }
}

#[test]
fn t14_on_the_surge_surface_the_time_constant_is_one_second_and_tf() {
    let (tf, h_s) = (0.3, 1e-4);
    let mut surface = Surface::new(&lead(tf));
    surface.step(&errors([1.0 + tf, 1.0 + tf, 0.0, 0.0], 0.0, 0.0), h_s);
    let mut first = None;
    let steps = ((1.0 + tf) / h_s).round() as u32;
    let mut last = Vector4::zeros();
    for _ in 0..=steps {
        let sigma = |u: f64| surface.clone().step(&errors([u, u, 0.0, 0.0], 0.0, 0.0), h_s);
        let (at_0, at_1) = (sigma(0.0), sigma(1.0));
        let u = Vector4::from_fn(|i, _| if i < 2 { -at_0[i] / (at_1[i] - at_0[i]) } else { 0.0 });
        let on = surface.step(&errors([u[0], u[1], 0.0, 0.0], 0.0, 0.0), h_s);
        assert!(on.amax() < 1e-12);
        first.get_or_insert(u);
        last = u;
    }
    let share = last.component_div(&first.expect("at least one step"));
    for axis in 0..2 {
        assert!((share[axis] - (-1.0f64).exp()).abs() < 1e-3, "axis {axis}: {}", share[axis]);
    }
}

#[test]
fn a_very_slow_lead_filter_is_the_acceleration_free_surface() {
    let free = SurfaceConfig::AccelerationFree { heave_rate_weight: 2.0.try_into().expect("positive") };
    let (mut slow, mut free) = (Surface::new(&lead(1e9)), Surface::new(&free));
    let mut draw = Stream::new(14, "surface");
    for _ in 0..2000 {
        let error = random_errors(&mut draw);
        let difference = slow.step(&error, H_S) - free.step(&error, H_S);
        assert!(difference.amax() < 2e-9, "{difference}");
    }
    let (g_slow, g_free) = (slow.control_gain(&nominal()), free.control_gain(&nominal()));
    assert!((g_slow.expect("degree 1") - g_free.expect("degree 1")).amax() < 1e-9);
}

#[test]
fn a_very_fast_lead_filter_is_the_papers_surface() {
    // σ → ũ + ũ' for smooth errors and h ≪ Tf ≪ 1 s; the lag of the filtered derivative is Tf.
    let (tf, h_s) = (0.01, 1e-4);
    let mut surface = Surface::new(&lead(tf));
    for k in 0..100_000 {
        let t = f64::from(k) * h_s;
        let sigma = surface.step(&errors([t.sin(), t.cos(), t.sin(), 0.3], t.cos(), 0.1), h_s);
        if t > 0.2 {
            assert!((sigma[0] - (t.sin() + t.cos())).abs() < 1.2 * tf);
            assert!((sigma[1] - (t.cos() - t.sin())).abs() < 1.2 * tf);
            assert!((sigma[2] - (t.sin() + 2.0 * t.cos() - t.sin())).abs() < 1.2 * tf);
            assert!((sigma[3] - 0.4).abs() < 1e-15);
        }
    }
}

#[test]
fn the_control_gain_is_the_slope_of_sigma_over_a_velocity_impulse() {
    let free = SurfaceConfig::AccelerationFree { heave_rate_weight: 1.0.try_into().expect("positive") };
    let printed = |tf: f64| {
        let lead = 1.0 / tf;
        [(1.0 + lead) / 150.0, (1.0 + lead) / 175.0, (2.0 + lead) / 200.0, 1.0 / 14.0]
    };
    let cases = [
        (lead(0.3), printed(0.3)),
        (lead(1.7), printed(1.7)),
        (free, [1.0 / 150.0, 1.0 / 175.0, 1.0 / 200.0, 1.0 / 14.0]),
    ];
    for (config, expected) in cases {
        let mut surface = Surface::new(&config);
        let mut draw = Stream::new(5, "warm up");
        for _ in 0..50 {
            surface.step(&random_errors(&mut draw), H_S);
        }
        let gain = surface.control_gain(&nominal()).expect("relative degree 1");
        let rest = [0.1, -0.2, 0.3, -0.4];
        let at = |delta: Vector4<f64>| {
            let x1 = [rest[0] + delta[0], rest[1] + delta[1], rest[2], rest[3]];
            surface.clone().step(&errors(x1, 0.05 + delta[2], -0.03 + delta[3]), H_S)
        };
        let base = at(Vector4::zeros());
        for i in 0..4 {
            // A force F over dt changes the velocity by F dt/m: σ changes by G F dt.
            let impulse = Vector4::ith(i, 1e-3 * nominal().M_inv()[i]);
            let slope = (at(impulse) - base) / 1e-3;
            assert!((slope[i] / gain[i] - 1.0).abs() < 1e-8, "axis {i}: {} against {}", slope[i], gain[i]);
            assert!((gain[i] / expected[i] - 1.0).abs() < 1e-14, "axis {i}: {} against {}", gain[i], expected[i]);
            for j in (0..4).filter(|j| *j != i) {
                assert!(slope[j].abs() < 1e-12, "axes do not mix");
            }
        }
    }
}

#[test]
fn the_literal_surface_has_no_control_gain_and_no_implicit_form() {
    assert_eq!(Surface::new(&SurfaceConfig::ModelAcceleration).control_gain(&nominal()), None);
    for name in ["agsta-implicit", "gsta-implicit"] {
        let refusal = law_config_with(name, [("surface", "model_acceleration")])
            .build(&nominal())
            .expect_err("relative degree 0");
        assert_eq!(
            refusal,
            "law.discretisation = \"implicit\": must be \"explicit\" with surface = \"model_acceleration\", \
             which has relative degree 0"
        );
    }
}

#[test]
fn the_literal_surface_takes_the_models_acceleration() {
    let mut surface = Surface::new(&SurfaceConfig::ModelAcceleration);
    let mut error = errors([0.1, 0.2, 0.3, 0.4], 0.05, 0.06);
    error.model_acceleration = Vector4::new(1.0, 2.0, 3.0, 4.0);
    let expected = Vector4::new(0.1 + 1.0, 0.2 + 2.0, 0.3 + 2.0 * 0.05 + 3.0, 0.4 + 0.06);
    assert!((surface.step(&error, H_S) - expected).amax() < 1e-15);
}

// ----------------------------------------------------------------------------------------------------- the hand-over

#[test]
fn every_law_of_every_file_takes_over_without_a_jump() {
    let mut draw = Stream::new(8, "hand-over");
    for name in FILES.split(' ') {
        for warm_up in [0, 1, 200] {
            for limited in [[false; 4], [true, false, true, false]] {
                let mut law = law(name);
                for _ in 0..warm_up {
                    let error = random_errors(&mut draw);
                    law.step(&input(&error));
                }
                let (error, applied) = (random_errors(&mut draw), random_wrench(&mut draw));
                let now = LawInput { limited, ..input(&error) };
                law.start_from(&now, &applied);
                let jump = (law.step(&now) - applied).amax();
                assert!(jump < 1e-9, "{name} after {warm_up} steps: {jump}");
            }
        }
    }
}

#[test]
fn a_pid_axis_without_integral_gain_can_only_start_from_its_own_force() {
    let mut law = law_with("pid", "ki", axes([5.0, 0.0, 1.0, 0.5]));
    let error = errors([0.1, 0.1, 0.1, 0.1], 0.0, 0.0);
    let applied = Vector4::new(10.0, 20.0, 30.0, 4.0);
    law.start_from(&input(&error), &applied);
    let wrench = law.step(&input(&error));
    assert!((wrench[1] + 200.0 * 0.1).abs() < 1e-12, "sway: −kp e");
    for i in [0, 2, 3] {
        assert!((wrench[i] - applied[i]).abs() < 1e-9);
    }
}

// ------------------------------------------------------------------------------------------------------------- errors

#[test]
fn tracking_errors_are_those_of_eq_4_with_the_heading_wrapped() {
    use supertwin_core::message::{Nav, Reference};
    let nav = Nav {
        depth_m: 3.0,
        heading_rad: -3.1,
        velocity: [0.3, -0.1, 0.05, 0.02].into(),
        acceleration: [1.0, 2.0, 3.0, 4.0].into(),
        ..Nav::default()
    };
    let reference = Reference {
        surge_m_per_s: 0.1,
        surge_m_per_s2: 0.01,
        sway_m_per_s: 0.2,
        sway_m_per_s2: 0.02,
        depth_m: 2.5,
        depth_m_per_s: 0.04,
        depth_m_per_s2: 0.03,
        heading_rad: 3.1,
        heading_rad_per_s: -0.01,
        heading_rad_per_s2: 0.05,
        ..Reference::default()
    };
    let error = TrackingError::new(&nav, &reference);
    let turn = core::f64::consts::TAU - 6.2;
    assert!((error.x1 - Vector4::new(0.2, -0.3, 0.5, turn)).amax() < 1e-12, "{}", error.x1);
    assert!((error.velocity - Vector4::new(0.2, -0.3, 0.01, 0.03)).amax() < 1e-12);
    assert!((error.model_acceleration - Vector4::new(0.99, 1.98, 2.97, 3.95)).amax() < 1e-12);
}

#[test]
fn a_law_shows_what_it_says_that_it_has() {
    for name in FILES.split(' ') {
        for law in law_config(name).family().expect("legal") {
            let shown = Snapshot::of(&law);
            for capability in law.capabilities() {
                assert!(shown.get(capability.signal()).is_some(), "{name}: {capability:?}");
            }
            let (has, sample) = (|one| law.capabilities().contains(&one), law.sample());
            assert_eq!(has(Capability::SlidingVariable), sample.sigma.is_some(), "{name}");
            assert_eq!(has(Capability::Gains), sample.k1.is_some(), "{name}");
            assert_eq!(has(Capability::AdaptiveGains), sample.alpha_tol.is_some(), "{name}");
        }
    }
}
