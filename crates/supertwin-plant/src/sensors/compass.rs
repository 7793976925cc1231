//! Fluxgate compass: heading with noise and a constant bias.

use super::Schedule;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::Tick;
use supertwin_core::check::{Finite, NonNegative, Positive};
use supertwin_core::frame::ssa;
use supertwin_core::message::HeadingSample;
use supertwin_core::random::Stream;

/// Compass of a sensor file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CompassConfig {
    /// Time between readings.
    pub period_s: Positive,
    /// Standard deviation of the noise.
    pub std_rad: NonNegative,
    /// Constant error.
    pub bias_rad: Finite,
}

/// `psi + bias + noise`, in [−π, π).
#[derive(Clone, Debug)]
pub struct Compass {
    config: CompassConfig,
    schedule: Schedule,
    stream: Stream,
}

impl Compass {
    /// Draws from the stream `compass`.
    #[must_use]
    pub fn new(config: &CompassConfig, seed: u64, dt_s: f64) -> Self {
        let schedule = Schedule::new(config.period_s.get(), dt_s);
        Self { config: *config, schedule, stream: Stream::new(seed, "compass") }
    }

    /// A reading, when one is due.
    pub fn step(&mut self, tick: Tick, heading_rad: f64) -> Option<HeadingSample> {
        self.schedule.is_due(tick).then(|| HeadingSample {
            taken_at_s: tick.t_s(),
            heading_rad: ssa(heading_rad
                + self.config.bias_rad.get()
                + self.config.std_rad.get() * self.stream.normal()),
        })
    }
}
