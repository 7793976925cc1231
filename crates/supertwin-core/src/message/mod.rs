//! The values on the wires, a file each. A message type carries the key it travels on, and nothing else is ever sent.
//!
//! Every number has its unit in its name; angles are in radians, clockwise from North; depth is positive down. The signals
//! of a message are declared beside it, each with the fields whose numbers it shows: from one declaration follow what is
//! shown ([`Observe`]) and how a message is found again in what was recorded ([`FromSignals`]).

#[macro_use]
mod shown;

pub mod measurements;
pub mod nav;
pub mod reference;
pub mod thrust;
pub mod truth;
pub mod wrench_request;

pub use measurements::{DepthSample, DvlPing, HeadingSample, Measurements, YawRateSample};
pub use nav::{Nav, NavHealth, NavVariance, NetEstimate};
pub use reference::{Direction, Mode, Reference};
pub use shown::{FromSignals, SignalValues};
pub use thrust::Thrust;
pub use truth::Truth;
pub use wrench_request::WrenchRequest;

use crate::Observe;
use arrayvec::ArrayVec;
use serde::{Serialize, de::DeserializeOwned};

/// Most thrusters that a vehicle can have.
pub const MAX_THRUSTERS: usize = 8;

/// Names of the thrusters in signals, in the order of the vehicle file.
pub const THRUSTER_NAMES: &[&str; MAX_THRUSTERS] = &["t1", "t2", "t3", "t4", "t5", "t6", "t7", "t8"];

/// One number per thruster, in the order of the vehicle file.
pub type PerThruster = ArrayVec<f64, MAX_THRUSTERS>;

/// A value that crosses a process boundary, and the one key it travels on.
pub trait Message: Observe + Serialize + DeserializeOwned + Clone + Send + Sync + 'static {
    /// Key relative to the vehicle's namespace.
    const KEY: &'static str;
    /// No number in it is NaN or infinite. Nothing else may leave a service.
    fn is_finite(&self) -> bool {
        crate::observe::Snapshot::of(self).is_finite()
    }
}
