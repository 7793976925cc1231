//! The estimator service: measurements and allocated thrust in, navigation out.

use crate::ekf::{B, Ekf, EkfConfig, Innovation, NU, PSI, Z};
use crate::net_plane::{NetPlane, NetPlaneConfig};
use nalgebra::{Vector3, Vector4};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{NonNegative, Positive};
use supertwin_core::command::EstimatorCommand;
use supertwin_core::message::{DvlPing, Measurements, Nav, NavHealth, NavVariance, Thrust};
use supertwin_core::{
    Block, Input, Notice, Notices, Observe, OperatorLink, PortRule, Prev, Probe, Refusal, Tick, Wired, Wires,
    parameter, signal,
};
use supertwin_model::Hydrodynamics;

/// An estimator file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EstimatorConfig {
    /// What it is and where its numbers come from.
    pub description: String,
    /// The filter.
    pub ekf: EkfConfig,
    /// The filter's trust in its sensors.
    pub measurement: MeasurementConfig,
    /// The net in front.
    pub net_plane: NetPlaneConfig,
}

/// Standard deviations and gates of the measurement updates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeasurementConfig {
    /// DVL velocity components.
    pub dvl: SensorTrust,
    /// Depth, from the pressure sensor.
    pub depth: SensorTrust,
    /// Heading, from the compass.
    pub compass: SensorTrust,
    /// Yaw rate, from the gyro.
    pub gyro: SensorTrust,
}

/// Trust in one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SensorTrust {
    /// Standard deviation that the filter assumes, in the sensor's unit.
    pub std: Positive,
    /// Gate on the normalised innovation squared (chi-square, one degree of freedom); without it all is taken.
    pub gate: Option<Positive>,
}

/// How old inputs may get, in seconds, before the estimator says so.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EstimatorLimits {
    /// A held thrust command older than this counts as none.
    pub thrust_s: NonNegative,
    /// Without a velocity for longer than this, health says dead reckoning.
    pub dvl_s: NonNegative,
    /// Without a depth.
    pub depth_s: NonNegative,
    /// Without a compass reading.
    pub heading_s: NonNegative,
    /// Without a usable ping for longer than this the net is no longer valid.
    pub net_s: NonNegative,
}

/// What the estimator consumes.
#[derive(Clone, Copy, Debug)]
pub struct EstimatorInput<'a> {
    /// Everything that arrived since the last step, in order. Empty when nothing did.
    pub measurements: &'a [Measurements],
    /// What the thrusters were told at the tick before.
    pub thrust: Prev<Input<&'a Thrust>>,
}

/// When a quantity was last measured.
#[derive(Clone, Copy, Debug, Default)]
struct LastSeen {
    depth: Option<u64>,
    heading: Option<u64>,
    velocity: Option<u64>,
    net: Option<u64>,
}

/// Innovations of the last step; absent where nothing arrived.
#[derive(Clone, Copy, Debug, Default)]
struct Innovations {
    dvl: Option<[Innovation; 3]>,
    depth: Option<Innovation>,
    compass: Option<Innovation>,
    gyro: Option<Innovation>,
    ping: bool,
}

/// Gated and accepted scalar measurements since the start.
#[derive(Clone, Copy, Debug, Default)]
struct Counters {
    accepted: u32,
    gated: u32,
    restarts: u32,
}

/// The estimator of one run.
#[derive(Clone, Debug)]
pub struct Estimator {
    config: EstimatorConfig,
    ekf: Ekf,
    net_plane: NetPlane,
    limits: LimitsInTicks,
    seen: LastSeen,
    innovations: Innovations,
    counters: Counters,
    restart_requested: bool,
}

#[derive(Clone, Copy, Debug)]
struct LimitsInTicks {
    thrust: u64,
    dvl: u64,
    depth: u64,
    heading: u64,
    net: u64,
}

