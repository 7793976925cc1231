//! Line-of-sight guidance along a net, paper eq. (25)-(27).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::message::Direction;

/// Which sign the cross-track term has when the vehicle travels to port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PortSign {
    /// Drives towards the desired distance in both directions.
    Corrected,
    /// As printed in eq. (25): to port it drives away from the desired distance. For experiments.
    Printed,
}

/// What the law works on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineOfSight {
    /// Δ, lookahead distance in metres.
    pub lookahead_m: f64,
    /// Which print of the law.
    pub port_sign: PortSign,
}

/// Desired velocity in body axes, and what led to it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DesiredVelocity {
    /// `u_d = U_d cos(χ − psi)`, eq. (26).
    pub surge_m_per_s: f64,
    /// `v_d = U_d sin(χ − psi)`, eq. (27).
    pub sway_m_per_s: f64,
    /// `χ`, desired course.
    pub course_rad: f64,
    /// `y_e = d − d_d`.
    pub cross_track_m: f64,
}

impl LineOfSight {
    /// `χ = psi_net + s (π/2 − atan(y_e/Δ))`, s = +1 to starboard and −1 to port.
    ///
    /// Eq. (25) with `γ_p = psi_net − π/2` for port keeps the sign of the arctangent and diverges; here both
    /// directions close the distance at `U_d sin(atan(y_e/Δ))`. Angles in radians, lengths in metres.
    #[must_use]
    pub fn velocity(
        &self,
        distance_m: f64,
        desired_distance_m: f64,
        net_heading_rad: f64,
        heading_rad: f64,
        speed_m_per_s: f64,
        direction: Direction,
    ) -> DesiredVelocity {
        let cross_track_m = distance_m - desired_distance_m;
        let s = direction.sign();
        let correction = libm::atan(cross_track_m / self.lookahead_m);
        let sign = match self.port_sign {
            PortSign::Corrected => s,
            PortSign::Printed => 1.0,
        };
        let course_rad = net_heading_rad + s * core::f64::consts::FRAC_PI_2 - sign * correction;
        let (sin, cos) = libm::sincos(course_rad - heading_rad);
        DesiredVelocity {
            surge_m_per_s: speed_m_per_s * cos,
            sway_m_per_s: speed_m_per_s * sin,
            course_rad,
            cross_track_m,
        }
    }
}
