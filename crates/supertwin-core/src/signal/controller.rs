//! Signals of the controller's states, and of the laws' that others ask for.

use crate::axes::{ACCELERATION_UNITS, AXIS_NAMES, VELOCITY_UNITS, WRENCH_UNITS};

crate::signals! { pub below "controller/":
    ERROR "error" AXIS_NAMES, &["m/s", "m/s", "m", "rad"],
        "tracking errors x1: surge and sway velocity, depth, heading";
    VELOCITY_ERROR "velocity_error" AXIS_NAMES, VELOCITY_UNITS, "velocity errors of all axes";
    ACCELERATION_ERROR "acceleration_error" AXIS_NAMES, ACCELERATION_UNITS,
        "acceleration errors by the estimator's model";
    SIGMA "sigma" AXIS_NAMES, &["m/s", "m/s", "m", "rad"], "sliding variable";
    PHI1 "phi1" AXIS_NAMES, &["√σ"], "φ1 of the sliding variable, eq. (16)";
    PHI2 "phi2" AXIS_NAMES, &["1"], "φ2 of the sliding variable, eq. (17)";
    K1 "k1" AXIS_NAMES, &["N/√σ", "N/√σ", "N/√σ", "N m/√σ"], "gain k1, adaptive in AGSTA";
    K2 "k2" AXIS_NAMES, &["N/s", "N/s", "N/s", "N m/s"], "gain k2";
    Z "z" AXIS_NAMES, WRENCH_UNITS, "integrator of the law";
    SURFACE_ACCELERATION "surface_acceleration" &["surge", "sway", "heave"], &["m/s²"],
        "acceleration error inside the sliding variable";
    INTEGRAL "integral" AXIS_NAMES, &["m", "m", "m s", "rad s"], "integral of the tracking error";
    EXTERNAL "external" AXIS_NAMES, &["flag"], "axes that are steered from outside";
    NON_FINITE "non_finite" &[], &["count"], "wrenches of the law that were no numbers and were replaced by zero";
    LAW "law" &[], &[], "law in command";
    STATUS "status" &[], &[], "what the controller is doing";
}
