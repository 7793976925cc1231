//! Signals of the plant's states beside the truth.

use crate::message::THRUSTER_NAMES;

crate::signals! { pub below "plant/":
    HEALTH "health" &["thrust_lost", "pings_lost"], &["flag", "count"],
        "no fresh thrust command: thrusters neutral; pings lost inside the DVL";
    THRUSTER_DEMAND "thruster_demand" THRUSTER_NAMES, &["N"],
        "force demanded at the propellers, after delay, dead band and limit";
}
