//! The table of ages: what the controller does when an input is stale.

use super::{Inputs, LIMIT_TICKS, Vehicle, controller, forces, nav, reference, reference_seen, run};
use crate::common::H_S;
use supertwin_core::Input;
use supertwin_core::frame::ssa;
use supertwin_core::message::{Mode, Reference, Thrust, WrenchRequest};
use supertwin_gnc::control::Status;

#[test]
fn without_navigation_there_is_no_force() {
    let (nav, reference, idle) = (nav(), reference(), Thrust::default());
    let mut controller = controller(&["pid-tuned"]);
    let fresh = Inputs { applied: Input::Missing, ..Inputs::fresh(&nav, &reference, &idle) };
    assert!(forces(&fresh.step(&mut controller, 0)) > 1.0);
    assert_eq!(controller.status, Status::Tracking);
    // Held up to the limit it still counts, whatever the reference says.
    for age in 1..=LIMIT_TICKS {
        let held = Inputs { nav: Input::Held { value: &nav, made_at: 0 }, ..fresh };
        held.step(&mut controller, age);
        assert_eq!(controller.status, Status::Tracking, "age {age}");
    }
    for (k, stale) in [(LIMIT_TICKS + 1, Input::Held { value: &nav, made_at: 0 }), (LIMIT_TICKS + 2, Input::Missing)] {
        let thrust = Inputs { nav: stale, ..fresh }.step(&mut controller, k);
        assert_eq!(controller.status, Status::NavStale);
        assert_eq!(forces(&thrust), 0.0);
        assert_eq!((thrust.requested, thrust.allocated), Default::default());
        assert_eq!(thrust.force_n.len(), 6, "every thruster is told");
    }
}

#[test]
fn navigation_that_comes_back_starts_from_the_zero_wrench_that_was_applied() {
    let (nav, reference) = (nav(), reference());
    for name in ["pid", "pid-tuned", "gsta", "gsta-tuned", "gsta-implicit", "agsta", "agsta-implicit"] {
        let mut controller = controller(&[name]);
        let applied = run(&mut controller, 200, &nav, &reference);
        let blind = Inputs { nav: Input::Missing, ..Inputs::fresh(&nav, &reference, &applied) };
        let applied = blind.step(&mut controller, 200);
        let back = Inputs::fresh(&nav, &reference, &applied).step(&mut controller, 201);
        assert!(back.requested.vector().amax() < 1e-9, "{name}: {:?}", back.requested);
    }
}

#[test]
fn a_neutral_reference_is_no_force() {
    let (nav, idle) = (nav(), Thrust::default());
    let neutral = Reference { mode: Mode::Neutral, ..reference() };
    let mut controller = controller(&["agsta"]);
    let thrust = Inputs::fresh(&nav, &neutral, &idle).step(&mut controller, 0);
    assert_eq!((forces(&thrust), controller.status), (0.0, Status::Neutral));
}

#[test]
fn without_a_reference_the_vehicle_brakes_within_its_limits_and_holds() {
    let nav = nav();
    let moving = Reference {
        surge_m_per_s: 0.3,
        sway_m_per_s: -0.2,
        depth_m_per_s: 0.1,
        heading_rad: 3.1,
        heading_rad_per_s: 0.1,
        ..reference()
    };
    let mut controller = controller(&["pid-tuned"]);
    let mut applied = Inputs::fresh(&nav, &moving, &Thrust::default()).step(&mut controller, 0);
    // Old but young enough: still followed.
    let held = Input::Held { value: &moving, made_at: 0 };
    for k in 1..=LIMIT_TICKS {
        applied = Inputs { reference: held, ..Inputs::fresh(&nav, &moving, &applied) }.step(&mut controller, k);
        assert_eq!(controller.status, Status::Tracking);
        assert!((reference_seen(&controller, &nav)[0] - 0.3).abs() < 1e-12);
    }
    let mut before = reference_seen(&controller, &nav);
    let mut slope_before = [0.0; 6];
    let mut travelled = [0.0; 2];
    for k in LIMIT_TICKS + 1..LIMIT_TICKS + 500 {
        let stale = if k % 2 == 0 { Input::Missing } else { held };
        applied = Inputs { reference: stale, ..Inputs::fresh(&nav, &moving, &applied) }.step(&mut controller, k);
        assert_eq!(controller.status, Status::Fallback);
        let now = reference_seen(&controller, &nav);
        // Surge, sway, depth rate, heading rate fall within 0.15 per second and 0.5 per second squared.
        for i in [0, 1, 4, 5] {
            let slope = (now[i] - before[i]) / H_S;
            assert!(slope.abs() <= 0.15 + 1e-9, "tick {k}, {i}: {slope}");
            assert!((slope - slope_before[i]).abs() <= 0.5 * H_S + 1e-9, "tick {k}, {i}: {slope}");
            assert!(now[i].abs() <= before[i].abs() + 1e-12, "brakes only");
            slope_before[i] = slope;
        }
        // Depth and heading go where their rates take them, and stay there.
        assert!((now[2] - before[2] - H_S * now[4]).abs() < 1e-9);
        assert!((ssa(now[3] - before[3]) - H_S * now[5]).abs() < 1e-9);
        travelled[0] += now[2] - before[2];
        travelled[1] += ssa(now[3] - before[3]);
        before = now;
    }
    assert!([before[0], before[1], before[4], before[5]].iter().all(|rate| rate.abs() < 1e-3), "{before:?}");
    assert!((0.05..0.3).contains(&travelled[0]) && (0.05..0.3).contains(&travelled[1]), "{travelled:?}");
    assert!(before[3] < -2.5, "the heading went on across the seam: {}", before[3]);
}

