//! Signals of guidance's states.

crate::signals! { pub below "guidance/":
    REASON "reason" &[], &[], "why guidance is in its mode";
    LINE_OF_SIGHT "line_of_sight" &["surge", "sway", "course", "cross_track"], &["m/s", "m/s", "rad", "m"],
        "desired velocity before the reference models, desired course, distance error";
    TARGET "target" &["depth", "heading"], &["m", "rad"], "depth and heading before the reference models";
}
