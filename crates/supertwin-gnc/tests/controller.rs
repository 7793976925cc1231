//! The controller block: what it does when inputs are stale, when laws change, and when numbers are none.

mod ages;

use crate::common::{self, H_S, law_config, nominal, thrusters, tick};
use nalgebra::{SVector, Vector4};
use supertwin_core::command::ControllerCommand;
use supertwin_core::frame::ssa;
use supertwin_core::integrate::rk4;
use supertwin_core::message::{Mode, Nav, Reference, Thrust, WrenchRequest};
use supertwin_core::observe::Snapshot;
use supertwin_core::random::Stream;
use supertwin_core::{Block, Input, Message, Prev, signal};
use supertwin_gnc::control::{ControllerLimits, ControllerSetup, FallbackConfig, Status};
use supertwin_gnc::{Allocation, Controller, ControllerInput, LawConfig};

/// Ages in `safety/standard.toml`: 0.5 s at 50 Hz.
const LIMIT_TICKS: u64 = 25;

fn try_build(laws: &[(&str, &LawConfig)]) -> Result<Controller, String> {
    let safety = common::file("safety/standard");
    let limits: ControllerLimits = common::read(safety["controller"].clone());
    let fallback: FallbackConfig = common::read(safety["fallback"].clone());
    Controller::new(&ControllerSetup {
        laws: laws.iter().map(|(name, law)| ((*name).to_owned(), *law)).collect(),
        model: nominal(),
        allocation: Allocation::new(thrusters(), 1.0, &common::tolerance()),
        limits: &limits,
        fallback: &fallback,
        dt_s: H_S,
    })
}

fn controller(names: &[&str]) -> Controller {
    let configs: Vec<LawConfig> = names.iter().map(|name| law_config(name)).collect();
    let laws: Vec<(&str, &LawConfig)> = names.iter().copied().zip(&configs).collect();
    try_build(&laws).expect("legal")
}

/// All inputs of a tick; fresh unless said otherwise.
#[derive(Clone, Copy)]
struct Inputs<'a> {
    nav: Input<&'a Nav>,
    reference: Input<&'a Reference>,
    applied: Input<&'a Thrust>,
    request: Input<&'a WrenchRequest>,
}

impl<'a> Inputs<'a> {
    fn fresh(nav: &'a Nav, reference: &'a Reference, applied: &'a Thrust) -> Self {
        let (nav, reference, applied) = (Input::Fresh(nav), Input::Fresh(reference), Input::Fresh(applied));
        Self { nav, reference, applied, request: Input::Missing }
    }
    fn step(self, controller: &mut Controller, k: u64) -> Thrust {
        let Self { nav, reference, applied, request: wrench_request } = self;
        controller.step(tick(k), ControllerInput { nav, reference, applied: Prev(applied), wrench_request })
    }
}

/// Steps on fresh, constant inputs from the first tick on; the last thrust.
fn run(controller: &mut Controller, ticks: u64, nav: &Nav, reference: &Reference) -> Thrust {
    let step = |applied, k| Inputs::fresh(nav, reference, &applied).step(controller, k);
    (0..ticks).fold(Thrust::default(), step)
}

fn nav() -> Nav {
    Nav { depth_m: 4.0, heading_rad: 0.6, velocity: [0.02, 0.15, -0.01, 0.01].into(), ..Nav::default() }
}

fn reference() -> Reference {
    Reference {
        mode: Mode::FollowNet,
        surge_m_per_s: 0.05,
        sway_m_per_s: 0.2,
        depth_m: 4.1,
        heading_rad: 0.55,
        ..Reference::default()
    }
}

fn forces(thrust: &Thrust) -> f64 {
    thrust.force_n.iter().fold(0.0, |most: f64, force| most.max(force.abs()))
}

/// The references behind the errors that the controller shows.
fn reference_seen(controller: &Controller, nav: &Nav) -> [f64; 6] {
    let shown = Snapshot::of(controller);
    let x1 = shown.get(&signal::controller::ERROR).expect("shown").to_vec();
    let velocity = shown.get(&signal::controller::VELOCITY_ERROR).expect("shown").to_vec();
    let nu = nav.velocity.to_array();
    let (depth_m, heading_rad) = (nav.depth_m - x1[2], ssa(nav.heading_rad - x1[3]));
    [nu[0] - x1[0], nu[1] - x1[1], depth_m, heading_rad, nu[2] - velocity[2], nu[3] - velocity[3]]
}

fn nominal_model() -> &'static supertwin_model::Hydrodynamics {
    static MODEL: std::sync::OnceLock<supertwin_model::Hydrodynamics> = std::sync::OnceLock::new();
    MODEL.get_or_init(nominal)
}

