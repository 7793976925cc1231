//! The assembly: configuration into blocks, the lock-step ring, missions, scores.
//!
//! * [`config`]: files into legal values, with errors that name file, line, path, value and rule.
//! * [`schema`]: what the files may hold.
//! * [`trial`]: what a trial is, and how its pieces become blocks.
//! * [`ring`]: the four blocks and their order.
//! * [`twin`]: the ring in lock step, in one process.
//! * [`mod@run`]: a seeded run from start to scores, into any [`supertwin_core::RunSink`].
//! * [`sweep`]: campaigns, as lists of such runs.
//! * [`replay`]: recorded inputs into the blocks again, as they were or with other parameters.
//! * [`mod@rescore`]: the same scores from any [`supertwin_core::RecordedRun`].
//! * [`align`], [`metrics`], [`statistics`], [`limits`]: runs beside each other, what they are compared by, what several
//!   seeds allow to say, and which runs pass.
//!
//! A trial of the shipped configuration, cut to twenty seconds and not recorded:
//!
//! ```
//! use supertwin_core::NoSink;
//! use supertwin_lab::{Library, run, trial};
//!
//! let shorter = vec!["trial.duration_s=20".parse()?];
//! let library = Library::new("../../config", shorter);
//! let trial = trial::load(&library, "paper-agsta")?.remove(0); // one for each of its controllers
//! let outcome = run(&trial, 1, &mut NoSink, None, |_| true)?;
//! assert!(outcome.complete && outcome.ticks == 1000);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod align;
pub mod config;
pub mod limits;
pub mod metrics;
pub mod mission;
pub mod paper;
pub mod replay;
pub mod rescore;
pub mod ring;
pub mod run;
pub mod schema;
pub mod score;
pub mod shadow;
pub mod statistics;
pub mod sweep;
pub mod trial;
mod trial_config;
pub mod twin;
mod wires;

pub use config::{ConfigError, Library, Override};
pub use rescore::{RescoreError, Rescored, rescore};
pub use ring::Blocks;
pub use run::{RunError, RunOutcome, run};
pub use score::{Scores, Tracking};
pub use supertwin_gnc::control::LAWS;
pub use trial::{ResolvedTrial, TrialConfig};
pub use twin::Twin;
