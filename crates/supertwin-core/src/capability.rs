//! What control laws have in common beside their wrench: scores, metrics and dashboards ask for it, not for a law's name.

use crate::Signal;
use crate::signal::controller::{EXTERNAL, INTEGRAL, K1, SIGMA};

/// Something that a law has, and shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum Capability {
    /// A sliding variable σ.
    SlidingVariable,
    /// Gains k1 on it.
    Gains,
    /// These gains adapt themselves, while σ is outside a tolerance α_tol.
    AdaptiveGains,
    /// An integral of the tracking error.
    Integral,
    /// Axes that are steered from outside the vehicle.
    External,
}

impl Capability {
    /// All capabilities, in the order in which a law lists them.
    pub const ALL: [Self; 5] =
        [Self::SlidingVariable, Self::Gains, Self::AdaptiveGains, Self::Integral, Self::External];

    /// The name in recordings.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// The one with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        name.parse().ok()
    }

    /// By which signal a law shows it.
    #[must_use]
    pub fn signal(self) -> &'static Signal {
        match self {
            Self::SlidingVariable => &SIGMA,
            Self::Gains | Self::AdaptiveGains => &K1,
            Self::Integral => &INTEGRAL,
            Self::External => &EXTERNAL,
        }
    }
}
