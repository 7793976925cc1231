//! The compass.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One reading of the compass.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HeadingSample {
    /// When it was taken, in seconds of the run.
    pub taken_at_s: f64,
    /// Heading, clockwise from North.
    pub heading_rad: f64,
}

shown! { sample: HeadingSample, "plant/measurements/":
    HEADING "heading" &[], &["rad"], "fluxgate compass" => { sample.heading_rad };
    TAKEN_AT "heading_taken_at" &[], &["s"], "when the heading was taken" => { sample.taken_at_s };
}
