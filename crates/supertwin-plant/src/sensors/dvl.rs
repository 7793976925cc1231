//! Forward-looking Doppler velocity log: pings with jitter and random latency, beams cast on the net, fish in between.

use crate::cage::Cage;
use arrayvec::ArrayVec;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::Tick;
use supertwin_core::check::{AcuteAngle, Fraction, NonNegative, Positive};
use supertwin_core::frame::Heading;
use supertwin_core::message::DvlPing;
use supertwin_core::random::Stream;
use supertwin_model::SonarArray;

/// Pings that can be under way at once.
const MAX_UNDER_WAY: usize = 16;

/// DVL of a sensor file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DvlConfig {
    /// Angle of the beams off the forward axis.
    pub beam_angle_rad: AcuteAngle,
    /// Mean time between pings.
    pub ping_interval_s: Positive,
    /// Standard deviation of that time, as a share of it.
    pub interval_jitter: Fraction,
    /// Shortest time from ping to delivery.
    pub latency_s: NonNegative,
    /// Mean of the exponential part on top.
    pub extra_latency_mean_s: NonNegative,
    /// Standard deviation of each velocity component.
    pub velocity_std_m_per_s: NonNegative,
    /// Standard deviation of each range.
    pub range_std_m: NonNegative,
    /// Ranges below this do not come back.
    pub min_range_m: NonNegative,
    /// Ranges above this do not come back.
    pub max_range_m: Positive,
    /// Fish in front of the net.
    pub fish: FishConfig,
}

/// Fish that block beams in bursts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FishConfig {
    /// Rate at which bursts begin.
    pub bursts_per_s: NonNegative,
    /// Mean duration of a burst (exponential).
    pub mean_duration_s: Positive,
    /// Probability that a beam is hit in a ping of a burst.
    pub hit_probability: Fraction,
    /// A beam that is hit is this much shorter, drawn per beam.
    pub range_factor: [Fraction; 2],
    /// Standard deviation that a ping with hits adds to each velocity component.
    pub velocity_std_m_per_s: NonNegative,
}

/// The true state that a ping sees.
#[derive(Clone, Copy, Debug)]
pub struct DvlScene<'a> {
    /// Position in NED axes.
    pub position_m: &'a Vector3<f64>,
    /// Heading of the vehicle: the rotation from body to NED axes.
    pub heading: Heading,
    /// Velocity over ground in body axes.
    pub velocity_m_per_s: Vector3<f64>,
    /// The net.
    pub cage: &'a Cage,
}

/// The instrument's state.
#[derive(Clone, Debug)]
pub struct Dvl {
    config: DvlConfig,
    array: SonarArray,
    next_ping_s: f64,
    burst_until_s: f64,
    silent_until_s: f64,
    under_way: ArrayVec<(f64, DvlPing), MAX_UNDER_WAY>,
    timing: Stream,
    noise: Stream,
    fish: Stream,
    /// Pings lost inside the instrument because too many were under way.
    pub lost: u64,
}

impl Dvl {
    /// Draws from the streams `dvl/timing`, `dvl/noise` and `dvl/fish`.
    #[must_use]
    pub fn new(config: &DvlConfig, seed: u64) -> Self {
        let mut timing = Stream::new(seed, "dvl/timing");
        Self {
            config: *config,
            array: SonarArray::new(config.beam_angle_rad.get()),
            next_ping_s: timing.uniform(0.0, config.ping_interval_s.get()),
            burst_until_s: f64::NEG_INFINITY,
            silent_until_s: f64::NEG_INFINITY,
            under_way: ArrayVec::new(),
            timing,
            noise: Stream::new(seed, "dvl/noise"),
            fish: Stream::new(seed, "dvl/fish"),
            lost: 0,
        }
    }

    /// Delivers nothing until `t_s`.
    pub fn silence_until(&mut self, t_s: f64) {
        self.silent_until_s = t_s;
        self.under_way.clear();
    }

    /// Pings when it is time to, and delivers what has arrived, in order, at most one ping per tick.
    pub fn step(&mut self, tick: Tick, scene: &DvlScene<'_>) -> Option<DvlPing> {
        let now_s = tick.t_s();
        if now_s >= self.next_ping_s {
            let c = &self.config;
            let interval_s = c.ping_interval_s.get();
            self.next_ping_s +=
                (interval_s * (1.0 + c.interval_jitter.get() * self.timing.normal())).max(0.25 * interval_s);
            let latency_s = c.latency_s.get() + self.timing.exponential(c.extra_latency_mean_s.get());
            let ping = self.ping(now_s, interval_s, scene);
            if now_s >= self.silent_until_s {
                // Deliveries keep their order: a ping never overtakes the one before it.
                let due_s = (now_s + latency_s).max(self.under_way.last().map_or(0.0, |(due_s, _)| *due_s));
                if self.under_way.try_push((due_s, ping)).is_err() {
                    self.lost += 1;
                }
            }
        }
        match self.under_way.first() {
            Some((due_s, _)) if now_s >= *due_s => self.under_way.pop_at(0).map(|(_, ping)| ping),
            _ => None,
        }
    }

    fn ping(&mut self, now_s: f64, interval_s: f64, scene: &DvlScene<'_>) -> DvlPing {
        let c = &self.config;
        // A burst begins in this ping's interval with probability 1 − e^{−rate · interval}.
        if now_s >= self.burst_until_s && self.fish.chance(-libm::expm1(-c.fish.bursts_per_s.get() * interval_s)) {
            self.burst_until_s = now_s + self.fish.exponential(c.fish.mean_duration_s.get());
        }
        let burst = now_s < self.burst_until_s;
        let mut any_hit = false;
        let (gap_m, [north, east]) = scene.cage.gap(scene.position_m);
        let radius_m = gap_m + scene.position_m.x * north + scene.position_m.y * east;
        let beam_range_m = core::array::from_fn(|i| {
            let ray = scene.heading.ned_from_body(self.array.beams()[i]);
            let noise_m = c.range_std_m.get() * self.noise.normal();
            let mut range_m = scene.cage.range(scene.position_m, &ray, radius_m)? + noise_m;
            if burst && self.fish.chance(c.fish.hit_probability.get()) {
                let [low, high] = c.fish.range_factor.map(Fraction::get);
                range_m *= self.fish.uniform(low, high);
                any_hit = true;
            }
            (c.min_range_m.get()..=c.max_range_m.get()).contains(&range_m).then_some(range_m)
        });
        // Velocity relative to the net, which moves outwards along the bearing of the vehicle.
        let net_speed = scene.cage.outward_speed_m_per_s;
        let net_velocity = scene.heading.body_from_ned(Vector3::new(north * net_speed, east * net_speed, 0.0));
        let fish_std = if any_hit { c.fish.velocity_std_m_per_s.get() } else { 0.0 };
        let noise = self.noise.normals::<3>() * c.velocity_std_m_per_s.get() + self.fish.normals::<3>() * fish_std;
        let velocity = scene.velocity_m_per_s - net_velocity + noise;
        let enough = beam_range_m.iter().flatten().count() >= 3;
        DvlPing { taken_at_s: now_s, velocity_m_per_s: enough.then(|| velocity.into()), beam_range_m }
    }
}
