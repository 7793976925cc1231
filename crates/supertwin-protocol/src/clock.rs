//! The only clock of the network's side. Blocks are handed ticks; hosts ask here when a tick begins.
#![allow(clippy::disallowed_methods, reason = "this module is the one place above the blocks that reads a clock")]

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Time as hosts and clients see it.
pub trait Clock: Send + Sync {
    /// Since some moment before anything began; never goes back.
    fn now(&self) -> Duration;
    /// Nanoseconds since 1970: the machine's own idea, for people and for clock offsets.
    fn unix_ns(&self) -> u64;
}

/// The machine's monotonic clock and its wall clock.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock(Instant);

impl SystemClock {
    /// A clock whose zero is now.
    #[must_use]
    pub fn start() -> Self {
        Self(Instant::now())
    }
}

impl Clock for SystemClock {
    fn now(&self) -> Duration {
        self.0.elapsed()
    }

    fn unix_ns(&self) -> u64 {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
    }
}
