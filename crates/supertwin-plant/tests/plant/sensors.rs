//! Depth sensor, compass and gyro, and rides with all of them.

use super::{H_S, Setup, down, file, idle, read, statistics, thrust, velocity_ned};
use nalgebra::Vector3;
use supertwin_core::frame::ssa;
use supertwin_core::message::Truth;
use supertwin_core::random::Stream;
use supertwin_core::{Message, Tick};
use supertwin_plant::SensorsConfig;
use supertwin_plant::sensors::{Compass, DepthSensor, Gyro};

#[test]
fn depth_compass_and_gyro_have_their_rates_noise_and_bias() {
    let sensors: SensorsConfig = read(file("sensors/argus-mini"));
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
        .set("environment.waves.significant_height_m", 0.6)
        .set("environment.waves.direction_rad", 1.0)
        .set("sensors.depth.std_m", 0.0)
        .set("start.net_distance_m", 15.0)
        .build(2);
    bench.run(1500, &idle());
    let (mut depths, mut readings) = (Vec::new(), Vec::new());
    for _ in 0..5000 {
        if let Some(sample) = bench.step(&idle()).depth {
            readings.push(sample.depth_m);
            depths.push(bench.plant.truth.depth_m);
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
    let base = Setup::new("rataren").set("start.net_distance_m", 3.5);
    let command = thrust([5.0, 8.0, 3.0, -4.0, 7.0, 7.0]);
    for (setting, value) in [
        ("dvl.fish.bursts_per_s", 0.0),
        ("dvl.fish.hit_probability", 1.0),
        ("dvl.interval_jitter", 0.0),
        ("depth.std_m", 0.5),
        ("gyro.std_rad_per_s", 0.1),
        ("compass.period_s", 0.2),
    ] {
        let of = |sensor: &str| setting.starts_with(sensor);
        let (mut a, mut b) = (base.build(9), base.clone().set(&format!("sensors.{setting}"), value).build(9));
        let (mut dvl, mut dvl_differs) = (0, 0);
        for k in 0..1500 {
            let (x, y) = (a.step(&command), b.step(&command));
            assert_eq!(a.plant.truth, b.plant.truth, "no sensor moves the vehicle");
            assert!(of("depth") || x.depth == y.depth, "{setting}, tick {k}: {x:?} {y:?}");
            assert!(of("gyro") || x.gyro == y.gyro, "{setting}, tick {k}: {x:?} {y:?}");
            assert!(of("compass") || x.compass == y.compass, "{setting}, tick {k}: {x:?} {y:?}");
            dvl += u32::from(x.dvl.is_some());
            dvl_differs += u32::from(x.dvl != y.dvl);
        }
        assert!(dvl > 200);
        assert_eq!(dvl_differs > 0, of("dvl"), "{setting}: only the DVL's own settings change the DVL");
    }
}

#[test]
fn a_random_ride_stays_a_number_and_moves_continuously() {
    let mut draw = Stream::new(30, "ride");
    let mut bench = Setup::new("rataren").set("start.depth_m", 8.0).build(11);
    let mut command = idle();
    let mut last = bench.plant.truth.clone();
    for k in 0..5000 {
        if k % 25 == 0 {
            // 6 N down in the mean hold it against its buoyancy.
            let scale = [(0.0, 60.0), (0.0, 60.0), (0.0, 60.0), (0.0, 60.0), (6.0, 20.0), (6.0, 20.0)];
            command = thrust(scale.map(|(mean, std)| mean + std * draw.normal()));
        }
        let measurements = bench.step(&command);
        assert!(measurements.is_finite(), "tick {k}: {measurements:?}");
        let truth = &bench.plant.truth;
        assert!(truth.is_finite());
        assert!((-core::f64::consts::PI..core::f64::consts::PI).contains(&truth.heading_rad));
        // Position is the integral of velocity, heading that of the yaw rate: trapezoids to 1 mm and 1 mrad.
        let position = |truth: &Truth| Vector3::new(truth.north_m, truth.east_m, truth.depth_m);
        let moved = position(truth) - position(&last);
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
    let mut bench = Setup::quiet().set("vehicle.true.net_buoyancy_n", 12.0).build(1);
    bench.run(2000, &down(6.0));
    let truth = &bench.plant.truth;
    assert!(truth.velocity.heave_m_per_s.abs() < 1e-6, "{}", truth.velocity.heave_m_per_s);
    assert!((truth.depth_m - 4.0).abs() < 0.05, "{}", truth.depth_m);
    bench.run(1000, &down(20.0));
    assert!(bench.plant.truth.depth_m > 6.0, "and more thrust dives");
}

#[test]
fn the_surface_holds_the_vehicle_back_whatever_the_thrusters_do() {
    // Full thrust upwards for two minutes in the highest sea: the body bobs at the surface, partly out of the water.
    let mut bench = Setup::new("rataren").build(1);
    let mut shallowest: f64 = 10.0;
    for _ in 0..6000 {
        bench.step(&down(-100.0));
        let truth = &bench.plant.truth;
        assert!(supertwin_core::Message::is_finite(truth), "{truth:?}");
        shallowest = shallowest.min(truth.depth_m);
    }
    assert!(shallowest < 0.3, "it came up: {shallowest}");
    assert!(shallowest > -0.6, "and did not fly: {shallowest}");
    // Without thrust the floats keep it up there, in waves of 0.6 m.
    for _ in 0..3000 {
        bench.step(&idle());
        let depth_m = bench.plant.truth.depth_m;
        assert!((-0.6..2.0).contains(&depth_m), "{depth_m}");
    }
}
