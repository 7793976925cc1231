//! Plant → recordings and scores: the true state.

use super::{MAX_THRUSTERS, Message, PerThruster, THRUSTER_NAMES};
use crate::axes::{AXIS_NAMES, VELOCITY_UNITS, WRENCH_UNITS};
use crate::{BodyVelocity, Wrench};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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

shown! { truth: Truth, "plant/truth/":
    POSE "pose" &["north", "east", "depth", "heading"], &["m", "m", "m", "rad"],
        "true position and heading; origin at the surface on the cage's axis"
        => { truth.north_m, truth.east_m, truth.depth_m, truth.heading_rad };
    VELOCITY "velocity" AXIS_NAMES, VELOCITY_UNITS, "true velocity over ground, body axes" => { truth.velocity };
    WATER_VELOCITY "water_velocity" AXIS_NAMES, VELOCITY_UNITS, "velocity of the water at the vehicle, body axes"
        => { truth.water_velocity };
    CURRENT "current" &["north", "east", "down"], &["m/s"], "velocity of the current without the waves, NED axes"
        => { truth.current_m_per_s };
    NET "net" &["distance", "heading"], &["m", "rad"], "true distance to the net and its outward direction"
        => { truth.net_distance_m, truth.net_heading_rad };
    DISTURBANCE "disturbance" AXIS_NAMES, WRENCH_UNITS, "tether and unmodelled coupling, body axes"
        => { truth.disturbance };
    WRENCH "wrench" AXIS_NAMES, WRENCH_UNITS, "force of the thrusters, body axes" => { truth.wrench };
    THRUSTER_FORCE "thruster_force" THRUSTER_NAMES, &["N"], "force of each thruster" => { truth.thruster_force_n };
}

impl Message for Truth {
    const KEY: &'static str = "plant/truth";
}