/// A vehicle that is the nominal model, with perfect navigation and thrusters.
struct Vehicle {
    nu: Vector4<f64>,
    depth_m: f64,
    heading_rad: f64,
    applied: Thrust,
    k: u64,
}

impl Vehicle {
    fn new() -> Self {
        Self { nu: Vector4::zeros(), depth_m: 4.0, heading_rad: 0.5, applied: Thrust::default(), k: 0 }
    }
    fn nav(&self) -> Nav {
        Nav { depth_m: self.depth_m, heading_rad: self.heading_rad, velocity: self.nu.into(), ..Nav::default() }
    }
    /// Some ticks; the last thrust.
    fn run(&mut self, controller: &mut Controller, ticks: u32, reference: Option<&Reference>) -> Thrust {
        (0..ticks).fold(Thrust::default(), |_, _| self.step(controller, reference))
    }
    /// One tick under a constant disturbance of 10 N in sway and −12 N in heave.
    fn step(&mut self, controller: &mut Controller, reference: Option<&Reference>) -> Thrust {
        let (nav, unused) = (self.nav(), Reference::default());
        let reference = reference.map_or(Input::Missing, Input::Fresh);
        let inputs = Inputs { reference, ..Inputs::fresh(&nav, &unused, &self.applied) };
        let thrust = inputs.step(controller, self.k);
        let tau = thrust.allocated.vector() + Vector4::new(0.0, 10.0, -12.0, 0.0);
        let model = nominal_model();
        self.nu = rk4(&self.nu, H_S, |_, nu: &SVector<f64, 4>| model.acceleration(nu, &tau));
        self.depth_m += H_S * self.nu[2];
        self.heading_rad = ssa(self.heading_rad + H_S * self.nu[3]);
        self.applied = thrust.clone();
        self.k += 1;
        thrust
    }
}

// ------------------------------------------------------------------------------------------------------ construction

#[test]
fn a_controller_needs_laws_with_different_names() {
    let pid = law_config("pid");
    assert_eq!(try_build(&[]).expect_err("no law"), "no controller given: there must be at least one");
    let refusal = try_build(&[("pid", &pid), ("pid", &pid)]).expect_err("twice");
    assert_eq!(refusal, "controller \"pid\" is given twice: every law needs its own name");
    let broken = common::law_config_with("gsta-implicit", [("surface", "model_acceleration")]);
    assert!(try_build(&[("broken", &broken)]).expect_err("implicit").contains("relative degree 0"));
}

#[test]
fn unknown_laws_are_refused_by_name_with_the_known_ones() {
    let mut controller = controller(&["pid-tuned", "gsta"]);
    let refusal = controller.command(tick(0), &ControllerCommand::Law("psta".to_owned())).expect_err("unknown");
    assert_eq!(refusal.to_string(), "law = \"psta\": must be one of pid-tuned, gsta");
    assert_eq!(controller.law_name(), "pid-tuned");
}

// ------------------------------------------------------------------------------------------------------- take-overs

#[test]
fn a_new_controller_starts_from_the_last_allocated_wrench_however_old() {
    let (nav, reference) = (nav(), reference());
    for name in ["pid", "pid-tuned", "gsta", "gsta-tuned", "gsta-implicit", "agsta", "agsta-implicit", "external"] {
        let applied = Thrust { allocated: [20.0, 35.0, -12.0, 3.0].into(), ..Thrust::default() };
        for made_at in [999, 400] {
            let mut controller = controller(&[name]);
            let held = Input::Held { value: &applied, made_at };
            let inputs = Inputs { applied: held, ..Inputs::fresh(&nav, &reference, &applied) };
            let first = inputs.step(&mut controller, 1000);
            let jump = (first.requested.vector() - applied.allocated.vector()).amax();
            assert!(jump < 1e-9, "{name}: {jump}");
            assert_eq!(controller.status, Status::Tracking);
        }
    }
}

#[test]
fn a_new_controller_that_knows_of_no_thrust_starts_from_its_own_law() {
    let (nav, reference, idle) = (nav(), reference(), Thrust::default());
    let mut controller = controller(&["pid"]);
    let first = Inputs { applied: Input::Missing, ..Inputs::fresh(&nav, &reference, &idle) }.step(&mut controller, 0);
    // −kp e − ki h e of table III.
    let expected = Vector4::new(
        200.0 * 0.03 + 5.0 * H_S * 0.03,
        200.0 * 0.05 + 5.0 * H_S * 0.05,
        100.0 * 0.1 + H_S * 0.1,
        -15.0 * 0.05 - 0.5 * H_S * 0.05 - 0.01,
    );
    assert!((first.requested.vector() - expected).amax() < 1e-9, "{:?}", first.requested);
}

