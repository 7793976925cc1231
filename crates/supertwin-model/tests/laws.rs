//! Laws of the equation of motion, the thruster matrix and the sonar array; oracles: control.md, tests T6 and T8.

#[path = "../../../tests/support/config.rs"]
mod config;

use nalgebra::{SVector, Vector3, Vector4};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use supertwin_core::integrate::rk4;
use supertwin_core::random::Stream;
use supertwin_model::thrusters::{Forces, ThrustersError};
use supertwin_model::{Hydrodynamics, HydrodynamicsConfig, SonarArray, ThrusterConfig, Thrusters};

/// `M` of the Argus-Mini class (control.md, section 2), kg and kg m².
const INERTIA: [f64; 4] = [150.0, 175.0, 200.0, 14.0];
/// `D_l` of it, N s/m and N m s.
const LINEAR: [f64; 4] = [70.0, 120.0, 90.0, 10.0];
/// `D_q` of it.
const QUADRATIC: [f64; 4] = [200.0, 300.0, 350.0, 12.0];
/// Beam angle of the DVL.
const BEAM_DEG: f64 = 25.0;

fn model(net_buoyancy_n: f64) -> Hydrodynamics {
    let text = format!(
        "net_buoyancy_n = {net_buoyancy_n:?}
         rigid_body = {{ mass_kg = 90.0, yaw_inertia_kg_m2 = 9.0 }}
         added_mass = {{ surge_kg = 60.0, sway_kg = 85.0, heave_kg = 110.0, yaw_kg_m2 = 5.0 }}
         linear_damping = {{ surge_n_s_per_m = 70.0, sway_n_s_per_m = 120.0, heave_n_s_per_m = 90.0, yaw_nm_s_per_rad = 10.0 }}
         quadratic_damping = {{ surge_n_s2_per_m2 = 200.0, sway_n_s2_per_m2 = 300.0, heave_n_s2_per_m2 = 350.0, yaw_nm_s2_per_rad2 = 12.0 }}"
    );
    let config: HydrodynamicsConfig = toml::from_str(&text).expect("a legal model");
    Hydrodynamics::from(&config)
}

/// The cases are the same in every run.
fn the_same_cases() -> ProptestConfig {
    ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() }
}

fn vehicle_file() -> toml::Table {
    config::file("vehicles/argus-mini")
}

fn thruster_configs() -> Vec<ThrusterConfig> {
    config::read(vehicle_file()["thruster"].clone())
}

fn thrusters() -> Thrusters {
    Thrusters::new(&thruster_configs()).expect("fully actuated")
}

/// Any velocity up to twice the vehicle's terminal speed.
fn velocities() -> impl Strategy<Value = Vector4<f64>> {
    prop::array::uniform4(-2.0..2.0f64).prop_map(Vector4::from)
}

fn settle(model: &Hydrodynamics, nu: Vector4<f64>, tau: Vector4<f64>, for_s: f64) -> Vector4<f64> {
    let h_s = 0.01;
    let mut nu = nu;
    for _ in 0..(for_s / h_s).round() as usize {
        nu = rk4(&nu, h_s, |_, nu: &SVector<f64, 4>| model.acceleration(nu, &tau));
    }
    nu
}

// ------------------------------------------------------------------------------------------------ equation of motion

#[test]
fn the_vehicle_file_holds_the_parameters_of_section_2() {
    let file = vehicle_file();
    for (part, net_buoyancy_n) in [("true", 12.0), ("nominal", 0.0)] {
        let config: HydrodynamicsConfig = config::read(file[part].clone());
        assert_eq!(Hydrodynamics::from(&config), model(net_buoyancy_n), "{part}");
    }
    let model = model(12.0);
    assert_eq!(model.M(), Vector4::from(INERTIA));
    assert_eq!(model.D_l(), Vector4::from(LINEAR));
    assert_eq!(model.D_q(), Vector4::from(QUADRATIC));
    assert!((model.M().component_mul(&model.M_inv()) - Vector4::repeat(1.0)).amax() < 1e-15);
}

