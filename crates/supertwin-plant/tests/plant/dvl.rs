//! The DVL.

use super::{H_S, Setup, idle, read, statistics};
use core::f64::consts::TAU;
use nalgebra::Vector3;
use supertwin_core::Tick;
use supertwin_core::command::PlantCommand;
use supertwin_core::frame::Heading;
use supertwin_core::message::DvlPing;
use supertwin_model::SonarArray;
use supertwin_plant::SensorsConfig;
use supertwin_plant::cage::Cage;
use supertwin_plant::sensors::{Dvl, DvlScene};

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
        let sensors: SensorsConfig = read(setup.parts["sensors"].clone());
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
    /// Pings up to a tick, each with the time of its delivery.
    fn pings_until(&mut self, end: u64) -> Vec<(f64, DvlPing)> {
        let mut pings = Vec::new();
        while self.k < end {
            pings.extend(self.step());
        }
        pings
    }
    fn step(&mut self) -> Option<(f64, DvlPing)> {
        let tick = Tick { k: self.k, dt_s: H_S };
        self.k += 1;
        self.cage.set_time(tick.t_s());
        let (heading, velocity_m_per_s) = (Heading::new(self.heading_rad), self.velocity);
        let scene = DvlScene { position_m: &self.position_m, heading, velocity_m_per_s, cage: &self.cage };
        self.dvl.step(tick, &scene).map(|ping| (tick.t_s(), ping))
    }
}

fn without_fish(setup: Setup) -> Setup {
    setup.set("sensors.dvl.fish.bursts_per_s", 0.0)
}

fn without_noise(setup: Setup) -> Setup {
    setup.set("sensors.dvl.velocity_std_m_per_s", 0.0).set("sensors.dvl.range_std_m", 0.0)
}

#[test]
fn the_dvl_pings_at_8_hz_and_delivers_in_order_after_its_latency() {
    let mut bench = DvlBench::new(&without_fish(Setup::quiet()), 1);
    let pings = bench.pings_until(100_000);
    let pings: Vec<(f64, f64)> = pings.into_iter().map(|(at_s, ping)| (at_s, ping.taken_at_s)).collect();
    let n = pings.len() as f64;
    let rate = n / 2000.0;
    assert!((rate / 8.0 - 1.0).abs() < 0.01, "{rate} Hz");
    assert!(pings.windows(2).all(|pair| pair[0].1 < pair[1].1 && pair[0].0 < pair[1].0), "in order");
    let latency: Vec<f64> = pings.iter().map(|(at_s, taken_s)| at_s - taken_s).collect();
    let least = latency.iter().copied().fold(f64::INFINITY, f64::min);
    let (_, mean, _) = statistics(&latency);
    println!("DVL: {rate:.3} Hz, latency from {least:.3} s, mean {mean:.4} s");
    assert!(least >= 0.04 - 1e-9, "{least}");
    // 0.09 s, up to the next tick (half a tick in the mean), and a slow ping holds up the one behind it (5 ms).
    assert!((0.09 + 0.5 * H_S..0.09 + 0.5 * H_S + 0.007).contains(&mean), "{mean}");
    assert_eq!(bench.dvl.lost, 0);
    // Intervals jitter by 10 %.
    let gaps: Vec<f64> = pings.windows(2).map(|pair| pair[1].1 - pair[0].1).collect();
    let (_, _, gap_std) = statistics(&gaps);
    // 12.5 ms of jitter, and the tick's rounding twice: √(12.5² + 20²/6) = 14.9 ms.
    assert!((gap_std - 0.0149).abs() < 0.001, "{gap_std}");
}

