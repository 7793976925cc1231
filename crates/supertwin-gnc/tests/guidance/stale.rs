//! The guidance block, when its inputs are stale and its operator is lost.

use super::{Bench, NAV_LIMIT_TICKS, nav};
use crate::common::H_S;
use supertwin_core::command::{GuidanceCommand, Setpoint};
use supertwin_core::frame::ssa;
use supertwin_core::message::{Direction, Mode, Nav, NetEstimate, Reference};
use supertwin_core::{Input, OperatorLink};
use supertwin_gnc::guidance::Reason;

#[test]
fn stale_navigation_stops_the_reference_where_it_is() {
    for held in [true, false] {
        let mut bench = Bench::new(Mode::FollowNet);
        bench.ask(&GuidanceCommand::DepthM(Setpoint::Constant(6.0)));
        let here = nav(2.0, 0.0);
        let last = bench.run(100, &here);
        assert!(last.depth_m_per_s > 0.1 && last.sway_m_per_s > 0.05, "everything is moving");
        let made_at = bench.k - 1;
        let stale = if held { Input::Held { value: &here, made_at } } else { Input::Missing };
        // Up to the limit it goes on.
        while held && bench.k <= made_at + NAV_LIMIT_TICKS {
            bench.step_with(stale, OperatorLink::Present);
            assert_eq!(bench.reason(), Reason::Commanded, "age {}", bench.k - 1 - made_at);
        }
        let stopped = bench.step_with(stale, OperatorLink::Present);
        assert_eq!(bench.reason(), Reason::NavStale);
        assert_eq!((stopped.surge_m_per_s2, stopped.sway_m_per_s2), (0.0, 0.0));
        assert_eq!((stopped.depth_m_per_s, stopped.depth_m_per_s2), (0.0, 0.0));
        assert_eq!((stopped.heading_rad_per_s, stopped.heading_rad_per_s2), (0.0, 0.0));
        for _ in 0..100 {
            assert_eq!(bench.step_with(stale, OperatorLink::Present), stopped);
        }
        // Fresh again: it goes on from there, at its limits.
        let again = bench.step(&here);
        assert_eq!(bench.reason(), Reason::Commanded);
        assert!((again.depth_m - stopped.depth_m).abs() <= 0.08 * H_S * H_S * (1.0 + 1e-9));
        assert!((again.sway_m_per_s - stopped.sway_m_per_s).abs() <= 0.5 * H_S * H_S * (1.0 + 1e-9));
        assert!(ssa(again.heading_rad - stopped.heading_rad).abs() <= 0.2095 * H_S * H_S);
    }
}

#[test]
fn without_an_operator_the_vehicle_holds_depth_and_heading() {
    let mut bench = Bench::new(Mode::FollowNet);
    let here = nav(2.0, 0.5);
    let before = bench.run(1000, &here);
    let lost = |bench: &mut Bench| bench.step_with(Input::Fresh(&here), OperatorLink::Lost);
    let mut reference = lost(&mut bench);
    assert_eq!((reference.mode, bench.reason()), (Mode::DepthHeadingHold, Reason::OperatorLost));
    for _ in 0..1000 {
        reference = lost(&mut bench);
    }
    assert!(reference.surge_m_per_s.abs() < 1e-6 && reference.sway_m_per_s.abs() < 1e-6, "it has stopped");
    assert!((reference.heading_rad - before.heading_rad).abs() < 1e-9 && (reference.depth_m - 2.0).abs() < 1e-9);
    // Back in command, it takes up what was commanded.
    assert_eq!(bench.step(&here).mode, Mode::FollowNet);
    // Neutral stays neutral.
    bench.ask(&GuidanceCommand::Mode(Mode::Neutral));
    assert_eq!(lost(&mut bench).mode, Mode::Neutral);
}

