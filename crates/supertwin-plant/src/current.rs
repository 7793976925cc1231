//! Current inside the pen: a profile that weakens and veers with depth, and slow fluctuations.

use nalgebra::{Vector2, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{Finite, NonNegative, Positive};
use supertwin_core::random::{Draw, OrnsteinUhlenbeck, Stream};

/// Current of an environment file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CurrentConfig {
    /// Mean speed at the surface.
    pub speed_m_per_s: NonNegative,
    /// Share of the surface speed that is lost per metre of depth.
    pub decay_per_m: NonNegative,
    /// Direction towards which it sets at the surface, from North; a range is drawn from per seed.
    pub direction_rad: Draw,
    /// Turn of the direction per metre of depth.
    pub veering_rad_per_m: Finite,
    /// Standard deviation of the fluctuation, per horizontal axis.
    pub fluctuation_std_m_per_s: NonNegative,
    /// Correlation time of the fluctuation.
    pub fluctuation_time_s: Positive,
}

/// `U(z) = U₀ max(0, 1 − c z)` towards `direction + veering z`, plus an Ornstein-Uhlenbeck part, in NED axes.
#[derive(Clone, Debug)]
pub struct Current {
    config: CurrentConfig,
    direction_rad: f64,
    fluctuation: OrnsteinUhlenbeck<2>,
}

impl Current {
    /// Draws from the streams `current/direction` and `current/fluctuation` of the seed.
    #[must_use]
    pub fn new(config: &CurrentConfig, seed: u64, dt_s: f64) -> Self {
        let std = config.fluctuation_std_m_per_s.get();
        Self {
            config: *config,
            direction_rad: config.direction_rad.sample(&mut Stream::new(seed, "current/direction")),
            fluctuation: OrnsteinUhlenbeck::new(
                Vector2::new(std, std),
                config.fluctuation_time_s.get(),
                dt_s,
                Stream::new(seed, "current/fluctuation"),
            ),
        }
    }

    /// One tick of the fluctuation, and the velocity at `depth_m` in NED axes.
    pub fn step(&mut self, depth_m: f64) -> Vector3<f64> {
        let fluctuation = self.fluctuation.step();
        let speed = self.config.speed_m_per_s.get() * (1.0 - self.config.decay_per_m.get() * depth_m).max(0.0);
        let (sin, cos) = libm::sincos(self.direction_rad + self.config.veering_rad_per_m.get() * depth_m);
        Vector3::new(speed * cos + fluctuation.x, speed * sin + fluctuation.y, 0.0)
    }
}
