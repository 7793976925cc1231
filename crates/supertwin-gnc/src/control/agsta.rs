//! AGSTA: generalized super-twisting with adaptive gains, paper eq. (14)-(20).
//!
//! ```text
//! k1' = ω √(γ/2)  while |σ| ≥ α_tol, else 0                                  (19)
//! k2  = 2 ε k1 + λ + 4 ε²                                                    (20)
//! ```
//!
//! Eq. (20) is printed with a dot on k2; the relation is algebraic (Shtessel et al. 2010, the paper's reference 6):
//! it is what keeps the Lyapunov function's derivative negative while k1 moves (control.md, section 1.3).

use super::super_twisting::{AntiWindup, Discretisation, SuperTwisting};
use super::surface::SurfaceConfig;
use super::{ControlLaw, LawInput, LawSample};
use nalgebra::Vector4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{NonNegative, Positive};
use supertwin_core::{Axes, Capability, Observe, Probe};
use supertwin_model::Hydrodynamics;

/// How k2 follows k1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SecondGain {
    /// `k2 = 2 ε k1 + λ + 4 ε²`.
    Algebraic,
    /// `k2' = 2 ε k1 + λ + 4 ε²` as printed. For experiments: it wrecks heading.
    Integrated,
}

/// Adaptation of one axis, or of all.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AdaptationConfig {
    /// `ω`.
    pub omega: Axes<Positive>,
    /// `γ`.
    pub gamma: Axes<Positive>,
    /// `ε`.
    pub epsilon: Axes<Positive>,
    /// `λ`.
    pub lambda: Axes<Positive>,
    /// `α_tol`, in the unit of σ.
    pub alpha_tol: Axes<Positive>,
    /// `k1` at the start; the paper does not print it.
    pub k1_initial: Axes<NonNegative>,
    /// How k2 follows k1.
    pub second_gain: SecondGain,
    /// Largest `k1`, if there is to be one.
    pub k1_cap: Option<Axes<Positive>>,
    /// Rate at which `k1` leaks towards its start, per second, if it is to.
    pub leak_per_s: Option<NonNegative>,
}

/// Parameters of the law.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AgstaConfig {
    /// The sliding surface.
    pub surface: SurfaceConfig,
    /// How it is sampled.
    pub discretisation: Discretisation,
    /// What saturation does to integrator and adaptation.
    pub anti_windup: AntiWindup,
    /// `β`.
    pub beta: Axes<Positive>,
    /// The adaptive law.
    pub adaptation: AdaptationConfig,
}

/// The law at work.
#[derive(Clone, Debug)]
pub struct Agsta {
    /// The algorithm's state.
    pub twisting: SuperTwisting,
    rate: Vector4<f64>,
    alpha_tol: Vector4<f64>,
    epsilon: Vector4<f64>,
    lambda: Vector4<f64>,
    k1_initial: Vector4<f64>,
    k1_cap: Vector4<f64>,
    leak_per_s: f64,
    second_gain: SecondGain,
}

impl ControlLaw for Agsta {
    type Config = AgstaConfig;
    const CAPABILITIES: &'static [Capability] =
        &[Capability::SlidingVariable, Capability::Gains, Capability::AdaptiveGains];

    /// Fails when the discretisation does not go with the surface, or a cap is below its start.
    fn new(config: &AgstaConfig, model: &Hydrodynamics) -> Result<Self, String> {
        let a = &config.adaptation;
        let twisting = SuperTwisting::new(
            &config.surface,
            config.discretisation,
            config.anti_windup,
            config.beta.vector(),
            model,
        )?;
        let k1_initial = a.k1_initial.vector();
        let k1_cap = a.k1_cap.map_or(Vector4::repeat(f64::INFINITY), Axes::vector);
        if let Some(i) = (0..4).find(|&i| k1_cap[i] < k1_initial[i]) {
            return Err(format!(
                "law.agsta.adaptation.k1_cap = {} ({}): must not be below k1_initial = {}",
                k1_cap[i],
                supertwin_core::axes::AXIS_NAMES[i],
                k1_initial[i]
            ));
        }
        let mut law = Self {
            twisting,
            rate: a.omega.vector().component_mul(&a.gamma.vector().map(|gamma| libm::sqrt(gamma / 2.0))),
            alpha_tol: a.alpha_tol.vector(),
            epsilon: a.epsilon.vector(),
            lambda: a.lambda.vector(),
            k1_initial,
            k1_cap,
            leak_per_s: a.leak_per_s.map_or(0.0, NonNegative::get),
            second_gain: a.second_gain,
        };
        law.reset();
        Ok(law)
    }

