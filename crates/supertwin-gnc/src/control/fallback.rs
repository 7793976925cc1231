//! What the vehicle does by itself when guidance is silent: brake to zero velocity, hold depth and heading.
//!
//! Guidance may stand topside of a cut tether, so this reference is made beside the controller.

use crate::reference_model::{ReferenceModel, ReferenceModelConfig};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::message::{Mode, Nav, Reference};

/// How it brakes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FallbackConfig {
    /// Surge and sway to zero.
    pub velocity: ReferenceModelConfig,
    /// Depth and heading rates to zero, after which both are held where they led to.
    pub rate: ReferenceModelConfig,
}

/// A reference made on the vehicle.
#[derive(Clone, Debug)]
pub(super) struct Fallback {
    surge: ReferenceModel,
    sway: ReferenceModel,
    depth_rate: ReferenceModel,
    heading_rate: ReferenceModel,
    reference: Reference,
}

impl Fallback {
    /// At rest.
    #[must_use]
    pub(super) fn new(config: &FallbackConfig) -> Self {
        Self {
            surge: ReferenceModel::new(&config.velocity),
            sway: ReferenceModel::new(&config.velocity),
            depth_rate: ReferenceModel::new(&config.rate),
            heading_rate: ReferenceModel::new(&config.rate),
            reference: Reference::default(),
        }
    }

    /// Other parameters from now on.
    pub(super) fn retune(&mut self, config: &FallbackConfig) {
        self.surge.retune(&config.velocity);
        self.sway.retune(&config.velocity);
        self.depth_rate.retune(&config.rate);
        self.heading_rate.retune(&config.rate);
    }

    /// Begins where the last reference led, or, without one, where the vehicle is.
    pub(super) fn begin(&mut self, last: Option<&Reference>, nav: &Nav) {
        self.reference = last.cloned().unwrap_or_else(|| Reference {
            depth_m: nav.depth_m,
            heading_rad: nav.heading_rad,
            ..Reference::default()
        });
        self.surge.hold(self.reference.surge_m_per_s);
        self.sway.hold(self.reference.sway_m_per_s);
        self.depth_rate.hold(self.reference.depth_m_per_s);
        self.heading_rate.hold(self.reference.heading_rad_per_s);
    }

    /// One step of braking.
    pub(super) fn step(&mut self, h_s: f64) -> &Reference {
        for model in [&mut self.surge, &mut self.sway, &mut self.depth_rate, &mut self.heading_rate] {
            model.step(0.0, h_s);
        }
        let r = &mut self.reference;
        r.mode = Mode::DepthHeadingHold;
        (r.surge_m_per_s, r.surge_m_per_s2) = (self.surge.value, self.surge.rate);
        (r.sway_m_per_s, r.sway_m_per_s2) = (self.sway.value, self.sway.rate);
        (r.depth_m_per_s, r.depth_m_per_s2) = (self.depth_rate.value, self.depth_rate.rate);
        r.depth_m += h_s * r.depth_m_per_s;
        (r.heading_rad_per_s, r.heading_rad_per_s2) = (self.heading_rate.value, self.heading_rate.rate);
        r.heading_rad = supertwin_core::frame::ssa(r.heading_rad + h_s * r.heading_rad_per_s);
        r.speed_m_per_s = 0.0;
        r
    }
}
