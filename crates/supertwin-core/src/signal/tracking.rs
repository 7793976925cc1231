//! The quantities that a run is scored by, in the order of the paper's table IV: measured, wanted, true.

use crate::Signal;

/// Components of every tracked quantity.
const THREE: &[&str] = &["measured", "reference", "true"];

crate::signals! { pub below "tracking/":
    DISTANCE "distance" THREE, &["m"], "distance to the net";
    SPEED "speed" THREE, &["m/s"], "total speed";
    SURGE "surge" THREE, &["m/s"], "surge";
    SWAY "sway" THREE, &["m/s"], "sway";
    DEPTH "depth" THREE, &["m"], "depth";
    HEADING "heading" THREE, &["rad"], "heading";
}

/// A quantity that is tracked.
#[derive(Clone, Copy, Debug)]
pub struct Quantity {
    /// What it is called in tables and titles, without its unit.
    pub title: &'static str,
    /// Its name among the scores, with its unit at the end: `depth_m`.
    pub score: &'static str,
    /// Measured, wanted and true.
    pub signal: &'static Signal,
}

impl Quantity {
    /// Its title with its unit, such as `Depth [m]`.
    #[must_use]
    pub fn label(&self) -> String {
        format!("{} [{}]", self.title, self.signal.unit(0))
    }

    /// Differences are taken the short way round.
    #[must_use]
    pub fn is_angle(&self) -> bool {
        self.signal.unit(0) == "rad"
    }
}

/// All of them.
pub static QUANTITIES: [Quantity; 6] = [
    Quantity { title: "Distance to net", score: "distance_m", signal: &DISTANCE },
    Quantity { title: "Total speed", score: "speed_m_per_s", signal: &SPEED },
    Quantity { title: "Surge speed", score: "surge_m_per_s", signal: &SURGE },
    Quantity { title: "Sway speed", score: "sway_m_per_s", signal: &SWAY },
    Quantity { title: "Depth", score: "depth_m", signal: &DEPTH },
    Quantity { title: "Heading", score: "heading_rad", signal: &HEADING },
];
