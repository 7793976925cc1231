//! Reference models: smooth references with bounded rate and acceleration (Fossen 2021, ch. 12).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::Positive;
use supertwin_core::frame::ssa;

/// Parameters of a reference model, in the unit of its quantity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReferenceModelConfig {
    /// Natural frequency of the critically damped second-order system.
    pub natural_frequency_rad_per_s: Positive,
    /// Largest first derivative, per second.
    pub max_rate: Positive,
    /// Largest second derivative, per second squared.
    pub max_acceleration: Positive,
}

/// A reference and its derivatives.
///
/// ```text
/// a = clip(ω² e − 2 ω v, ±a_max),   v⁺ = clip(v + h a, ±v_max),   a := (v⁺ − v)/h,   x⁺ = x + h v⁺
/// ```
///
/// The acceleration that it supplies is the realised one, so that integrating it gives the rate that it supplies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceModel {
    config: ReferenceModelConfig,
    /// `x`.
    pub value: f64,
    /// `x'`.
    pub rate: f64,
    /// `x''`.
    pub acceleration: f64,
}

impl ReferenceModel {
    /// At rest at zero.
    #[must_use]
    pub fn new(config: &ReferenceModelConfig) -> Self {
        Self { config: *config, value: 0.0, rate: 0.0, acceleration: 0.0 }
    }

    /// Other parameters from now on; value and rate stay.
    pub fn retune(&mut self, config: &ReferenceModelConfig) {
        self.config = *config;
    }

    /// At rest at `value`.
    pub fn hold(&mut self, value: f64) {
        (self.value, self.rate, self.acceleration) = (value, 0.0, 0.0);
    }

    /// One step of `h_s` seconds towards `target`.
    pub fn step(&mut self, target: f64, h_s: f64) {
        self.toward(target - self.value, h_s);
    }

    /// One step towards an angle, the short way round; the value stays in [−π, π).
    pub fn step_angle(&mut self, target_rad: f64, h_s: f64) {
        self.toward(ssa(target_rad - self.value), h_s);
        self.value = ssa(self.value);
    }

    fn toward(&mut self, error: f64, h_s: f64) {
        let omega = self.config.natural_frequency_rad_per_s.get();
        let (max_rate, max_acceleration) = (self.config.max_rate.get(), self.config.max_acceleration.get());
        let wanted = omega * omega * error - 2.0 * omega * self.rate;
        let acceleration = wanted.clamp(-max_acceleration, max_acceleration);
        let rate = (self.rate + h_s * acceleration).clamp(-max_rate, max_rate);
        self.acceleration = (rate - self.rate) / h_s;
        self.rate = rate;
        self.value += h_s * rate;
    }
}
