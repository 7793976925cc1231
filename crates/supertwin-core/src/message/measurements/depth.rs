//! The pressure sensor.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One reading of the pressure sensor.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DepthSample {
    /// When it was taken, in seconds of the run.
    pub taken_at_s: f64,
    /// Depth below the mean surface from pressure; includes the waves' dynamic pressure.
    pub depth_m: f64,
}

shown! { sample: DepthSample, "plant/measurements/":
    DEPTH "depth" &[], &["m"], "depth from pressure" => { sample.depth_m };
    TAKEN_AT "depth_taken_at" &[], &["s"], "when the depth was taken" => { sample.taken_at_s };
}
