//! Signals of the shadow beside those of its plant, which stand below `shadow/` as well.

crate::signals! { pub below "shadow/":
    RESIDUAL "residual" &["depth", "heading", "yaw_rate", "surge", "sway", "heave"],
        &["m", "rad", "rad/s", "m/s", "m/s", "m/s"], "the vehicle's last readings less where its shadow is";
    LEFT_OUT "left_out" &[], &["count"], "ticks that were never made up for";
}