impl Estimator {
    /// From an estimator file, the nominal model, the instrument's beam angle and the limits of the trial.
    #[must_use]
    pub fn new(
        config: &EstimatorConfig,
        model: Hydrodynamics,
        beam_angle_rad: f64,
        limits: &EstimatorLimits,
        dt_s: f64,
    ) -> Self {
        let ticks = |limit_s: NonNegative| Tick::at_or_after(limit_s.get(), dt_s);
        Self {
            config: config.clone(),
            ekf: Ekf::new(&config.ekf, model),
            net_plane: NetPlane::new(&config.net_plane, beam_angle_rad),
            limits: LimitsInTicks {
                thrust: ticks(limits.thrust_s),
                dvl: ticks(limits.dvl_s),
                depth: ticks(limits.depth_s),
                heading: ticks(limits.heading_s),
                net: ticks(limits.net_s),
            },
            seen: LastSeen::default(),
            innovations: Innovations::default(),
            counters: Counters::default(),
            restart_requested: false,
        }
    }

    fn restart(&mut self) {
        self.ekf.restart();
        self.net_plane.restart();
        self.seen = LastSeen::default();
        self.counters.restarts += 1;
    }

    /// One scalar measurement of one state; the `first` sets it.
    fn update(&mut self, state: usize, measured: f64, trust: &SensorTrust, first: bool) -> Innovation {
        if first && measured.is_finite() {
            self.ekf.x[state] = measured;
        }
        let variance = trust.std.get() * trust.std.get();
        let innovation = self.ekf.update(state, measured, variance, trust.gate.map(Positive::get));
        self.counters.accepted += u32::from(innovation.accepted);
        self.counters.gated += u32::from(!innovation.accepted);
        innovation
    }

    fn take(&mut self, tick: Tick, measurements: &Measurements) {
        let trust = self.config.measurement;
        if let Some(sample) = &measurements.depth {
            let innovation = self.update(Z, sample.depth_m, &trust.depth, self.seen.depth.is_none());
            self.seen.depth = innovation.accepted.then_some(tick.k).or(self.seen.depth);
            self.innovations.depth = Some(innovation);
        }
        if let Some(sample) = &measurements.compass {
            let innovation = self.update(PSI, sample.heading_rad, &trust.compass, self.seen.heading.is_none());
            self.seen.heading = innovation.accepted.then_some(tick.k).or(self.seen.heading);
            self.innovations.compass = Some(innovation);
        }
        if let Some(sample) = &measurements.gyro {
            self.innovations.gyro = Some(self.update(NU + 3, sample.yaw_rate_rad_per_s, &trust.gyro, false));
        }
        if let Some(ping) = &measurements.dvl {
            self.take_ping(tick, ping, &trust.dvl);
        }
    }

    fn take_ping(&mut self, tick: Tick, ping: &DvlPing, trust: &SensorTrust) {
        if let Some(velocity) = ping.velocity_m_per_s {
            let innovations = core::array::from_fn(|i| self.update(NU + i, velocity[i], trust, false));
            if innovations.iter().any(|innovation| innovation.accepted) {
                self.seen.velocity = Some(tick.k);
            }
            self.innovations.dvl = Some(innovations);
        }
        self.innovations.ping = true;
        if self.net_plane.update(ping, self.ekf.x[PSI]) {
            self.seen.net = Some(tick.k);
        }
    }

    fn nav(&self, tick: Tick, thrust_unknown: bool, restarted: bool) -> Nav {
        let lost = |seen: Option<u64>, limit: u64| seen.is_none_or(|seen| tick.k - seen > limit);
        let x = &self.ekf.x;
        let diagonal = self.ekf.P.diagonal();
        let quad = |from: usize| core::array::from_fn(|i| diagonal[from + i]);
        let mut net = self.net_plane.estimate(x[PSI]).unwrap_or_default();
        net.valid &= !lost(self.seen.net, self.limits.net);
        Nav {
            depth_m: x[Z],
            heading_rad: x[PSI],
            velocity: self.ekf.nu().into(),
            acceleration: self.ekf.acceleration.into(),
            disturbance: x.fixed_rows::<4>(B).into_owned().into(),
            variance: NavVariance {
                depth_m2: diagonal[Z],
                heading_rad2: diagonal[PSI],
                velocity: quad(NU),
                disturbance: quad(B),
            },
            net,
            health: NavHealth {
                dead_reckoning: lost(self.seen.velocity, self.limits.dvl),
                depth_lost: lost(self.seen.depth, self.limits.depth),
                heading_lost: lost(self.seen.heading, self.limits.heading),
                thrust_unknown,
                restarted,
            },
        }
    }
}

