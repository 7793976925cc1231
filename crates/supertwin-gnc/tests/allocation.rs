//! Allocation: exact within the limits, direction-preserving beyond them, never more than a thruster can do.

use crate::common::{thrusters, tolerance};
use nalgebra::{Vector3, Vector4};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use supertwin_gnc::Allocation;

const MAX_N: f64 = 100.0;

fn allocation(dead_band_n: f64) -> Allocation {
    Allocation::new(thrusters(), dead_band_n, &tolerance())
}

fn wrenches(scale: f64) -> impl Strategy<Value = Vector4<f64>> {
    let one = -1.0..1.0f64;
    [one.clone(), one.clone(), one.clone(), one]
        .prop_map(move |x| Vector4::from(x).component_mul(&Vector4::new(283.0, 283.0, 200.0, 147.0)) * scale)
}

fn flags(requested: &Vector4<f64>, allocated: &Vector4<f64>) -> [bool; 4] {
    core::array::from_fn(|i| (allocated[i] - requested[i]).abs() > 3.0 + 0.05 * requested[i].abs())
}

proptest! {
    // The cases are the same in every run.
    #![proptest_config(
        ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() }
    )]

    #[test]
    fn a_wrench_within_the_limits_is_allocated_exactly(tau in wrenches(0.6)) {
        prop_assume!(thrusters().forces(&tau).amax() <= MAX_N);
        let allocated = allocation(0.0).allocate(&tau);
        prop_assert!((allocated.wrench - tau).amax() < 1e-9);
        prop_assert_eq!(allocated.limited, [false; 4]);
    }

    #[test]
    fn no_thruster_is_asked_for_more_than_it_can_do(tau in wrenches(50.0), dead_band_n in 0.0..5.0f64) {
        let allocated = allocation(dead_band_n).allocate(&tau);
        for i in 0..6 {
            let force = allocated.force_n[i].abs();
            prop_assert!(force <= MAX_N * (1.0 + 1e-12), "thruster {}: {}", i, force);
            prop_assert!(force >= dead_band_n || force <= 0.0, "thruster {}: {} inside the dead band", i, force);
        }
        prop_assert_eq!(allocated.force_n[6], 0.0);
        prop_assert_eq!(allocated.force_n[7], 0.0);
        prop_assert!((thrusters().wrench(&allocated.force_n) - allocated.wrench).amax() < 1e-12);
    }

    #[test]
    fn the_horizontal_part_keeps_its_direction_and_heave_saturates_by_itself(tau in wrenches(5.0)) {
        let horizontal = |w: &Vector4<f64>| Vector3::new(w[0], w[1], w[3]);
        let allocated = allocation(0.0).allocate(&tau);
        let (wanted, got) = (horizontal(&tau), horizontal(&allocated.wrench));
        prop_assert!(wanted.cross(&got).norm() <= 1e-9 * wanted.norm() * got.norm().max(1.0));
        prop_assert!(wanted.dot(&got) >= 0.0);
        // One group at its limit says nothing about the other.
        let heave = tau[2].clamp(-200.0, 200.0);
        prop_assert!((allocated.wrench[2] - heave).abs() < 1e-9);
        // Scaled by exactly as much as the worst thruster needs.
        let forces = thrusters().forces(&tau);
        let worst = (0..4).map(|i| forces[i].abs()).fold(0.0, f64::max);
        let share = (MAX_N / worst).min(1.0);
        prop_assert!((got - wanted * share).amax() < 1e-9);
    }

    #[test]
    fn an_axis_is_flagged_when_it_changes_by_more_than_the_tolerance(tau in wrenches(3.0), dead_band_n in 0.0..20.0f64) {
        let allocated = allocation(dead_band_n).allocate(&tau);
        prop_assert_eq!(allocated.limited, flags(&tau, &allocated.wrench));
    }

    #[test]
    fn finite_wrenches_make_finite_forces(tau in prop::array::uniform4(-1e300..1e300f64).prop_map(Vector4::from)) {
        let allocated = allocation(1.0).allocate(&tau);
        prop_assert!(allocated.force_n.iter().chain(allocated.wrench.iter()).all(|x| x.is_finite()));
    }
}

#[test]
fn no_wrench_no_force() {
    let allocated = allocation(1.0).allocate(&Vector4::zeros());
    assert_eq!(allocated.force_n.amax(), 0.0);
    assert_eq!(allocated.wrench, Vector4::zeros());
    assert_eq!(allocated.limited, [false; 4]);
}

#[test]
fn forces_inside_the_dead_band_are_dropped_and_flag_nothing() {
    // 2 N of heave are 1 N per thruster: at the band's edge, still made; 1.9 N are not.
    let at = |heave_n: f64| allocation(1.0).allocate(&Vector4::new(0.0, 0.0, heave_n, 0.0)).wrench[2];
    assert!((at(2.0) - 2.0).abs() < 1e-12);
    assert!((at(-2.0) + 2.0).abs() < 1e-12);
    assert_eq!(at(1.9), 0.0);
    assert_eq!(allocation(1.0).allocate(&Vector4::new(0.0, 0.0, 1.9, 0.0)).limited, [false; 4]);
}

#[test]
fn beyond_the_single_axis_limits_only_the_axis_itself_is_limited() {
    for (axis, limit) in [(0, 282.8), (1, 282.8), (2, 200.0), (3, 147.1)] {
        let allocated = allocation(0.0).allocate(&Vector4::ith(axis, -2.0 * limit));
        assert!((allocated.wrench[axis] + limit).abs() < 0.05, "axis {axis}: {}", allocated.wrench[axis]);
        for i in 0..4 {
            assert_eq!(allocated.limited[i], i == axis);
        }
    }
}

#[test]
fn the_saturation_flag_is_that_of_section_5() {
    // |tau_alloc − tau| > 3 + 5 %.
    assert_eq!((tolerance().tolerance_n.get(), tolerance().tolerance_share.get()), (3.0, 0.05));
}
