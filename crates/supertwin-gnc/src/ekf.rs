//! Extended Kalman filter for depth, heading, velocity and a lumped disturbance, after Candeloro et al. (2012).
//!
//! ```text
//! x = [z, psi, u, v, w, r, b_u, b_v, b_w, b_r]
//! z' = w,  psi' = r,  nu' = M⁻¹ (tau + b − C(nu) nu − D(nu) nu − g),  b' = −b/T_b
//! ```
//!
//! North and east are left out: without an external position they are unobservable, and nothing uses them.
//! Source: M. Candeloro et al., *Observers for dynamic positioning of ROVs with experimental results*,
//! IFAC Proceedings Volumes 45(27):85-90, 2012 (the paper's reference 21); structure only, the numbers are ours.

use nalgebra::{SMatrix, SVector, Vector4};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::Positive;
use supertwin_core::frame::ssa;
use supertwin_model::Hydrodynamics;

/// Number of states.
pub const STATES: usize = 10;
/// Index of the depth.
pub const Z: usize = 0;
/// Index of the heading.
pub const PSI: usize = 1;
/// Index of surge; sway, heave and yaw rate follow.
pub const NU: usize = 2;
/// Index of the disturbance in surge; sway, heave and yaw follow.
pub const B: usize = 6;

/// State vector.
pub type State = SVector<f64, STATES>;
/// Covariance matrix.
pub type Covariance = SMatrix<f64, STATES, STATES>;

/// Process noise and initial uncertainty, as they stand in an estimator file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EkfConfig {
    /// Power spectral densities of the process noise: unit of the state squared, per second.
    pub process_noise: StateWise,
    /// Variances at the start.
    pub initial_variance: StateWise,
    /// Correlation time of the disturbance.
    pub disturbance_time_s: Positive,
}

/// One positive number per state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StateWise {
    /// The depth, a state in metres.
    pub depth: Positive,
    /// The heading, a state in radians.
    pub heading: Positive,
    /// Surge, sway, heave, yaw rate.
    pub velocity: [Positive; 4],
    /// Disturbance in surge, sway, heave, yaw.
    pub disturbance: [Positive; 4],
}

impl StateWise {
    fn vector(&self) -> State {
        let mut v = State::zeros();
        v[Z] = self.depth.get();
        v[PSI] = self.heading.get();
        for i in 0..4 {
            v[NU + i] = self.velocity[i].get();
            v[B + i] = self.disturbance[i].get();
        }
        v
    }
}

/// Result of a scalar measurement update.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Innovation {
    /// Measured minus predicted.
    pub value: f64,
    /// Its predicted variance `S`.
    pub variance: f64,
    /// Normalised innovation squared, `value²/S`.
    pub nis: f64,
    /// Whether it passed its gate and was used.
    pub accepted: bool,
}

/// The filter.
#[derive(Clone, Debug)]
pub struct Ekf {
    model: Hydrodynamics,
    q: State,
    p0: State,
    disturbance_rate: f64,
    /// The state.
    pub x: State,
    /// Its covariance.
    pub P: Covariance,
    /// `nu'` of the model at the last prediction.
    pub acceleration: Vector4<f64>,
}

impl Ekf {
    /// At zero with its initial uncertainty.
    #[must_use]
    pub fn new(config: &EkfConfig, model: Hydrodynamics) -> Self {
        let p0 = config.initial_variance.vector();
        Self {
            model,
            q: config.process_noise.vector(),
            p0,
            disturbance_rate: 1.0 / config.disturbance_time_s.get(),
            x: State::zeros(),
            P: Covariance::from_diagonal(&p0),
            acceleration: Vector4::zeros(),
        }
    }

    /// Other parameters from now on; state and covariance stay.
    pub fn retune(&mut self, config: &EkfConfig) {
        self.q = config.process_noise.vector();
        self.p0 = config.initial_variance.vector();
        self.disturbance_rate = 1.0 / config.disturbance_time_s.get();
    }

