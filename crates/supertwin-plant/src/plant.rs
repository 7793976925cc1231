//! The plant twin: thrust in, measurements out, and the truth for recordings and scores.

use crate::cage::Cage;
use crate::current::Current;
use crate::environment::EnvironmentConfig;
use crate::propulsion::{Propulsion, PropulsionConfig};
use crate::sensors::{Compass, DepthSensor, Dvl, DvlScene, Gyro, SensorsConfig};
use crate::waves::{WaveMotion, Waves};
use nalgebra::{SVector, Vector3, Vector4};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::Finite;
use supertwin_core::command::PlantCommand;
use supertwin_core::frame::{Heading, ssa};
use supertwin_core::integrate::rk4;
use supertwin_core::message::{Measurements, Thrust, Truth};
use supertwin_core::port::MessageVisitor;
use supertwin_core::random::{Draw, OrnsteinUhlenbeck, Stream};
use supertwin_core::{
    Block, BodyVelocity, Input, Notice, Notices, Observe, OperatorLink, PortRule, Prev, Probe, Refusal, Tick, Wired,
    Wires, Wrench, signal,
};
use supertwin_model::{Hydrodynamics, Thrusters};

/// Acceleration of gravity.
const GRAVITY_M_PER_S2: f64 = 9.81;

/// What no nominal model contains.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UnmodelledConfig {
    /// Sway thrust turns the vehicle through this arm.
    pub sway_to_yaw_arm_m: Finite,
}

/// Where the vehicle starts; ranges are drawn from per seed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StartConfig {
    /// Bearing from the pen's axis.
    pub bearing_rad: Draw,
    /// Distance to the net.
    pub net_distance_m: Draw,
    /// Depth below the surface.
    pub depth_m: Draw,
    /// Heading off the direction that faces the net.
    pub heading_offset_rad: Draw,
}

impl StartConfig {
    /// # Errors
    /// When the vehicle would start outside the pen or out of the water.
    pub fn check(&self, radius_m: f64) -> Result<(), String> {
        let (near, far) = self.net_distance_m.range();
        if !(near > 0.0 && far < radius_m) {
            return Err(format!(
                "start.net_distance_m = [{near}, {far}]: must lie between 0 and the pen's radius {radius_m}"
            ));
        }
        let (shallow, _) = self.depth_m.range();
        if shallow < 0.0 {
            return Err(format!("start.depth_m = {shallow}: must be zero or positive"));
        }
        Ok(())
    }
}

/// Everything a plant is made of.
#[derive(Clone, Debug)]
pub struct PlantConfig<'a> {
    /// True parameters of the equation of motion.
    pub dynamics: Hydrodynamics,
    /// Mass in air, whose weight the water no longer carries where the body leaves it.
    pub mass_kg: f64,
    /// Height of the body.
    pub height_m: f64,
    /// Thruster geometry and limits.
    pub thrusters: Thrusters,
    /// Thruster dynamics.
    pub propulsion: &'a PropulsionConfig,
    /// Terms that no nominal model contains.
    pub unmodelled: &'a UnmodelledConfig,
    /// Sea and pen.
    pub environment: &'a EnvironmentConfig,
    /// Parameters of all sensors.
    pub sensors: &'a SensorsConfig,
    /// Where the vehicle starts.
    pub start: &'a StartConfig,
    /// Length of a tick.
    pub dt_s: f64,
    /// Runge-Kutta steps per tick.
    pub substeps: u32,
    /// A thrust command older than this means neutral.
    pub thrust_stale_after_ticks: u64,
}

/// What the plant consumes: the thrust of the tick before.
pub type PlantInput<'a> = Prev<Input<&'a Thrust>>;

/// A disturbance from outside in the place of current, waves and tether: fixed in space, whatever the vehicle's heading.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Drive {
    /// Force towards North, East and down, in newtons.
    pub force_ned_n: [f64; 3],
    /// Moment about the downward axis, in newton metres.
    pub yaw_nm: f64,
}

impl Drive {
    /// A disturbance in body axes at this heading; a number that is none is no force.
    #[must_use]
    pub fn from_body(disturbance: &Wrench, heading_rad: f64) -> Self {
        let finite = |x: f64| if x.is_finite() { x } else { 0.0 };
        let [surge, sway, heave, yaw] = disturbance.to_array().map(finite);
        let force = Heading::new(finite(heading_rad)).ned_from_body(Vector3::new(surge, sway, heave));
        Self { force_ned_n: force.into(), yaw_nm: yaw }
    }
}

