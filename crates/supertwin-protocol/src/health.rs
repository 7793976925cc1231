//! The counters of a service and of each of its inputs.

use crate::command_queue::CommandCounts;
use crate::ledger::Counts;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One input of a service, in its health message.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InputHealth {
    /// Service and instance that writes it.
    pub source: String,
    /// Counters of the sequence numbers.
    #[serde(flatten)]
    pub counts: Counts,
    /// First and newest sequence number of the present writer: while it has been the only one, the numbers in between
    /// are those received and those missing.
    pub seq: [u64; 2],
    /// Greatest age at a step in the last second.
    pub age_ticks_max: u64,
    /// Longest way here in the last second, if the clocks agree.
    pub transport_ms_max: f64,
    /// Time since it was last heard.
    pub silent_s: f64,
}

/// A service's counters, once a second.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Health {
    /// Identifier of the run.
    pub run: String,
    /// Service and instance.
    pub source: String,
    /// Version of the program.
    pub version: String,
    /// The sender's clock, nanoseconds since 1970.
    pub clock_ns: u64,
    /// The last tick that was stepped.
    pub tick: u64,
    /// Length of a tick.
    pub tick_s: f64,
    /// Lock step rather than real time.
    pub lock_step: bool,
    /// Messages sent on its wire.
    pub sent: u64,
    /// Steps done.
    pub steps: u64,
    /// Ticks without a step.
    pub skipped: u64,
    /// Steps by its own timer, without a trigger.
    pub by_timer: u64,
    /// Ticks that began too late to be sent.
    pub deadline_misses: u64,
    /// Triggers that came after their tick had been stepped.
    pub late_triggers: u64,
    /// Outputs sent again.
    pub repeats: u64,
    /// Outputs that were no numbers and were not sent.
    pub not_finite: u64,
    /// Time of a step with all that belongs to it: median, 99th percentile, maximum of the last 512, microseconds.
    pub step_us: [f64; 3],
    /// The same of a lap of the ring, from measurements to the thrust they led to; zeros but for the owner of time.
    #[serde(default)]
    pub loop_us: [f64; 3],
    /// Inputs by key.
    pub inputs: BTreeMap<String, InputHealth>,
    /// Commands that were requested, by their outcome.
    pub commands: CommandCounts,
    /// Streaming set-points taken and refused.
    pub setpoints: [u64; 2],
    /// Messages and requests that did not fit into the mailbox.
    pub overflow: [u64; 2],
    /// Telemetry that did not fit into the outbox.
    pub telemetry_dropped: u64,
    /// Other letters that did not fit.
    pub letters_dropped: u64,
    /// Everything that was refused, of whatever kind.
    pub refused: u64,
    /// Events so far.
    pub events: u64,
}
