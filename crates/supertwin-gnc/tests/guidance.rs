//! Line of sight, reference models and the guidance block; oracles: control.md, tests T7 and T15.

mod stale;

use crate::common::{H_S, guidance_config, tick};
use core::f64::consts::PI;
use supertwin_core::command::{GuidanceCommand, Setpoint};
use supertwin_core::frame::ssa;
use supertwin_core::message::{Direction, Mode, Nav, NetEstimate, Reference};
use supertwin_core::observe::Snapshot;
use supertwin_core::random::Stream;
use supertwin_core::{Block, Input, OperatorLink, signal};
use supertwin_gnc::guidance::Reason;
use supertwin_gnc::los::{LineOfSight, PortSign};
use supertwin_gnc::reference_model::{ReferenceModel, ReferenceModelConfig};
use supertwin_gnc::{Guidance, GuidanceInput};

/// Age at which navigation is too old, as in `safety/standard.toml`.
const NAV_LIMIT_S: f64 = 0.5;
const NAV_LIMIT_TICKS: u64 = 25;

// ---------------------------------------------------------------------------------------------------------------- T7

/// `d(y_e)/dt` of a vehicle that moves as the law wants, heading anywhere, towards a plane net.
fn cross_track_rate(port_sign: PortSign, direction: Direction, y_e: f64, heading_rad: f64) -> f64 {
    let law = LineOfSight { lookahead_m: 2.0, port_sign };
    let net_heading_rad: f64 = 0.8;
    let desired = law.velocity(3.0 + y_e, 3.0, net_heading_rad, heading_rad, 0.2, direction);
    assert!((desired.cross_track_m - y_e).abs() < 1e-12);
    assert!((desired.surge_m_per_s.hypot(desired.sway_m_per_s) - 0.2).abs() < 1e-15, "always at U_d");
    // Outward speed of the vehicle, by geometry in NED: it closes the distance.
    let (s, c) = heading_rad.sin_cos();
    let north = c * desired.surge_m_per_s - s * desired.sway_m_per_s;
    let east = s * desired.surge_m_per_s + c * desired.sway_m_per_s;
    -(north * net_heading_rad.cos() + east * net_heading_rad.sin())
}

#[test]
fn t7_the_corrected_law_closes_the_distance_both_ways_and_the_printed_one_diverges_to_port() {
    // Columns of the oracle: s, y_e, corrected, printed.
    let oracle = [
        (Direction::Starboard, -1.0, 0.089, 0.089),
        (Direction::Starboard, 1.0, -0.089, -0.089),
        (Direction::Port, -1.0, 0.089, -0.089),
        (Direction::Port, 1.0, -0.089, 0.089),
    ];
    for (direction, y_e, corrected, printed) in oracle {
        for heading_rad in [0.8, 0.3, -2.0, 3.1] {
            let is_corrected = cross_track_rate(PortSign::Corrected, direction, y_e, heading_rad);
            let is_printed = cross_track_rate(PortSign::Printed, direction, y_e, heading_rad);
            // The oracle has three digits; exactly it is 0.2 sin(atan(1/2)) = 0.2/√5.
            assert!((is_corrected - corrected).abs() < 5e-4, "{direction:?}, {y_e}: {is_corrected}");
            assert!((is_printed - printed).abs() < 5e-4, "{direction:?}, {y_e}: {is_printed}");
            assert!((is_corrected.abs() - 0.2 / 5f64.sqrt()).abs() < 1e-12);
        }
    }
    println!("T7 |d(y_e)/dt| = {:.4} m/s (control.md: 0.089)", 0.2 / 5f64.sqrt());
}

#[test]
fn at_the_desired_distance_the_vehicle_travels_along_the_net_in_the_asked_direction() {
    let law = LineOfSight { lookahead_m: 2.0, port_sign: PortSign::Corrected };
    for (direction, sway) in [(Direction::Starboard, 0.2), (Direction::Port, -0.2)] {
        let desired = law.velocity(3.0, 3.0, -1.2, -1.2, 0.2, direction);
        assert!(desired.surge_m_per_s.abs() < 1e-15 && (desired.sway_m_per_s - sway).abs() < 1e-15);
    }
}

// --------------------------------------------------------------------------------------------------------------- T15

