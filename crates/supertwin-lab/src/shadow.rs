//! The wires of the plant beside a real vehicle, for those who listen to them.

use supertwin_core::Message;
use supertwin_plant::{ShadowMeasurements, ShadowTruth};

/// What its sensors deliver.
pub const MEASUREMENTS: &str = ShadowMeasurements::KEY;

/// Where it is.
pub const TRUTH: &str = ShadowTruth::KEY;