/// `[north, east, depth, psi, u, v, w, r]`.
type State = SVector<f64, 8>;

/// The truth of one run.
#[derive(Clone, Debug)]
pub struct Plant {
    dynamics: Hydrodynamics,
    propulsion: Propulsion,
    arm_m: f64,
    /// Buoyancy of the whole body, and its height.
    buoyancy_n: f64,
    height_m: f64,
    current: Current,
    waves: Waves,
    /// The waves' motion at the present state.
    sea: WaveMotion,
    cage: Cage,
    tether: OrnsteinUhlenbeck<4>,
    dvl: Dvl,
    depth: DepthSensor,
    compass: Compass,
    gyro: Gyro,
    state: State,
    /// Rotation of the present state's heading.
    heading: Heading,
    substeps: u32,
    substep_s: f64,
    stale_after_ticks: u64,
    neutral: Thrust,
    started: bool,
    thrust_lost: bool,
    /// In the place of current, waves and tether, once there is one.
    drive: Option<Drive>,
    /// The true state after the last step.
    pub truth: Truth,
}

impl Plant {
    /// Draws start, current, waves and pen from the seed's streams.
    ///
    /// # Errors
    /// Names the value and the rule when the pieces do not fit together.
    pub fn new(config: &PlantConfig<'_>, seed: u64) -> Result<Self, String> {
        let substep_s = config.dt_s / f64::from(config.substeps);
        let environment = config.environment;
        let mut cage = Cage::new(&environment.cage, seed)?;
        let mut waves = Waves::new(&environment.waves, seed, substep_s);
        let tether = &environment.tether;
        let tether_std = Vector4::new(
            tether.surge_std_n.get(),
            tether.sway_std_n.get(),
            tether.heave_std_n.get(),
            tether.yaw_std_nm.get(),
        );

        let mut stream = Stream::new(seed, "start");
        let bearing_rad = config.start.bearing_rad.sample(&mut stream);
        let distance_m = config.start.net_distance_m.sample(&mut stream);
        let depth_m = config.start.depth_m.sample(&mut stream);
        let heading_rad = ssa(bearing_rad + config.start.heading_offset_rad.sample(&mut stream));
        cage.set_time(0.0);
        let (sin, cos) = libm::sincos(bearing_rad);
        let from_axis_m = cage.radius([cos, sin], depth_m) - distance_m;
        let position = Vector3::new(from_axis_m * cos, from_axis_m * sin, depth_m);
        waves.start(&position, 0.0);
        let mut state = State::zeros();
        state.fixed_rows_mut::<3>(0).copy_from(&position);
        state[3] = heading_rad;

        let mut plant = Self {
            dynamics: config.dynamics,
            propulsion: Propulsion::new(config.propulsion, config.thrusters, config.dt_s, substep_s)?,
            arm_m: config.unmodelled.sway_to_yaw_arm_m.get(),
            buoyancy_n: config.mass_kg * GRAVITY_M_PER_S2 + config.dynamics.g()[2],
            height_m: config.height_m,
            current: Current::new(&environment.current, seed, config.dt_s),
            sea: waves.motion(),
            waves,
            cage,
            tether: OrnsteinUhlenbeck::new(
                tether_std,
                tether.correlation_time_s.get(),
                config.dt_s,
                Stream::new(seed, "tether"),
            ),
            dvl: Dvl::new(&config.sensors.dvl, seed),
            depth: DepthSensor::new(&config.sensors.depth, seed, config.dt_s),
            compass: Compass::new(&config.sensors.compass, seed, config.dt_s),
            gyro: Gyro::new(&config.sensors.gyro, seed),
            state,
            heading: Heading::new(heading_rad),
            substeps: config.substeps,
            substep_s,
            stale_after_ticks: config.thrust_stale_after_ticks,
            neutral: Thrust { force_n: (0..config.thrusters.count()).map(|_| 0.0).collect(), ..Thrust::default() },
            started: false,
            thrust_lost: false,
            drive: None,
            truth: Truth::default(),
        };
        plant.tell_truth(&Vector3::zeros(), &Vector4::zeros(), &Vector4::zeros());
        Ok(plant)
    }

