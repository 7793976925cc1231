//! The assembly: configuration into blocks, the lock-step ring, missions, scores.
//!
//! * [`config`]: files into legal values, with errors that name file, line, path, value and rule.
//! * [`trial`]: what a trial is, and how its pieces become blocks.
//! * [`twin`]: the ring of four blocks in lock step, in one process.
//! * [`run`]: a seeded run from start to scores, into any [`supertwin_core::RunSink`].

pub mod config;
pub mod mission;
pub mod paper;
pub mod run;
pub mod score;
pub mod trial;
pub mod twin;
pub mod wire;

pub use config::{ConfigError, Library, Override};
pub use run::{RunError, RunOutcome, run};
pub use score::{Scores, Tracking};
pub use trial::{ResolvedTrial, TrialConfig};
pub use twin::{Blocks, Twin};
