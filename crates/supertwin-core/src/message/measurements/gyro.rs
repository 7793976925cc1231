//! The rate gyro.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One reading of the rate gyro.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct YawRateSample {
    /// When it was taken, in seconds of the run.
    pub taken_at_s: f64,
    /// Rate of turn, positive clockwise.
    pub yaw_rate_rad_per_s: f64,
}

shown! { sample: YawRateSample, "plant/measurements/":
    YAW_RATE "yaw_rate" &[], &["rad/s"], "rate gyro" => { sample.yaw_rate_rad_per_s };
    TAKEN_AT "yaw_rate_taken_at" &[], &["s"], "when the rate was taken" => { sample.taken_at_s };
}