fn models() -> [(&'static str, ReferenceModelConfig); 3] {
    let reference = guidance_config("net-following").reference;
    [("velocity", reference.velocity), ("depth", reference.depth), ("heading", reference.heading)]
}

#[test]
fn t15_rate_and_acceleration_keep_their_limits_and_integrate_to_each_other() {
    for (name, config) in models() {
        let (max_rate, max_acceleration) = (config.max_rate.get(), config.max_acceleration.get());
        let mut model = ReferenceModel::new(&config);
        let mut draw = Stream::new(15, name);
        let mut reached = [0.0f64; 2];
        for _ in 0..200 {
            let target = 3.0 * draw.normal();
            for _ in 0..(draw.uniform(1.0, 300.0) as u32) {
                let before = model;
                model.step(target, H_S);
                assert!(model.rate.abs() <= max_rate && model.acceleration.abs() <= max_acceleration * (1.0 + 1e-12));
                assert!((before.rate + H_S * model.acceleration - model.rate).abs() < 1e-15, "realised acceleration");
                assert!((before.value + H_S * model.rate - model.value).abs() < 1e-14);
                reached = [reached[0].max(model.rate.abs()), reached[1].max(model.acceleration.abs())];
            }
        }
        assert!((reached[0] / max_rate - 1.0).abs() < 1e-9, "{name}: the limits were met");
        assert!((reached[1] / max_acceleration - 1.0).abs() < 1e-9, "{name}: the limits were met");
    }
}

#[test]
fn t15_without_saturation_a_reference_never_overshoots() {
    for (name, config) in models() {
        let mut model = ReferenceModel::new(&config);
        // Small enough that ω² e stays below the acceleration limit.
        let omega = config.natural_frequency_rad_per_s.get();
        let target = 0.5 * config.max_acceleration.get() / (omega * omega);
        for _ in 0..3000 {
            let before = model.value;
            model.step(target, H_S);
            assert!(model.value <= target * (1.0 + 1e-12) && model.value >= before, "{name}: monotonous");
        }
        assert!((model.value / target - 1.0).abs() < 1e-9, "{name} arrives: {}", model.value);
    }
}

#[test]
fn t15_it_is_critically_damped_with_its_natural_frequency() {
    for (name, config) in models() {
        let omega = config.natural_frequency_rad_per_s.get();
        let target = 1e-3;
        let mut model = ReferenceModel::new(&config);
        let mut t_s = 0.0;
        // e(t) = (1 + ωt) e^{−ωt}, up to the step's first-order error.
        while t_s < 5.0 / omega {
            model.step(target, H_S);
            t_s += H_S;
            let exact = 1.0 - (1.0 + omega * t_s) * (-omega * t_s).exp();
            assert!((model.value / target - exact).abs() < 1.5 * omega * H_S, "{name} at {t_s}");
        }
    }
}

#[test]
fn t15_saturated_references_do_not_overshoot_a_step_either() {
    for (name, config) in models() {
        for target in [0.01, 0.1, 0.5, 1.0, 3.0, 10.0] {
            let mut model = ReferenceModel::new(&config);
            let mut most: f64 = 0.0;
            for _ in 0..10_000 {
                model.step(target, H_S);
                most = most.max(model.value);
            }
            assert!(most <= target * (1.0 + 1e-12), "{name}, step of {target}: {most}");
            assert!((model.value / target - 1.0).abs() < 1e-9 && model.rate.abs() < 1e-9, "{name}: {}", model.value);
        }
    }
}

#[test]
fn t15_angles_take_the_short_way_across_plus_minus_pi_both_ways() {
    let heading = models()[2].1;
    for (from, to) in [(3.0, -3.0), (-3.0, 3.0), (PI - 0.01, -PI + 0.2), (1.0, -2.5)] {
        let mut model = ReferenceModel::new(&heading);
        model.hold(from);
        let way = ssa(to - from);
        let mut travelled = 0.0;
        let mut wrapped = false;
        for _ in 0..3000 {
            let before = model.value;
            model.step_angle(to, H_S);
            let step = ssa(model.value - before);
            wrapped |= (model.value - before).abs() > PI;
            assert!((-PI..PI).contains(&model.value), "{}", model.value);
            assert!(step.abs() <= heading.max_rate.get() * H_S * (1.0 + 1e-9), "no jump, not at the seam either");
            travelled += step;
        }
        assert!((travelled - way).abs() < 1e-6, "{from} to {to}: {travelled} against {way}");
        assert_eq!(wrapped, (from + way).abs() > PI, "{from} to {to}");
    }
}

// ---------------------------------------------------------------------------------------------------- the block, bits

/// The block with its clock.
#[derive(Clone)]
struct Bench {
    guidance: Guidance,
    k: u64,
}

impl Bench {
    /// At the first tick, with nothing commanded.
    fn idle() -> Self {
        Self { guidance: Guidance::new(&guidance_config("net-following"), NAV_LIMIT_S, H_S), k: 0 }
    }

    fn new(mode: Mode) -> Self {
        let mut bench = Self::idle();
        bench.ask(&GuidanceCommand::Mode(mode));
        bench
    }

    fn ask(&mut self, command: &GuidanceCommand) {
        self.guidance.command(tick(self.k), command).expect("obeyed");
    }

    fn step_with(&mut self, nav: Input<&Nav>, operator: OperatorLink) -> Reference {
        let reference = self.guidance.step(tick(self.k), GuidanceInput { nav, operator });
        self.k += 1;
        reference
    }

    fn step(&mut self, nav: &Nav) -> Reference {
        self.step_with(Input::Fresh(nav), OperatorLink::Present)
    }

    /// Steps on fresh, constant navigation; the last reference.
    fn run(&mut self, ticks: u64, nav: &Nav) -> Reference {
        (1..ticks).fold(self.step(nav), |_, _| self.step(nav))
    }

    fn reason(&self) -> Reason {
        self.guidance.reason
    }

    fn target(&self) -> [f64; 2] {
        let shown = Snapshot::of(&self.guidance);
        shown.get(&signal::guidance::TARGET).expect("shown").try_into().expect("two numbers")
    }
}

fn nav(depth_m: f64, heading_rad: f64) -> Nav {
    let net = NetEstimate { distance_m: 3.4, heading_rad: 0.5, valid: true, ..NetEstimate::default() };
    Nav { depth_m, heading_rad, net, ..Nav::default() }
}

#[test]
fn before_the_first_navigation_guidance_waits_in_neutral() {
    let mut bench = Bench::new(Mode::DepthHeadingHold);
    for _ in 0..10 {
        let reference = bench.step_with(Input::Missing, OperatorLink::Present);
        assert_eq!((reference.mode, bench.reason()), (Mode::Neutral, Reason::WaitingForNav));
    }
    let reference = bench.step(&nav(2.0, 0.7));
    assert_eq!((reference.mode, bench.reason()), (Mode::DepthHeadingHold, Reason::Commanded));
    assert_eq!((reference.depth_m, reference.heading_rad), (2.0, 0.7), "it holds where the vehicle is");
}

#[test]
fn neutral_keeps_the_references_on_the_vehicle() {
    let mut bench = Bench::idle();
    let mut draw = Stream::new(1, "drift");
    for _ in 0..200 {
        let here = nav(5.0 + draw.normal(), draw.uniform(-PI, PI));
        let (depth_m, heading_rad) = (here.depth_m, here.heading_rad);
        let expected = Reference { depth_m, heading_rad, net_distance_m: 3.0, ..Reference::default() };
        assert_eq!(bench.step(&here), expected);
    }
    // From there into hold: no step in depth or heading.
    let here = nav(4.2, -2.2);
    bench.step(&here);
    bench.ask(&GuidanceCommand::Mode(Mode::DepthHeadingHold));
    let reference = bench.run(500, &here);
    assert_eq!((reference.depth_m, reference.heading_rad), (4.2, -2.2));
}

#[test]
fn hold_goes_to_its_set_points_at_rest_in_surge_and_sway() {
    let mut bench = Bench::new(Mode::DepthHeadingHold);
    bench.step(&nav(1.5, 0.2));
    bench.ask(&GuidanceCommand::DepthM(Setpoint::Constant(3.5)));
    bench.ask(&GuidanceCommand::HeadingRad(Setpoint::Constant(-0.4)));
    let reference = bench.run(2000, &nav(1.5, 0.2));
    assert!((reference.depth_m - 3.5).abs() < 1e-4 && (reference.heading_rad + 0.4).abs() < 1e-6, "{reference:?}");
    assert_eq!((reference.surge_m_per_s, reference.sway_m_per_s, reference.speed_m_per_s), (0.0, 0.0, 0.0));
    assert_eq!(bench.target(), [3.5, -0.4]);
}

#[test]
fn following_the_net_faces_it_and_travels_by_line_of_sight() {
    let mut bench = Bench::new(Mode::FollowNet);
    // 0.4 m too far out at 0.2 m/s, facing the net: u_d = U sin(atan(0.4/2)), v_d = U cos(…) to starboard.
    let here = nav(2.0, 0.5);
    let angle = 0.2f64.atan();
    for (direction, side) in [(None, 1.0), (Some(Direction::Port), -1.0)] {
        direction.into_iter().for_each(|to| bench.ask(&GuidanceCommand::Direction(to)));
        let reference = bench.run(1500, &here);
        assert_eq!(reference.mode, Mode::FollowNet);
        assert!((reference.surge_m_per_s - 0.2 * angle.sin()).abs() < 1e-6, "towards the net: {reference:?}");
        assert!((reference.sway_m_per_s - side * 0.2 * angle.cos()).abs() < 1e-6, "{reference:?}");
        assert!((reference.heading_rad - 0.5).abs() < 1e-9);
        assert_eq!((reference.speed_m_per_s, reference.net_distance_m), (side * 0.2, 3.0));
    }
}

#[test]
fn set_points_follow_their_profiles() {
    let mut bench = Bench::new(Mode::DepthHeadingHold);
    let here = nav(2.0, 0.0);
    bench.step(&here);
    // A ramp, from where the set-point is.
    bench.ask(&GuidanceCommand::DepthM(Setpoint::Ramp { to: 5.0, over_s: 30.0 }));
    let mut reference = Reference::default();
    for k in 0..1500 {
        reference = bench.step(&here);
        let elapsed_s = f64::from(k) * H_S;
        assert!((bench.target()[0] - (2.0 + 0.1 * elapsed_s)).abs() < 1e-9, "at {elapsed_s} s");
    }
    // On a ramp a critically damped model trails by 2/ω of its slope.
    assert!((reference.depth_m_per_s - 0.1).abs() < 1e-4);
    assert!((bench.target()[0] - reference.depth_m - 0.1 * 2.0 / 0.6).abs() < 5e-3, "{}", reference.depth_m);
    // A sine about the depth, and another in heading across the seam.
    bench.ask(&GuidanceCommand::DepthM(Setpoint::Sine { mean: 5.0, amplitude: 0.5, period_s: 20.0 }));
    bench.ask(&GuidanceCommand::HeadingRad(Setpoint::Sine { mean: PI, amplitude: 0.3, period_s: 30.0 }));
    for k in 0..3000 {
        bench.step(&here);
        let elapsed_s = f64::from(k) * H_S;
        let [depth_m, heading_rad] = bench.target();
        assert!((depth_m - 5.0 - 0.5 * (PI * elapsed_s / 10.0).sin()).abs() < 1e-9);
        assert!((heading_rad - PI - 0.3 * (PI * elapsed_s / 15.0).sin()).abs() < 1e-9);
    }
    // Distance and speed along the net.
    bench.ask(&GuidanceCommand::Mode(Mode::FollowNet));
    bench.ask(&GuidanceCommand::NetDistanceM(Setpoint::Ramp { to: 2.0, over_s: 10.0 }));
    bench.ask(&GuidanceCommand::SpeedMPerS(Setpoint::Ramp { to: 0.4, over_s: 10.0 }));
    bench.ask(&GuidanceCommand::Direction(Direction::Port));
    let reference = bench.run(251, &here);
    assert!((reference.net_distance_m - 2.5).abs() < 1e-9 && (reference.speed_m_per_s + 0.3).abs() < 1e-9);
}

#[test]
fn a_vehicle_may_begin_at_its_greatest_speed_and_not_beyond() {
    let mut config = guidance_config("net-following");
    config.initial.speed_m_per_s = config.limits.speed_m_per_s.get().try_into().expect("legal");
    assert_eq!(config.check(), Ok(()));
    config.initial.speed_m_per_s = (config.limits.speed_m_per_s.get() + 0.01).try_into().expect("legal");
    assert!(config.check().expect_err("too fast").starts_with("initial.speed_m_per_s = "));
}

#[test]
fn set_points_outside_their_limits_are_refused_with_value_and_rule_and_change_nothing() {
    use GuidanceCommand::{DepthM, HeadingRad, NetDistanceM, SpeedMPerS};
    use Setpoint::Constant;
    let mut bench = Bench::new(Mode::FollowNet);
    let here = nav(2.0, 0.5);
    bench.run(100, &here);
    let mut untouched = bench.clone();
    let sine = Setpoint::Sine { mean: 0.3, amplitude: 0.5, period_s: 10.0 };
    let (at_once, too_far) = (Setpoint::Ramp { to: 3.0, over_s: 0.0 }, Setpoint::Ramp { to: 9.0, over_s: 5.0 });
    let a_turn = "heading_rad = inf: must lie between -6.283185307179586 and 6.283185307179586";
    for (command, message) in [
        (DepthM(Constant(20.0)), "depth_m = 20: must lie between 0 and 14"),
        (DepthM(sine), "depth_m = -0.2: must lie between 0 and 14"),
        (DepthM(Constant(f64::NAN)), "depth_m = NaN: must lie between 0 and 14"),
        (DepthM(at_once), "depth_m: the time 0 s must be at least 0.001 s and finite"),
        (NetDistanceM(Constant(0.5)), "net_distance_m = 0.5: must lie between 1 and 8"),
        (NetDistanceM(too_far), "net_distance_m = 9: must lie between 1 and 8"),
        (SpeedMPerS(Constant(0.6)), "speed_m_per_s = 0.6: must lie between 0 and 0.5"),
        (SpeedMPerS(Constant(-0.1)), "speed_m_per_s = -0.1: must lie between 0 and 0.5"),
        (HeadingRad(Constant(f64::INFINITY)), a_turn),
    ] {
        let refusal = bench.guidance.command(tick(bench.k), &command).expect_err("outside");
        assert_eq!(refusal.to_string(), message);
    }
    assert_eq!(bench.run(500, &here), untouched.run(500, &here));
}
