//! Guidance → controller: what is wanted.

use super::Message;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What guidance is doing, or what the controller does when guidance is silent.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    Serialize,
    Deserialize,
    JsonSchema,
    strum::EnumString,
    strum::IntoStaticStr,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
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
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Neutral, Self::DepthHeadingHold, Self::FollowNet];

    /// The name used in files, on wires and in recordings.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
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

shown! { reference: Reference, "guidance/reference/":
    VELOCITY "velocity" &["surge", "sway", "surge_rate", "sway_rate"], &["m/s", "m/s", "m/s²", "m/s²"],
        "desired surge and sway with derivatives"
        => {
            reference.surge_m_per_s, reference.sway_m_per_s, reference.surge_m_per_s2, reference.sway_m_per_s2
        };
    DEPTH "depth" &["depth", "rate", "acceleration"], &["m", "m/s", "m/s²"], "desired depth with derivatives"
        => { reference.depth_m, reference.depth_m_per_s, reference.depth_m_per_s2 };
    HEADING "heading" &["heading", "rate", "acceleration"], &["rad", "rad/s", "rad/s²"],
        "desired heading with derivatives"
        => { reference.heading_rad, reference.heading_rad_per_s, reference.heading_rad_per_s2 };
    SETPOINT "setpoint" &["net_distance", "speed"], &["m", "m/s"],
        "desired distance to the net, and speed along it (positive to starboard)"
        => { reference.net_distance_m, reference.speed_m_per_s };
    MODE "mode" &[], &[], "mode of guidance" => { reference.mode };
}

impl Message for Reference {
    const KEY: &'static str = "guidance/reference";
}