proptest! {
    #![proptest_config(the_same_cases())]

    /// T8: `nuᵀ C(nu) nu = 0`, because `C` is skew-symmetric.
    #[test]
    fn t8_coriolis_and_centripetal_forces_do_no_work(nu in velocities()) {
        let c = model(0.0).C(&nu);
        prop_assert_eq!(c + c.transpose(), nalgebra::Matrix4::zeros());
        // The oracle's largest is 7.1e-14 on its range; here each of the cancelling terms can reach 1400 W.
        prop_assert!(nu.dot(&(c * nu)).abs() < 1e-12);
        prop_assert!(nu.dot(&model(0.0).coriolis(&nu)).abs() < 1e-12);
    }

    #[test]
    fn the_matrix_times_the_velocity_is_the_coriolis_vector(nu in velocities()) {
        let model = model(0.0);
        prop_assert!((model.C(&nu) * nu - model.coriolis(&nu)).amax() < 1e-12);
    }

    #[test]
    fn damping_dissipates_at_every_velocity_but_zero(nu in velocities()) {
        prop_assume!(nu.norm() > 1e-6);
        let model = model(0.0);
        let power = nu.dot(&model.damping(&nu));
        // Not less than the linear part alone.
        let linear: f64 = (0..4).map(|i| LINEAR[i] * nu[i] * nu[i]).sum();
        prop_assert!(power >= linear * (1.0 - 1e-12) && power > 0.0, "{} against {}", power, linear);
    }

    #[test]
    fn kinetic_energy_falls_at_every_step_of_a_free_decay(nu in velocities()) {
        prop_assume!(nu.norm() > 0.01);
        let model = model(0.0);
        let energy = |nu: &Vector4<f64>| 0.5 * nu.dot(&model.M().component_mul(nu));
        let start = energy(&nu);
        let (mut nu, mut before) = (nu, start);
        for step in 0..500 {
            nu = settle(&model, nu, Vector4::zeros(), 0.02);
            let now = energy(&nu);
            prop_assert!(now < before, "step {}: {} after {}", step, now, before);
            before = now;
        }
        // Ten seconds are more than four of the longest time constants: exp(-2 · 10/2.22) = 1.2e-4.
        prop_assert!(before < 2e-4 * start);
    }
}

#[test]
fn positive_net_buoyancy_floats_up_and_moves_nothing_else() {
    let acceleration = model(12.0).acceleration(&Vector4::zeros(), &Vector4::zeros());
    assert_eq!(acceleration, Vector4::new(0.0, 0.0, -12.0 / 200.0, 0.0));
    // It rises at the speed at which drag balances 12 N: 350 w² + 90 w = 12.
    let rise = settle(&model(12.0), Vector4::zeros(), Vector4::zeros(), 60.0);
    let expected = (-90.0 + f64::sqrt(90.0 * 90.0 + 4.0 * 350.0 * 12.0)) / 700.0;
    assert!((rise[2] + expected).abs() < 1e-9, "{} against -{expected}", rise[2]);
    // Downward thrust of that size balances it exactly.
    let balanced = model(12.0).acceleration(&Vector4::zeros(), &Vector4::new(0.0, 0.0, 12.0, 0.0));
    assert_eq!(balanced, Vector4::zeros());
}

#[test]
fn terminal_surge_speed_at_full_thrust_is_1_03_m_per_s() {
    let tau = Vector4::new(283.0, 0.0, 0.0, 0.0);
    let u = settle(&model(12.0), Vector4::zeros(), tau, 60.0)[0];
    let exact = (-70.0 + f64::sqrt(70.0 * 70.0 + 4.0 * 200.0 * 283.0)) / 400.0;
    println!("terminal surge speed {u:.4} m/s (control.md: 1.03)");
    assert!((u - exact).abs() < 1e-9, "{u} against {exact}");
    assert!((u - 1.03).abs() < 0.005, "{u}");
}

#[test]
fn time_constants_at_rest_are_2_1_and_1_5_and_2_2_and_1_4_s() {
    let model = model(0.0);
    for (axis, expected_s) in [2.1, 1.5, 2.2, 1.4].into_iter().enumerate() {
        let linear_s = INERTIA[axis] / LINEAR[axis];
        assert!((linear_s - expected_s).abs() < 0.05, "axis {axis}: {linear_s} s");
        // And the equation of motion decays with it: at 1e-6 m/s the quadratic part is nothing.
        let mut nu = Vector4::ith(axis, 1e-6);
        let h_s = linear_s / 100.0;
        for _ in 0..100 {
            nu = rk4(&nu, h_s, |_, nu: &SVector<f64, 4>| model.acceleration(nu, &Vector4::zeros()));
        }
        let share = nu[axis] / 1e-6;
        assert!((share - (-1.0f64).exp()).abs() < 1e-5, "axis {axis}: {share}");
    }
}

#[test]
fn a_perturbed_model_is_wrong_by_its_factors() {
    let factors = Vector4::new(1.25, 0.75, 1.1, 0.9);
    let wrong = model(12.0).perturbed(&factors, &(factors * 2.0), &(factors * 3.0));
    for i in 0..4 {
        assert!((wrong.M()[i] / INERTIA[i] - factors[i]).abs() < 1e-15);
        assert!((wrong.M_inv()[i] * INERTIA[i] * factors[i] - 1.0).abs() < 1e-15);
        assert!((wrong.D_l()[i] / LINEAR[i] - 2.0 * factors[i]).abs() < 1e-15);
        assert!((wrong.D_q()[i] / QUADRATIC[i] - 3.0 * factors[i]).abs() < 1e-14);
    }
    assert_eq!(wrong.g(), model(12.0).g());
}

