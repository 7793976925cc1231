//! Thrusters: delay, lag, limits, faults.

use super::{Bench, H_S, STALE_TICKS, Setup, ahead, idle, thrust};
use core::f64::consts::FRAC_1_SQRT_2;
use supertwin_core::command::PlantCommand;
use supertwin_core::message::Thrust;
use supertwin_core::observe::Snapshot;
use supertwin_core::{Block, Input, Message, signal};

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
        assert!(measurements.is_finite() && bench.plant.truth.is_finite());
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
    let gain = |thruster, gain| PlantCommand::ThrusterGain { thruster, gain };
    let cases = [
        (gain(0, 1.0), "thruster_gain.thruster = 0: must be between 1 and 6"),
        (gain(7, 1.0), "thruster_gain.thruster = 7: must be between 1 and 6"),
        (gain(1, 2.5), "thruster_gain.gain = 2.5: must be between 0 and 2"),
        (gain(1, f64::NAN), "thruster_gain.gain = NaN: must be between 0 and 2"),
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
                assert!(bench.plant.truth.thruster_force_n[0] > 49.0, "held up to 0.5 s");
                assert!(health(&bench) <= 0.0);
            }
        }
        // From here on neutral; what was under way still arrives for 0.1 s, and then the lag.
        for i in 0..100 {
            bench.step_with(if missing { Input::Missing } else { Input::Held { value: &command, made_at } });
            assert!(health(&bench) >= 1.0, "said so");
            let force = bench.plant.truth.thruster_force_n[0];
            assert_eq!(force > 49.0, i < 5, "tick {i}: {force}");
        }
        assert!(bench.plant.truth.thruster_force_n[0] < 1e-3);
        bench.step(&command);
        assert!(health(&bench) <= 0.0, "fresh again");
    }
}

#[test]
fn a_delay_that_is_too_long_is_refused() {
    let refusal = Setup::quiet().set("vehicle.propulsion.delay_s", 2.0).try_build(1).expect_err("too long");
    assert_eq!(refusal, "propulsion.delay_s = 2: must be shorter than 1.28 s (64 ticks)");
}
