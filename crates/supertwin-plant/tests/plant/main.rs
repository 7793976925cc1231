//! The plant: integration, water, thrusters, sensors and their faults, on the real configuration files.

#[path = "../../../../tests/support/config.rs"]
mod config;
mod dvl;
mod sensors;
mod thrusters;

use config::{file, put, read};
use core::f64::consts::FRAC_1_SQRT_2;
use nalgebra::{Vector3, Vector4};
use supertwin_core::command::PlantCommand;
use supertwin_core::frame::{Heading, ssa};
use supertwin_core::message::{Measurements, Thrust, Truth};
use supertwin_core::{Block, Input, Prev, Tick, Wrench};
use supertwin_model::{Hydrodynamics, HydrodynamicsConfig, ThrusterConfig, Thrusters};
use supertwin_plant::cage::Cage;
use supertwin_plant::{Drive, Plant, PlantConfig};

const H_S: f64 = 0.02;
/// Age of a thrust command that means neutral: 0.5 s.
const STALE_TICKS: u64 = 25;

/// Everything a plant is made of: `vehicle`, `environment`, `sensors` and `start`, as tables that a test may change.
#[derive(Clone)]
struct Setup {
    parts: toml::Table,
    dt_s: f64,
    substeps: u32,
}

impl Setup {
    fn new(environment: &str) -> Self {
        let mut parts = toml::Table::new();
        for (part, path) in [("vehicle", "vehicles/argus-mini"), ("sensors", "sensors/argus-mini")] {
            put(&mut parts, part, file(path));
        }
        put(&mut parts, "environment", file(&format!("environments/{environment}")));
        put(&mut parts, "start", toml::Table::new());
        let setup = Self { parts, dt_s: H_S, substeps: 2 };
        let setup = setup.set("start.bearing_rad", 0.4).set("start.net_distance_m", 10.0);
        setup.set("start.depth_m", 4.0).set("start.heading_offset_rad", 0.1)
    }

    /// A calm sea and a round pen that stands still, neutral buoyancy, no coupling of sway thrust into yaw.
    fn quiet() -> Self {
        let setup = Self::new("calm").set("vehicle.true.net_buoyancy_n", 0.0);
        let setup = setup.set("vehicle.unmodelled.sway_to_yaw_arm_m", 0.0).set("environment.cage.tilt_m_per_m", 0.0);
        setup.set("environment.cage.undulation", Vec::<toml::Value>::new())
    }

    /// Sets `part.a.b`.
    fn set(mut self, path: &str, value: impl Into<toml::Value>) -> Self {
        put(&mut self.parts, path, value);
        self
    }

