//! Inertia, Coriolis and centripetal terms, damping and buoyancy of a vehicle with three planes of symmetry.

use nalgebra::{Matrix4, Vector4};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{Finite, NonNegative, Positive};

/// Parameters of the equation of motion, as they stand in a vehicle file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HydrodynamicsConfig {
    /// The body itself.
    pub rigid_body: RigidBody,
    /// Added mass, the diagonal of `M_A`.
    pub added_mass: AddedMass,
    /// Linear damping, the diagonal of `D_l`.
    pub linear_damping: LinearDamping,
    /// Quadratic damping, the diagonal of `D_n` per unit of speed.
    pub quadratic_damping: QuadraticDamping,
    /// Buoyancy minus weight: positive floats up.
    pub net_buoyancy_n: Finite,
}

/// Mass and moment of inertia.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RigidBody {
    /// Mass in air.
    pub mass_kg: Positive,
    /// Moment of inertia about the downward axis.
    pub yaw_inertia_kg_m2: Positive,
}

/// Water that moves with the body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "the field names carry axis and unit")]
pub struct AddedMass {
    pub surge_kg: NonNegative,
    pub sway_kg: NonNegative,
    pub heave_kg: NonNegative,
    pub yaw_kg_m2: NonNegative,
}

/// Force per unit of speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "the field names carry axis and unit")]
pub struct LinearDamping {
    pub surge_n_s_per_m: NonNegative,
    pub sway_n_s_per_m: NonNegative,
    pub heave_n_s_per_m: NonNegative,
    pub yaw_nm_s_per_rad: NonNegative,
}

/// Force per unit of speed squared.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "the field names carry axis and unit")]
pub struct QuadraticDamping {
    pub surge_n_s2_per_m2: NonNegative,
    pub sway_n_s2_per_m2: NonNegative,
    pub heave_n_s2_per_m2: NonNegative,
    pub yaw_nm_s2_per_rad2: NonNegative,
}

/// The terms of `M nu' + C(nu) nu + D(nu) nu + g = tau`. All matrices but `C` are diagonal (paper, Remark 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hydrodynamics {
    M: Vector4<f64>,
    M_inv: Vector4<f64>,
    D_l: Vector4<f64>,
    D_q: Vector4<f64>,
    g: Vector4<f64>,
}

impl From<&HydrodynamicsConfig> for Hydrodynamics {
    fn from(c: &HydrodynamicsConfig) -> Self {
        let mass_kg = c.rigid_body.mass_kg.get();
        let M = Vector4::new(
            mass_kg + c.added_mass.surge_kg.get(),
            mass_kg + c.added_mass.sway_kg.get(),
            mass_kg + c.added_mass.heave_kg.get(),
            c.rigid_body.yaw_inertia_kg_m2.get() + c.added_mass.yaw_kg_m2.get(),
        );
        let d = &c.linear_damping;
        let q = &c.quadratic_damping;
        Self {
            M,
            M_inv: M.map(|m| 1.0 / m),
            D_l: Vector4::new(
                d.surge_n_s_per_m.get(),
                d.sway_n_s_per_m.get(),
                d.heave_n_s_per_m.get(),
                d.yaw_nm_s_per_rad.get(),
            ),
            D_q: Vector4::new(
                q.surge_n_s2_per_m2.get(),
                q.sway_n_s2_per_m2.get(),
                q.heave_n_s2_per_m2.get(),
                q.yaw_nm_s2_per_rad2.get(),
            ),
            g: Vector4::new(0.0, 0.0, c.net_buoyancy_n.get(), 0.0),
        }
    }
}

impl Hydrodynamics {
    /// Unit inertia, no damping, no buoyancy: for checks that no vehicle matters to.
    #[must_use]
    pub fn unit() -> Self {
        let (one, none) = (Vector4::repeat(1.0), Vector4::zeros());
        Self { M: one, M_inv: one, D_l: none, D_q: none, g: none }
    }

    /// The diagonal of `M = M_RB + M_A`, in kg and kg m².
    #[must_use]
    pub fn M(&self) -> Vector4<f64> {
        self.M
    }

    /// The diagonal of `M⁻¹`.
    #[must_use]
    pub fn M_inv(&self) -> Vector4<f64> {
        self.M_inv
    }

    /// The diagonal of the linear damping `D_l`.
    #[must_use]
    pub fn D_l(&self) -> Vector4<f64> {
        self.D_l
    }

    /// The diagonal of the quadratic damping.
    #[must_use]
    pub fn D_q(&self) -> Vector4<f64> {
        self.D_q
    }

    /// `g`: on the left-hand side, positive net buoyancy is a positive heave entry because z points down.
    #[must_use]
    pub fn g(&self) -> Vector4<f64> {
        self.g
    }

    /// `C(nu)`, paper eq. (3): skew-symmetric, so that `nuᵀ C(nu) nu = 0`.
    #[must_use]
    pub fn C(&self, nu: &Vector4<f64>) -> Matrix4<f64> {
        let mut C = Matrix4::zeros();
        C[(0, 3)] = -self.M[1] * nu[1];
        C[(1, 3)] = self.M[0] * nu[0];
        C[(3, 0)] = self.M[1] * nu[1];
        C[(3, 1)] = -self.M[0] * nu[0];
        C
    }

    /// `C(nu) nu = [−m22 v r, m11 u r, 0, (m22 − m11) u v]`.
    #[inline]
    #[must_use]
    pub fn coriolis(&self, nu: &Vector4<f64>) -> Vector4<f64> {
        let [u, v, _, r] = [nu[0], nu[1], nu[2], nu[3]];
        Vector4::new(-self.M[1] * v * r, self.M[0] * u * r, 0.0, (self.M[1] - self.M[0]) * u * v)
    }

    /// `D(nu) nu = (D_l + D_q |nu|) nu`, axis by axis.
    #[inline]
    #[must_use]
    pub fn damping(&self, nu: &Vector4<f64>) -> Vector4<f64> {
        (self.D_l + self.D_q.component_mul(&nu.abs())).component_mul(nu)
    }

    /// `nu' = M⁻¹ (tau − C(nu) nu − D(nu) nu − g)` in still water, or relative to water that does not accelerate.
    #[inline]
    #[must_use]
    pub fn acceleration(&self, nu: &Vector4<f64>, tau: &Vector4<f64>) -> Vector4<f64> {
        self.M_inv.component_mul(&(tau - self.coriolis(nu) - self.damping(nu) - self.g))
    }

    /// Scales inertia, linear and quadratic damping axis by axis: a nominal model that is wrong in a known way.
    ///
    /// `1.25` means 25 % too much; the factors must be positive.
    #[must_use]
    pub fn perturbed(&self, M: &Vector4<f64>, D_l: &Vector4<f64>, D_q: &Vector4<f64>) -> Self {
        let M = self.M.component_mul(M);
        Self {
            M,
            M_inv: M.map(|m| 1.0 / m),
            D_l: self.D_l.component_mul(D_l),
            D_q: self.D_q.component_mul(D_q),
            g: self.g,
        }
    }
}
