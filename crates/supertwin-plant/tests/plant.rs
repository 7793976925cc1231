//! The plant: integration, water, thrusters, sensors and their faults, on the real configuration files.

use core::f64::consts::{FRAC_1_SQRT_2, TAU};
use nalgebra::{Vector3, Vector4};
use serde::de::DeserializeOwned;
use supertwin_core::command::PlantCommand;
use supertwin_core::frame::{Heading, ssa};
use supertwin_core::message::{Measurements, Thrust, Truth};
use supertwin_core::observe::Snapshot;
use supertwin_core::random::Stream;
use supertwin_core::{Block, Input, Message, Prev, Tick, Wrench, signal};
use supertwin_model::{Hydrodynamics, HydrodynamicsConfig, SonarArray, ThrusterConfig, Thrusters};
use supertwin_plant::cage::{Cage, CageConfig};
use supertwin_plant::sensors::{Compass, DepthSensor, Dvl, DvlScene, Gyro};
use supertwin_plant::{Drive, EnvironmentConfig, Plant, PlantConfig, PropulsionConfig, SensorsConfig, StartConfig};

const H_S: f64 = 0.02;
/// Age of a thrust command that means neutral: 0.5 s.
const STALE_TICKS: u64 = 25;

fn file(path: &str) -> toml::Table {
    let path = format!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/{}.toml"), path);
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    text.parse().unwrap_or_else(|error| panic!("{path}: {error}"))
}

fn read<T: DeserializeOwned>(value: &toml::Value) -> T {
    value.clone().try_into().expect("a legal configuration")
}

/// Sets `a.b.c` of a table.
fn put(table: &mut toml::Table, path: &str, value: impl Into<toml::Value>) {
    let (parents, last) = path.rsplit_once('.').unwrap_or(("", path));
    let mut place = table;
    for part in parents.split('.').filter(|part| !part.is_empty()) {
        place = place.get_mut(part).and_then(toml::Value::as_table_mut).expect("a table on the way");
    }
    place.insert(last.to_owned(), value.into());
}

/// Everything a plant is made of, as tables that a test may change.
#[derive(Clone)]
struct Setup {
    vehicle: toml::Table,
    environment: toml::Table,
    sensors: toml::Table,
    start: toml::Table,
    dt_s: f64,
    substeps: u32,
}

impl Setup {
    fn new(environment: &str) -> Self {
        let start = "bearing_rad = 0.4
             net_distance_m = 10.0
             depth_m = 4.0
             heading_offset_rad = 0.1";
        Self {
            vehicle: file("vehicles/argus-mini"),
            environment: file(&format!("environments/{environment}")),
            sensors: file("sensors/argus-mini"),
            start: start.parse().expect("TOML"),
            dt_s: H_S,
            substeps: 2,
        }
    }

    /// A calm sea and a round pen that stands still, neutral buoyancy, no coupling of sway thrust into yaw.
    fn quiet() -> Self {
        let mut setup = Self::new("calm");
        put(&mut setup.vehicle, "true.net_buoyancy_n", 0.0);
        put(&mut setup.vehicle, "unmodelled.sway_to_yaw_arm_m", 0.0);
        put(&mut setup.environment, "cage.undulation", toml::Value::Array(Vec::new()));
        put(&mut setup.environment, "cage.tilt_m_per_m", 0.0);
        setup
    }

    fn with(mut self, part: fn(&mut Self) -> &mut toml::Table, path: &str, value: impl Into<toml::Value>) -> Self {
        put(part(&mut self), path, value);
        self
    }
    fn vehicle(self, path: &str, value: impl Into<toml::Value>) -> Self {
        self.with(|setup| &mut setup.vehicle, path, value)
    }
    fn environment(self, path: &str, value: impl Into<toml::Value>) -> Self {
        self.with(|setup| &mut setup.environment, path, value)
    }
    fn sensors(self, path: &str, value: impl Into<toml::Value>) -> Self {
        self.with(|setup| &mut setup.sensors, path, value)
    }
    fn start(self, path: &str, value: impl Into<toml::Value>) -> Self {
        self.with(|setup| &mut setup.start, path, value)
    }

    fn try_build(&self, seed: u64) -> Result<Plant, String> {
        let dynamics: HydrodynamicsConfig = read(&self.vehicle["true"]);
        let thrusters: Vec<ThrusterConfig> = read(&self.vehicle["thruster"]);
        let propulsion: PropulsionConfig = read(&self.vehicle["propulsion"]);
        let environment: EnvironmentConfig = read(&toml::Value::Table(self.environment.clone()));
        let sensors: SensorsConfig = read(&toml::Value::Table(self.sensors.clone()));
        let start: StartConfig = read(&toml::Value::Table(self.start.clone()));
        let config = PlantConfig {
            dynamics: Hydrodynamics::from(&dynamics),
            mass_kg: dynamics.rigid_body.mass_kg.get(),
            height_m: self.vehicle["size_m"][2].as_float().expect("a length"),
            thrusters: Thrusters::new(&thrusters).expect("fully actuated"),
            propulsion: &propulsion,
            unmodelled: &read(&self.vehicle["unmodelled"]),
            environment: &environment,
            sensors: &sensors,
            start: &start,
            dt_s: self.dt_s,
            substeps: self.substeps,
            thrust_stale_after_ticks: STALE_TICKS,
        };
        Plant::new(&config, seed)
    }

    fn build(&self, seed: u64) -> Bench {
        Bench { plant: self.try_build(seed).expect("a legal plant"), k: 0, dt_s: self.dt_s }
    }

    fn cage(&self, seed: u64) -> Cage {
        let config: CageConfig = read(&self.environment["cage"]);
        Cage::new(&config, seed).expect("a legal pen")
    }
}

/// A plant with its clock.
#[derive(Clone)]
struct Bench {
    plant: Plant,
    k: u64,
    dt_s: f64,
}

impl Bench {
    fn tick(&self) -> Tick {
        Tick { k: self.k, dt_s: self.dt_s }
    }
    fn step_with(&mut self, thrust: Input<&Thrust>) -> Measurements {
        let measurements = self.plant.step(self.tick(), Prev(thrust));
        self.k += 1;
        measurements
    }
    fn step(&mut self, thrust: &Thrust) -> Measurements {
        self.step_with(Input::Fresh(thrust))
    }
    fn run(&mut self, ticks: u64, thrust: &Thrust) -> &Truth {
        for _ in 0..ticks {
            self.step(thrust);
        }
        self.plant.truth()
    }
    fn command(&mut self, command: &PlantCommand) {
        let tick = self.tick();
        self.plant.command(tick, command).expect("obeyed");
    }
}