    /// From the next step on the water stands still and nothing but `drive` acts beside the thrusters, until the next call.
    pub fn drive(&mut self, drive: Drive) {
        if self.drive.is_none() {
            self.sea = WaveMotion::default();
            self.truth.water_velocity = BodyVelocity::default();
            self.truth.current_m_per_s = [0.0; 3];
        }
        self.drive = Some(drive);
    }

    /// Moves from the last tick to this one under the thrust of the last tick.
    fn advance(&mut self, tick: Tick, thrust: &Thrust) {
        self.propulsion.command(&thrust.force_n);
        let tether = self.tether.step();
        let mut current = Vector3::zeros();
        let (mut disturbance, mut wrench) = (Vector4::zeros(), Vector4::zeros());
        for substep in 0..self.substeps {
            if substep == 0 && self.drive.is_none() {
                current = self.current.step(self.state[2]);
            }
            self.propulsion.advance();
            let tau = self.propulsion.wrench();
            if let Some(drive) = &self.drive {
                // What the estimator found contains the moment of the sway thrust.
                disturbance = self.driving(drive);
            } else {
                disturbance = tether;
                disturbance[3] += self.arm_m * tau[1];
            }
            let sea = self.sea;
            let surface = Vector4::new(0.0, 0.0, self.lost_buoyancy_n(), 0.0);
            self.integrate(&(tau + disturbance + surface), &(current + sea.velocity), &sea.acceleration);
            wrench = tau;
            if self.drive.is_none() {
                let position = self.position();
                self.waves.advance(&position);
                if substep + 1 == self.substeps {
                    self.waves.correct(tick.t_s());
                }
                self.sea = self.waves.motion();
            }
        }
        self.state[3] = ssa(self.state[3]);
        self.heading = Heading::new(self.state[3]);
        self.cage.set_time(tick.t_s());
        self.tell_truth(&current, &disturbance, &wrench);
    }

    /// What `drive` does in body axes; out of the way of a step without one.
    #[cold]
    #[inline(never)]
    fn driving(&self, drive: &Drive) -> Vector4<f64> {
        let force = self.heading.body_from_ned(Vector3::from(drive.force_ned_n));
        Vector4::new(force.x, force.y, force.z, drive.yaw_nm)
    }

    /// One Runge-Kutta step; over it the water's velocity (NED) changes linearly with its acceleration.
    fn integrate(&mut self, tau: &Vector4<f64>, water: &Vector3<f64>, water_acceleration: &Vector3<f64>) {
        let dynamics = &self.dynamics;
        let start = self.heading;
        let psi_start = self.state[3];
        self.state = rk4(&self.state, self.substep_s, |t, x| {
            let heading = start.turned(x[3] - psi_start);
            let nu = Vector4::new(x[4], x[5], x[6], x[7]);
            let water_b = heading.body_from_ned(water + water_acceleration * t);
            let nu_r = nu - Vector4::new(water_b.x, water_b.y, water_b.z, 0.0);
            // d/dt nu_f = Rᵀ a_f − [0, 0, r] × nu_f
            let a_b = heading.body_from_ned(*water_acceleration);
            let drift = Vector4::new(a_b.x + nu[3] * water_b.y, a_b.y - nu[3] * water_b.x, a_b.z, 0.0);
            let nu_dot = dynamics.acceleration(&nu_r, tau) + drift;
            let v_n = heading.ned_from_body(Vector3::new(nu[0], nu[1], nu[2]));
            State::from([v_n.x, v_n.y, v_n.z, nu[3], nu_dot[0], nu_dot[1], nu_dot[2], nu_dot[3]])
        });
        // Within a tick by the angle-sum theorem; every tick ends with the exact functions.
        self.heading = start.turned(self.state[3] - psi_start);
    }

    /// Buoyancy that is missing because part of the body stands out of the water; it pulls down.
    fn lost_buoyancy_n(&self) -> f64 {
        let submerged = ((self.state[2] + 0.5 * self.height_m) / self.height_m).clamp(0.0, 1.0);
        self.buoyancy_n * (1.0 - submerged)
    }

    fn position(&self) -> Vector3<f64> {
        Vector3::new(self.state[0], self.state[1], self.state[2])
    }