    /// One tick: slide, adapt, twist.
    fn step(&mut self, input: &LawInput<'_>) -> Vector4<f64> {
        self.twisting.slide(input.error, input.h_s);
        self.adapt(input.h_s, self.twisting.frozen(input.limited));
        self.twisting.twist(input)
    }

    /// See [`SuperTwisting::start_from`]. Adapted gains are kept: a hand-over does not unlearn.
    fn start_from(&mut self, input: &LawInput<'_>, wrench: &Vector4<f64>) {
        // The step that follows adapts first: anticipate it, so that nothing jumps.
        let mut ahead = self.clone();
        ahead.twisting.surface_restart();
        ahead.twisting.slide(input.error, input.h_s);
        ahead.adapt(input.h_s, ahead.twisting.frozen(input.limited));
        ahead.twisting.start_from(input, wrench);
        self.twisting.surface_restart();
        self.twisting.z = ahead.twisting.z;
    }

    /// Takes over the adapted gains of `other`, up to the cap; where the initial gain was changed, it starts anew.
    fn keep_adapted(&mut self, other: &Self) {
        for i in 0..4 {
            if self.k1_initial[i] == other.k1_initial[i] {
                let k1 = other.twisting.k1[i].min(self.k1_cap[i]);
                self.twisting.k1[i] = k1;
                self.twisting.k2[i] = match self.second_gain {
                    SecondGain::Algebraic => self.second(i, k1),
                    SecondGain::Integrated => other.twisting.k2[i],
                };
            }
        }
    }

    /// Forgets integrator, filter and adapted gains.
    fn reset(&mut self) {
        self.twisting.reset();
        self.twisting.k1 = self.k1_initial;
        self.twisting.k2 = Vector4::from_fn(|i, _| self.second(i, self.k1_initial[i]));
    }

    fn sample(&self) -> LawSample {
        LawSample { alpha_tol: Some(self.alpha_tol.into()), ..self.twisting.sample() }
    }
}

impl Agsta {
    /// `2 ε k1 + λ + 4 ε²`.
    fn second(&self, i: usize, k1: f64) -> f64 {
        2.0 * self.epsilon[i] * k1 + self.lambda[i] + 4.0 * self.epsilon[i] * self.epsilon[i]
    }

    fn adapt(&mut self, h_s: f64, frozen: [bool; 4]) {
        for (i, frozen) in frozen.into_iter().enumerate() {
            if frozen {
                continue;
            }
            let growth = if self.twisting.sigma[i].abs() >= self.alpha_tol[i] { self.rate[i] } else { 0.0 };
            let k1 = self.twisting.k1[i];
            let leak = self.leak_per_s * (k1 - self.k1_initial[i]);
            let k1 = (k1 + h_s * (growth - leak)).min(self.k1_cap[i]);
            self.twisting.k1[i] = k1;
            let second = self.second(i, k1);
            match self.second_gain {
                SecondGain::Algebraic => self.twisting.k2[i] = second,
                SecondGain::Integrated => self.twisting.k2[i] += h_s * second,
            }
        }
    }
}

impl Observe for Agsta {
    fn observe<P: Probe>(&self, probe: &mut P) {
        self.twisting.observe(probe);
    }
}
