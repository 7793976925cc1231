//! Everything around the vehicle, as it stands in an environment file.

use crate::cage::CageConfig;
use crate::current::CurrentConfig;
use crate::waves::WavesConfig;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{NonNegative, Positive};

/// One sea and one net pen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentConfig {
    /// What it is and where its numbers come from.
    pub description: String,
    /// Mean current and its fluctuations.
    pub current: CurrentConfig,
    /// Spectrum of the waves.
    pub waves: WavesConfig,
    /// The pen.
    pub cage: CageConfig,
    /// The tether's pull.
    pub tether: TetherConfig,
}

/// The tether pulls at random: an Ornstein-Uhlenbeck force in body axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "the field names carry axis and unit")]
pub struct TetherConfig {
    pub surge_std_n: NonNegative,
    pub sway_std_n: NonNegative,
    pub heave_std_n: NonNegative,
    pub yaw_std_nm: NonNegative,
    /// Time after which the correlation has fallen to 1/e.
    pub correlation_time_s: Positive,
}

impl EnvironmentConfig {
    /// # Errors
    /// When pieces that are legal alone do not fit together.
    pub fn check(&self) -> Result<(), String> {
        if self.waves.band.low() <= 0.0 {
            return Err(format!("waves.band: {} must be positive", self.waves.band.low()));
        }
        crate::cage::Cage::new(&self.cage, 0).map(drop)
    }
}
