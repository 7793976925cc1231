//! The values on the wires. A message type carries the key it travels on, and nothing else is ever sent.
//!
//! Every number has its unit in its name; angles are in radians, clockwise from North; depth is positive down.

use crate::axes::{ACCELERATION_UNITS, AXIS_NAMES, VELOCITY_UNITS, WRENCH_UNITS};
use crate::{Axes, BodyAcceleration, BodyVelocity, Observe, Probe, Signal, Wrench};
use arrayvec::ArrayVec;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// Most thrusters that a vehicle can have.
pub const MAX_THRUSTERS: usize = 8;

/// One number per thruster, in the order of the vehicle file.
pub type PerThruster = ArrayVec<f64, MAX_THRUSTERS>;

/// A value that crosses a process boundary, and the one key it travels on.
pub trait Message: Observe + Serialize + DeserializeOwned + Clone + Send + 'static {
    /// Key relative to the vehicle's namespace.
    const KEY: &'static str;
    /// No number in it is NaN or infinite. Nothing else may leave a service.
    fn is_finite(&self) -> bool {
        crate::observe::Snapshot::of(self).is_finite()
    }
}

// ------------------------------------------------------------------------------------------------ plant → estimator

/// What the sensors delivered at a tick: each part is present only when it arrived.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Measurements {
    /// Doppler velocity log, forward-looking.
    pub dvl: Option<DvlPing>,
    /// Pressure sensor.
    pub depth: Option<DepthSample>,
    /// Fluxgate compass.
    pub compass: Option<HeadingSample>,
    /// Rate gyro.
    pub gyro: Option<YawRateSample>,
}

/// One ping of the forward-looking DVL.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DvlPing {
    /// When the sound was sent, in seconds of the run.
    pub taken_at_s: f64,
    /// Surge, sway, heave of the vehicle relative to the net, in m/s; absent when fewer than three beams came back.
    pub velocity_m_per_s: Option<[f64; 3]>,
    /// Range along each of the four beams in metres; absent where nothing came back.
    pub beam_range_m: [Option<f64>; 4],
}

/// One reading of the pressure sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DepthSample {
    /// When it was taken, in seconds of the run.
    pub taken_at_s: f64,
    /// Depth below the mean surface from pressure; includes the waves' dynamic pressure.
    pub depth_m: f64,
}

/// One reading of the compass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HeadingSample {
    /// When it was taken, in seconds of the run.
    pub taken_at_s: f64,
    /// Heading, clockwise from North.
    pub heading_rad: f64,
}

/// One reading of the rate gyro.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct YawRateSample {
    /// When it was taken, in seconds of the run.
    pub taken_at_s: f64,
    /// Rate of turn, positive clockwise.
    pub yaw_rate_rad_per_s: f64,
}

static DVL_VELOCITY: Signal = Signal {
    path: "plant/measurements/dvl_velocity",
    components: &["surge", "sway", "heave"],
    units: &["m/s"],
    about: "DVL velocity relative to the net",
};
static DVL_RANGE: Signal = Signal {
    path: "plant/measurements/dvl_range",
    components: &["beam1", "beam2", "beam3", "beam4"],
    units: &["m"],
    about: "DVL beam ranges; 0 where nothing came back",
};
static DVL_LATENCY: Signal =
    Signal { path: "plant/measurements/dvl_taken_at", components: &[], units: &["s"], about: "when the ping was sent" };
static DEPTH: Signal =
    Signal { path: "plant/measurements/depth", components: &[], units: &["m"], about: "depth from pressure" };
static COMPASS: Signal =
    Signal { path: "plant/measurements/heading", components: &[], units: &["rad"], about: "fluxgate compass" };
static GYRO: Signal =
    Signal { path: "plant/measurements/yaw_rate", components: &[], units: &["rad/s"], about: "rate gyro" };
static DEPTH_TAKEN_AT: Signal = Signal {
    path: "plant/measurements/depth_taken_at",
    components: &[],
    units: &["s"],
    about: "when the depth was taken",
};
static COMPASS_TAKEN_AT: Signal = Signal {
    path: "plant/measurements/heading_taken_at",
    components: &[],
    units: &["s"],
    about: "when the heading was taken",
};
static GYRO_TAKEN_AT: Signal = Signal {
    path: "plant/measurements/yaw_rate_taken_at",
    components: &[],
    units: &["s"],
    about: "when the rate was taken",
};

