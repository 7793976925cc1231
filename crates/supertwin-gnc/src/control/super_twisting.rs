//! The generalized super-twisting algorithm, axis by axis, paper eq. (14)-(18), explicit and implicit.
//!
//! ```text
//! φ1(s) = |s|^½ sgn s + β s          φ2(s) = ½ sgn s + 3/2 β |s|^½ sgn s + β² s   ( = φ1 φ1' )
//! tau = −k1 φ1(σ) + z                z' = −k2 φ2(σ)
//! ```
//!
//! Gains are in newtons (newton metres in yaw): `k1` per √σ, `k2` per second.

use super::surface::{Surface, SurfaceConfig};
use super::{LawInput, LawSample, TrackingError};
use nalgebra::Vector4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::{Observe, Probe, signal};
use supertwin_model::Hydrodynamics;

/// How the continuous law becomes a sampled one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Discretisation {
    /// Forward Euler: chatters at a few L h²/m.
    Explicit,
    /// Proper backward Euler: L h²/m exactly, and stable at any gain. Needs a nominal inertia, better too small.
    Implicit,
}

/// What integrators and adaptation do on an axis whose force allocation has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AntiWindup {
    /// They wait.
    Freeze,
    /// They go on: for experiments.
    None,
}

/// Gains of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// `k1`.
    pub k1: f64,
    /// `k2`.
    pub k2: f64,
    /// `β`.
    pub beta: f64,
}

/// `sgn s`, zero at zero.
#[must_use]
pub fn sgn(s: f64) -> f64 {
    if s > 0.0 {
        1.0
    } else if s < 0.0 {
        -1.0
    } else {
        0.0
    }
}

/// `φ1(s)`, paper eq. (16).
#[must_use]
pub fn phi1(s: f64, beta: f64) -> f64 {
    libm::sqrt(s.abs()) * sgn(s) + beta * s
}

/// `φ2(s)`, paper eq. (17); equals `φ1 φ1'`.
#[must_use]
pub fn phi2(s: f64, beta: f64) -> f64 {
    sgn(s) * (0.5 + 1.5 * beta * libm::sqrt(s.abs())) + beta * beta * s
}

/// Forward Euler on one axis: `(tau, z')` at `σ` and `z`.
#[must_use]
pub fn explicit(sigma: f64, z: f64, gains: Gains) -> (f64, f64) {
    (-gains.k1 * phi1(sigma, gains.beta) + z, -gains.k2 * phi2(sigma, gains.beta))
}

/// Proper backward Euler on one axis with `σ' = G (tau + d)`: `(tau, z')` at `σ` and `z`.
///
/// Solves `x + hG k1 φ1(x) + h²G k2 φ2(x) = σ` in closed form, `s = √|x|`, and returns
/// `tau = −k1 φ1(x) + z + 2 h z'`, which makes `σ⁺ = x + hG (z⁺ + d)` the exact backward Euler step of `(x, z + d)`
/// (control.md, section 7.2; idea after Seeber & Andritsch, Automatica 173, 2025, 112027).
#[must_use]
pub fn implicit(sigma: f64, z: f64, gains: Gains, h_s: f64, g: f64) -> (f64, f64) {
    let Gains { k1, k2, beta } = gains;
    let (hg, h2g) = (h_s * g, h_s * h_s * g);
    let a = 1.0 + hg * k1 * beta + h2g * k2 * beta * beta;
    let b = hg * k1 + 1.5 * h2g * k2 * beta;
    let c = sigma.abs() - 0.5 * h2g * k2;
    let (s, xi) = if c <= 0.0 {
        // Sliding: the set-valued sign takes the value that brings σ to zero in this step.
        (0.0, if k2 > 0.0 { sigma.abs() / (0.5 * h2g * k2) } else { 0.0 })
    } else {
        ((-b + libm::sqrt(b * b + 4.0 * a * c)) / (2.0 * a), 1.0)
    };
    let direction = sgn(sigma);
    let rate = -k2 * direction * (0.5 * xi + 1.5 * beta * s + beta * beta * s * s);
    (-k1 * direction * (s + beta * s * s) + z + 2.0 * h_s * rate, rate)
}

/// Largest slope of a disturbance that fixed gains provably reject: `L < L_cert` with `m = 1/G`.
///
/// `(k2/2) · (1 if ζ² ≥ ½ else 2 √(ζ² (1 − ζ²)))`, `ζ² = k1²/(4 k2 m)` (circle criterion; control.md, section 1.5).
#[must_use]
pub fn certificate(gains: Gains, g: f64) -> f64 {
    let zeta2 = gains.k1 * gains.k1 * g / (4.0 * gains.k2);
    let share = if zeta2 >= 0.5 { 1.0 } else { 2.0 * libm::sqrt(zeta2 * (1.0 - zeta2)) };
    0.5 * gains.k2 * share
}

