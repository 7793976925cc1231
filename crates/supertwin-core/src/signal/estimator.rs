//! Signals of the estimator's states.

use crate::message::measurements::dvl::BEAM_NAMES;

/// Of the innovation of one number.
const INNOVATION: &[&str] = &["innovation", "std", "nis"];

crate::signals! { pub below "estimator/":
    INNOVATION_DVL "innovation/dvl"
        &["surge", "sway", "heave", "surge_std", "sway_std", "heave_std", "surge_nis", "sway_nis", "heave_nis"],
        &["m/s", "m/s", "m/s", "m/s", "m/s", "m/s", "1", "1", "1"],
        "DVL innovations, their predicted standard deviations, normalised squares";
    INNOVATION_DEPTH "innovation/depth" INNOVATION, &["m", "m", "1"],
        "depth innovation, its predicted standard deviation, normalised square";
    INNOVATION_HEADING "innovation/heading" INNOVATION, &["rad", "rad", "1"],
        "compass innovation, its predicted standard deviation, normalised square";
    INNOVATION_YAW_RATE "innovation/yaw_rate" INNOVATION, &["rad/s", "rad/s", "1"],
        "gyro innovation, its predicted standard deviation, normalised square";
    COUNTERS "counters" &["accepted", "gated", "restarts"], &["count"],
        "scalar measurements used and refused by their gates, restarts of the filter";
    NET_PLANE_PARITY "net_plane/parity" &[], &["1/m"],
        "q1 − q2 + q3 − q4 of the inverse ranges: zero for a plane";
    NET_PLANE_ACCEPTED "net_plane/accepted" BEAM_NAMES, &["flag"], "beams that were used";
    NET_PLANE_INNOVATION "net_plane/innovation" BEAM_NAMES, &["1/m"], "innovation of each beam's inverse range";
    NET_PLANE_STATE "net_plane/state" &["a_x", "a_y", "a_z"], &["1/m"], "inverse-range plane in body axes";
    NET_PLANE_FIT "net_plane/fit" &["distance", "heading", "rejections"], &["m", "rad", "count"],
        "filtered least-squares plane, and consecutive rejections";
}
