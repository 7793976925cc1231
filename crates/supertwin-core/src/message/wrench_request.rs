//! Client → controller: a wrench from outside.

use super::Message;
use crate::axes::{AXIS_NAMES, WRENCH_UNITS};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A wrench from outside, for the law `external`. Axes that are absent stay with the law's own substitute.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WrenchRequest {
    /// Along the forward axis, in newtons.
    pub surge_n: Option<f64>,
    /// Along the starboard axis, in newtons.
    pub sway_n: Option<f64>,
    /// Along the downward axis, in newtons.
    pub heave_n: Option<f64>,
    /// About the downward axis, in newton metres.
    pub yaw_nm: Option<f64>,
}

impl WrenchRequest {
    /// In the order surge, sway, heave, yaw.
    #[must_use]
    pub fn to_array(&self) -> [Option<f64>; 4] {
        [self.surge_n, self.sway_n, self.heave_n, self.yaw_nm]
    }
}

shown! { request: WrenchRequest, "controller/":
    WRENCH_REQUEST "wrench_request" AXIS_NAMES, WRENCH_UNITS,
        "wrench asked for by an external controller; 0 where it left the axis alone"
        => { request.surge_n, request.sway_n, request.heave_n, request.yaw_nm };
}

impl Message for WrenchRequest {
    const KEY: &'static str = "controller/wrench_request";
}