/// The algorithm on all four axes, with its surface. Gains may be changed between steps.
#[derive(Clone, Debug)]
pub struct SuperTwisting {
    surface: Surface,
    discretisation: Discretisation,
    anti_windup: AntiWindup,
    g: Vector4<f64>,
    beta: Vector4<f64>,
    /// `K1`, the diagonal.
    pub k1: Vector4<f64>,
    /// `K2`, the diagonal.
    pub k2: Vector4<f64>,
    /// Integrator state `z`.
    pub z: Vector4<f64>,
    /// Sliding variable of the last step.
    pub sigma: Vector4<f64>,
    phi1: Vector4<f64>,
    phi2: Vector4<f64>,
}

impl SuperTwisting {
    /// # Errors
    /// The implicit discretisation needs a surface of relative degree 1.
    pub fn new(
        surface: &SurfaceConfig,
        discretisation: Discretisation,
        anti_windup: AntiWindup,
        beta: Vector4<f64>,
        model: &Hydrodynamics,
    ) -> Result<Self, String> {
        let surface = Surface::new(surface);
        let g = surface.control_gain(model);
        if discretisation == Discretisation::Implicit && g.is_none() {
            return Err(
                "law.discretisation = \"implicit\": must be \"explicit\" with surface = \"model_acceleration\", \
                        which has relative degree 0"
                    .to_owned(),
            );
        }
        Ok(Self {
            surface,
            discretisation,
            anti_windup,
            g: g.unwrap_or_else(|| model.M_inv()),
            beta,
            k1: Vector4::zeros(),
            k2: Vector4::zeros(),
            z: Vector4::zeros(),
            sigma: Vector4::zeros(),
            phi1: Vector4::zeros(),
            phi2: Vector4::zeros(),
        })
    }

    /// Forgets integrator and filter.
    pub fn reset(&mut self) {
        self.surface.reset();
        self.z = Vector4::zeros();
        self.sigma = Vector4::zeros();
    }

    /// The surface's filter starts afresh at the next step.
    pub fn surface_restart(&mut self) {
        self.surface.reset();
    }

    /// Axes on which integrator and adaptation wait.
    #[must_use]
    pub fn frozen(&self, limited: [bool; 4]) -> [bool; 4] {
        if self.anti_windup == AntiWindup::Freeze { limited } else { [false; 4] }
    }

    /// The first half of a step: the sliding variable.
    pub fn slide(&mut self, error: &TrackingError, h_s: f64) -> &Vector4<f64> {
        self.sigma = self.surface.step(error, h_s);
        &self.sigma
    }

    /// The second half: the wrench at the present `σ` and gains; the integrator moves where it may.
    pub fn twist(&mut self, input: &LawInput<'_>) -> Vector4<f64> {
        let frozen = self.frozen(input.limited);
        let mut tau = Vector4::zeros();
        for i in 0..4 {
            let gains = Gains { k1: self.k1[i], k2: self.k2[i], beta: self.beta[i] };
            let (sigma, z) = (self.sigma[i], self.z[i]);
            self.phi1[i] = phi1(sigma, gains.beta);
            self.phi2[i] = phi2(sigma, gains.beta);
            let (force, rate) = match self.discretisation {
                Discretisation::Explicit => (-gains.k1 * self.phi1[i] + z, -gains.k2 * self.phi2[i]),
                Discretisation::Implicit => implicit(sigma, z, gains, input.h_s, self.g[i]),
            };
            tau[i] = force;
            if !frozen[i] {
                self.z[i] += input.h_s * rate;
            }
        }
        tau
    }

    /// What the laws of this family are scored by; they add a tolerance if they adapt.
    #[must_use]
    pub fn sample(&self) -> LawSample {
        LawSample { k1: Some(self.k1.into()), sigma: Some(self.sigma.into()), alpha_tol: None }
    }

    /// Sets the integrator so that the wrench at `input` is `wrench`; the filter starts afresh.
    pub fn start_from(&mut self, input: &LawInput<'_>, wrench: &Vector4<f64>) {
        let h_s = input.h_s;
        self.surface.reset();
        let sigma = self.surface.clone().step(input.error, h_s);
        for i in 0..4 {
            let gains = Gains { k1: self.k1[i], k2: self.k2[i], beta: self.beta[i] };
            let (force, _) = match self.discretisation {
                Discretisation::Explicit => explicit(sigma[i], 0.0, gains),
                Discretisation::Implicit => implicit(sigma[i], 0.0, gains, h_s, self.g[i]),
            };
            self.z[i] = wrench[i] - force;
        }
    }
}

impl Observe for SuperTwisting {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.vector(&signal::controller::SIGMA, self.sigma.as_slice());
        probe.vector(&signal::controller::PHI1, self.phi1.as_slice());
        probe.vector(&signal::controller::PHI2, self.phi2.as_slice());
        probe.vector(&signal::controller::K1, self.k1.as_slice());
        probe.vector(&signal::controller::K2, self.k2.as_slice());
        probe.vector(&signal::controller::Z, self.z.as_slice());
        self.surface.observe(probe);
    }
}