impl Block for Estimator {
    const NAME: &'static str = "estimator";
    type In<'a> = EstimatorInput<'a>;
    type Out = Nav;
    type Command = EstimatorCommand;

    /// Predicts one tick with the thrust of the tick before, then takes every measurement in order.
    fn step(&mut self, tick: Tick, input: EstimatorInput<'_>) -> Nav {
        let mut restarted = core::mem::take(&mut self.restart_requested);
        if restarted {
            self.restart();
        }
        self.innovations = Innovations::default();
        let thrust = input.thrust.0.within(tick, self.limits.thrust);
        let tau = thrust.map_or_else(Vector4::zeros, |thrust| thrust.allocated.vector());
        if tick.k > 0 {
            self.ekf.predict(&tau, tick.dt_s);
            let nu = self.ekf.nu();
            self.net_plane.predict(&Vector3::new(nu[0], nu[1], nu[2]), nu[3], tick.dt_s);
        }
        for measurements in input.measurements {
            self.take(tick, measurements);
        }
        if !self.ekf.is_sane() {
            self.restart();
            restarted = true;
        }
        self.nav(tick, thrust.is_none() && tick.k > 0, restarted)
    }

    fn command(&mut self, _: Tick, command: &EstimatorCommand) -> Result<(), Refusal> {
        match command {
            EstimatorCommand::Restart => self.restart_requested = true,
            EstimatorCommand::Parameter(change) => {
                if change.path == "description" {
                    return Err(Refusal("description: is no parameter".to_owned()));
                }
                let config: EstimatorConfig = parameter::changed(&self.config, change)?;
                self.ekf.retune(&config.ekf);
                self.net_plane.retune(&config.net_plane);
                self.config = config;
            }
        }
        Ok(())
    }

    fn notices(&self, out: Option<&Nav>) -> Notices {
        // Before the first step nothing has been seen: what arrives is found, and only what goes again is lost.
        let unseen = NavHealth { dead_reckoning: true, depth_lost: true, heading_lost: true, ..NavHealth::default() };
        let health = out.map_or(unseen, |nav| nav.health);
        Notices::from_iter([
            Notice::either(!out.is_some_and(|nav| nav.net.valid), "net", "lost", "found"),
            Notice::either(health.dead_reckoning, "velocity", "lost", "found").with_consequence("dead reckoning"),
            Notice::either(health.depth_lost, "depth", "lost", "found"),
            Notice::either(health.heading_lost, "heading", "lost", "found"),
            Notice::either(health.thrust_unknown, "thrust", "unknown", "known"),
            Notice::either(health.restarted, "filter", "restarted", "running"),
        ])
    }

    fn parameters(&self) -> serde_json::Value {
        parameter::tree(&self.config)
    }
}

impl Wired for Estimator {
    fn input<'a>(wires: &mut impl Wires<'a>, _: OperatorLink) -> EstimatorInput<'a> {
        EstimatorInput { measurements: wires.every(PortRule::EVERY), thrust: Prev(wires.newest(PortRule::BEFORE)) }
    }
}

impl Observe for Estimator {
    fn observe<P: Probe>(&self, probe: &mut P) {
        let show = |i: &Innovation| [i.value, libm::sqrt(i.variance), i.nis];
        if let Some(dvl) = &self.innovations.dvl {
            let [a, b, c] = dvl.each_ref().map(show);
            probe.vector(&signal::estimator::INNOVATION_DVL, &[a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]]);
        }
        for (signal, innovation) in [
            (&signal::estimator::INNOVATION_DEPTH, &self.innovations.depth),
            (&signal::estimator::INNOVATION_HEADING, &self.innovations.compass),
            (&signal::estimator::INNOVATION_YAW_RATE, &self.innovations.gyro),
        ] {
            if let Some(innovation) = innovation {
                probe.vector(signal, &show(innovation));
            }
        }
        if self.innovations.ping {
            self.net_plane.report().observe(probe);
        }
        self.net_plane.observe(probe);
        let c = &self.counters;
        probe.vector(&signal::estimator::COUNTERS, &[f64::from(c.accepted), f64::from(c.gated), f64::from(c.restarts)]);
    }
}