    fn tell_truth(&mut self, current: &Vector3<f64>, disturbance: &Vector4<f64>, wrench: &Vector4<f64>) {
        let (net_distance_m, [north, east]) = self.cage.gap(&self.position());
        let water = self.heading.body_from_ned(current + self.sea.velocity);
        let x = &self.state;
        let truth = &mut self.truth;
        truth.north_m = x[0];
        truth.east_m = x[1];
        truth.depth_m = x[2];
        truth.heading_rad = x[3];
        truth.velocity = [x[4], x[5], x[6], x[7]].into();
        truth.water_velocity = [water.x, water.y, water.z, 0.0].into();
        truth.current_m_per_s = (*current).into();
        truth.net_distance_m = net_distance_m;
        truth.net_heading_rad = libm::atan2(east, north);
        truth.disturbance = (*disturbance).into();
        let force = &self.propulsion.force;
        truth.wrench = (*wrench).into();
        truth.thruster_force_n.clear();
        truth.thruster_force_n.extend(force.iter().take(self.propulsion.thrusters.count()).copied());
    }

    /// Linear part of the true velocity, body axes.
    fn velocity(&self) -> Vector3<f64> {
        Vector3::new(self.state[4], self.state[5], self.state[6])
    }
}

impl Block for Plant {
    const NAME: &'static str = "plant";
    type In<'a> = PlantInput<'a>;
    type Out = Measurements;
    type Command = PlantCommand;

    /// Integrates from the last tick to this one, then measures. The first tick only measures.
    fn step(&mut self, tick: Tick, Prev(thrust): PlantInput<'_>) -> Measurements {
        let thrust = thrust.within(tick, self.stale_after_ticks);
        self.thrust_lost = self.started && thrust.is_none();
        if self.started {
            match thrust {
                Some(thrust) => self.advance(tick, thrust),
                None => {
                    let neutral = self.neutral.clone();
                    self.advance(tick, &neutral);
                }
            }
        }
        self.started = true;
        let scene = DvlScene {
            position_m: &self.position(),
            heading: self.heading,
            velocity_m_per_s: self.velocity(),
            cage: &self.cage,
        };
        Measurements {
            dvl: self.dvl.step(tick, &scene),
            depth: self.depth.step(
                tick,
                self.state[2],
                if self.drive.is_none() { self.waves.pressure_head_m() } else { 0.0 },
            ),
            compass: self.compass.step(tick, self.state[3]),
            gyro: Some(self.gyro.step(tick, self.state[7])),
        }
    }

    fn notices(&self, _: Option<&Measurements>) -> Notices {
        let thrust = Notice::either(self.thrust_lost, "thrust", "lost", "found");
        Notices::from_iter([thrust.with_consequence("thrusters neutral")])
    }

    fn command(&mut self, tick: Tick, command: &PlantCommand) -> Result<(), Refusal> {
        match command {
            PlantCommand::DvlSilentForS(for_s) if *for_s >= 0.0 && for_s.is_finite() => {
                self.dvl.silence_until(tick.t_s() + for_s);
                Ok(())
            }
            PlantCommand::DvlSilentForS(for_s) => {
                Err(Refusal(format!("dvl_silent_for_s = {for_s}: must be zero or positive, and finite")))
            }
            PlantCommand::ThrusterGain { thruster, gain } => {
                if !(0.0..=2.0).contains(gain) {
                    return Err(Refusal(format!("thruster_gain.gain = {gain}: must be between 0 and 2")));
                }
                let count = self.propulsion.thrusters.count();
                if thruster.checked_sub(1).is_some_and(|i| self.propulsion.set_gain(i, *gain)) {
                    Ok(())
                } else {
                    Err(Refusal(format!("thruster_gain.thruster = {thruster}: must be between 1 and {count}")))
                }
            }
        }
    }
}

impl Wired for Plant {
    const OWNS_TIME: bool = true;

    fn input<'a>(wires: &mut impl Wires<'a>, _: OperatorLink) -> PlantInput<'a> {
        Prev(wires.newest(PortRule::BEFORE))
    }

    fn asides<V: MessageVisitor>(&self, visitor: &mut V) {
        visitor.message(&self.truth);
    }
}

impl Observe for Plant {
    fn observe<P: Probe>(&self, probe: &mut P) {
        self.truth.observe(probe);
        probe.vector(
            &signal::plant::THRUSTER_DEMAND,
            &self.propulsion.demand.as_slice()[..self.propulsion.thrusters.count()],
        );
        probe.vector(&signal::plant::HEALTH, &[f64::from(u8::from(self.thrust_lost)), self.dvl.lost as f64]);
    }
}
