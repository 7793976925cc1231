//! The parts of a host's state: its wires, its numbers and times, who steers it.

use crate::mailbox::Overflow;
use std::collections::VecDeque;
use std::time::Duration;
use supertwin_core::OperatorLink;
use supertwin_protocol::health::Health;
use supertwin_protocol::lease::{Authority, LeaseView};
use supertwin_protocol::ledger::Ledger;
use supertwin_protocol::payload::STREAMS;
use zenoh::bytes::ZBytes;

/// What a wire carries: an input port of the block, of the same number, or what steers the host itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WireKind {
    Port,
    Setpoint(usize),
    Lease,
    Stop,
    Witness,
    Operator,
}

#[derive(Debug)]
pub(super) struct WireState {
    pub(super) kind: WireKind,
    pub(super) ledger: Ledger,
    /// The newest payload, for those who start anew.
    pub(super) held: Option<ZBytes>,
    pub(super) age_max: u64,
    pub(super) transport_ms_max: f64,
}

impl WireState {
    pub(super) fn new(kind: WireKind, silence: Duration) -> Self {
        Self { kind, ledger: Ledger::new(silence), held: None, age_max: 0, transport_ms_max: 0.0 }
    }
}

#[derive(Debug, Default)]
pub(super) struct StepSchedule {
    /// Real time: when the next step is due without a trigger.
    pub(super) due: Option<Duration>,
    /// The newest trigger that has not been acted on.
    pub(super) trigger: Option<u64>,
}

/// Numbers of the last messages that were sent.
#[derive(Debug, Default)]
pub(super) struct Sent {
    pub(super) outputs: u64,
    pub(super) telemetry: u64,
    pub(super) events: u64,
}

/// Times of a lap of the ring, by which lost outputs are repeated.
#[derive(Debug)]
pub(super) struct LapTimer {
    pub(super) began: Duration,
    /// Length of the shortest lap lately.
    pub(super) shortest: Duration,
    pub(super) sent_at: Duration,
    pub(super) repeat_after: Duration,
}

#[derive(Debug, Default)]
pub(super) struct Witness {
    pub(super) name: String,
    pub(super) source: String,
    pub(super) seen: Option<u64>,
}

#[derive(Debug, Default)]
pub(super) struct Stream {
    pub(super) seq: u64,
    pub(super) token: String,
    pub(super) client: String,
    pub(super) received_at: Duration,
    pub(super) live: bool,
    pub(super) accepted: u64,
    pub(super) refused: u64,
}

/// The last so many durations, in microseconds.
#[derive(Debug, Default)]
pub(super) struct Recent(VecDeque<f64>);

impl Recent {
    const LENGTH: usize = 512;

    pub(super) fn add(&mut self, duration: Duration) {
        if self.0.len() >= Self::LENGTH {
            self.0.pop_front();
        }
        self.0.push_back(duration.as_secs_f64() * 1e6);
    }

    /// Median, 99th percentile, maximum; zeros when there is nothing.
    pub(super) fn quantiles(&self) -> [f64; 3] {
        let mut sorted: Vec<f64> = self.0.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        [0.5, 0.99, 1.0].map(|q| {
            let at = (q * (sorted.len().max(1) - 1) as f64).round();
            sorted.get(at as usize).copied().unwrap_or(0.0)
        })
    }
}

/// What the health message tells of a host.
#[derive(Debug, Default)]
pub(super) struct Counters {
    /// Its counters of steps; the rest is filled in when it is told.
    pub(super) health: Health,
    pub(super) step_us: Recent,
    /// Owner of time: from sending a tick's output to what comes back round the ring.
    pub(super) loop_us: Recent,
    /// Telemetry that could not be written as JSON.
    pub(super) unwritten: u64,
    /// What the mailbox had no room for.
    pub(super) overflow: Overflow,
    /// When a refusal was last reported, and how many there were.
    pub(super) refused: (Duration, u64),
    /// When the next health message is due.
    pub(super) due: Duration,
}

/// Who steers: the lease, and what its holder streams.
#[derive(Debug, Default)]
pub(super) struct Operator {
    /// In the host that grants the lease.
    pub(super) authority: Option<Authority>,
    /// In all others: the lease as it was told last.
    pub(super) lease: LeaseView,
    /// Whether the operator was there at the last step.
    pub(super) link: OperatorLink,
    pub(super) streams: [Stream; STREAMS.len()],
}
