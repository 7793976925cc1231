//! PID, the paper's third case study: `tau = −kp e − ki ∫e dt − kd e'` per axis.
//!
//! `e = x1 = [ũ, ṽ, z̃, psĩ]`: velocity errors in surge and sway, position errors in depth and heading. `e'` is `w̃`
//! and `r̃` in depth and heading, and a filtered derivative in surge and sway.

use super::super_twisting::AntiWindup;
use super::surface::{Surface, SurfaceConfig};
use super::{ControlLaw, LawInput};
use nalgebra::Vector4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{NonNegative, Positive};
use supertwin_core::{Axes, Capability, Observe, Probe, signal};
use supertwin_model::Hydrodynamics;

/// Gains in newtons (newton metres) per unit of error, its integral and its derivative.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PidConfig {
    /// Proportional gain.
    pub kp: Axes<NonNegative>,
    /// Integral gain.
    pub ki: Axes<NonNegative>,
    /// Derivative gain.
    pub kd: Axes<NonNegative>,
    /// Time constant of the derivative in surge and sway.
    pub derivative_filter_s: Positive,
    /// What saturation does to the integrator.
    pub anti_windup: AntiWindup,
}

/// The law at work.
#[derive(Clone, Debug)]
pub struct Pid {
    kp: Vector4<f64>,
    ki: Vector4<f64>,
    kd: Vector4<f64>,
    anti_windup: AntiWindup,
    /// Reused for its filter: `σ − x1` of the lead-filter surface is the filtered derivative.
    derivative: Surface,
    integral: Vector4<f64>,
}

impl Pid {
    fn rate(derivative: &mut Surface, input: &LawInput<'_>) -> Vector4<f64> {
        let lead = derivative.step(input.error, input.h_s) - input.error.x1;
        Vector4::new(lead[0], lead[1], input.error.velocity[2], input.error.velocity[3])
    }
}

impl ControlLaw for Pid {
    type Config = PidConfig;
    const CAPABILITIES: &'static [Capability] = &[Capability::Integral];

    fn new(config: &PidConfig, _: &Hydrodynamics) -> Result<Self, String> {
        let filter = SurfaceConfig::LeadFilter { time_constant_s: config.derivative_filter_s };
        Ok(Self {
            kp: config.kp.vector(),
            ki: config.ki.vector(),
            kd: config.kd.vector(),
            anti_windup: config.anti_windup,
            derivative: Surface::new(&filter),
            integral: Vector4::zeros(),
        })
    }

    fn step(&mut self, input: &LawInput<'_>) -> Vector4<f64> {
        let e = input.error.x1;
        let e_dot = Self::rate(&mut self.derivative, input);
        for i in 0..4 {
            if !(input.limited[i] && self.anti_windup == AntiWindup::Freeze) {
                self.integral[i] += input.h_s * e[i];
            }
        }
        -(self.kp.component_mul(&e) + self.ki.component_mul(&self.integral) + self.kd.component_mul(&e_dot))
    }

    /// Sets the integrals so that the wrench at `input` is `wrench`, on the axes that have an integral gain.
    fn start_from(&mut self, input: &LawInput<'_>, wrench: &Vector4<f64>) {
        self.derivative.reset();
        let e_dot = Self::rate(&mut self.derivative.clone(), input);
        let rest = self.kp.component_mul(&input.error.x1) + self.kd.component_mul(&e_dot) + wrench;
        for i in 0..4 {
            let ahead = if input.limited[i] && self.anti_windup == AntiWindup::Freeze {
                0.0
            } else {
                input.h_s * input.error.x1[i]
            };
            self.integral[i] = if self.ki[i] > 0.0 { -rest[i] / self.ki[i] - ahead } else { 0.0 };
        }
    }

    fn reset(&mut self) {
        self.derivative.reset();
        self.integral = Vector4::zeros();
    }
}

impl Observe for Pid {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.vector(&signal::controller::INTEGRAL, self.integral.as_slice());
    }
}
