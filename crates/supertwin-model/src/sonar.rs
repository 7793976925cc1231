//! The four-beam Janus array of a Doppler velocity log that looks forward.

use nalgebra::Vector3;

/// Unit vectors of the beams in body axes: azimuth 45°, 135°, 225°, 315° about the forward axis.
///
/// `b_i = [cos θ, sin θ cos a_i, sin θ sin a_i]`, with θ the beam's angle off the forward axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SonarArray {
    beams: [Vector3<f64>; 4],
    cos: f64,
    sin_diagonal: f64,
}

impl SonarArray {
    /// From the beam angle off the forward axis.
    #[must_use]
    pub fn new(beam_angle_rad: f64) -> Self {
        let (sin, cos) = libm::sincos(beam_angle_rad);
        let d = sin * core::f64::consts::FRAC_1_SQRT_2;
        let beams = [(d, d), (-d, d), (-d, -d), (d, -d)].map(|(y, z)| Vector3::new(cos, y, z));
        Self { beams, cos, sin_diagonal: d }
    }

    /// The beams.
    #[must_use]
    pub fn beams(&self) -> &[Vector3<f64>; 4] {
        &self.beams
    }

    /// Least-squares plane through the four foot points.
    ///
    /// A plane `a · p = 1` (normal over distance) meets beam i at `r_i b_i` with `b_i · a = q_i`, `q_i = 1/r_i`:
    /// linear in the inverse range, and diagonal for this array (control.md, section 3.2).
    #[must_use]
    pub fn plane(&self, q: &[f64; 4]) -> Vector3<f64> {
        Vector3::new(
            (q[0] + q[1] + q[2] + q[3]) / (4.0 * self.cos),
            (q[0] - q[1] - q[2] + q[3]) / (4.0 * self.sin_diagonal),
            (q[0] + q[1] - q[2] - q[3]) / (4.0 * self.sin_diagonal),
        )
    }

    /// `q1 − q2 + q3 − q4` in 1/m: zero for any plane, so anything else is a fish or a fold.
    #[must_use]
    pub fn parity(q: &[f64; 4]) -> f64 {
        q[0] - q[1] + q[2] - q[3]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_are_unit_vectors_at_their_angle() {
        let array = SonarArray::new(25f64.to_radians());
        for beam in array.beams() {
            assert!((beam.norm() - 1.0).abs() < 1e-15);
            assert!((beam.x - 0.9063).abs() < 1e-4 && (beam.y.abs() - 0.2988).abs() < 1e-4);
        }
    }
}