impl Observe for Measurements {
    fn observe<P: Probe>(&self, probe: &mut P) {
        if let Some(ping) = &self.dvl {
            probe.scalar(&DVL_LATENCY, ping.taken_at_s);
            probe.vector(&DVL_RANGE, &ping.beam_range_m.map(|range| range.unwrap_or(0.0)));
            if let Some(velocity) = &ping.velocity_m_per_s {
                probe.vector(&DVL_VELOCITY, velocity);
            }
        }
        if let Some(sample) = &self.depth {
            probe.scalar(&DEPTH, sample.depth_m);
            probe.scalar(&DEPTH_TAKEN_AT, sample.taken_at_s);
        }
        if let Some(sample) = &self.compass {
            probe.scalar(&COMPASS, sample.heading_rad);
            probe.scalar(&COMPASS_TAKEN_AT, sample.taken_at_s);
        }
        if let Some(sample) = &self.gyro {
            probe.scalar(&GYRO, sample.yaw_rate_rad_per_s);
            probe.scalar(&GYRO_TAKEN_AT, sample.taken_at_s);
        }
    }
}
impl Message for Measurements {
    const KEY: &'static str = "plant/measurements";
}

/// The true state, for recordings and scores. The brain never subscribes to it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// North of the cage's centre.
    pub north_m: f64,
    /// East of the cage's centre.
    pub east_m: f64,
    /// Below the mean surface.
    pub depth_m: f64,
    /// Clockwise from North.
    pub heading_rad: f64,
    /// Velocity over ground in body axes.
    pub velocity: BodyVelocity,
    /// Velocity of the water at the vehicle in body axes (current and waves).
    pub water_velocity: BodyVelocity,
    /// Velocity of the current alone, towards North, East and down, in m/s.
    pub current_m_per_s: [f64; 3],
    /// Horizontal distance to the net, radially from the cage's axis.
    pub net_distance_m: f64,
    /// Outward direction of the net at the vehicle.
    pub net_heading_rad: f64,
    /// Forces of the tether and of the coupling that no nominal model contains, in body axes.
    pub disturbance: Wrench,
    /// Force of the thrusters, in body axes.
    pub wrench: Wrench,
    /// Force of each thruster in newtons.
    #[schemars(with = "Vec<f64>", length(max = MAX_THRUSTERS))]
    pub thruster_force_n: PerThruster,
}

static TRUE_POSE: Signal = Signal {
    path: "plant/truth/pose",
    components: &["north", "east", "depth", "heading"],
    units: &["m", "m", "m", "rad"],
    about: "true position and heading; origin at the surface on the cage's axis",
};
static TRUE_VELOCITY: Signal = Signal {
    path: "plant/truth/velocity",
    components: AXIS_NAMES,
    units: VELOCITY_UNITS,
    about: "true velocity over ground, body axes",
};
static TRUE_WATER: Signal = Signal {
    path: "plant/truth/water_velocity",
    components: AXIS_NAMES,
    units: VELOCITY_UNITS,
    about: "velocity of the water at the vehicle, body axes",
};
static TRUE_CURRENT: Signal = Signal {
    path: "plant/truth/current",
    components: &["north", "east", "down"],
    units: &["m/s"],
    about: "velocity of the current without the waves, NED axes",
};
static TRUE_NET: Signal = Signal {
    path: "plant/truth/net",
    components: &["distance", "heading"],
    units: &["m", "rad"],
    about: "true distance to the net and its outward direction",
};
static TRUE_DISTURBANCE: Signal = Signal {
    path: "plant/truth/disturbance",
    components: AXIS_NAMES,
    units: WRENCH_UNITS,
    about: "tether and unmodelled coupling, body axes",
};
static TRUE_WRENCH: Signal = Signal {
    path: "plant/truth/wrench",
    components: AXIS_NAMES,
    units: WRENCH_UNITS,
    about: "force of the thrusters, body axes",
};
static TRUE_THRUSTERS: Signal = Signal {
    path: "plant/truth/thruster_force",
    components: &["t1", "t2", "t3", "t4", "t5", "t6", "t7", "t8"],
    units: &["N"],
    about: "force of each thruster",
};

