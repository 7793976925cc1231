//! The command line's only clock: how long things took, for people.
#![allow(clippy::disallowed_methods, reason = "this module is the one place of the command line that reads a clock")]

use std::time::Instant;

/// Started when made.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stopwatch(Instant);

impl Stopwatch {
    /// Starts.
    pub(crate) fn start() -> Self {
        Self(Instant::now())
    }

    /// Seconds since the start.
    pub(crate) fn elapsed_s(self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}