    /// Forgets everything; the state is zero, with its initial uncertainty.
    pub fn restart(&mut self) {
        self.x = State::zeros();
        self.P = Covariance::from_diagonal(&self.p0);
        self.acceleration = Vector4::zeros();
    }

    /// `nu` of the state.
    #[must_use]
    pub fn nu(&self) -> Vector4<f64> {
        self.x.fixed_rows::<4>(NU).into_owned()
    }

    /// `f(x, tau)`, the continuous-time model.
    #[must_use]
    pub fn derivative(&self, x: &State, tau: &Vector4<f64>) -> State {
        let nu = x.fixed_rows::<4>(NU).into_owned();
        let b = x.fixed_rows::<4>(B).into_owned();
        let mut dx = State::zeros();
        dx[Z] = nu[2];
        dx[PSI] = nu[3];
        dx.fixed_rows_mut::<4>(NU).copy_from(&self.model.acceleration(&nu, &(tau + b)));
        dx.fixed_rows_mut::<4>(B).copy_from(&(b * -self.disturbance_rate));
        dx
    }

    /// The non-trivial entries of `F = I + h ∂f/∂x`.
    fn jacobian(&self, h: f64) -> SparseJacobian {
        let [u, v, w, r] = [self.x[NU], self.x[NU + 1], self.x[NU + 2], self.x[NU + 3]];
        let (M, W) = (self.model.M(), self.model.M_inv() * h);
        let drag = |i: usize, speed: f64| 1.0 - W[i] * (self.model.D_l()[i] + 2.0 * self.model.D_q()[i] * speed.abs());
        let difference = M[1] - M[0];
        SparseJacobian {
            h,
            u: [drag(0, u), W[0] * M[1] * r, W[0] * M[1] * v, W[0]],
            v: [-W[1] * M[0] * r, drag(1, v), -W[1] * M[0] * u, W[1]],
            w: [drag(2, w), W[2]],
            r: [-W[3] * difference * v, -W[3] * difference * u, drag(3, r), W[3]],
            b: 1.0 - h * self.disturbance_rate,
        }
    }

    /// `F = I + h ∂f/∂x` as a dense matrix, for tests.
    #[must_use]
    pub fn dense_jacobian(&self, h: f64) -> Covariance {
        self.jacobian(h).times_transposed(&Covariance::identity()).transpose()
    }

    /// `x⁺ = x + h f(x, tau)`, `P⁺ = F P Fᵀ + h Q`. `tau` is the wrench commanded and allocated.
    pub fn predict(&mut self, tau: &Vector4<f64>, h_s: f64) {
        let F = self.jacobian(h_s);
        let dx = self.derivative(&self.x, tau);
        self.acceleration = dx.fixed_rows::<4>(NU).into_owned();
        self.x += dx * h_s;
        self.x[PSI] = ssa(self.x[PSI]);
        // P is symmetric, so F (P Fᵀ) is too.
        self.P = F.times_symmetric(&F.times_transposed(&self.P));
        for i in 0..STATES {
            self.P[(i, i)] += h_s * self.q[i];
        }
    }

    /// Scalar update with a direct measurement of one state; `gate` bounds the normalised innovation squared.
    pub fn update(&mut self, state: usize, measured: f64, variance: f64, gate: Option<f64>) -> Innovation {
        let mut value = measured - self.x[state];
        if state == PSI {
            value = ssa(value);
        }
        let column = self.P.data.0[state];
        let s = column[state] + variance;
        let nis = value * value / s;
        // Positive containment, so that a NaN is never accepted.
        let accepted = s > 0.0 && nis.is_finite() && gate.is_none_or(|gate| nis <= gate);
        if accepted {
            let inverse = 1.0 / s;
            let gain = value * inverse;
            for (x, p) in self.x.iter_mut().zip(&column) {
                *x += p * gain;
            }
            self.x[PSI] = ssa(self.x[PSI]);
            // P⁺ = P − P hᵀ S⁻¹ h P, column by column.
            for (updated, p) in self.P.data.0.iter_mut().zip(&column) {
                let factor = p * inverse;
                for (entry, p) in updated.iter_mut().zip(&column) {
                    *entry -= p * factor;
                }
            }
        }
        Innovation { value, variance: s, nis, accepted }
    }