impl Observe for Truth {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.vector(&TRUE_POSE, &[self.north_m, self.east_m, self.depth_m, self.heading_rad]);
        probe.vector(&TRUE_VELOCITY, &self.velocity.to_array());
        probe.vector(&TRUE_WATER, &self.water_velocity.to_array());
        probe.vector(&TRUE_CURRENT, &self.current_m_per_s);
        probe.vector(&TRUE_NET, &[self.net_distance_m, self.net_heading_rad]);
        probe.vector(&TRUE_DISTURBANCE, &self.disturbance.to_array());
        probe.vector(&TRUE_WRENCH, &self.wrench.to_array());
        probe.vector(&TRUE_THRUSTERS, &self.thruster_force_n);
    }
}
impl Message for Truth {
    const KEY: &'static str = "plant/truth";
}

// --------------------------------------------------------------------------------- estimator → guidance, controller

/// The vehicle's and the net's state as the estimator sees them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Nav {
    /// Below the mean surface.
    pub depth_m: f64,
    /// Clockwise from North, in [−π, π).
    pub heading_rad: f64,
    /// Velocity relative to the net, body axes.
    pub velocity: BodyVelocity,
    /// `M⁻¹(tau + b − C nu − D nu)` of the filter's own model; contains the controller's own output.
    pub acceleration: BodyAcceleration,
    /// Lumped disturbance force `b` that explains the motion.
    pub disturbance: Wrench,
    /// Variances of the estimates.
    pub variance: NavVariance,
    /// The net in front.
    pub net: NetEstimate,
    /// What is wrong, if anything.
    pub health: NavHealth,
}

/// Variances of [`Nav`], in the squared unit of each quantity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NavVariance {
    /// Of the depth.
    pub depth_m2: f64,
    /// Of the heading.
    pub heading_rad2: f64,
    /// Of surge, sway, heave (m²/s²) and yaw rate (rad²/s²).
    pub velocity: [f64; 4],
    /// Of the disturbance, N² and N²m².
    pub disturbance: [f64; 4],
}

/// The net plane in front of the vehicle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NetEstimate {
    /// Shortest distance from the vehicle's origin to the plane.
    pub distance_m: f64,
    /// Outward direction of the plane's normal: the heading that faces the net squarely.
    pub heading_rad: f64,
    /// Variance of the distance.
    pub distance_variance_m2: f64,
    /// Variance of the heading.
    pub heading_variance_rad2: f64,
    /// A plane has been seen recently enough to be used.
    pub valid: bool,
}

/// Health of the estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(clippy::struct_excessive_bools, reason = "independent flags")]
pub struct NavHealth {
    /// No velocity measurement yet, or none for longer than the limit: the velocity is predicted only.
    pub dead_reckoning: bool,
    /// No depth measurement yet, or none for longer than the limit.
    pub depth_lost: bool,
    /// No compass reading yet, or none for longer than the limit.
    pub heading_lost: bool,
    /// The thruster forces are unknown and taken as zero.
    pub thrust_unknown: bool,
    /// A number went bad or a variance lost its sign; the filter started again.
    pub restarted: bool,
}

static NAV_POSE: Signal = Signal {
    path: "estimator/nav/pose",
    components: &["depth", "heading"],
    units: &["m", "rad"],
    about: "estimated depth and heading",
};
static NAV_VELOCITY: Signal = Signal {
    path: "estimator/nav/velocity",
    components: AXIS_NAMES,
    units: VELOCITY_UNITS,
    about: "estimated velocity, body axes",
};
static NAV_ACCELERATION: Signal = Signal {
    path: "estimator/nav/acceleration",
    components: AXIS_NAMES,
    units: ACCELERATION_UNITS,
    about: "acceleration of the filter's model, body axes",
};
static NAV_DISTURBANCE: Signal = Signal {
    path: "estimator/nav/disturbance",
    components: AXIS_NAMES,
    units: WRENCH_UNITS,
    about: "estimated disturbance, body axes",
};
static NAV_VARIANCE: Signal = Signal {
    path: "estimator/nav/variance",
    components: &["depth", "heading", "surge", "sway", "heave", "yaw", "b_surge", "b_sway", "b_heave", "b_yaw"],
    units: &["m²", "rad²", "m²/s²", "m²/s²", "m²/s²", "rad²/s²", "N²", "N²", "N²", "N²m²"],
    about: "variances of the estimates",
};
static NAV_NET: Signal = Signal {
    path: "estimator/nav/net",
    components: &["distance", "heading", "distance_variance", "heading_variance"],
    units: &["m", "rad", "m²", "rad²"],
    about: "estimated net plane",
};
static NAV_HEALTH: Signal = Signal {
    path: "estimator/nav/health",
    components: &["net_valid", "dead_reckoning", "depth_lost", "heading_lost", "thrust_unknown", "restarted"],
    units: &["flag"],
    about: "health of the estimate",
};