// --------------------------------------------------------------------------------------------------------- thrusters

#[test]
fn t8_the_thruster_matrix_has_rank_four_and_the_printed_columns() {
    let thrusters = thrusters();
    assert_eq!(thrusters.count(), 6);
    let singular = thrusters.B().svd(false, false).singular_values;
    assert!(singular.min() > 0.5, "{singular}");
    let printed = [
        [0.707, -0.707, 0.0, -0.368],
        [0.707, 0.707, 0.0, 0.368],
        [0.707, 0.707, 0.0, -0.368],
        [0.707, -0.707, 0.0, 0.368],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
    ];
    for (i, column) in printed.into_iter().enumerate() {
        let difference = (thrusters.B().column(i) - Vector4::from(column)).amax();
        assert!(difference <= 5e-4, "thruster {}: {}", i + 1, thrusters.B().column(i));
        assert_eq!(thrusters.is_vertical(i), i >= 4);
    }
    for i in 6..8 {
        assert_eq!(thrusters.B().column(i).amax(), 0.0, "no seventh and eighth thruster");
    }
}

#[test]
fn t8_single_axis_limits_are_283_and_283_and_200_and_147() {
    let thrusters = thrusters();
    for (axis, expected) in [282.8, 282.8, 200.0, 147.1].into_iter().enumerate() {
        let limit = 100.0 / thrusters.forces(&Vector4::ith(axis, 1.0)).amax();
        println!("limit of axis {axis}: {limit:.2} (control.md: {expected})");
        assert!((limit - expected).abs() < 0.06, "axis {axis}: {limit}");
    }
}

proptest! {
    #![proptest_config(the_same_cases())]

    /// `B B⁺ = I`, and `B⁺ tau` is the shortest solution: it has no part in the null space of `B`.
    #[test]
    fn the_pseudo_inverse_is_one(tau in prop::array::uniform4(-300.0..300.0f64).prop_map(Vector4::from)) {
        let thrusters = thrusters();
        let force = thrusters.forces(&tau);
        prop_assert!((thrusters.wrench(&force) - tau).amax() < 1e-9);
        // Null space of this layout: the front pair against the rear pair, and the vertical ones against each other.
        for null in [[1.0, 1.0, -1.0, -1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0]] {
            let null = Forces::from(null);
            prop_assert!(thrusters.wrench(&null).amax() < 1e-12);
            prop_assert!(force.dot(&null).abs() < 1e-9);
        }
    }
}

#[test]
fn thruster_sets_that_are_none_are_refused_with_number_and_rule() {
    let good = thruster_configs();
    let refusal = |set: &[ThrusterConfig]| Thrusters::new(set).expect_err("illegal").to_string();

    assert_eq!(refusal(&[]), "thruster: 0 thrusters given, must be 1 to 8");

    let nine: Vec<_> = good.iter().chain(&good).take(9).cloned().collect();
    assert_eq!(refusal(&nine), "thruster: 9 thrusters given, must be 1 to 8");

    let mut zero = good.clone();
    zero[2].direction = [0.0; 3].map(|x| x.try_into().expect("finite"));
    assert_eq!(refusal(&zero), "thruster[3].direction = [0, 0, 0]: must not be zero");

    // Without vertical thrusters there is no heave; with two parallel ones in front neither sway nor yaw.
    for set in [good[..4].to_vec(), vec![good[0].clone(), good[0].clone(), good[4].clone(), good[5].clone()]] {
        let error = Thrusters::new(&set).expect_err("rank below 4");
        assert_eq!(error, ThrustersError::Rank(4));
        assert!(error.to_string().contains("the 4 thrusters can't make every wrench"), "{error}");
    }
    // Eight are legal.
    let eight: Vec<_> = good.iter().chain(&good).take(8).cloned().collect();
    assert_eq!(Thrusters::new(&eight).expect("legal").count(), 8);
}

#[test]
fn the_length_of_a_direction_does_not_matter() {
    let mut long = thruster_configs();
    for thruster in &mut long {
        thruster.direction = thruster.direction.map(|x| (7.0 * x.get()).try_into().expect("finite"));
    }
    let difference = Thrusters::new(&long).expect("legal").B() - thrusters().B();
    assert!(difference.amax() < 1e-15);
}

// ------------------------------------------------------------------------------------------------------- sonar array

fn array() -> SonarArray {
    SonarArray::new(BEAM_DEG.to_radians())
}

/// Distance and bearing of the normal from inverse ranges.
fn distance_and_bearing(q: &[f64; 4]) -> (f64, f64) {
    let a = array().plane(q);
    (1.0 / a.norm(), a.y.atan2(a.x))
}