    /// All numbers are finite and all variances positive.
    #[must_use]
    pub fn is_sane(&self) -> bool {
        let sum: f64 = self.x.iter().sum();
        sum.is_finite() && (0..STATES).all(|i| self.P[(i, i)] > 0.0 && self.P[(i, i)].is_finite())
    }
}

/// `F` by its 22 entries that are not 0 and not implied by the structure.
struct SparseJacobian {
    h: f64,
    /// Row u: columns u, v, r, b_u.
    u: [f64; 4],
    /// Row v: columns u, v, r, b_v.
    v: [f64; 4],
    /// Row w: columns w, b_w.
    w: [f64; 2],
    /// Row r: columns u, v, r, b_r.
    r: [f64; 4],
    /// Diagonal of the disturbance.
    b: f64,
}

impl SparseJacobian {
    /// `A Fᵀ`: every column of the result is a combination of at most four columns of `A`.
    fn times_transposed(&self, A: &Covariance) -> Covariance {
        let a = &A.data.0;
        let mut out = Covariance::zeros();
        let o = &mut out.data.0;
        for i in 0..STATES {
            let [cu, cv, cw, cr] = [a[NU][i], a[NU + 1][i], a[NU + 2][i], a[NU + 3][i]];
            o[Z][i] = a[Z][i] + self.h * cw;
            o[PSI][i] = a[PSI][i] + self.h * cr;
            o[NU][i] = self.u[0] * cu + self.u[1] * cv + self.u[2] * cr + self.u[3] * a[B][i];
            o[NU + 1][i] = self.v[0] * cu + self.v[1] * cv + self.v[2] * cr + self.v[3] * a[B + 1][i];
            o[NU + 2][i] = self.w[0] * cw + self.w[1] * a[B + 2][i];
            o[NU + 3][i] = self.r[0] * cu + self.r[1] * cv + self.r[2] * cr + self.r[3] * a[B + 3][i];
            for j in B..STATES {
                o[j][i] = self.b * a[j][i];
            }
        }
        out
    }

    /// `F A` when that is symmetric: the same combinations, of rows; what lies above the diagonal blocks is mirrored.
    fn times_symmetric(&self, A: &Covariance) -> Covariance {
        let mut out = Covariance::zeros();
        let o = &mut out.data.0;
        for (j, a) in A.data.0.iter().enumerate() {
            if j < NU {
                o[j][Z] = a[Z] + self.h * a[NU + 2];
                o[j][PSI] = a[PSI] + self.h * a[NU + 3];
            }
            if j < B {
                let [cu, cv, cw, cr] = [a[NU], a[NU + 1], a[NU + 2], a[NU + 3]];
                o[j][NU] = self.u[0] * cu + self.u[1] * cv + self.u[2] * cr + self.u[3] * a[B];
                o[j][NU + 1] = self.v[0] * cu + self.v[1] * cv + self.v[2] * cr + self.v[3] * a[B + 1];
                o[j][NU + 2] = self.w[0] * cw + self.w[1] * a[B + 2];
                o[j][NU + 3] = self.r[0] * cu + self.r[1] * cv + self.r[2] * cr + self.r[3] * a[B + 3];
            }
            for i in B..STATES {
                o[j][i] = self.b * a[i];
            }
        }
        for (rows, columns) in [(0..NU, NU..STATES), (NU..B, B..STATES)] {
            for j in columns {
                for i in rows.clone() {
                    o[j][i] = o[i][j];
                }
            }
        }
        out
    }
}
