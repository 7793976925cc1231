//! Estimator → guidance and controller: the state of vehicle and net as it is estimated.

use super::Message;
use crate::axes::{ACCELERATION_UNITS, AXIS_NAMES, VELOCITY_UNITS, WRENCH_UNITS};
use crate::{BodyAcceleration, BodyVelocity, Wrench};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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

shown! { nav: Nav, "estimator/nav/":
    POSE "pose" &["depth", "heading"], &["m", "rad"], "estimated depth and heading"
        => { nav.depth_m, nav.heading_rad };
    VELOCITY "velocity" AXIS_NAMES, VELOCITY_UNITS, "estimated velocity, body axes" => { nav.velocity };
    ACCELERATION "acceleration" AXIS_NAMES, ACCELERATION_UNITS, "acceleration of the filter's model, body axes"
        => { nav.acceleration };
    DISTURBANCE "disturbance" AXIS_NAMES, WRENCH_UNITS, "estimated disturbance, body axes" => { nav.disturbance };
    VARIANCE "variance"
        &["depth", "heading", "surge", "sway", "heave", "yaw", "b_surge", "b_sway", "b_heave", "b_yaw"],
        &["m²", "rad²", "m²/s²", "m²/s²", "m²/s²", "rad²/s²", "N²", "N²", "N²", "N²m²"], "variances of the estimates"
        => {
            nav.variance.depth_m2, nav.variance.heading_rad2,
            nav.variance.velocity[0], nav.variance.velocity[1], nav.variance.velocity[2], nav.variance.velocity[3],
            nav.variance.disturbance[0], nav.variance.disturbance[1],
            nav.variance.disturbance[2], nav.variance.disturbance[3]
        };
    NET "net" &["distance", "heading", "distance_variance", "heading_variance"], &["m", "rad", "m²", "rad²"],
        "estimated net plane"
        => {
            nav.net.distance_m, nav.net.heading_rad, nav.net.distance_variance_m2, nav.net.heading_variance_rad2
        };
    HEALTH "health" &["net_valid", "dead_reckoning", "depth_lost", "heading_lost", "thrust_unknown", "restarted"],
        &["flag"], "health of the estimate"
        => {
            nav.net.valid, nav.health.dead_reckoning, nav.health.depth_lost, nav.health.heading_lost,
            nav.health.thrust_unknown, nav.health.restarted
        };
}

impl Message for Nav {
    const KEY: &'static str = "estimator/nav";
}
