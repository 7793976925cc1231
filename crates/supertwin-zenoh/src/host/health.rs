//! The account of a service, once a second.

use super::Host;
use super::ports::Keys;
use crate::mailbox::Overflow;
use crate::outbox::Outgoing;
use std::collections::BTreeMap;
use std::time::Duration;
use supertwin_core::port::wires;
use supertwin_core::{EventKind, Severity, Wired};
use supertwin_protocol::health::{Health, InputHealth};
use supertwin_protocol::keys;

impl<B: Wired + 'static> Host<B> {
    pub(super) fn housekeeping(&mut self, overflow: Overflow) {
        let now = self.now;
        if overflow != self.counters.overflow {
            let lost =
                overflow.wires + overflow.requests - self.counters.overflow.wires - self.counters.overflow.requests;
            self.counters.overflow = overflow;
            self.refused("", |_, so_far| EventKind::MailboxOverflow { messages: lost, so_far });
        }
        if let Some(authority) = &mut self.operator.authority
            && let Some(client) = authority.expire(now)
        {
            let state = authority.state(&self.source, now);
            self.tell_state(keys::LEASE_STATE.to_owned(), &state);
            self.note(Severity::Warning, EventKind::LeaseExpired { client });
        }
        if now >= self.counters.due {
            self.counters.due = now + Duration::from_secs(1);
            self.tell_health();
            if let Some(authority) = &self.operator.authority {
                let state = authority.state(&self.source, now);
                self.tell_state(keys::LEASE_STATE.to_owned(), &state);
            }
        }
    }

    pub(super) fn tell_health(&mut self) {
        let mut names = Keys(Vec::new());
        wires::<B>(&mut names);
        let (telemetry_dropped, letters_dropped) = self.outbox.dropped();
        let inputs: BTreeMap<&str, InputHealth> = names
            .0
            .iter()
            .zip(&self.wires)
            .map(|((key, _), wire)| {
                let silent = self.now.saturating_sub(wire.ledger.heard_at()).as_secs_f64();
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
            sent: self.sent.outputs,
            steps: self.counters.steps.steps,
            skipped: self.counters.steps.skipped,
            by_timer: self.counters.steps.by_timer,
            deadline_misses: self.counters.steps.deadline_misses,
            late_triggers: self.counters.steps.late_triggers,
            repeats: self.counters.steps.repeats,
            not_finite: self.counters.steps.not_finite,
            step_us: self.counters.step_us.quantiles(),
            loop_us: self.counters.loop_us.quantiles(),
            inputs: inputs.into_iter().map(|(key, health)| (key.to_owned(), health)).collect(),
            commands: self.commands.counts,
            setpoints: [
                self.operator.streams.iter().map(|stream| stream.accepted).sum(),
                self.operator.streams.iter().map(|stream| stream.refused).sum(),
            ],
            overflow: [self.counters.overflow.wires, self.counters.overflow.requests],
            telemetry_dropped: telemetry_dropped + self.thrown,
            letters_dropped,
            refused: self.counters.refused.1,
            events: self.sent.events,
        };
        for wire in &mut self.wires {
            wire.age_max = 0;
            wire.transport_ms_max = 0.0;
        }
        if let Ok(payload) = serde_json::to_vec(&health) {
            self.outbox.send(Outgoing::Health(payload));
        }
    }
}
