//! Pressure sensor: depth below the mean surface, and the waves' dynamic pressure with it.

use super::Schedule;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::Tick;
use supertwin_core::check::{NonNegative, Positive};
use supertwin_core::message::DepthSample;
use supertwin_core::random::Stream;

/// Pressure sensor of a sensor file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DepthSensorConfig {
    /// Time between readings.
    pub period_s: Positive,
    /// Standard deviation of the noise.
    pub std_m: NonNegative,
}

/// `depth + ζ e^{−kz} + noise`.
#[derive(Clone, Debug)]
pub struct DepthSensor {
    config: DepthSensorConfig,
    schedule: Schedule,
    stream: Stream,
}

impl DepthSensor {
    /// Draws from the stream `depth`.
    #[must_use]
    pub fn new(config: &DepthSensorConfig, seed: u64, dt_s: f64) -> Self {
        let schedule = Schedule::new(config.period_s.get(), dt_s);
        Self { config: *config, schedule, stream: Stream::new(seed, "depth") }
    }

    /// A reading, when one is due.
    pub fn step(&mut self, tick: Tick, depth_m: f64, pressure_head_m: f64) -> Option<DepthSample> {
        self.schedule.is_due(tick).then(|| DepthSample {
            taken_at_s: tick.t_s(),
            depth_m: depth_m + pressure_head_m + self.config.std_m.get() * self.stream.normal(),
        })
    }
}