/// The same force on all horizontal, and another one on both vertical thrusters.
fn thrust(force_n: [f64; 6]) -> Thrust {
    Thrust { force_n: force_n.into_iter().collect(), ..Thrust::default() }
}

fn idle() -> Thrust {
    thrust([0.0; 6])
}

fn ahead(force_n: f64) -> Thrust {
    thrust([force_n, force_n, force_n, force_n, 0.0, 0.0])
}

fn down(force_n: f64) -> Thrust {
    thrust([0.0, 0.0, 0.0, 0.0, force_n, force_n])
}

/// Over-ground velocity in NED axes.
fn velocity_ned(truth: &Truth) -> Vector3<f64> {
    let nu = truth.velocity.to_array();
    Heading::new(truth.heading_rad).ned_from_body(Vector3::new(nu[0], nu[1], nu[2]))
}

fn state(truth: &Truth) -> [f64; 8] {
    let nu = truth.velocity.to_array();
    [truth.north_m, truth.east_m, truth.depth_m, truth.heading_rad, nu[0], nu[1], nu[2], nu[3]]
}

fn distance(a: &[f64; 8], b: &[f64; 8]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

// ----------------------------------------------------------------------------------------------------------- driven

#[test]
fn a_driven_plant_feels_the_given_force_and_nothing_of_the_sea() {
    // North by East, whatever the heading; in a sea with current, waves and a tether.
    let force_ned_n = [20.0, 10.0, 0.0];
    let mut directions = Vec::new();
    for offset_rad in [0.1, 2.0, -1.3] {
        let setup = Setup::new("rataren").vehicle("true.net_buoyancy_n", 0.0).start("heading_offset_rad", offset_rad);
        let mut bench = setup.sensors("depth.std_m", 0.0).build(3);
        for _ in 0..60 {
            bench.plant.drive(Drive { force_ned_n, yaw_nm: 0.0 });
            let measured = bench.step(&idle());
            let truth = bench.plant.truth();
            if let Some(sample) = measured.depth {
                assert_eq!(sample.depth_m.to_bits(), truth.depth_m.to_bits(), "no wave's pressure");
            }
            assert_eq!((truth.current_m_per_s, truth.water_velocity.to_array()), ([0.0; 3], [0.0; 4]));
        }
        let disturbance = bench.plant.truth().disturbance.to_array();
        let of_heading = Heading::new(bench.plant.truth().heading_rad);
        let back = of_heading.ned_from_body(Vector3::new(disturbance[0], disturbance[1], disturbance[2]));
        assert!((back - Vector3::from(force_ned_n)).norm() < 0.5, "{back}");
        let velocity = velocity_ned(bench.plant.truth());
        assert!(velocity.x > 0.05 && velocity.y > 0.0, "{velocity}");
        directions.push(libm::atan2(velocity.y, velocity.x));
    }
    // Surge and sway have other masses: near the force's direction, not along it.
    assert!(directions.iter().all(|direction| (direction - 0.4636).abs() < 0.4), "{directions:?}");
}

#[test]
fn a_disturbance_that_is_no_number_is_no_force() {
    let wrench = Wrench::from([f64::NAN, 3.0, f64::INFINITY, f64::NAN]);
    let drive = Drive::from_body(&wrench, 0.0);
    assert_eq!((drive.force_ned_n, drive.yaw_nm), ([0.0, 3.0, 0.0], 0.0));
    let turned = Drive::from_body(&Wrench::from([2.0, 0.0, 1.0, 0.5]), core::f64::consts::FRAC_PI_2);
    assert!(turned.force_ned_n[0].abs() < 1e-12 && (turned.force_ned_n[1] - 2.0).abs() < 1e-12, "{turned:?}");
    assert_eq!((turned.force_ned_n[2], turned.yaw_nm), (1.0, 0.5));
    assert!(Drive::from_body(&wrench, f64::NAN).force_ned_n.iter().all(|x| x.is_finite()));
}

// ------------------------------------------------------------------------------------------------------- integration

#[test]
fn with_constant_forces_the_integration_is_of_fourth_order() {
    // Forces that are there at once, still water: what is left is Runge-Kutta. Ticks of half a second. (Where the flow
    // past the hull changes its sign, |u| u has a kink, and the order falls to about two.)
    let run = |substeps: u32| {
        let mut setup = Setup::quiet().vehicle("propulsion.lag_s", 1e-6).vehicle("propulsion.delay_s", 0.0);
        (setup.dt_s, setup.substeps) = (0.5, substeps);
        state(setup.build(1).run(17, &thrust([60.0, 20.0, 50.0, 40.0, 15.0, 15.0])))
    };
    let exact = run(256);
    let errors: Vec<f64> = [1, 2, 4, 8].into_iter().map(|substeps| distance(&run(substeps), &exact)).collect();
    let orders: Vec<f64> = errors.windows(2).map(|pair| (pair[0] / pair[1]).log2()).collect();
    println!("integration: errors {errors:?}, orders {orders:.2?}");
    assert!(orders.iter().all(|order| (3.8..4.2).contains(order)), "{orders:?}");
}

#[test]
fn at_the_twins_step_the_sub_step_does_not_matter() {
    // The whole sea of the trials, lag and delay: forces and waves are held over a sub-step, so the error is of first
    // order; at 10 ms it must be far below what the sensors see.
    let run = |substeps: u32| {
        let mut setup = Setup::new("rataren");
        setup.substeps = substeps;
        let mut bench = setup.build(3);
        let mut states = Vec::new();
        for second in 0..30 {
            let force = if second % 2 == 0 { 20.0 } else { -10.0 };
            states.push(state(bench.run(50, &thrust([force, 15.0, 12.0, force, 8.0, 8.0]))));
        }
        states
    };
    let exact = run(32);
    let error = |substeps: u32| {
        let states = run(substeps);
        let worst = |part: core::ops::Range<usize>| {
            let of = |(a, b): (&[f64; 8], &[f64; 8])| {
                part.clone().map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum::<f64>().sqrt()
            };
            states.iter().zip(&exact).map(of).fold(0.0, f64::max)
        };
        (worst(0..3), worst(4..8))
    };
    let (two, four) = (error(2), error(4));
    println!("sub-steps of 10 ms: {:.1e} m, {:.1e} m/s; of 5 ms: {:.1e} m, {:.1e} m/s", two.0, two.1, four.0, four.1);
    assert!(two.0 < 0.01 && two.1 < 0.003, "{two:?}");
    assert!(four.0 < 0.6 * two.0 && four.1 < 0.6 * two.1, "{four:?} after {two:?}");
}

#[test]
fn the_first_tick_only_measures() {
    let setup = Setup::quiet();
    let mut bench = setup.build(1);
    let before = bench.plant.truth().clone();
    assert!((before.net_distance_m - 10.0).abs() < 1e-12);
    assert!((before.depth_m - 4.0).abs() < 1e-12 && (before.net_heading_rad - 0.4).abs() < 1e-12);
    assert!((before.heading_rad - 0.5).abs() < 1e-12, "0.1 off the direction that faces the net");
    let measurements = bench.step(&ahead(100.0));
    assert_eq!(*bench.plant.truth(), before);
    assert!(measurements.depth.is_some() && measurements.compass.is_some() && measurements.gyro.is_some());
}

#[test]
fn the_start_is_drawn_within_its_ranges() {
    let range = |low: f64, high: f64| toml::Value::Array(vec![low.into(), high.into()]);
    let setup = Setup::new("rataren")
        .start("net_distance_m", range(3.4, 4.2))
        .start("heading_offset_rad", range(-0.24, 0.24))
        .start("bearing_rad", range(-3.1, 3.1));
    let mut distances = Vec::new();
    for seed in 0..50 {
        let truth = setup.build(seed).plant.truth().clone();
        assert!((3.4..4.2).contains(&truth.net_distance_m), "{}", truth.net_distance_m);
        assert!(ssa(truth.heading_rad - truth.net_heading_rad).abs() <= 0.24);
        distances.push(truth.net_distance_m);
    }
    let mean = distances.iter().sum::<f64>() / 50.0;
    assert!((mean - 3.8).abs() < 0.1, "{mean}");
}

#[test]
fn one_seed_is_one_run_to_the_bit_and_another_seed_is_another_run() {
    let setup = Setup::new("rataren");
    let command = thrust([10.0, -5.0, 20.0, 3.0, 8.0, 6.0]);
    let (mut a, mut b, mut c) = (setup.build(7), setup.build(7), setup.build(8));
    let mut differs = 0;
    for _ in 0..2000 {
        let (x, y, z) = (a.step(&command), b.step(&command), c.step(&command));
        assert_eq!(x, y);
        assert_eq!(a.plant.truth(), b.plant.truth());
        differs += u32::from(x != z);
    }
    assert_eq!(differs, 2000, "another seed has other noise at every tick");
}

// -------------------------------------------------------------------------------------------------------------- water

#[test]
fn a_vehicle_without_thrust_drifts_with_a_steady_current() {
    for direction in [-2.5f64, 0.7] {
        let mut bench = Setup::quiet()
            .environment("current.speed_m_per_s", 0.22)
            .environment("current.decay_per_m", 0.0)
            .environment("current.veering_rad_per_m", 0.0)
            .environment("current.direction_rad", direction)
            .build(1);
        let truth = bench.run(3000, &idle());
        let current = Vector3::new(0.22 * direction.cos(), 0.22 * direction.sin(), 0.0);
        assert!((velocity_ned(truth) - current).norm() < 1e-6, "{}", velocity_ned(truth));
        assert!((truth.velocity.vector() - truth.water_velocity.vector()).amax() < 1e-6, "no flow past the hull");
    }
}

#[test]
fn the_current_weakens_and_veers_with_depth() {
    let at = |depth_m: f64| {
        let mut bench = Setup::quiet()
            .environment("current.speed_m_per_s", 0.22)
            .environment("current.direction_rad", 0.3)
            .start("depth_m", depth_m)
            .build(1);
        bench.run(2, &idle());
        let truth = bench.plant.truth();
        let water = truth.water_velocity.to_array();
        Heading::new(truth.heading_rad).ned_from_body(Vector3::new(water[0], water[1], water[2]))
    };
    for depth_m in [0.5f64, 4.0, 12.0] {
        let (speed, direction) = (0.22 * (1.0 - 0.04 * depth_m), 0.3 + 0.05 * depth_m);
        let expected = Vector3::new(speed * direction.cos(), speed * direction.sin(), 0.0);
        assert!((at(depth_m) - expected).norm() < 1e-5, "{} at {depth_m} m", at(depth_m));
    }
    assert!(at(30.0).norm() < 1e-5, "it never turns round");
}

#[test]
fn a_neutrally_buoyant_vehicle_follows_the_water_of_the_waves() {
    let mut bench = Setup::quiet()
        .environment("waves.significant_height_m", 0.6)
        .environment("waves.direction_rad", 1.0)
        .start("net_distance_m", 15.0)
        .build(2);
    bench.run(1500, &idle());
    let (mut slip2, mut water2, mut sinks) = (Vector4::zeros(), Vector4::zeros(), 0.0);
    let n = 5000;
    for _ in 0..n {
        let truth = bench.run(1, &idle());
        let (slip, water) = (truth.velocity.vector() - truth.water_velocity.vector(), truth.water_velocity.vector());
        slip2 += slip.component_mul(&slip) / f64::from(n);
        water2 += water.component_mul(&water) / f64::from(n);
        sinks += slip[2] / f64::from(n);
    }
    let (slip, water) = (slip2.map(f64::sqrt), water2.map(f64::sqrt));
    println!(
        "waves: water {:.4?} m/s rms, slip {:.4?} m/s rms, mean sink {sinks:.4} m/s",
        water.as_slice(),
        slip.as_slice()
    );
    // Oscillating water at 4 m under Hs 0.6 m: up to 0.1 m/s rms, as much horizontally as vertically.
    assert!((0.06..0.1).contains(&water[2]), "{water}");
    assert!((water[0].hypot(water[1]) / water[2] - 1.0).abs() < 0.05, "{water}");
    assert!(slip[0].hypot(slip[1]) < 0.02 * water[0].hypot(water[1]), "{slip}");
    // Vertically it follows to a tenth only: the plant's d/dt nu_f is the local acceleration of the water, without the
    // convective part (v · ∇) v of it (control.md, section 1.1), whose mean M k (u² + w²) is half a newton downwards.
    assert!(slip[2] < 0.1 * water[2], "{slip}");
    assert!((0.003..0.007).contains(&sinks), "{sinks}");
}

#[test]
fn buoyancy_lifts_the_vehicle_at_its_rise_speed() {
    let mut bench = Setup::quiet().vehicle("true.net_buoyancy_n", 12.0).start("depth_m", 12.0).build(1);
    let truth = bench.run(2500, &idle()).clone();
    // 350 w² + 90 w = 12.
    let rise = (-90.0 + f64::sqrt(90.0 * 90.0 + 4.0 * 350.0 * 12.0)) / 700.0;
    assert!((truth.velocity.heave_m_per_s + rise).abs() < 1e-6, "{} against -{rise}", truth.velocity.heave_m_per_s);
    assert!(truth.depth_m < 12.0 - 0.9 * rise * 50.0, "up is towards smaller depth: {}", truth.depth_m);
}

#[test]
fn full_thrust_ahead_makes_1_03_m_per_s() {
    let mut bench = Setup::quiet().start("net_distance_m", 24.0).build(1);
    let truth = bench.run(3000, &ahead(100.0));
    let exact = (-70.0 + f64::sqrt(70.0 * 70.0 + 4.0 * 200.0 * 400.0 * FRAC_1_SQRT_2)) / 400.0;
    assert!((truth.velocity.surge_m_per_s - exact).abs() < 1e-6, "{}", truth.velocity.surge_m_per_s);
    assert!((exact - 1.03).abs() < 0.005);
}

#[test]
fn sway_thrust_turns_the_vehicle_through_the_unmodelled_arm() {
    let mut bench = Setup::quiet().vehicle("unmodelled.sway_to_yaw_arm_m", 0.1).build(1);
    let truth = bench.run(200, &thrust([-20.0, 20.0, 20.0, -20.0, 0.0, 0.0]));
    assert!(truth.wrench.sway_n > 50.0 && truth.wrench.surge_n.abs() < 1e-9 && truth.wrench.yaw_nm.abs() < 1e-9);
    assert!((truth.disturbance.yaw_nm - 0.1 * truth.wrench.sway_n).abs() < 1e-9);
    assert_eq!([truth.disturbance.surge_n, truth.disturbance.sway_n, truth.disturbance.heave_n], [0.0; 3]);
}

#[test]
fn the_tether_pulls_with_its_standard_deviations() {
    // 4000 s with a correlation time of 20 s are 100 independent samples per seed; ten seeds know their std to 3 %.
    let setup = Setup::new("rataren").vehicle("unmodelled.sway_to_yaw_arm_m", 0.0);
    let mut sum2 = Vector4::zeros();
    let mut n = 0.0;
    for seed in 0..10 {
        let mut coarse = setup.clone();
        (coarse.dt_s, coarse.substeps) = (1.0, 4);
        let mut bench = coarse.build(seed);
        for _ in 0..4000 {
            let pull = bench.run(1, &idle()).disturbance.vector();
            sum2 += pull.component_mul(&pull);
            n += 1.0;
        }
    }
    let std = (sum2 / n).map(f64::sqrt);
    for (i, expected) in [5.0, 5.0, 4.0, 1.0].into_iter().enumerate() {
        assert!((std[i] / expected - 1.0).abs() < 0.1, "axis {i}: {} against {expected}", std[i]);
    }
}

// ---------------------------------------------------------------------------------------------------------- thrusters

#[test]
fn thrust_goes_nowhere_before_its_delay_and_then_lags_with_0_15_s() {
    let mut bench = Setup::quiet().build(1);
    bench.step(&idle());
    for k in 1..=40 {
        let truth = bench.run(1, &ahead(50.0)).clone();
        let elapsed_s = f64::from(k - 5) * H_S;
        let expected = if k <= 5 { 0.0 } else { 50.0 * (1.0 - (-elapsed_s / 0.15).exp()) };
        for force in truth.thruster_force_n.iter().take(4) {
            assert!((force - expected).abs() < 1e-9, "tick {k}: {force} against {expected}");
        }
        if k <= 5 {
            assert_eq!((truth.wrench, truth.velocity), Default::default(), "nothing moves for 0.1 s");
        }
        assert!((truth.wrench.surge_n - 4.0 * expected * FRAC_1_SQRT_2).abs() < 1e-9);
    }
    // 0.15 s after its beginning it is at 63 %: half-way between ticks 12 and 13.
    assert!((1.0 - (-1.0f64).exp() - 0.632).abs() < 1e-3);
}

#[test]
fn commands_are_delayed_one_by_one() {
    let mut bench = Setup::quiet().build(1);
    bench.step(&idle());
    // One tick of thrust, then none: it arrives five ticks later and lasts for one.
    bench.step(&ahead(50.0));
    let mut demands = Vec::new();
    for _ in 0..8 {
        bench.step(&idle());
        demands.push(Snapshot::of(&bench.plant).get(&signal::plant::THRUSTER_DEMAND).expect("shown")[0]);
    }
    assert_eq!(demands, [0.0, 0.0, 0.0, 0.0, 50.0, 0.0, 0.0, 0.0]);
}

/// Forces after a second of constant command.
fn settled(command: &Thrust) -> Vec<f64> {
    let mut bench = Setup::quiet().build(1);
    bench.run(150, command).thruster_force_n.to_vec()
}

#[test]
fn thrusters_have_a_dead_band_and_a_limit() {
    let forces = settled(&thrust([0.99, -0.99, 1.0, -1.0, 500.0, -500.0]));
    for (force, expected) in forces.iter().zip([0.0, 0.0, 1.0, -1.0, 100.0, -100.0]) {
        assert!((force - expected).abs() <= 1e-4 * f64::abs(expected), "{forces:?}");
    }
}

#[test]
fn a_command_that_is_no_number_makes_no_force() {
    let forces = settled(&thrust([f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 10.0, f64::NAN, 10.0]));
    assert_eq!(forces[..3], [0.0; 3]);
    assert_eq!(forces[4], 0.0);
    assert!((forces[3] - 10.0).abs() < 1e-2 && (forces[5] - 10.0).abs() < 1e-2);
    let mut bench = Setup::new("rataren").build(1);
    for _ in 0..500 {
        let measurements = bench.step(&thrust([f64::NAN; 6]));
        assert!(measurements.is_finite() && bench.plant.truth().is_finite());
    }
}

#[test]
fn too_few_and_too_many_commands_are_survived() {
    let few = Thrust { force_n: [10.0, 10.0].into_iter().collect(), ..Thrust::default() };
    let forces = settled(&few);
    assert_eq!(forces.len(), 6);
    assert!(forces[0] > 9.9 && forces[1] > 9.9 && forces[2..].iter().all(|force| *force <= 0.0));
    let many = Thrust { force_n: [10.0; 8].into_iter().collect(), ..Thrust::default() };
    assert_eq!(settled(&many).len(), 6);
}

#[test]
fn a_faulty_thruster_gives_its_share() {
    let mut bench = Setup::quiet().build(1);
    bench.run(100, &ahead(40.0));
    bench.command(&PlantCommand::ThrusterGain { thruster: 2, gain: 0.25 });
    bench.command(&PlantCommand::ThrusterGain { thruster: 6, gain: 0.0 });
    let truth = bench.run(150, &thrust([40.0, 40.0, 40.0, 40.0, 10.0, 10.0])).clone();
    let expected = [40.0, 10.0, 40.0, 40.0, 10.0, 0.0];
    for (force, expected) in truth.thruster_force_n.iter().zip(expected) {
        assert!((force - expected).abs() < 1e-5, "{:?}", truth.thruster_force_n);
    }
    assert!(truth.wrench.yaw_nm.abs() > 5.0, "and the vehicle turns");
    bench.command(&PlantCommand::ThrusterGain { thruster: 2, gain: 1.0 });
    assert!((bench.run(150, &ahead(40.0)).thruster_force_n[1] - 40.0).abs() < 1e-5, "healed");
}

#[test]
fn faults_that_can_not_be_are_refused_with_value_and_rule() {
    let mut bench = Setup::quiet().build(1);
    let tick = bench.tick();
    let cases = [
        (PlantCommand::ThrusterGain { thruster: 0, gain: 1.0 }, "thruster_gain.thruster = 0: must be between 1 and 6"),
        (PlantCommand::ThrusterGain { thruster: 7, gain: 1.0 }, "thruster_gain.thruster = 7: must be between 1 and 6"),
        (PlantCommand::ThrusterGain { thruster: 1, gain: 2.5 }, "thruster_gain.gain = 2.5: must be between 0 and 2"),
        (
            PlantCommand::ThrusterGain { thruster: 1, gain: f64::NAN },
            "thruster_gain.gain = NaN: must be between 0 and 2",
        ),
        (PlantCommand::DvlSilentForS(-1.0), "dvl_silent_for_s = -1: must be zero or positive, and finite"),
        (PlantCommand::DvlSilentForS(f64::INFINITY), "dvl_silent_for_s = inf: must be zero or positive, and finite"),
    ];
    for (command, message) in cases {
        let refusal = bench.plant.command(tick, &command).expect_err("impossible");
        assert_eq!(refusal.to_string(), message);
    }
}

#[test]
fn a_thrust_command_that_is_too_old_means_neutral() {
    let health = |bench: &Bench| Snapshot::of(&bench.plant).get(&signal::plant::HEALTH).expect("shown")[0];
    for missing in [false, true] {
        let mut bench = Setup::quiet().build(1);
        let command = ahead(50.0);
        bench.run(100, &command);
        let made_at = bench.k - 1;
        if !missing {
            for _ in 0..STALE_TICKS {
                bench.step_with(Input::Held { value: &command, made_at });
                assert!(bench.plant.truth().thruster_force_n[0] > 49.0, "held up to 0.5 s");
                assert!(health(&bench) <= 0.0);
            }
        }
        // From here on neutral; what was under way still arrives for 0.1 s, and then the lag.
        for i in 0..100 {
            bench.step_with(if missing { Input::Missing } else { Input::Held { value: &command, made_at } });
            assert!(health(&bench) >= 1.0, "said so");
            let force = bench.plant.truth().thruster_force_n[0];
            assert_eq!(force > 49.0, i < 5, "tick {i}: {force}");
        }
        assert!(bench.plant.truth().thruster_force_n[0] < 1e-3);
        bench.step(&command);
        assert!(health(&bench) <= 0.0, "fresh again");
    }
}

#[test]
fn a_delay_that_is_too_long_is_refused() {
    let refusal = Setup::quiet().vehicle("propulsion.delay_s", 2.0).try_build(1).expect_err("too long");
    assert_eq!(refusal, "propulsion.delay_s = 2: must be shorter than 1.28 s (64 ticks)");
}

// ---------------------------------------------------------------------------------------------------------------- DVL

/// A DVL at rest in front of a pen, ticked at 50 Hz.
struct DvlBench {
    dvl: Dvl,
    cage: Cage,
    position_m: Vector3<f64>,
    heading_rad: f64,
    velocity: Vector3<f64>,
    k: u64,
}

impl DvlBench {
    fn new(setup: &Setup, seed: u64) -> Self {
        let sensors: SensorsConfig = read(&toml::Value::Table(setup.sensors.clone()));
        Self {
            dvl: Dvl::new(&sensors.dvl, seed),
            cage: setup.cage(seed),
            // 3 m from a round net, at bearing 0.7.
            position_m: Vector3::new(22.0 * 0.7f64.cos(), 22.0 * 0.7f64.sin(), 4.0),
            heading_rad: 0.7,
            velocity: Vector3::zeros(),
            k: 0,
        }
    }
    fn step(&mut self) -> Option<(f64, supertwin_core::message::DvlPing)> {
        let tick = Tick { k: self.k, dt_s: H_S };
        self.k += 1;
        self.cage.set_time(tick.t_s());
        let scene = DvlScene {
            position_m: &self.position_m,
            heading: Heading::new(self.heading_rad),
            velocity_m_per_s: self.velocity,
            cage: &self.cage,
        };
        self.dvl.step(tick, &scene).map(|ping| (tick.t_s(), ping))
    }
}

fn without_fish(setup: Setup) -> Setup {
    setup.sensors("dvl.fish.bursts_per_s", 0.0)
}

fn without_noise(setup: Setup) -> Setup {
    setup.sensors("dvl.velocity_std_m_per_s", 0.0).sensors("dvl.range_std_m", 0.0)
}

#[test]
fn the_dvl_pings_at_8_hz_and_delivers_in_order_after_its_latency() {
    let mut bench = DvlBench::new(&without_fish(Setup::quiet()), 1);
    let mut pings = Vec::new();
    while bench.k < 100_000 {
        pings.extend(bench.step().map(|(at_s, ping)| (at_s, ping.taken_at_s)));
    }
    let n = pings.len() as f64;
    let rate = n / 2000.0;
    assert!((rate / 8.0 - 1.0).abs() < 0.01, "{rate} Hz");
    assert!(pings.windows(2).all(|pair| pair[0].1 < pair[1].1 && pair[0].0 < pair[1].0), "in order");
    let latency: Vec<f64> = pings.iter().map(|(at_s, taken_s)| at_s - taken_s).collect();
    let least = latency.iter().copied().fold(f64::INFINITY, f64::min);
    let mean = latency.iter().sum::<f64>() / n;
    println!("DVL: {rate:.3} Hz, latency from {least:.3} s, mean {mean:.4} s");
    assert!(least >= 0.04 - 1e-9, "{least}");
    // 0.09 s, up to the next tick (half a tick in the mean), and a slow ping holds up the one behind it (5 ms).
    assert!((0.09 + 0.5 * H_S..0.09 + 0.5 * H_S + 0.007).contains(&mean), "{mean}");
    assert_eq!(bench.dvl.lost(), 0);
    // Intervals jitter by 10 %.
    let gaps: Vec<f64> = pings.windows(2).map(|pair| pair[1].1 - pair[0].1).collect();
    let gap_mean = gaps.iter().sum::<f64>() / gaps.len() as f64;
    let gap_std = (gaps.iter().map(|gap| (gap - gap_mean).powi(2)).sum::<f64>() / gaps.len() as f64).sqrt();
    // 12.5 ms of jitter, and the tick's rounding twice: √(12.5² + 20²/6) = 14.9 ms.
    assert!((gap_std - 0.0149).abs() < 0.001, "{gap_std}");
}

#[test]
fn the_dvls_latency_is_0_04_s_and_an_exponential_of_0_05_s() {
    // One ping in two seconds, so that none holds up another.
    let mut bench = DvlBench::new(&without_fish(Setup::quiet()).sensors("dvl.ping_interval_s", 2.0), 2);
    let mut latency = Vec::new();
    while bench.k < 2_000_000 {
        latency.extend(bench.step().map(|(at_s, ping)| at_s - ping.taken_at_s));
    }
    let (n, mean, std) = statistics(&latency);
    println!("DVL alone: latency {mean:.4} s (0.09 and half a tick), std {std:.4} s");
    assert!((mean - 0.09 - 0.5 * H_S).abs() < 3.0 * 0.05 / n.sqrt() + 2e-4, "{mean}");
    assert!((std - 0.05).abs() < 0.002, "{std}");
    // Longer than 0.04 + 0.06 s: e^{−6/5} of them. A tick's edge, so that rounding does not matter.
    let beyond = latency.iter().filter(|latency| **latency > 0.1 + 1e-6).count() as f64 / n;
    assert!((beyond - (-1.2f64).exp()).abs() < 0.01, "{beyond}");
}

#[test]
fn without_noise_ranges_are_those_of_geometry() {
    let mut setup = without_noise(without_fish(Setup::quiet()));
    put(&mut setup.sensors, "dvl.interval_jitter", 0.0);
    for (off_rad, radius_m) in [(0.0, 22.0), (0.3, 22.0), (-0.6, 20.0), (0.2, 5.0)] {
        let mut bench = DvlBench::new(&setup, 1);
        bench.position_m = Vector3::new(radius_m * 0.7f64.cos(), radius_m * 0.7f64.sin(), 4.0);
        bench.heading_rad = 0.7 + off_rad;
        bench.velocity = Vector3::new(0.1, -0.2, 0.05);
        let mut seen = 0;
        while bench.k < 100 {
            let Some((_, ping)) = bench.step() else { continue };
            seen += 1;
            assert_eq!(ping.velocity_m_per_s, Some([0.1, -0.2, 0.05]));
            for (beam, range) in SonarArray::new(25f64.to_radians()).beams().iter().zip(ping.beam_range_m) {
                // The hit lies on the cylinder.
                let hit =
                    bench.position_m + Heading::new(bench.heading_rad).ned_from_body(*beam) * range.expect("back");
                assert!((hit.x.hypot(hit.y) - 25.0).abs() < 1e-9, "{hit}");
            }
        }
        assert!(seen > 10);
    }
}

#[test]
fn beams_beyond_the_instruments_range_do_not_come_back_and_three_are_needed_for_a_velocity() {
    let near = without_noise(without_fish(Setup::quiet())).sensors("dvl.max_range_m", 3.6);
    let mut bench = DvlBench::new(&near, 1);
    // Turned by 0.3: two beams are longer than 3.6 m, two are shorter.
    bench.heading_rad = 0.7 + 0.3;
    let mut seen = 0;
    while bench.k < 100 {
        let Some((_, ping)) = bench.step() else { continue };
        seen += 1;
        assert_eq!(ping.beam_range_m.iter().flatten().count(), 2, "{:?}", ping.beam_range_m);
        assert_eq!(ping.velocity_m_per_s, None);
    }
    assert!(seen > 10);
    let close = without_noise(without_fish(Setup::quiet())).sensors("dvl.min_range_m", 3.4);
    let mut bench = DvlBench::new(&close, 1);
    while bench.k < 100 {
        if let Some((_, ping)) = bench.step() {
            assert_eq!(ping.beam_range_m, [None; 4]);
        }
    }
}

#[test]
fn the_dvls_noise_has_its_standard_deviations() {
    let mut bench = DvlBench::new(&without_fish(Setup::quiet()), 4);
    bench.velocity = Vector3::new(0.1, -0.2, 0.05);
    let mut exact = DvlBench::new(&without_noise(without_fish(Setup::quiet())), 4);
    exact.velocity = bench.velocity;
    let (mut velocity2, mut range2, mut n) = (0.0, 0.0, 0.0);
    while bench.k < 100_000 {
        let (Some((_, ping)), Some((_, truth))) = (bench.step(), exact.step()) else { continue };
        assert_eq!(ping.taken_at_s, truth.taken_at_s, "noise does not shift the timing");
        let difference = |a: Option<f64>, b: Option<f64>| a.expect("back") - b.expect("back");
        range2 += (0..4).map(|i| difference(ping.beam_range_m[i], truth.beam_range_m[i]).powi(2)).sum::<f64>() / 4.0;
        let (v, w) = (ping.velocity_m_per_s.expect("4 beams"), truth.velocity_m_per_s.expect("4 beams"));
        velocity2 += (0..3).map(|i| (v[i] - w[i]).powi(2)).sum::<f64>() / 3.0;
        n += 1.0;
    }
    let (velocity_std, range_std) = ((velocity2 / n).sqrt(), (range2 / n).sqrt());
    assert!((velocity_std / 0.025 - 1.0).abs() < 0.02, "{velocity_std}");
    assert!((range_std / 0.05 - 1.0).abs() < 0.02, "{range_std}");
}

#[test]
fn the_dvl_measures_relative_to_the_moving_net() {
    let mut setup = without_noise(without_fish(Setup::quiet()));
    put(&mut setup.environment, "cage.motion_amplitude_m", 0.02);
    put(&mut setup.environment, "cage.motion_period_s", 5.0);
    for off_rad in [0.0, 0.5] {
        let mut bench = DvlBench::new(&setup, 1);
        bench.heading_rad = 0.7 + off_rad;
        bench.velocity = Vector3::new(0.05, 0.2, 0.01);
        let mut fastest: f64 = 0.0;
        while bench.k < 2000 {
            let Some((_, ping)) = bench.step() else { continue };
            let net = 0.02 * TAU / 5.0 * (TAU / 5.0 * ping.taken_at_s).cos();
            let velocity = Vector3::from(ping.velocity_m_per_s.expect("4 beams"));
            // Outwards is along the bearing, which the bow is off by `off_rad`.
            let expected = bench.velocity - Vector3::new(net * off_rad.cos(), -net * off_rad.sin(), 0.0);
            assert!((velocity - expected).norm() < 1e-12, "{velocity} against {expected}");
            fastest = fastest.max(net.abs());
        }
        assert!(fastest > 0.02, "the net moved: {fastest} m/s");
    }
}

#[test]
fn fish_come_in_bursts_with_their_rate_duration_and_hits() {
    let mut bench = DvlBench::new(&without_noise(Setup::quiet()), 5);
    let mut exact = DvlBench::new(&without_noise(without_fish(Setup::quiet())), 5);
    let (mut pings, mut hit_pings, mut hits) = (0.0, 0.0, 0.0);
    let (mut least, mut most, mut sum) = (f64::INFINITY, 0.0f64, 0.0);
    let (mut disturbed2, mut clean) = (0.0, true);
    while bench.k < 3_000_000 {
        let (Some((_, ping)), Some((_, truth))) = (bench.step(), exact.step()) else { continue };
        pings += 1.0;
        let shares: Vec<f64> = (0..4)
            .map(|i| ping.beam_range_m[i].expect("back") / truth.beam_range_m[i].expect("back"))
            .filter(|share| *share < 0.99)
            .collect();
        for share in &shares {
            (least, most, sum) = (least.min(*share), most.max(*share), sum + share);
            hits += 1.0;
        }
        let velocity = Vector3::from(ping.velocity_m_per_s.expect("4 beams"));
        if shares.is_empty() {
            clean &= velocity.norm() <= 0.0;
        } else {
            hit_pings += 1.0;
            disturbed2 += velocity.norm_squared() / 3.0;
        }
    }
    // A burst is met at every ping with 1 − e^{−rate·interval} and lasts Exp(2 s): in pings, geometric both.
    let (start, end) = (1.0 - f64::exp(-0.125 / 6.0), 1.0 - f64::exp(-0.125 / 2.0));
    let (on, off) = (1.0 / end, (1.0 - start) / start);
    let share = on / (on + off);
    println!(
        "fish: pings with a hit {:.3} ({:.3}), beams hit {:.4} ({:.4}), factor {least:.3} to {most:.3}, velocity noise {:.4}",
        hit_pings / pings,
        share * (1.0 - 0.5f64.powi(4)),
        hits / (4.0 * pings),
        share * 0.5,
        (disturbed2 / hit_pings).sqrt()
    );
    // About 7500 bursts: their share is known to about 2 %.
    assert!((hit_pings / pings / (share * (1.0 - 0.5f64.powi(4))) - 1.0).abs() < 0.05, "{}", hit_pings / pings);
    // Of the beams of hit pings 0.5/(1 − 0.5⁴) are hit, independently of the bursts.
    let per_hit_ping = hits / (4.0 * hit_pings);
    assert!((per_hit_ping - 0.5 / (1.0 - 0.5f64.powi(4))).abs() < 0.005, "{per_hit_ping}");
    assert!((0.35..0.352).contains(&least) && (0.948..0.95).contains(&most), "{least} to {most}");
    assert!((sum / hits - 0.65).abs() < 0.003, "uniform: {}", sum / hits);
    assert!(((disturbed2 / hit_pings).sqrt() / 0.06 - 1.0).abs() < 0.01);
    assert!(clean, "pings without a hit are not disturbed");
}

#[test]
fn a_silent_dvl_delivers_nothing_until_it_speaks_again() {
    let mut bench = Setup::new("rataren").start("net_distance_m", 3.5).build(1);
    let mut healthy = bench.clone();
    bench.run(100, &idle());
    healthy.run(100, &idle());
    bench.command(&PlantCommand::DvlSilentForS(5.0));
    let mut after = 0;
    for k in 100..1000 {
        let (a, b) = (bench.step(&idle()), healthy.step(&idle()));
        assert_eq!((&a.depth, &a.compass, &a.gyro), (&b.depth, &b.compass, &b.gyro), "the others do not notice");
        if k < 350 {
            assert_eq!(a.dvl, None, "tick {k}");
        } else if k >= 375 {
            assert_eq!(a.dvl, b.dvl, "the same pings as if nothing had been");
            after += u32::from(a.dvl.is_some());
        }
    }
    assert!(after > 80, "{after} pings");
    assert_eq!(bench.plant.truth(), healthy.plant.truth());
}

// ------------------------------------------------------------------------------------------------------ other sensors

/// Number, mean and standard deviation.
fn statistics(samples: &[f64]) -> (f64, f64, f64) {
    let n = samples.len() as f64;
    let mean = samples.iter().sum::<f64>() / n;
    (n, mean, (samples.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n).sqrt())
}

#[test]
fn depth_compass_and_gyro_have_their_rates_noise_and_bias() {
    let sensors: SensorsConfig = read(&toml::Value::Table(file("sensors/argus-mini")));
    let mut depth = DepthSensor::new(&sensors.depth, 1, H_S);
    let mut compass = Compass::new(&sensors.compass, 1, H_S);
    let mut gyro = Gyro::new(&sensors.gyro, 1);
    let mut samples: [Vec<f64>; 3] = Default::default();
    let ticks = 200_000;
    for k in 0..ticks {
        let tick = Tick { k, dt_s: H_S };
        if let Some(sample) = depth.step(tick, 4.0, 0.03) {
            assert_eq!(sample.taken_at_s, tick.t_s());
            samples[0].push(sample.depth_m - 4.03);
        }
        // Across the seam: readings stay in [−π, π).
        if let Some(sample) = compass.step(tick, 3.13) {
            assert!((-core::f64::consts::PI..core::f64::consts::PI).contains(&sample.heading_rad));
            samples[1].push(ssa(sample.heading_rad - 3.13));
        }
        samples[2].push(gyro.step(tick, 0.05).yaw_rate_rad_per_s - 0.05);
    }
    let expected = [
        ("depth", 5, 0.02, 0.0),
        ("compass", 5, 1.5f64.to_radians(), 1f64.to_radians()),
        ("gyro", 1, 0.4f64.to_radians(), 0.1f64.to_radians()),
    ];
    for ((name, every, std, bias), samples) in expected.into_iter().zip(&samples) {
        let (n, mean, measured) = statistics(samples);
        assert_eq!(samples.len() as u64, ticks / every, "{name}: its rate");
        // Three standard errors.
        assert!((mean - bias).abs() < 3.0 * std / n.sqrt(), "{name}: {mean} against {bias}");
        assert!((measured / std - 1.0).abs() < 3.0 / (2.0 * n).sqrt(), "{name}: {measured} against {std}");
        // White: neighbours are uncorrelated.
        let lagged = samples.windows(2).map(|pair| (pair[0] - mean) * (pair[1] - mean)).sum::<f64>() / n;
        assert!((lagged / (measured * measured)).abs() < 3.0 / n.sqrt(), "{name}");
    }
}

#[test]
fn the_pressure_sensor_sees_the_dynamic_pressure_of_the_waves() {
    // A vehicle that floats with the particles keeps its pressure: from second to second the reading varies far less
    // than the true depth.
    let mut bench = Setup::quiet()
        .environment("waves.significant_height_m", 0.6)
        .environment("waves.direction_rad", 1.0)
        .sensors("depth.std_m", 0.0)
        .start("net_distance_m", 15.0)
        .build(2);
    bench.run(1500, &idle());
    let (mut depths, mut readings) = (Vec::new(), Vec::new());
    for _ in 0..5000 {
        if let Some(sample) = bench.step(&idle()).depth {
            readings.push(sample.depth_m);
            depths.push(bench.plant.truth().depth_m);
        }
    }
    let moved = |depths: &[f64]| {
        let steps: Vec<f64> = depths.windows(11).map(|second| second[10] - second[0]).collect();
        statistics(&steps).2
    };
    let (really, seen) = (moved(&depths), moved(&readings));
    println!("riding the waves, change of depth in a second: {really:.4} m rms, {seen:.4} m rms from pressure");
    assert!(really > 0.05, "{really}");
    assert!(seen < 0.1 * really, "{seen} against {really}");
}

#[test]
fn sensors_have_streams_of_their_own() {
    let base = Setup::new("rataren").start("net_distance_m", 3.5);
    let variants = [
        base.clone().sensors("dvl.fish.bursts_per_s", 0.0),
        base.clone().sensors("dvl.fish.hit_probability", 1.0),
        base.clone().sensors("dvl.interval_jitter", 0.0),
        base.clone().sensors("depth.std_m", 0.5),
        base.clone().sensors("gyro.std_rad_per_s", 0.1),
        base.clone().sensors("compass.period_s", 0.2),
    ];
    let command = thrust([5.0, 8.0, 3.0, -4.0, 7.0, 7.0]);
    for (i, variant) in variants.iter().enumerate() {
        let (mut a, mut b) = (base.build(9), variant.build(9));
        let (mut dvl, mut dvl_differs) = (0, 0);
        for k in 0..1500 {
            let (x, y) = (a.step(&command), b.step(&command));
            assert_eq!(a.plant.truth(), b.plant.truth(), "no sensor moves the vehicle");
            if i != 3 {
                assert_eq!(x.depth, y.depth, "variant {i}, tick {k}");
            }
            if i != 4 {
                assert_eq!(x.gyro, y.gyro, "variant {i}, tick {k}");
            }
            if i != 5 {
                assert_eq!(x.compass, y.compass, "variant {i}, tick {k}");
            }
            dvl += u32::from(x.dvl.is_some());
            dvl_differs += u32::from(x.dvl != y.dvl);
        }
        assert!(dvl > 200);
        assert_eq!(dvl_differs > 0, i < 3, "variant {i}: only the DVL's own settings change the DVL");
    }
}

#[test]
fn a_random_ride_stays_a_number_and_moves_continuously() {
    let mut draw = Stream::new(30, "ride");
    let mut bench = Setup::new("rataren").start("depth_m", 8.0).build(11);
    let mut command = idle();
    let mut last = bench.plant.truth().clone();
    for k in 0..5000 {
        if k % 25 == 0 {
            // 6 N down in the mean hold it against its buoyancy.
            let mut force_n = [0.0; 6];
            for force in &mut force_n[..4] {
                *force = 60.0 * draw.normal();
            }
            for force in &mut force_n[4..] {
                *force = 6.0 + 20.0 * draw.normal();
            }
            command = thrust(force_n);
        }
        let measurements = bench.step(&command);
        assert!(measurements.is_finite(), "tick {k}: {measurements:?}");
        let truth = bench.plant.truth();
        assert!(truth.is_finite());
        assert!((-core::f64::consts::PI..core::f64::consts::PI).contains(&truth.heading_rad));
        // Position is the integral of velocity, heading that of the yaw rate: trapezoids to 1 mm and 1 mrad.
        let moved =
            Vector3::new(truth.north_m - last.north_m, truth.east_m - last.east_m, truth.depth_m - last.depth_m);
        let expected = (velocity_ned(truth) + velocity_ned(&last)) * (0.5 * H_S);
        assert!(k == 0 || (moved - expected).norm() < 1e-3, "tick {k}: {moved} against {expected}");
        let turned = ssa(truth.heading_rad - last.heading_rad);
        let mean_rate = 0.5 * (truth.velocity.yaw_rad_per_s + last.velocity.yaw_rad_per_s);
        assert!((turned - H_S * mean_rate).abs() < 1e-3, "tick {k}: {turned}");
        last = truth.clone();
    }
    assert!(last.depth_m > 1.0, "it stayed under water: {}", last.depth_m);
}

#[test]
fn diving_needs_thrust_against_buoyancy() {
    // 12 N up, 2 · 6 N down: balanced, so a vehicle at rest stays at its depth once the thrust is there.
    let mut bench = Setup::quiet().vehicle("true.net_buoyancy_n", 12.0).build(1);
    bench.run(2000, &down(6.0));
    let truth = bench.plant.truth();
    assert!(truth.velocity.heave_m_per_s.abs() < 1e-6, "{}", truth.velocity.heave_m_per_s);
    assert!((truth.depth_m - 4.0).abs() < 0.05, "{}", truth.depth_m);
    bench.run(1000, &down(20.0));
    assert!(bench.plant.truth().depth_m > 6.0, "and more thrust dives");
}

#[test]
fn the_surface_holds_the_vehicle_back_whatever_the_thrusters_do() {
    // Full thrust upwards for two minutes in the highest sea: the body bobs at the surface, partly out of the water.
    let mut bench = Setup::new("rataren").build(1);
    let mut shallowest: f64 = 10.0;
    for _ in 0..6000 {
        bench.step(&down(-100.0));
        let truth = bench.plant.truth();
        assert!(supertwin_core::Message::is_finite(truth), "{truth:?}");
        shallowest = shallowest.min(truth.depth_m);
    }
    assert!(shallowest < 0.3, "it came up: {shallowest}");
    assert!(shallowest > -0.6, "and did not fly: {shallowest}");
    // Without thrust the floats keep it up there, in waves of 0.6 m.
    for _ in 0..3000 {
        bench.step(&idle());
        let depth_m = bench.plant.truth().depth_m;
        assert!((-0.6..2.0).contains(&depth_m), "{depth_m}");
    }
}
