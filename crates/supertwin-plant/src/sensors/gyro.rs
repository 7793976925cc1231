//! Rate gyro: yaw rate at every tick, with noise and a constant bias.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::Tick;
use supertwin_core::check::{Finite, NonNegative};
use supertwin_core::message::YawRateSample;
use supertwin_core::random::Stream;

/// Gyro of a sensor file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GyroConfig {
    /// Standard deviation of the noise.
    pub std_rad_per_s: NonNegative,
    /// Constant error.
    pub bias_rad_per_s: Finite,
}

/// `r + bias + noise`.
#[derive(Clone, Debug)]
pub struct Gyro {
    config: GyroConfig,
    stream: Stream,
}

impl Gyro {
    /// Draws from the stream `gyro`.
    #[must_use]
    pub fn new(config: &GyroConfig, seed: u64) -> Self {
        Self { config: *config, stream: Stream::new(seed, "gyro") }
    }

    /// A reading.
    pub fn step(&mut self, tick: Tick, yaw_rate_rad_per_s: f64) -> YawRateSample {
        let noise = self.config.std_rad_per_s.get() * self.stream.normal();
        let yaw_rate_rad_per_s = yaw_rate_rad_per_s + self.config.bias_rad_per_s.get() + noise;
        YawRateSample { taken_at_s: tick.t_s(), yaw_rate_rad_per_s }
    }
}