proptest! {
    #![proptest_config(the_same_cases())]

    /// T6: exact for every plane that all four beams meet.
    #[test]
    fn t6_the_plane_fit_is_exact_and_its_parity_is_zero(
        distance_m in 0.5..20.0f64,
        bearing_rad in -0.7..0.7f64,
        slope_rad in -0.7..0.7f64,
    ) {
        let normal = Vector3::new(bearing_rad.cos() * slope_rad.cos(), bearing_rad.sin() * slope_rad.cos(), slope_rad.sin());
        // From geometry, not from the inverse ranges: beam i meets n · p = d at r = d/(n · b_i).
        let meets = array().beams().map(|b| normal.dot(&b));
        prop_assume!(meets.iter().all(|m| *m > 0.05));
        let q = meets.map(|m| 1.0 / (distance_m / m));
        let a = array().plane(&q);
        prop_assert!((a - normal / distance_m).norm() < 1e-12);
        let (fitted_m, fitted_rad) = distance_and_bearing(&q);
        prop_assert!((fitted_m / distance_m - 1.0).abs() < 1e-12);
        prop_assert!((fitted_rad - bearing_rad).abs() < 1e-12);
        prop_assert!(SonarArray::parity(&q).abs() < 1e-12);
    }
}

#[test]
fn t6_a_cylinder_of_25_m_is_taken_for_a_plane_that_is_centimetres_nearer() {
    // Oracle: 1.9914, 2.9807, 4.9467 m at 2, 3, 5 m.
    for (true_m, expected_m) in [(2.0, 1.9914), (3.0, 2.9807), (5.0, 4.9467)] {
        let from_axis_m = 25.0 - true_m;
        let q = array().beams().map(|b| {
            // |[from_axis + s b_x, s b_y]| = 25.
            let horizontal2 = b.x * b.x + b.y * b.y;
            let along = from_axis_m * b.x;
            horizontal2 / ((along * along + horizontal2 * (25.0 * 25.0 - from_axis_m * from_axis_m)).sqrt() - along)
        });
        let (distance_m, bearing_rad) = distance_and_bearing(&q);
        println!("cylinder at {true_m} m: plane at {distance_m:.4} m (control.md: {expected_m})");
        assert!((distance_m - expected_m).abs() < 6e-5, "{distance_m}");
        assert!(bearing_rad.abs() < 1e-12 && SonarArray::parity(&q).abs() < 1e-12);
    }
}

#[test]
fn t6_range_noise_becomes_the_noise_of_section_3_2() {
    // Oracle: standard deviations of distance, bearing, parity at 3 m; 20,000 samples here know theirs to 0.5 %.
    let oracle = [(0.02, [0.0090, 0.0091, 0.0037]), (0.05, [0.0228, 0.0231, 0.0092]), (0.10, [0.0458, 0.0458, 0.0184])];
    let n = 20_000;
    for (range_std_m, printed) in oracle {
        let mut noise = Stream::new(6, "ranges");
        let (mut sum, mut sum2) = ([0.0; 3], [0.0; 3]);
        for _ in 0..n {
            let q = array().beams().map(|b| 1.0 / (3.0 / b.x + range_std_m * noise.normal()));
            let (distance_m, bearing_rad) = distance_and_bearing(&q);
            for (i, x) in [distance_m - 3.0, bearing_rad, SonarArray::parity(&q)].into_iter().enumerate() {
                sum[i] += x;
                sum2[i] += x * x;
            }
        }
        let n = f64::from(n);
        let std: [f64; 3] = core::array::from_fn(|i| (sum2[i] / n - (sum[i] / n) * (sum[i] / n)).sqrt());
        println!("range noise {range_std_m}: {std:.4?} (control.md: {printed:?})");
        for (measured, expected) in std.iter().zip(printed) {
            // 2 % and half a digit of the oracle's print.
            assert!((measured - expected).abs() < 0.02 * expected + 5e-5, "{std:?} at {range_std_m}");
        }
    }
}

#[test]
fn t6_one_blocked_beam_spoils_the_fit_and_shows_in_the_parity() {
    for (share, expected_m, expected_rad) in [(0.5, 1.82, 0.55), (0.8, 2.74, 0.18)] {
        let mut q = array().beams().map(|b| b.x / 3.0);
        q[0] /= share;
        let (distance_m, bearing_rad) = distance_and_bearing(&q);
        println!("one beam at {share}: {distance_m:.3} m, {bearing_rad:.3} rad ({expected_m}, {expected_rad})");
        assert!((distance_m - expected_m).abs() < 0.005, "{distance_m}");
        assert!((bearing_rad.abs() - expected_rad).abs() < 0.005, "{bearing_rad}");
        // Eight standard deviations of the parity noise at 0.05 m.
        assert!(SonarArray::parity(&q).abs() > 8.0 * 0.0092);
    }
}
