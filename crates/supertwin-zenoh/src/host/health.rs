//! The account of a service, once a second.

use super::Host;
use super::ports::Keys;
use crate::desk::DeskCounts;
use crate::keys;
use crate::ledger::Counts;
use crate::mailbox::Overflow;
use crate::outbox::Letter;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;
use supertwin_core::Wired;
use supertwin_core::run::Severity;

impl<B: Wired + 'static> Host<B> {
    pub(super) fn housekeeping(&mut self, overflow: Overflow) {
        let now = self.clock.now();
        if overflow != self.overflow {
            let lost = overflow.wires + overflow.requests - self.overflow.wires - self.overflow.requests;
            self.overflow = overflow;
            self.refused(&format!("{lost} messages did not fit into the mailbox"));
        }
        if let Some(authority) = &mut self.authority
            && authority.expire(now)
        {
            let state = authority.state(&self.source, now);
            self.tell_state(keys::LEASE_STATE.to_owned(), &state);
            self.note(Severity::Warning, "the lease has run out without being given back".to_owned());
        }
        if now >= self.health_due {
            self.health_due = now + Duration::from_secs(1);
            self.tell_health();
            if let Some(authority) = &self.authority {
                let state = authority.state(&self.source, now);
                self.tell_state(keys::LEASE_STATE.to_owned(), &state);
            }
        }
    }

    pub(super) fn tell_health(&mut self) {
        let mut names = Keys(Vec::new());
        B::visit(&mut B::ports(), &mut names);
        let (telemetry_dropped, letters_dropped) = self.outbox.dropped();
        let inputs: BTreeMap<&str, InputHealth> = names
            .0
            .iter()
            .zip(&self.wires)
            .map(|((key, _), wire)| {
                let silent = self.clock.now().saturating_sub(wire.ledger.heard_at()).as_secs_f64();
                let health = InputHealth {
                    source: wire.ledger.source().to_owned(),
                    counts: wire.ledger.counts,
                    seq: wire.ledger.range(),
                    age_ticks_max: wire.age_max,
                    transport_ms_max: wire.transport_ms_max,
                    silent_s: silent,
                };
                (*key, health)
            })
            .collect();
        let health = Health {
            run: self.run.clone(),
            source: self.source.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            clock_ns: self.clock.unix_ns(),
            tick: self.next.saturating_sub(1),
            tick_s: self.options.tick_s,
            lock_step: self.lock_step(),
            sent: self.seq,
            steps: self.steps.steps,
            skipped: self.steps.skipped,
            by_timer: self.steps.by_timer,
            deadline_misses: self.steps.deadline_misses,
            late_triggers: self.steps.late_triggers,
            repeats: self.steps.repeats,
            not_finite: self.steps.not_finite,
            step_us: self.step_us.quantiles(),
            loop_us: self.loop_us.quantiles(),
            inputs: inputs.into_iter().map(|(key, health)| (key.to_owned(), health)).collect(),
            commands: self.desk.counts,
            setpoints: [
                self.streams.iter().map(|stream| stream.accepted).sum(),
                self.streams.iter().map(|stream| stream.refused).sum(),
            ],
            overflow: [self.overflow.wires, self.overflow.requests],
            telemetry_dropped: telemetry_dropped + self.thrown,
            letters_dropped,
            refused: self.refused_reported.1,
            events: self.event_seq,
        };
        for wire in &mut self.wires {
            wire.age_max = 0;
            wire.transport_ms_max = 0.0;
        }
        if let Ok(payload) = serde_json::to_vec(&health) {
            self.outbox.send(Letter::Health(payload));
        }
    }
}

/// One input of a service, in its health message.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InputHealth {
    /// Who writes it.
    pub source: String,
    /// The account.
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
    /// The run.
    pub run: String,
    /// Service and instance.
    pub source: String,
    /// Version of the program.
    pub version: String,
    /// The sender's clock, nanoseconds since 1970.
    pub clock_ns: u64,
    /// The last tick.
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
    /// Requests.
    pub commands: DeskCounts,
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