#[test]
fn without_any_reference_from_the_start_the_vehicle_holds_where_it_is() {
    let nav = nav();
    let mut controller = controller(&["gsta-tuned"]);
    let (unused, idle) = (Reference::default(), Thrust::default());
    for k in 0..100 {
        Inputs { reference: Input::Missing, ..Inputs::fresh(&nav, &unused, &idle) }.step(&mut controller, k);
        assert_eq!(controller.status, Status::Fallback);
        let seen = reference_seen(&controller, &nav);
        let expected = [0.0, 0.0, 4.0, 0.6, 0.0, 0.0];
        assert!(seen.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{seen:?}");
    }
}

#[test]
fn a_link_that_comes_back_while_holding_makes_no_jump() {
    let hold = Reference { mode: Mode::DepthHeadingHold, depth_m: 4.0, heading_rad: 0.5, ..Reference::default() };
    for name in ["pid-tuned", "gsta-tuned", "agsta"] {
        let mut controller = controller(&[name]);
        let mut vehicle = Vehicle::new();
        let mut last = vehicle.run(&mut controller, 3000, Some(&hold));
        for (label, reference, ticks) in [("lost", None, 250), ("back", Some(&hold), 250)] {
            for _ in 0..ticks {
                let now = vehicle.step(&mut controller, reference);
                let jump = (now.requested.vector() - last.requested.vector()).amax();
                // The same reference as before: no more than the law's own creep from tick to tick. The 1 N dead
                // band of the thrusters keeps all of them in a small cycle.
                assert!(jump < 2.0, "{name}, {label}: {jump} N");
                last = now;
            }
        }
        assert_eq!(controller.status, Status::Tracking);
    }
}

#[test]
fn a_link_that_comes_back_on_the_move_jumps_by_no_more_than_the_law_answers_to_the_speed() {
    // Cut for 10 s at 0.2 m/s: the vehicle has stopped by itself. The reference that returns asks for 0.2 m/s at once.
    let follow =
        Reference { mode: Mode::FollowNet, sway_m_per_s: 0.2, depth_m: 4.0, heading_rad: 0.5, ..Reference::default() };
    let mut controller = controller(&["pid-tuned"]);
    let mut vehicle = Vehicle::new();
    vehicle.run(&mut controller, 2000, Some(&follow));
    let before = vehicle.run(&mut controller, 500, None);
    assert!(vehicle.nu[1].abs() < 0.03, "it has stopped: {}", vehicle.nu[1]);
    let after = vehicle.step(&mut controller, Some(&follow));
    let jump = after.requested.vector() - before.requested.vector();
    // kp · 0.2 m/s = 60 N in sway, and nothing elsewhere.
    assert!((jump[1] - 300.0 * 0.2).abs() < 1.0, "{jump}");
    assert!(jump[0].abs() < 0.5 && jump[2].abs() < 0.5 && jump[3].abs() < 0.5, "{jump}");
    assert_eq!(after.limited.to_array(), [false; 4]);
}

#[test]
fn a_wrench_request_that_is_too_old_leaves_the_substitute_in_command() {
    let (nav, reference) = (nav(), reference());
    let request = WrenchRequest { surge_n: Some(30.0), ..WrenchRequest::default() };
    let request = Input::Held { value: &request, made_at: 0 };
    let mut controller = controller(&["external"]);
    let mut applied = Thrust::default();
    for k in 0..=LIMIT_TICKS {
        applied = Inputs { request, ..Inputs::fresh(&nav, &reference, &applied) }.step(&mut controller, k);
        assert_eq!(applied.requested.surge_n, 30.0, "age {k}");
    }
    let k = LIMIT_TICKS + 1;
    let inputs = Inputs { request, ..Inputs::fresh(&nav, &reference, &applied) };
    let handed_back = inputs.step(&mut controller, k);
    assert!((handed_back.requested.surge_n - 30.0).abs() < 1e-9, "without a jump");
    let own = Inputs { request: Input::Missing, ..inputs }.step(&mut controller, k + 1);
    assert!((own.requested.surge_n - 30.0).abs() > 1e-3, "the substitute moves it: {}", own.requested.surge_n);
}
