//! Both net planes.

use super::{BEAM_RAD, band, ranges};
use crate::common::{self, H_S, estimator_config};
use nalgebra::Vector3;
use supertwin_core::frame::ssa;
use supertwin_core::message::DvlPing;
use supertwin_core::random::Stream;
use supertwin_gnc::net_plane::{InverseRange, NetPlaneConfig, RateGated};
use supertwin_model::SonarArray;

// ---------------------------------------------------------------------------------------------- the plane, rate-gated

fn rate_gated() -> RateGated {
    let NetPlaneConfig::RateGated(config) = estimator_config("paper").net_plane else { panic!("paper.toml") };
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
        let (d, psi, refused) = plane.state();
        assert_eq!(refused, 0);
        assert!((d - 3.0).abs() > 0.1 || psi.abs() > 0.1, "and believed: {d}, {psi}");
    }
}

#[test]
fn fish_leak_when_they_stay_longer_than_the_release() {
    let burst = |pings: u32| {
        let mut plane = rate_gated();
        for _ in 0..10 {
            plane.update(&dvl(ranges(3.0, 0.0)), 0.0);
        }
        let mut worst: f64 = 0.0;
        for _ in 0..pings {
            plane.update(&fish(0, 0.5), 0.0);
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
    common::put(&mut table, "net_plane.inverse_range.gate", gate);
    let config: supertwin_gnc::EstimatorConfig = common::read(table);
    let NetPlaneConfig::InverseRange(config) = config.net_plane else { panic!("plane-filter.toml") };
    InverseRange::new(&config, SonarArray::new(BEAM_RAD))
}

fn inverse_range() -> InverseRange {
    inverse_range_with(9.0)
}

const STILL: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);

/// A filter that has seen a plane once.
fn begun(distance_m: f64) -> InverseRange {
    let mut plane = inverse_range();
    plane.update(&dvl(ranges(distance_m, 0.0)));
    plane
}

/// The ranges to a plane at 3 m ahead, one of them shortened by a fish.
fn fish(blocked: usize, share: f64) -> DvlPing {
    let mut range = ranges(3.0, 0.0);
    range[blocked] = range[blocked].map(|range| share * range);
    dvl(range)
}

fn distance_m(plane: &InverseRange) -> f64 {
    plane.estimate(0.0).expect("a plane").distance_m
}

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
            // A burst of 2 s.
            for _ in 0..16 {
                assert!(plane.update(&fish(blocked, share)));
                let accepted: [bool; 4] = core::array::from_fn(|i| i != blocked);
                assert_eq!(plane.report.accepted, accepted, "beam {blocked} at {share}");
                rest(&mut plane);
            }
            let net = plane.estimate(0.0).expect("a plane");
            assert!((net.distance_m - 3.0).abs() < 1e-3, "{}", net.distance_m);
            assert!(net.heading_rad.abs() < 1e-3, "the rate-gated fit is 0.55 rad off here: {}", net.heading_rad);
            assert!(plane.report.parity_per_m.abs() > 0.03);
        }
    }
}

#[test]
fn missing_beams_are_left_out() {
    let mut plane = begun(3.0);
    rest(&mut plane);
    let mut two = ranges(3.0, 0.0);
    (two[1], two[3]) = (None, Some(f64::NAN));
    assert!(plane.update(&dvl(two)));
    assert_eq!(plane.report.accepted, [true, false, true, false]);
    assert!(!plane.update(&dvl([None; 4])));
    assert!((distance_m(&plane) - 3.0).abs() < 1e-9);
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
        assert_eq!(plane.report.accepted, [false; 4]);
        assert!((distance_m(&plane) - 3.0).abs() < 1e-9, "kept");
    }
    assert!(plane.update(&dvl(ranges(6.0, 0.1))), "the twenty-first is taken");
    let net = plane.estimate(0.0).expect("a plane");
    assert!((net.distance_m - 6.0).abs() < 1e-12 && (net.heading_rad - 0.1).abs() < 1e-12);
}

#[test]
fn it_does_not_begin_with_a_fish_in_the_ping() {
    let mut plane = inverse_range();
    for _ in 0..50 {
        assert!(!plane.update(&fish(2, 0.6)), "parity tells");
        assert_eq!(plane.estimate(0.0), None);
    }
    assert!(plane.update(&dvl(ranges(3.0, 0.0))));
}

#[test]
fn the_plane_stays_between_its_bounds() {
    let distance = |true_m: f64| distance_m(&begun(true_m));
    // |a| from 0.1 to 2.5 per metre: 10 m to 0.4 m.
    for (true_m, seen_m) in [(0.2, 0.4), (0.5, 0.5), (9.0, 9.0), (40.0, 10.0)] {
        assert!((distance(true_m) - seen_m).abs() < 1e-12, "{true_m}: {}", distance(true_m));
    }
    // Prediction keeps to them too: backing off for a long time, and running into the net.
    for (speed, bound_m) in [(-0.5, 10.0), (0.5, 0.4)] {
        let mut plane = begun(3.0);
        for _ in 0..5000 {
            plane.predict(&Vector3::new(speed, 0.0, 0.0), 0.0, H_S);
        }
        assert!((distance_m(&plane) - bound_m).abs() < 1e-9);
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
            (plane.a - moved_plane(&v, r, 4.0)).norm()
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