#[test]
fn without_a_net_following_becomes_holding_until_the_net_is_seen_again() {
    let mut bench = Bench::new(Mode::FollowNet);
    let here = nav(2.0, 0.5);
    bench.run(500, &here);
    let mut blind = here.clone();
    blind.net.valid = false;
    // Numbers of an invalid net must not matter.
    (blind.net.distance_m, blind.net.heading_rad) = (0.0, 2.9);
    let reference = bench.step(&blind);
    assert_eq!((reference.mode, bench.reason()), (Mode::DepthHeadingHold, Reason::NetLost));
    let reference = bench.run(1000, &blind);
    assert!((reference.heading_rad - 0.5).abs() < 1e-6 && reference.sway_m_per_s.abs() < 1e-6, "{reference:?}");
    assert_eq!(reference.speed_m_per_s, 0.0);
    let reference = bench.step(&here);
    assert_eq!((reference.mode, bench.reason()), (Mode::FollowNet, Reason::Commanded));
}

/// A vehicle that does what the references say, in front of a plane net.
struct Follower {
    north_m: f64,
    east_m: f64,
    nav: Nav,
    net_heading_rad: f64,
}

impl Follower {
    fn new() -> Self {
        let mut follower = Self { north_m: 0.0, east_m: 0.0, nav: nav(1.5, 0.3), net_heading_rad: 3.0 };
        follower.look();
        follower
    }
    fn look(&mut self) {
        let (s, c) = self.net_heading_rad.sin_cos();
        self.nav.net = NetEstimate {
            distance_m: 3.8 - self.north_m * c - self.east_m * s,
            heading_rad: self.net_heading_rad,
            valid: true,
            ..NetEstimate::default()
        };
    }
    fn follow(&mut self, reference: &Reference) {
        let (s, c) = reference.heading_rad.sin_cos();
        self.north_m += H_S * (c * reference.surge_m_per_s - s * reference.sway_m_per_s);
        self.east_m += H_S * (s * reference.surge_m_per_s + c * reference.sway_m_per_s);
        self.nav.depth_m = reference.depth_m;
        self.nav.heading_rad = reference.heading_rad;
        // A net that bends away as one travels along it.
        self.net_heading_rad = ssa(self.net_heading_rad + 0.0004);
        self.look();
    }
}

#[test]
fn no_reference_jumps_at_any_mode_change_of_a_scripted_run() {
    use Setpoint::{Constant, Ramp};
    let mut bench = Bench::new(Mode::DepthHeadingHold);
    let mut vehicle = Follower::new();
    let mut last: Option<Reference> = None;
    let mut seen = Vec::new();
    let script = [
        (1, GuidanceCommand::DepthM(Constant(3.5))),
        (1000, GuidanceCommand::Mode(Mode::FollowNet)),
        (2500, GuidanceCommand::Direction(Direction::Port)),
        (3500, GuidanceCommand::SpeedMPerS(Constant(0.5))),
        (4000, GuidanceCommand::NetDistanceM(Constant(2.0))),
        // 5000 to 6000: no net. 7000 to 8000: no operator.
        (8500, GuidanceCommand::DepthM(Ramp { to: 8.0, over_s: 20.0 })),
        (9000, GuidanceCommand::Mode(Mode::DepthHeadingHold)),
        (9500, GuidanceCommand::HeadingRad(Constant(-2.9))),
        (10_200, GuidanceCommand::HeadingRad(Constant(2.9))),
        (11_000, GuidanceCommand::Mode(Mode::FollowNet)),
    ];
    for k in 0..12_000 {
        script.iter().filter(|(at, _)| *at == k).for_each(|(_, command)| bench.ask(command));
        vehicle.nav.net.valid = !(5000..6000).contains(&k);
        let operator = if (7000..8000).contains(&k) { OperatorLink::Lost } else { OperatorLink::Present };
        let reference = bench.step_with(Input::Fresh(&vehicle.nav), operator);
        if let Some(last) = &last {
            let eps = 1e-12;
            let turned = ssa(reference.heading_rad - last.heading_rad);
            let axis = |was: f64, is: f64, rate_was: f64, rate_is: f64, max_rate: f64, max_acceleration: f64| {
                assert!((is - was).abs() <= max_rate * H_S + eps, "tick {k}: {was} to {is}");
                assert!((rate_is - rate_was).abs() <= max_acceleration * H_S + eps, "tick {k}: {rate_was}, {rate_is}");
                assert!((is - was - H_S * rate_is).abs() < 1e-9, "tick {k}: the rate is the value's");
            };
            let (a, b) = (last, &reference);
            axis(a.surge_m_per_s, b.surge_m_per_s, a.surge_m_per_s2, b.surge_m_per_s2, 0.15, 0.5);
            axis(a.sway_m_per_s, b.sway_m_per_s, a.sway_m_per_s2, b.sway_m_per_s2, 0.15, 0.5);
            axis(a.depth_m, b.depth_m, a.depth_m_per_s, b.depth_m_per_s, 0.22, 0.08);
            let [max_rate, max_acceleration] = [10f64, 12.0].map(f64::to_radians);
            axis(0.0, turned, a.heading_rad_per_s, b.heading_rad_per_s, max_rate, max_acceleration);
        }
        if seen.last() != Some(&(reference.mode, bench.reason())) {
            seen.push((reference.mode, bench.reason()));
        }
        vehicle.follow(&reference);
        last = Some(reference);
    }
    let (hold, follow) = (Mode::DepthHeadingHold, Mode::FollowNet);
    let expected = [
        (hold, Reason::Commanded),
        (follow, Reason::Commanded),
        (hold, Reason::NetLost),
        (follow, Reason::Commanded),
        (hold, Reason::OperatorLost),
        (follow, Reason::Commanded),
        (hold, Reason::Commanded),
        (follow, Reason::Commanded),
    ];
    assert_eq!(seen, expected);
}