    fn try_build(&self, seed: u64) -> Result<Plant, String> {
        let vehicle = &self.parts["vehicle"];
        let of_vehicle = |part: &str| vehicle[part].clone();
        let dynamics: HydrodynamicsConfig = read(of_vehicle("true"));
        let thrusters: Vec<ThrusterConfig> = read(of_vehicle("thruster"));
        let config = PlantConfig {
            dynamics: Hydrodynamics::from(&dynamics),
            mass_kg: dynamics.rigid_body.mass_kg.get(),
            height_m: vehicle["size_m"][2].as_float().expect("a length"),
            thrusters: Thrusters::new(&thrusters).expect("fully actuated"),
            propulsion: &read(of_vehicle("propulsion")),
            unmodelled: &read(of_vehicle("unmodelled")),
            environment: &read(self.parts["environment"].clone()),
            sensors: &read(self.parts["sensors"].clone()),
            start: &read(self.parts["start"].clone()),
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
        Cage::new(&read(self.parts["environment"]["cage"].clone()), seed).expect("a legal pen")
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
        &self.plant.truth
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
    ned(truth, truth.velocity.vector())
}

/// What a vector in the vehicle's axes is in NED axes.
fn ned(truth: &Truth, body: Vector4<f64>) -> Vector3<f64> {
    Heading::new(truth.heading_rad).ned_from_body(body.xyz())
}

fn state(truth: &Truth) -> [f64; 8] {
    let nu = truth.velocity.to_array();
    [truth.north_m, truth.east_m, truth.depth_m, truth.heading_rad, nu[0], nu[1], nu[2], nu[3]]
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

/// Number, mean and standard deviation.
fn statistics(samples: &[f64]) -> (f64, f64, f64) {
    let n = samples.len() as f64;
    let mean = samples.iter().sum::<f64>() / n;
    (n, mean, (samples.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n).sqrt())
}

// ----------------------------------------------------------------------------------------------------------- driven

#[test]
fn a_driven_plant_feels_the_given_force_and_nothing_of_the_sea() {
    // North by East, whatever the heading; in a sea with current, waves and a tether.
    let force_ned_n = [20.0, 10.0, 0.0];
    let mut directions = Vec::new();
    for offset_rad in [0.1, 2.0, -1.3] {
        let setup =
            Setup::new("rataren").set("vehicle.true.net_buoyancy_n", 0.0).set("start.heading_offset_rad", offset_rad);
        let mut bench = setup.set("sensors.depth.std_m", 0.0).build(3);
        for _ in 0..60 {
            bench.plant.drive(Drive { force_ned_n, yaw_nm: 0.0 });
            let measured = bench.step(&idle());
            let truth = &bench.plant.truth;
            if let Some(sample) = measured.depth {
                assert_eq!(sample.depth_m.to_bits(), truth.depth_m.to_bits(), "no wave's pressure");
            }
            assert_eq!((truth.current_m_per_s, truth.water_velocity.to_array()), ([0.0; 3], [0.0; 4]));
        }
        let truth = &bench.plant.truth;
        let back = ned(truth, truth.disturbance.vector());
        assert!((back - Vector3::from(force_ned_n)).norm() < 0.5, "{back}");
        let velocity = velocity_ned(truth);
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
        let mut setup = Setup::quiet().set("vehicle.propulsion.lag_s", 1e-6).set("vehicle.propulsion.delay_s", 0.0);
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
            let apart = |(a, b): (&[f64; 8], &[f64; 8])| distance(&a[part.clone()], &b[part.clone()]);
            states.iter().zip(&exact).map(apart).fold(0.0, f64::max)
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
    let before = bench.plant.truth.clone();
    assert!((before.net_distance_m - 10.0).abs() < 1e-12);
    assert!((before.depth_m - 4.0).abs() < 1e-12 && (before.net_heading_rad - 0.4).abs() < 1e-12);
    assert!((before.heading_rad - 0.5).abs() < 1e-12, "0.1 off the direction that faces the net");
    let measurements = bench.step(&ahead(100.0));
    assert_eq!(bench.plant.truth, before);
    assert!(measurements.depth.is_some() && measurements.compass.is_some() && measurements.gyro.is_some());
}

#[test]
fn the_start_is_drawn_within_its_ranges() {
    let range = |low: f64, high: f64| toml::Value::Array(vec![low.into(), high.into()]);
    let setup = Setup::new("rataren")
        .set("start.net_distance_m", range(3.4, 4.2))
        .set("start.heading_offset_rad", range(-0.24, 0.24))
        .set("start.bearing_rad", range(-3.1, 3.1));
    let mut distances = Vec::new();
    for seed in 0..50 {
        let truth = setup.build(seed).plant.truth.clone();
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
        assert_eq!(a.plant.truth, b.plant.truth);
        differs += u32::from(x != z);
    }
    assert_eq!(differs, 2000, "another seed has other noise at every tick");
}

// -------------------------------------------------------------------------------------------------------------- water

#[test]
fn a_vehicle_without_thrust_drifts_with_a_steady_current() {
    for direction in [-2.5f64, 0.7] {
        let mut bench = Setup::quiet()
            .set("environment.current.speed_m_per_s", 0.22)
            .set("environment.current.decay_per_m", 0.0)
            .set("environment.current.veering_rad_per_m", 0.0)
            .set("environment.current.direction_rad", direction)
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
            .set("environment.current.speed_m_per_s", 0.22)
            .set("environment.current.direction_rad", 0.3)
            .set("start.depth_m", depth_m)
            .build(1);
        let truth = bench.run(2, &idle());
        ned(truth, truth.water_velocity.vector())
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
        .set("environment.waves.significant_height_m", 0.6)
        .set("environment.waves.direction_rad", 1.0)
        .set("start.net_distance_m", 15.0)
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
    println!("waves: water {water:.4?} m/s rms, slip {slip:.4?} m/s rms, mean sink {sinks:.4} m/s");
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
    let mut bench = Setup::quiet().set("vehicle.true.net_buoyancy_n", 12.0).set("start.depth_m", 12.0).build(1);
    let truth = bench.run(2500, &idle()).clone();
    // 350 w² + 90 w = 12.
    let rise = (-90.0 + f64::sqrt(90.0 * 90.0 + 4.0 * 350.0 * 12.0)) / 700.0;
    assert!((truth.velocity.heave_m_per_s + rise).abs() < 1e-6, "{} against -{rise}", truth.velocity.heave_m_per_s);
    assert!(truth.depth_m < 12.0 - 0.9 * rise * 50.0, "up is towards smaller depth: {}", truth.depth_m);
}

#[test]
fn full_thrust_ahead_makes_1_03_m_per_s() {
    let mut bench = Setup::quiet().set("start.net_distance_m", 24.0).build(1);
    let truth = bench.run(3000, &ahead(100.0));
    let exact = (-70.0 + f64::sqrt(70.0 * 70.0 + 4.0 * 200.0 * 400.0 * FRAC_1_SQRT_2)) / 400.0;
    assert!((truth.velocity.surge_m_per_s - exact).abs() < 1e-6, "{}", truth.velocity.surge_m_per_s);
    assert!((exact - 1.03).abs() < 0.005);
}

#[test]
fn sway_thrust_turns_the_vehicle_through_the_unmodelled_arm() {
    let mut bench = Setup::quiet().set("vehicle.unmodelled.sway_to_yaw_arm_m", 0.1).build(1);
    let truth = bench.run(200, &thrust([-20.0, 20.0, 20.0, -20.0, 0.0, 0.0]));
    assert!(truth.wrench.sway_n > 50.0 && truth.wrench.surge_n.abs() < 1e-9 && truth.wrench.yaw_nm.abs() < 1e-9);
    assert!((truth.disturbance.yaw_nm - 0.1 * truth.wrench.sway_n).abs() < 1e-9);
    assert_eq!([truth.disturbance.surge_n, truth.disturbance.sway_n, truth.disturbance.heave_n], [0.0; 3]);
}

#[test]
fn the_tether_pulls_with_its_standard_deviations() {
    // 4000 s with a correlation time of 20 s are 100 independent samples per seed; ten seeds know their std to 3 %.
    let setup = Setup::new("rataren").set("vehicle.unmodelled.sway_to_yaw_arm_m", 0.0);
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