impl Observe for Nav {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.vector(&NAV_POSE, &[self.depth_m, self.heading_rad]);
        probe.vector(&NAV_VELOCITY, &self.velocity.to_array());
        probe.vector(&NAV_ACCELERATION, &self.acceleration.to_array());
        probe.vector(&NAV_DISTURBANCE, &self.disturbance.to_array());
        let v = &self.variance;
        let mut variance = [v.depth_m2, v.heading_rad2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        variance[2..6].copy_from_slice(&v.velocity);
        variance[6..10].copy_from_slice(&v.disturbance);
        probe.vector(&NAV_VARIANCE, &variance);
        let net = &self.net;
        probe.vector(&NAV_NET, &[net.distance_m, net.heading_rad, net.distance_variance_m2, net.heading_variance_rad2]);
        let h = &self.health;
        let health = [net.valid, h.dead_reckoning, h.depth_lost, h.heading_lost, h.thrust_unknown, h.restarted];
        probe.vector(&NAV_HEALTH, &health.map(|flag| if flag { 1.0 } else { 0.0 }));
    }
}
impl Message for Nav {
    const KEY: &'static str = "estimator/nav";
}

// ------------------------------------------------------------------------------------------- guidance → controller

/// What guidance is doing, or what the controller does when guidance is silent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// No force at all.
    #[default]
    Neutral,
    /// Zero velocity relative to the net, set-points in depth and heading.
    DepthHeadingHold,
    /// Along the net at a distance, facing it.
    FollowNet,
}

impl Mode {
    /// The name used in files, on wires and in recordings.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Neutral => "neutral",
            Self::DepthHeadingHold => "depth_heading_hold",
            Self::FollowNet => "follow_net",
        }
    }
}

/// Direction of travel along the net, as seen from a vehicle that faces it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// To the right.
    #[default]
    Starboard,
    /// To the left.
    Port,
}

impl Direction {
    /// +1 to starboard, −1 to port: `s` of the guidance law.
    #[must_use]
    pub fn sign(self) -> f64 {
        match self {
            Self::Starboard => 1.0,
            Self::Port => -1.0,
        }
    }
}

/// Smooth references with their derivatives, and the set-points behind them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// What guidance is doing.
    pub mode: Mode,
    /// Desired surge `u_d`.
    pub surge_m_per_s: f64,
    /// Its derivative.
    pub surge_m_per_s2: f64,
    /// Desired sway `v_d`.
    pub sway_m_per_s: f64,
    /// Its derivative.
    pub sway_m_per_s2: f64,
    /// Desired depth `z_d`.
    pub depth_m: f64,
    /// Its derivative.
    pub depth_m_per_s: f64,
    /// Its second derivative.
    pub depth_m_per_s2: f64,
    /// Desired heading `psi_d`.
    pub heading_rad: f64,
    /// Its derivative.
    pub heading_rad_per_s: f64,
    /// Its second derivative.
    pub heading_rad_per_s2: f64,
    /// Desired distance to the net `d_d`.
    pub net_distance_m: f64,
    /// Desired speed along the net `U_d`, signed: positive to starboard.
    pub speed_m_per_s: f64,
}

static REF_VELOCITY: Signal = Signal {
    path: "guidance/reference/velocity",
    components: &["surge", "sway", "surge_rate", "sway_rate"],
    units: &["m/s", "m/s", "m/s²", "m/s²"],
    about: "desired surge and sway with derivatives",
};
static REF_DEPTH: Signal = Signal {
    path: "guidance/reference/depth",
    components: &["depth", "rate", "acceleration"],
    units: &["m", "m/s", "m/s²"],
    about: "desired depth with derivatives",
};
static REF_HEADING: Signal = Signal {
    path: "guidance/reference/heading",
    components: &["heading", "rate", "acceleration"],
    units: &["rad", "rad/s", "rad/s²"],
    about: "desired heading with derivatives",
};
static REF_SETPOINT: Signal = Signal {
    path: "guidance/reference/setpoint",
    components: &["net_distance", "speed"],
    units: &["m", "m/s"],
    about: "desired distance to the net, and speed along it (positive to starboard)",
};
static REF_MODE: Signal =
    Signal { path: "guidance/reference/mode", components: &[], units: &[], about: "mode of guidance" };

