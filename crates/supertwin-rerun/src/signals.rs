//! Signals that no block shows: what `derived` computes for the dashboards.
//!
//! None of them is needed to repeat or to score a run.

use supertwin_core::axes::{AXIS_NAMES, VELOCITY_UNITS, WRENCH_UNITS};

/// An innovation with the bounds that its gate sets.
const BOUNDED: &[&str] = &["innovation", "gate", "gate"];
/// The band of the sliding variable, both of its ends.
const BAND: &[&str] = &["α_tol", "α_tol"];

supertwin_core::signals! { pub below "derived/":
    CHATTERING "chattering" AXIS_NAMES, &["N/s", "N/s", "N/s", "N m/s"],
        "total variation of the requested wrench over the last second";
    LIMITED "limited" AXIS_NAMES, &["%"], "part of the last second in which allocation changed the wrench";
    THRUST_SHARE "thrust_share" &[], &["%"], "largest thruster command as a share of its limit";
    BEAMS_USED "beams_used" &[], &["count"], "beams of the last ping that the estimator used";
    PINGS_LOST "pings_lost" &[], &["count"], "pings that the DVL lost";
    REFUSED "refused" &["gated", "restarts"], &["count"],
        "measurements refused by their gates, restarts of the filter";
    STD_POSE "std/pose" &["depth", "heading"], &["m", "rad"], "standard deviation of the estimates";
    STD_VELOCITY "std/velocity" AXIS_NAMES, VELOCITY_UNITS, "standard deviation of the estimates";
    STD_DISTURBANCE "std/disturbance" AXIS_NAMES, WRENCH_UNITS, "standard deviation of the estimates";
    NIS_DVL "nis/dvl" &["surge", "sway", "heave", "gate"], &["1"], "normalised innovations squared";
    NIS_DEPTH "nis/depth" &["depth", "gate"], &["1"], "normalised innovation squared";
    NIS_HEADING "nis/heading" &["heading", "gate"], &["1"], "normalised innovation squared";
    NIS_YAW_RATE "nis/yaw_rate" &["yaw rate", "gate"], &["1"], "normalised innovation squared";
    INNOVATION_SURGE "innovation/surge" BOUNDED, &["m/s"], "innovation between its gates";
    INNOVATION_SWAY "innovation/sway" BOUNDED, &["m/s"], "innovation between its gates";
    INNOVATION_HEAVE "innovation/heave" BOUNDED, &["m/s"], "innovation between its gates";
    INNOVATION_DEPTH "innovation/depth" BOUNDED, &["m"], "innovation between its gates";
    INNOVATION_HEADING "innovation/heading" BOUNDED, &["rad"], "innovation between its gates";
    INNOVATION_YAW_RATE "innovation/yaw_rate" BOUNDED, &["rad/s"], "innovation between its gates";
    ALPHA_TOL_SURGE "alpha_tol/surge" BAND, &["m/s"], "band of the sliding variable in which gains fall";
    ALPHA_TOL_SWAY "alpha_tol/sway" BAND, &["m/s"], "band of the sliding variable in which gains fall";
    ALPHA_TOL_HEAVE "alpha_tol/heave" BAND, &["m"], "band of the sliding variable in which gains fall";
    ALPHA_TOL_YAW "alpha_tol/yaw" BAND, &["rad"], "band of the sliding variable in which gains fall";
    HEALTH_NET "health/net" &[], &[], "whether there is a net plane";
    HEALTH_VELOCITY "health/velocity" &[], &[], "whether the velocity is measured";
    HEALTH_DEPTH "health/depth" &[], &[], "whether the depth is measured";
    HEALTH_HEADING "health/heading" &[], &[], "whether the heading is measured";
    HEALTH_THRUST "health/thrust" &[], &[], "whether the thrusters' forces are known";
    HEALTH_FILTER "health/filter" &[], &[], "whether the filter has restarted";
    NEUTRAL_PLANT "neutral/plant" &[], &[], "whether the plant has a fresh thrust command";
    NEUTRAL_EMERGENCY "neutral/emergency" &[], &[], "whether somebody demanded no force";
    EXTERNAL_SURGE "external/surge" &[], &[], "who controls surge";
    EXTERNAL_SWAY "external/sway" &[], &[], "who controls sway";
    EXTERNAL_HEAVE "external/heave" &[], &[], "who controls heave";
    EXTERNAL_YAW "external/yaw" &[], &[], "who controls yaw";
}

/// The bands of the sliding variable, axis by axis.
pub static ALPHA_TOL: [&supertwin_core::Signal; 4] =
    [&ALPHA_TOL_SURGE, &ALPHA_TOL_SWAY, &ALPHA_TOL_HEAVE, &ALPHA_TOL_YAW];