#[test]
fn laws_hand_over_by_command_without_a_jump() {
    let names = ["pid", "gsta-tuned", "agsta", "external", "gsta-implicit", "agsta-implicit"];
    let mut controller = controller(&names);
    let mut vehicle = Vehicle::new();
    let follow =
        Reference { mode: Mode::FollowNet, sway_m_per_s: 0.2, depth_m: 4.4, heading_rad: 0.7, ..Reference::default() };
    let mut last = vehicle.run(&mut controller, 400, Some(&follow));
    for round in 0..18 {
        let name = names[(round * 5 + 1) % names.len()];
        controller.command(tick(vehicle.k), &ControllerCommand::Law(name.to_owned())).expect("known");
        let first = vehicle.step(&mut controller, Some(&follow));
        assert_eq!(controller.law_name(), name);
        let jump = (first.requested.vector() - last.allocated.vector()).amax();
        assert!(jump < 1e-9, "to {name}: {jump}");
        last = vehicle.run(&mut controller, 150, Some(&follow));
    }
}

#[test]
fn a_command_for_the_law_in_command_changes_nothing() {
    let mut a = controller(&["agsta", "pid"]);
    let (nav, reference) = (nav(), reference());
    let applied = run(&mut a, 100, &nav, &reference);
    let mut b = a.clone();
    b.command(tick(100), &ControllerCommand::Law("agsta".to_owned())).expect("known");
    let inputs = Inputs::fresh(&nav, &reference, &applied);
    assert_eq!(inputs.step(&mut a, 100), inputs.step(&mut b, 100));
}

#[test]
fn emergency_neutral_holds_until_it_is_taken_back() {
    let mut controller = controller(&["gsta-tuned"]);
    let (nav, reference) = (nav(), reference());
    let mut applied = run(&mut controller, 50, &nav, &reference);
    assert!(forces(&applied) > 1.0);
    controller.command(tick(50), &ControllerCommand::Neutral(true)).expect("always");
    for k in 50..100 {
        applied = Inputs::fresh(&nav, &reference, &applied).step(&mut controller, k);
        assert_eq!((forces(&applied), controller.status), (0.0, Status::EmergencyNeutral));
        // No other command lifts it.
        controller.command(tick(k), &ControllerCommand::Law("gsta-tuned".to_owned())).expect("known");
    }
    controller.command(tick(100), &ControllerCommand::Neutral(false)).expect("always");
    applied = Inputs::fresh(&nav, &reference, &applied).step(&mut controller, 100);
    assert_eq!(controller.status, Status::Tracking);
    assert!(applied.requested.vector().amax() < 1e-9, "from zero, without a kick: {:?}", applied.requested);
}

// ------------------------------------------------------------------------------------------------ numbers that are none

#[test]
fn what_is_no_number_in_navigation_never_leaves_the_controller() {
    let (good, reference) = (nav(), reference());
    let spoil: [fn(&mut Nav, f64); 6] = [
        |nav, x| nav.depth_m = x,
        |nav, x| nav.heading_rad = x,
        |nav, x| nav.velocity.surge_m_per_s = x,
        |nav, x| nav.velocity.sway_m_per_s = x,
        |nav, x| nav.velocity.heave_m_per_s = x,
        |nav, x| nav.velocity.yaw_rad_per_s = x,
    ];
    for name in ["pid-tuned", "gsta", "gsta-implicit", "agsta", "agsta-implicit", "external"] {
        for spoil in spoil {
            for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                let mut controller = controller_of(name);
                let mut applied = run(&mut controller, 20, &good, &reference);
                let mut bad = good.clone();
                spoil(&mut bad, value);
                for k in 20..23 {
                    applied = Inputs::fresh(&bad, &reference, &applied).step(&mut controller, k);
                    assert!(applied.is_finite(), "{name}: {applied:?}");
                    assert_eq!((forces(&applied), controller.status), (0.0, Status::NotFinite), "{name}, {value}");
                }
                assert_eq!(Snapshot::of(&controller).get(&signal::controller::NON_FINITE), Some(&[3.0][..]));
                // It recovers with the numbers, from the zero wrench.
                applied = Inputs::fresh(&good, &reference, &applied).step(&mut controller, 23);
                assert_eq!(controller.status, Status::Tracking, "{name}");
                assert!(applied.is_finite() && applied.requested.vector().amax() < 1e-9, "{name}: {applied:?}");
                assert!(Snapshot::of(&controller).is_finite(), "{name} shows numbers only");
            }
        }
    }
}

/// Parsing files once per case would be most of the test's time.
fn controller_of(name: &'static str) -> Controller {
    use std::cell::RefCell;
    use std::collections::BTreeMap;
    thread_local! {
        static BUILT: RefCell<BTreeMap<&'static str, Controller>> = const { RefCell::new(BTreeMap::new()) };
    }
    BUILT.with_borrow_mut(|built| built.entry(name).or_insert_with(|| controller(&[name])).clone())
}