#[test]
fn line_of_sight_brings_a_perfect_vehicle_to_its_distance_both_ways() {
    for direction in [Direction::Starboard, Direction::Port] {
        let mut bench = Bench::new(Mode::FollowNet);
        let mut vehicle = Follower::new();
        bench.ask(&GuidanceCommand::Direction(direction));
        for _ in 0..5000 {
            let reference = bench.step(&vehicle.nav);
            vehicle.follow(&reference);
            vehicle.net_heading_rad = 3.0;
            vehicle.look();
        }
        let error = vehicle.nav.net.distance_m - 3.0;
        // Time constant Δ/U_d = 10 s: 0.8 m become centimetres within 100 s.
        assert!(error.abs() < 0.02, "{direction:?}: {error} m");
    }
}

#[test]
fn a_second_hold_begins_where_the_vehicle_is_unless_somebody_asked() {
    let mut bench = Bench::new(Mode::DepthHeadingHold);
    bench.run(10, &nav(2.0, 0.2));
    bench.ask(&GuidanceCommand::Mode(Mode::Neutral));
    bench.run(100, &nav(5.0, 1.5));
    bench.ask(&GuidanceCommand::Mode(Mode::DepthHeadingHold));
    let reference = bench.run(2000, &nav(5.0, 1.5));
    assert_eq!((reference.depth_m, reference.heading_rad), (5.0, 1.5));
}

#[test]
fn a_ramp_that_is_asked_for_before_the_first_navigation_begins_at_the_vehicle() {
    let mut bench = Bench::new(Mode::DepthHeadingHold);
    bench.ask(&GuidanceCommand::DepthM(Setpoint::Ramp { to: 5.0, over_s: 30.0 }));
    for _ in 0..1500 {
        let reference = bench.step(&nav(2.0, 0.2));
        assert!(reference.depth_m >= 2.0 - 1e-9, "never shallower than where it began: {}", reference.depth_m);
    }
}

#[test]
fn one_navigation_that_is_no_number_does_not_spoil_the_reference_for_good() {
    let mut bench = Bench::new(Mode::FollowNet);
    let good = nav(2.0, 0.5);
    bench.run(100, &good);
    bench.step(&Nav { heading_rad: f64::NAN, ..good.clone() });
    let reference = bench.run(100, &good);
    assert!(supertwin_core::Message::is_finite(&reference), "{reference:?}");
}