#[test]
fn the_dvls_latency_is_0_04_s_and_an_exponential_of_0_05_s() {
    // One ping in two seconds, so that none holds up another.
    let mut bench = DvlBench::new(&without_fish(Setup::quiet()).set("sensors.dvl.ping_interval_s", 2.0), 2);
    let pings = bench.pings_until(2_000_000);
    let latency: Vec<f64> = pings.iter().map(|(at_s, ping)| at_s - ping.taken_at_s).collect();
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
    let setup = without_noise(without_fish(Setup::quiet())).set("sensors.dvl.interval_jitter", 0.0);
    for (off_rad, radius_m) in [(0.0, 22.0), (0.3, 22.0), (-0.6, 20.0), (0.2, 5.0)] {
        let mut bench = DvlBench::new(&setup, 1);
        bench.position_m = Vector3::new(radius_m * 0.7f64.cos(), radius_m * 0.7f64.sin(), 4.0);
        bench.heading_rad = 0.7 + off_rad;
        bench.velocity = Vector3::new(0.1, -0.2, 0.05);
        let pings = bench.pings_until(100);
        assert!(pings.len() > 10);
        for (_, ping) in pings {
            assert_eq!(ping.velocity_m_per_s, Some([0.1, -0.2, 0.05]));
            for (beam, range) in SonarArray::new(25f64.to_radians()).beams().iter().zip(ping.beam_range_m) {
                // The hit lies on the cylinder.
                let beam_ned = Heading::new(bench.heading_rad).ned_from_body(*beam);
                let hit = bench.position_m + beam_ned * range.expect("back");
                assert!((hit.x.hypot(hit.y) - 25.0).abs() < 1e-9, "{hit}");
            }
        }
    }
}

#[test]
fn beams_beyond_the_instruments_range_do_not_come_back_and_three_are_needed_for_a_velocity() {
    let near = without_noise(without_fish(Setup::quiet())).set("sensors.dvl.max_range_m", 3.6);
    let mut bench = DvlBench::new(&near, 1);
    // Turned by 0.3: two beams are longer than 3.6 m, two are shorter.
    bench.heading_rad = 0.7 + 0.3;
    let pings = bench.pings_until(100);
    assert!(pings.len() > 10);
    for (_, ping) in pings {
        assert_eq!(ping.beam_range_m.iter().flatten().count(), 2, "{:?}", ping.beam_range_m);
        assert_eq!(ping.velocity_m_per_s, None);
    }
    let close = without_noise(without_fish(Setup::quiet())).set("sensors.dvl.min_range_m", 3.4);
    for (_, ping) in DvlBench::new(&close, 1).pings_until(100) {
        assert_eq!(ping.beam_range_m, [None; 4]);
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
    let setup = without_noise(without_fish(Setup::quiet())).set("environment.cage.motion_amplitude_m", 0.02);
    let setup = setup.set("environment.cage.motion_period_s", 5.0);
    for off_rad in [0.0, 0.5] {
        let mut bench = DvlBench::new(&setup, 1);
        bench.heading_rad = 0.7 + off_rad;
        bench.velocity = Vector3::new(0.05, 0.2, 0.01);
        let mut fastest: f64 = 0.0;
        for (_, ping) in bench.pings_until(2000) {
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
    // At least one of four beams is hit.
    let any = 1.0 - 0.5f64.powi(4);
    let (hit_share, per_hit_ping, noise) =
        (hit_pings / pings, hits / (4.0 * hit_pings), (disturbed2 / hit_pings).sqrt());
    println!("fish: pings with a hit {hit_share:.3} ({:.3}), factor {least:.3} to {most:.3}, {noise:.4}", share * any);
    // About 7500 bursts: their share is known to about 2 %.
    assert!((hit_share / (share * any) - 1.0).abs() < 0.05, "{hit_share}");
    // Of the beams of hit pings 0.5/(1 − 0.5⁴) are hit, independently of the bursts.
    assert!((per_hit_ping - 0.5 / any).abs() < 0.005, "{per_hit_ping}");
    assert!((0.35..0.352).contains(&least) && (0.948..0.95).contains(&most), "{least} to {most}");
    assert!((sum / hits - 0.65).abs() < 0.003, "uniform: {}", sum / hits);
    assert!((noise / 0.06 - 1.0).abs() < 0.01, "{noise}");
    assert!(clean, "pings without a hit are not disturbed");
}

#[test]
fn a_silent_dvl_delivers_nothing_until_it_speaks_again() {
    let mut bench = Setup::new("rataren").set("start.net_distance_m", 3.5).build(1);
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
    assert_eq!(&bench.plant.truth, &healthy.plant.truth);
}
