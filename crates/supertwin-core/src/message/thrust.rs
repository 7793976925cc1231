//! Controller → plant: what the thrusters are to do.

use super::{MAX_THRUSTERS, Message, PerThruster, THRUSTER_NAMES};
use crate::axes::{AXIS_NAMES, WRENCH_UNITS};
use crate::{Axes, Wrench};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Thruster commands, and the wrench that was wanted and the one they make.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Thrust {
    /// Commanded force of each thruster in newtons.
    #[schemars(with = "Vec<f64>", length(max = MAX_THRUSTERS))]
    pub force_n: PerThruster,
    /// What the control law asked for.
    pub requested: Wrench,
    /// What the commanded forces make of it.
    pub allocated: Wrench,
    /// Axes on which the two differ by more than the allocation's tolerance.
    pub limited: Axes<bool>,
    /// Somebody demanded no force. A controller that starts anew takes this over from its predecessor.
    pub emergency_neutral: bool,
}

shown! { thrust: Thrust, "controller/thrust/":
    FORCE "force" THRUSTER_NAMES, &["N"], "commanded force of each thruster" => { thrust.force_n };
    REQUESTED "requested" AXIS_NAMES, WRENCH_UNITS, "wrench the law asked for, body axes" => { thrust.requested };
    ALLOCATED "allocated" AXIS_NAMES, WRENCH_UNITS, "wrench the commanded forces make, body axes"
        => { thrust.allocated };
    LIMITED "limited" AXIS_NAMES, &["flag"], "axes on which allocation changed the wrench" => { thrust.limited };
    EMERGENCY_NEUTRAL "emergency_neutral" &[], &["flag"], "somebody demanded no force"
        => { thrust.emergency_neutral };
}

impl Message for Thrust {
    const KEY: &'static str = "controller/thrust";
}
