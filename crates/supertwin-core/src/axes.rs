//! The four degrees of freedom and the vectors over them.
//!
//! Inside formulas these are `Vector4` in the order surge, sway, heave, yaw; at boundaries they are named fields.

use nalgebra::Vector4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Component names of every four-axis signal.
pub const AXIS_NAMES: &[&str] = &["surge", "sway", "heave", "yaw"];

/// One value per degree of freedom.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Axes<T> {
    /// Along the body's forward axis.
    pub surge: T,
    /// Along the body's starboard axis.
    pub sway: T,
    /// Along the body's downward axis.
    pub heave: T,
    /// About the body's downward axis.
    pub yaw: T,
}

impl<T> Axes<T> {
    /// The values in the order surge, sway, heave, yaw.
    pub fn to_array(self) -> [T; 4] {
        [self.surge, self.sway, self.heave, self.yaw]
    }

    /// The same function on every axis.
    pub fn map<U>(self, mut f: impl FnMut(T) -> U) -> Axes<U> {
        Axes { surge: f(self.surge), sway: f(self.sway), heave: f(self.heave), yaw: f(self.yaw) }
    }
}

impl<T> From<[T; 4]> for Axes<T> {
    fn from([surge, sway, heave, yaw]: [T; 4]) -> Self {
        Self { surge, sway, heave, yaw }
    }
}

impl<T: Into<f64>> Axes<T> {
    /// As a column vector for use in a formula.
    pub fn vector(self) -> Vector4<f64> {
        Vector4::new(self.surge.into(), self.sway.into(), self.heave.into(), self.yaw.into())
    }
}

macro_rules! four_axis {
    ($(#[$doc:meta])* $name:ident { $a:ident, $b:ident, $c:ident, $d:ident }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        #[allow(missing_docs, reason = "the field names carry axis and unit")]
        pub struct $name { pub $a: f64, pub $b: f64, pub $c: f64, pub $d: f64 }

        impl From<Vector4<f64>> for $name {
            fn from(v: Vector4<f64>) -> Self { Self { $a: v[0], $b: v[1], $c: v[2], $d: v[3] } }
        }

        impl From<[f64; 4]> for $name {
            fn from(v: [f64; 4]) -> Self { Self { $a: v[0], $b: v[1], $c: v[2], $d: v[3] } }
        }

        impl $name {
            /// As a column vector in the order surge, sway, heave, yaw.
            #[must_use]
            pub fn vector(self) -> Vector4<f64> { Vector4::new(self.$a, self.$b, self.$c, self.$d) }

            /// As an array in the order surge, sway, heave, yaw.
            #[must_use]
            pub fn to_array(self) -> [f64; 4] { [self.$a, self.$b, self.$c, self.$d] }

            /// No entry is NaN or infinite.
            #[must_use]
            pub fn is_finite(self) -> bool { self.to_array().iter().all(|x| x.is_finite()) }
        }
    };
}

four_axis! {
    /// Generalised velocity `nu = [u, v, w, r]` in the body frame.
    BodyVelocity { surge_m_per_s, sway_m_per_s, heave_m_per_s, yaw_rad_per_s }
}
four_axis! {
    /// Time derivative of [`BodyVelocity`] in the body frame.
    BodyAcceleration { surge_m_per_s2, sway_m_per_s2, heave_m_per_s2, yaw_rad_per_s2 }
}
four_axis! {
    /// Generalised force `tau = [X, Y, Z, N]` in the body frame.
    Wrench { surge_n, sway_n, heave_n, yaw_nm }
}

/// Units of a generalised velocity, axis by axis.
pub const VELOCITY_UNITS: &[&str] = &["m/s", "m/s", "m/s", "rad/s"];
/// Units of a generalised acceleration, axis by axis.
pub const ACCELERATION_UNITS: &[&str] = &["m/s²", "m/s²", "m/s²", "rad/s²"];
/// Units of a generalised force, axis by axis.
pub const WRENCH_UNITS: &[&str] = &["N", "N", "N", "N m"];
