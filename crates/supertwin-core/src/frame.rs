//! Frames: North-East-Down {n} and body {b} (forward, starboard, down), related by the heading alone.
//!
//! Roll and pitch are passively stabilised and taken as zero (paper, Assumption 2), so the only rotation is `Rz(psi)`.

use core::f64::consts::{PI, TAU};
use nalgebra::Vector3;

/// Smallest signed angle: `angle` moved by whole turns into [−π, π).
///
/// Source: Fossen (2021), *Handbook of Marine Craft Hydrodynamics and Motion Control*, 2nd ed., eq. for `ssa`.
/// # Examples
/// ```
/// let a = supertwin_core::frame::ssa(3.5 * std::f64::consts::PI);
/// assert!((a + std::f64::consts::FRAC_PI_2).abs() < 1e-12);
/// ```
#[inline]
#[must_use]
pub fn ssa(angle_rad: f64) -> f64 {
    if (-PI..PI).contains(&angle_rad) {
        return angle_rad;
    }
    let wrapped = angle_rad - TAU * libm::floor((angle_rad + PI) / TAU);
    // Rounding may land exactly on +π, which belongs to the other end.
    if wrapped >= PI { wrapped - TAU } else { wrapped }
}

/// The rotation `R_nb = Rz(psi)` between body and NED axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading {
    sin: f64,
    cos: f64,
}

impl Heading {
    /// From the heading angle, clockwise from North.
    #[must_use]
    pub fn new(psi_rad: f64) -> Self {
        let (sin, cos) = libm::sincos(psi_rad);
        Self { sin, cos }
    }

    /// `R_nb v_b`: body coordinates into NED coordinates.
    #[inline]
    #[must_use]
    pub fn ned_from_body(self, v: Vector3<f64>) -> Vector3<f64> {
        Vector3::new(self.cos * v.x - self.sin * v.y, self.sin * v.x + self.cos * v.y, v.z)
    }

    /// `R_nbᵀ v_n`: NED coordinates into body coordinates.
    #[inline]
    #[must_use]
    pub fn body_from_ned(self, v: Vector3<f64>) -> Vector3<f64> {
        Vector3::new(self.cos * v.x + self.sin * v.y, -self.sin * v.x + self.cos * v.y, v.z)
    }

    /// The same heading turned by a small angle: the angle-sum theorem with the fifth-order series of sine and cosine.
    ///
    /// The truncation error is below 1e-16 for |delta| ≤ 0.01 rad; larger angles take the exact functions.
    #[inline]
    #[must_use]
    pub fn turned(self, delta_rad: f64) -> Self {
        let d2 = delta_rad * delta_rad;
        let (s, c) = if d2 <= 1e-4 {
            (delta_rad * (1.0 - d2 * (1.0 / 6.0 - d2 / 120.0)), 1.0 - d2 * (0.5 - d2 * (1.0 / 24.0 - d2 / 720.0)))
        } else {
            libm::sincos(delta_rad)
        };
        Self { sin: self.sin * c + self.cos * s, cos: self.cos * c - self.sin * s }
    }

    /// Sine of the heading.
    #[must_use]
    pub fn sin(self) -> f64 {
        self.sin
    }

    /// Cosine of the heading.
    #[must_use]
    pub fn cos(self) -> f64 {
        self.cos
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ssa_stays_in_its_interval_and_keeps_the_angle() {
        for i in -1000..1000 {
            let angle = f64::from(i) * 0.1;
            let wrapped = ssa(angle);
            assert!((-PI..PI).contains(&wrapped), "{angle} -> {wrapped}");
            assert!((libm::sin(wrapped) - libm::sin(angle)).abs() < 1e-12);
            assert!((libm::cos(wrapped) - libm::cos(angle)).abs() < 1e-12);
        }
        assert_eq!(ssa(PI), -PI);
        assert_eq!(ssa(-PI), -PI);
    }

    #[test]
    fn rotation_is_orthogonal_and_points_starboard_east() {
        let north_facing = Heading::new(0.0);
        assert_eq!(north_facing.ned_from_body(Vector3::new(0.0, 1.0, 0.0)), Vector3::new(0.0, 1.0, 0.0));
        let v = Vector3::new(0.3, -0.7, 0.2);
        for i in 0..100 {
            let heading = Heading::new(f64::from(i) * 0.07 - 3.0);
            let back = heading.body_from_ned(heading.ned_from_body(v));
            assert!((back - v).norm() < 1e-15);
        }
    }

    #[test]
    fn turning_by_series_equals_the_exact_functions() {
        for i in -120..=120 {
            let delta = f64::from(i) * 1e-4;
            let series = Heading::new(0.7).turned(delta);
            let exact = Heading::new(0.7 + delta);
            assert!((series.sin - exact.sin).abs() < 4e-16 && (series.cos - exact.cos).abs() < 4e-16, "{delta}");
        }
    }
}