#[test]
fn an_allocated_wrench_that_is_no_number_is_not_taken_over() {
    let (nav, reference) = (nav(), reference());
    let bad = Thrust { allocated: [f64::NAN, 0.0, 0.0, 0.0].into(), ..Thrust::default() };
    let mut controller = controller(&["gsta-tuned"]);
    let first = Inputs::fresh(&nav, &reference, &bad).step(&mut controller, 0);
    assert!(first.is_finite() && forces(&first) == 0.0, "{first:?}");
    let second = Inputs::fresh(&nav, &reference, &first).step(&mut controller, 1);
    assert!(second.is_finite());
    assert_eq!(controller.status, Status::Tracking);
}

#[test]
fn random_inputs_never_make_a_force_beyond_the_limits() {
    let mut draw = Stream::new(20, "fuzz");
    let mut controller = controller(&["agsta"]);
    let mut applied = Thrust::default();
    for k in 0..5000 {
        let nav = Nav {
            depth_m: 10.0 * draw.normal(),
            heading_rad: draw.uniform(-3.1, 3.1),
            velocity: (draw.normals::<4>() * 3.0).into(),
            ..Nav::default()
        };
        let reference = Reference { sway_m_per_s: draw.normal(), depth_m: 10.0 * draw.normal(), ..reference() };
        applied = Inputs::fresh(&nav, &reference, &applied).step(&mut controller, k);
        assert!(applied.is_finite());
        assert!(forces(&applied) <= 100.0 * (1.0 + 1e-12));
        let (requested, allocated) = (applied.requested.to_array(), applied.allocated.to_array());
        for (i, limited) in applied.limited.to_array().into_iter().enumerate() {
            let (asked, got) = (requested[i], allocated[i]);
            assert_eq!(limited, (asked - got).abs() > 3.0 + 0.05 * asked.abs());
        }
    }
}

#[test]
fn a_request_of_any_finite_size_never_leaves_as_no_number() {
    let (nav, reference, idle) = (nav(), reference(), Thrust::default());
    let huge = Some(1.7e308);
    let request = WrenchRequest { surge_n: huge, sway_n: huge, heave_n: huge, yaw_nm: huge };
    let inputs = Inputs { request: Input::Fresh(&request), ..Inputs::fresh(&nav, &reference, &idle) };
    let thrust = inputs.step(&mut controller(&["external"]), 0);
    assert!(thrust.is_finite(), "{thrust:?}");
    assert!(forces(&thrust) <= 100.0 * (1.0 + 1e-12));
}

#[test]
fn a_gap_in_navigation_does_not_start_a_braked_vehicle_again() {
    let nav = nav();
    let moving = Reference { surge_m_per_s: 0.3, ..reference() };
    let idle = Thrust::default();
    let mut controller = controller(&["pid-tuned"]);
    Inputs::fresh(&nav, &moving, &idle).step(&mut controller, 0);
    let silent = Inputs { reference: Input::Missing, ..Inputs::fresh(&nav, &moving, &idle) };
    for k in 1..400 {
        silent.step(&mut controller, k);
    }
    assert!(reference_seen(&controller, &nav)[0].abs() < 1e-3, "braked");
    Inputs { nav: Input::Missing, ..silent }.step(&mut controller, 400);
    silent.step(&mut controller, 401);
    assert!(reference_seen(&controller, &nav)[0].abs() < 1e-3, "{}", reference_seen(&controller, &nav)[0]);
}

#[test]
fn who_wanted_no_force_and_fell_silent_still_wants_none() {
    let (nav, idle) = (nav(), Thrust::default());
    let neutral = Reference { mode: Mode::Neutral, ..reference() };
    let mut controller = controller(&["pid-tuned"]);
    Inputs::fresh(&nav, &neutral, &idle).step(&mut controller, 0);
    let silent = Inputs { reference: Input::Missing, ..Inputs::fresh(&nav, &neutral, &idle) };
    for k in 1..100 {
        assert_eq!(forces(&silent.step(&mut controller, k)), 0.0, "tick {k}");
    }
    // Nor does a gap in navigation, or an emergency that is over, make it want some.
    Inputs { nav: Input::Missing, ..silent }.step(&mut controller, 100);
    assert_eq!(forces(&silent.step(&mut controller, 101)), 0.0);
    for demanded in [true, false] {
        controller.command(tick(102), &ControllerCommand::Neutral(demanded)).expect("always");
        assert_eq!(forces(&silent.step(&mut controller, 102)), 0.0);
    }
}