impl Observe for Reference {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.vector(&REF_VELOCITY, &[self.surge_m_per_s, self.sway_m_per_s, self.surge_m_per_s2, self.sway_m_per_s2]);
        probe.vector(&REF_DEPTH, &[self.depth_m, self.depth_m_per_s, self.depth_m_per_s2]);
        probe.vector(&REF_HEADING, &[self.heading_rad, self.heading_rad_per_s, self.heading_rad_per_s2]);
        probe.vector(&REF_SETPOINT, &[self.net_distance_m, self.speed_m_per_s]);
        probe.label(&REF_MODE, self.mode.name());
    }
}
impl Message for Reference {
    const KEY: &'static str = "guidance/reference";
}

// ---------------------------------------------------------------------------------------------- controller → plant

/// Thruster commands, and the wrench that was wanted and the one they make.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Thrust {
    /// Commanded force of each thruster in newtons.
    #[schemars(with = "Vec<f64>", length(max = MAX_THRUSTERS))]
    pub force_n: PerThruster,
    /// What the control law asked for.
    pub requested: Wrench,
    /// What the commanded forces make of it.
    pub allocated: Wrench,
    /// Axes on which the two differ by more than the allocation's tolerance.
    pub limited: Axes<bool>,
    /// Somebody demanded no force. A controller that starts anew takes this over from its predecessor.
    pub emergency_neutral: bool,
}

static THRUST_FORCE: Signal = Signal {
    path: "controller/thrust/force",
    components: &["t1", "t2", "t3", "t4", "t5", "t6", "t7", "t8"],
    units: &["N"],
    about: "commanded force of each thruster",
};
static THRUST_REQUESTED: Signal = Signal {
    path: "controller/thrust/requested",
    components: AXIS_NAMES,
    units: WRENCH_UNITS,
    about: "wrench the law asked for, body axes",
};
static THRUST_ALLOCATED: Signal = Signal {
    path: "controller/thrust/allocated",
    components: AXIS_NAMES,
    units: WRENCH_UNITS,
    about: "wrench the commanded forces make, body axes",
};
static THRUST_LIMITED: Signal = Signal {
    path: "controller/thrust/limited",
    components: AXIS_NAMES,
    units: &["flag"],
    about: "axes on which allocation changed the wrench",
};
static THRUST_EMERGENCY: Signal = Signal {
    path: "controller/thrust/emergency_neutral",
    components: &[],
    units: &["flag"],
    about: "somebody demanded no force",
};

impl Observe for Thrust {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.vector(&THRUST_FORCE, &self.force_n);
        probe.vector(&THRUST_REQUESTED, &self.requested.to_array());
        probe.vector(&THRUST_ALLOCATED, &self.allocated.to_array());
        probe.vector(&THRUST_LIMITED, &self.limited.to_array().map(|flag| if flag { 1.0 } else { 0.0 }));
        probe.scalar(&THRUST_EMERGENCY, f64::from(u8::from(self.emergency_neutral)));
    }
}
impl Message for Thrust {
    const KEY: &'static str = "controller/thrust";
}

/// A wrench from outside, for the law `external`. Axes that are absent stay with the law's own substitute.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WrenchRequest {
    /// Along the forward axis, in newtons.
    pub surge_n: Option<f64>,
    /// Along the starboard axis, in newtons.
    pub sway_n: Option<f64>,
    /// Along the downward axis, in newtons.
    pub heave_n: Option<f64>,
    /// About the downward axis, in newton metres.
    pub yaw_nm: Option<f64>,
}

impl WrenchRequest {
    /// In the order surge, sway, heave, yaw.
    #[must_use]
    pub fn to_array(&self) -> [Option<f64>; 4] {
        [self.surge_n, self.sway_n, self.heave_n, self.yaw_nm]
    }
}

static WRENCH_REQUEST: Signal = Signal {
    path: "controller/wrench_request",
    components: AXIS_NAMES,
    units: WRENCH_UNITS,
    about: "wrench asked for by an external controller; 0 where it left the axis alone",
};

impl Observe for WrenchRequest {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.vector(&WRENCH_REQUEST, &self.to_array().map(|axis| axis.unwrap_or(0.0)));
    }
}
impl Message for WrenchRequest {
    const KEY: &'static str = "controller/wrench_request";
}
