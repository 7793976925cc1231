//! The vehicle's sensors, with their rates, noise, delays and faults.

mod compass;
mod depth;
mod dvl;
mod gyro;

pub use compass::{Compass, CompassConfig};
pub use depth::{DepthSensor, DepthSensorConfig};
pub use dvl::{Dvl, DvlConfig, DvlScene, FishConfig};
pub use gyro::{Gyro, GyroConfig};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::Tick;

/// All sensors of a sensor file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SensorsConfig {
    /// What they are and where their numbers come from.
    pub description: String,
    /// Doppler velocity log.
    pub dvl: DvlConfig,
    /// Pressure sensor.
    pub depth: DepthSensorConfig,
    /// Fluxgate compass.
    pub compass: CompassConfig,
    /// Rate gyro.
    pub gyro: GyroConfig,
}

impl SensorsConfig {
    /// # Errors
    /// When ranges contradict each other.
    pub fn check(&self) -> Result<(), String> {
        let (min, max) = (self.dvl.min_range_m.get(), self.dvl.max_range_m.get());
        if min >= max {
            return Err(format!("dvl.min_range_m = {min}: must be less than dvl.max_range_m = {max}"));
        }
        let [low, high] = self.dvl.fish.range_factor.map(supertwin_core::check::Fraction::get);
        if low > high {
            return Err(format!("dvl.fish.range_factor = [{low}, {high}]: the first must not exceed the second"));
        }
        Ok(())
    }
}

/// A fixed sampling period in whole ticks.
#[derive(Clone, Copy, Debug)]
struct Schedule {
    every_ticks: u64,
}

impl Schedule {
    fn new(period_s: f64, dt_s: f64) -> Self {
        Self { every_ticks: (libm::round(period_s / dt_s) as u64).max(1) }
    }
    fn is_due(self, tick: Tick) -> bool {
        tick.k.is_multiple_of(self.every_ticks)
    }
}
