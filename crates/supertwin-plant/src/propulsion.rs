//! What the thrusters make of their commands: transport delay, dead band, saturation, lag, faults.

use nalgebra::Vector4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{NonNegative, Positive};
use supertwin_core::message::{MAX_THRUSTERS, PerThruster};
use supertwin_model::thrusters::{Forces, Thrusters};

/// Longest transport delay in ticks.
const MAX_DELAY_TICKS: usize = 64;

/// Thruster dynamics of a vehicle file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PropulsionConfig {
    /// Time from command to the first effect.
    pub delay_s: NonNegative,
    /// Time constant of the first-order response.
    pub lag_s: Positive,
    /// Commands below this make no force.
    pub dead_band_n: NonNegative,
}

/// The thrusters' state.
#[derive(Clone, Debug)]
pub struct Propulsion {
    /// The thrusters.
    pub thrusters: Thrusters,
    dead_band_n: f64,
    /// `1 − e^{−h/T}` of a sub-step.
    response: f64,
    queue: [Forces; MAX_DELAY_TICKS],
    delay_ticks: usize,
    head: usize,
    /// Forces that were demanded and have reached the propellers.
    pub demand: Forces,
    /// Present forces.
    pub force: Forces,
    gain: Forces,
}

impl Propulsion {
    /// # Errors
    /// When the delay is longer than 64 ticks.
    pub fn new(config: &PropulsionConfig, thrusters: Thrusters, dt_s: f64, substep_s: f64) -> Result<Self, String> {
        let delay_ticks = libm::round(config.delay_s.get() / dt_s) as usize;
        if delay_ticks >= MAX_DELAY_TICKS {
            return Err(format!(
                "propulsion.delay_s = {}: must be shorter than {} s ({MAX_DELAY_TICKS} ticks)",
                config.delay_s.get(),
                MAX_DELAY_TICKS as f64 * dt_s
            ));
        }
        Ok(Self {
            thrusters,
            dead_band_n: config.dead_band_n.get(),
            response: -libm::expm1(-substep_s / config.lag_s.get()),
            queue: [Forces::zeros(); MAX_DELAY_TICKS],
            delay_ticks,
            head: 0,
            demand: Forces::zeros(),
            force: Forces::zeros(),
            gain: Forces::repeat(1.0),
        })
    }

    /// Once per tick: takes a command in and brings the delayed one to the propellers.
    pub fn command(&mut self, force_n: &PerThruster) {
        let mut command = Forces::zeros();
        for (i, force_n) in force_n.iter().enumerate().take(self.thrusters.count()) {
            let limit = self.thrusters.max_n()[i];
            // A command that is no number makes no force: NaN stops here.
            let legal = if force_n.is_finite() { force_n.clamp(-limit, limit) } else { 0.0 };
            command[i] = if legal.abs() < self.dead_band_n { 0.0 } else { legal };
        }
        self.queue[self.head] = command;
        let tail = (self.head + MAX_DELAY_TICKS - self.delay_ticks) % MAX_DELAY_TICKS;
        self.head = (self.head + 1) % MAX_DELAY_TICKS;
        self.demand = self.queue[tail].component_mul(&self.gain);
    }

    /// One sub-step of the first-order lag, discretised exactly.
    pub fn advance(&mut self) {
        self.force += (self.demand - self.force) * self.response;
    }

    /// Wrench of the present forces, in body axes.
    #[must_use]
    pub fn wrench(&self) -> Vector4<f64> {
        self.thrusters.wrench(&self.force)
    }

    /// Sets the share of its force that a thruster (from 0) gives; false when there is no such thruster.
    pub fn set_gain(&mut self, thruster: usize, gain: f64) -> bool {
        let exists = thruster < self.thrusters.count().min(MAX_THRUSTERS);
        if exists {
            self.gain[thruster] = gain;
        }
        exists
    }
}
