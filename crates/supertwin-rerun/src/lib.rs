//! Recordings: whatever a run shows goes into columns of a Rerun file, with a first view that explains itself.
//!
//! * [`RerunSink`]: a [`supertwin_core::RunSink`] that writes one `.rrd` file.
//! * [`blueprint`]: the dashboards that are embedded in every recording.
//! * [`mod@read`]: a recording back as numbers, also when its writer died.

pub mod blueprint;
mod chunks;
pub mod read;
mod scene;
pub mod sink;
mod style;
mod writer;

pub use read::{ReadError, Recording, read};
pub use sink::{Options, RerunSink};

/// The application that recordings belong to; a blueprint is only used for recordings of its own application.
pub const APPLICATION: &str = "supertwin";

/// Timeline of the simulated time, a duration since the start of the run.
pub const TIME: &str = "sim_time";

/// Timeline of the tick number.
pub const TICK: &str = "tick";
