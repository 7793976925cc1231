//! Plant → estimator: what the sensors delivered, a file per sensor.

use super::{FromSignals, Message, SignalValues};
use crate::{Observe, Probe};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub mod compass;
pub mod depth;
pub mod dvl;
pub mod gyro;

pub use compass::HeadingSample;
pub use depth::DepthSample;
pub use dvl::DvlPing;
pub use gyro::YawRateSample;

/// A line per sensor, in the order in which they are shown.
macro_rules! sensors {
    ($(#[doc = $about:literal] $sensor:ident: $part:ident),* $(,)?) => {
        /// What the sensors delivered at a tick: each part is present only when it arrived.
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct Measurements {
            $(#[doc = $about] pub $sensor: Option<$part>,)*
        }

        impl Observe for Measurements {
            fn observe<P: Probe>(&self, probe: &mut P) {
                $(if let Some(part) = &self.$sensor {
                    part.observe(probe);
                })*
            }
        }

        impl FromSignals for Measurements {
            fn from_signals(values: &impl SignalValues) -> Option<Self> {
                // A part of which a signal is missing did not arrive.
                Some(Self { $($sensor: $part::from_signals(values)),* })
            }
        }

        /// Signals of every sensor.
        pub static SIGNALS: &[&[&crate::Signal]] = &[$($sensor::SIGNALS),*];
    };
}

sensors! {
    /// Doppler velocity log, forward-looking.
    dvl: DvlPing,
    /// Pressure sensor.
    depth: DepthSample,
    /// Fluxgate compass.
    compass: HeadingSample,
    /// Rate gyro.
    gyro: YawRateSample,
}

impl Message for Measurements {
    const KEY: &'static str = "plant/measurements";
}
