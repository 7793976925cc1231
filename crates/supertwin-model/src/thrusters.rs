//! Where the thrusters sit and what they can do: the configuration matrix `B` of `tau = B f`.

use nalgebra::{Matrix4, SMatrix, SVector, Vector3, Vector4};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{Finite, Positive};
use supertwin_core::message::MAX_THRUSTERS;

/// Forces of all thrusters; entries beyond the vehicle's number are zero.
pub type Forces = SVector<f64, MAX_THRUSTERS>;

/// Thrusters that are scaled down together when one of them saturates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// Surge, sway, yaw.
    Horizontal,
    /// Heave alone.
    Vertical,
}

/// One thruster of a vehicle file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ThrusterConfig {
    /// Name for people.
    pub name: String,
    /// Position in body axes, in metres.
    pub position_m: [Finite; 3],
    /// Direction of a positive force in body axes, of any length but zero.
    pub direction: [Finite; 3],
    /// Largest force either way.
    pub max_n: Positive,
    /// What it is scaled together with.
    pub group: Group,
}

/// A set of thrusters that can make any wrench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thrusters {
    count: usize,
    B: SMatrix<f64, 4, MAX_THRUSTERS>,
    B_pinv: SMatrix<f64, MAX_THRUSTERS, 4>,
    max_n: Forces,
    vertical: [bool; MAX_THRUSTERS],
}

/// A set of thrusters that is not one.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ThrustersError {
    /// Too many or none.
    #[error("thruster: {0} thrusters given, must be 1 to {MAX_THRUSTERS}")]
    Count(usize),
    /// A direction of length zero.
    #[error("thruster[{0}].direction = [0, 0, 0]: must not be zero")]
    Direction(usize),
    /// Not fully actuated (paper, Assumption 5).
    #[error(
        "thruster: the {0} thrusters can't make every wrench (rank of B below 4): surge, sway, heave and yaw must all be reachable"
    )]
    Rank(usize),
}

impl Thrusters {
    /// Builds `B` column by column, `[d; (p × d)_z]`, and its pseudo-inverse `Bᵀ(BBᵀ)⁻¹`.
    ///
    /// # Errors
    /// When the number does not fit, a direction is zero, or `B` has not full rank.
    pub fn new(thrusters: &[ThrusterConfig]) -> Result<Self, ThrustersError> {
        let count = thrusters.len();
        if count == 0 || count > MAX_THRUSTERS {
            return Err(ThrustersError::Count(count));
        }
        let mut B = SMatrix::<f64, 4, MAX_THRUSTERS>::zeros();
        let mut max_n = Forces::zeros();
        let mut vertical = [false; MAX_THRUSTERS];
        for (i, thruster) in thrusters.iter().enumerate() {
            let [dx, dy, dz] = thruster.direction.map(Finite::get);
            let length = libm::sqrt(dx * dx + dy * dy + dz * dz);
            if length <= 0.0 {
                return Err(ThrustersError::Direction(i + 1));
            }
            let d = Vector3::new(dx, dy, dz) / length;
            let [x, y, _] = thruster.position_m.map(Finite::get);
            B.set_column(i, &Vector4::new(d.x, d.y, d.z, x * d.y - y * d.x));
            max_n[i] = thruster.max_n.get();
            vertical[i] = thruster.group == Group::Vertical;
        }
        let gram: Matrix4<f64> = B * B.transpose();
        // A determinant this small against its diagonal means that some wrench costs unbounded force.
        let scale = (0..4).map(|i| gram[(i, i)]).product::<f64>();
        let inverse = gram.try_inverse().filter(|_| gram.determinant() > 1e-9 * scale);
        let B_pinv = B.transpose() * inverse.ok_or(ThrustersError::Rank(count))?;
        Ok(Self { count, B, B_pinv, max_n, vertical })
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// `tau = B f`.
    #[inline]
    #[must_use]
    pub fn wrench(&self, f: &Forces) -> Vector4<f64> {
        self.B * f
    }

    /// `f = B⁺ tau`: the smallest forces that make a wrench, without limits.
    #[inline]
    #[must_use]
    pub fn forces(&self, tau: &Vector4<f64>) -> Forces {
        self.B_pinv * tau
    }

    /// The configuration matrix.
    #[must_use]
    pub fn B(&self) -> &SMatrix<f64, 4, MAX_THRUSTERS> {
        &self.B
    }

    /// Largest force of each thruster in newtons.
    #[must_use]
    pub fn max_n(&self) -> &Forces {
        &self.max_n
    }

    /// Whether thruster `i` belongs to the vertical group.
    #[must_use]
    pub fn is_vertical(&self, i: usize) -> bool {
        self.vertical[i]
    }
}
