//! The account of a service, once a second.

use super::{Host, WireState};
use crate::mailbox::Overflow;
use crate::outbox::Outgoing;
use std::time::Duration;
use supertwin_core::{EventKind, Severity, Wired};
use supertwin_protocol::health::{Health, InputHealth};

impl<B: Wired + 'static> Host<B> {
    pub(super) fn housekeeping(&mut self, overflow: Overflow) {
        let now = self.now;
        if overflow != self.counters.overflow {
            let before = core::mem::replace(&mut self.counters.overflow, overflow);
            let lost = overflow.wires + overflow.requests - before.wires - before.requests;
            self.refused("", |_, so_far| EventKind::MailboxOverflow { messages: lost, so_far });
        }
        if let Some(client) = self.operator.authority.as_mut().and_then(|authority| authority.expire(now)) {
            self.tell_lease();
            self.note(Severity::Warning, EventKind::LeaseExpired { client });
        }
        if now >= self.counters.due {
            self.counters.due = now + Duration::from_secs(1);
            self.tell_health();
            self.tell_lease();
        }
    }

    pub(super) fn tell_health(&mut self) {
        let (telemetry_dropped, letters_dropped) = self.outbox.dropped();
        let input = |wire: &WireState| InputHealth {
            source: wire.ledger.source.clone(),
            counts: wire.ledger.counts,
            seq: wire.ledger.range(),
            age_ticks_max: wire.age_max,
            transport_ms_max: wire.transport_ms_max,
            silent_s: self.now.saturating_sub(wire.ledger.received_at).as_secs_f64(),
        };
        let inputs = self.ports.states().zip(&self.wires).map(|(port, wire)| (port.key.to_owned(), input(wire)));
        let health = Health {
            run: self.run.clone(),
            source: self.source.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            clock_ns: self.clock.unix_ns(),
            tick: self.next.saturating_sub(1),
            tick_s: self.options.tick_s,
            lock_step: self.lock_step(),
            sent: self.sent.outputs,
            step_us: self.counters.step_us.quantiles(),
            loop_us: self.counters.loop_us.quantiles(),
            inputs: inputs.collect(),
            commands: self.commands.counts,
            setpoints: [
                self.operator.streams.iter().map(|stream| stream.accepted).sum(),
                self.operator.streams.iter().map(|stream| stream.refused).sum(),
            ],
            overflow: [self.counters.overflow.wires, self.counters.overflow.requests],
            telemetry_dropped: telemetry_dropped + self.counters.unwritten,
            letters_dropped,
            refused: self.counters.refused.1,
            events: self.sent.events,
            ..self.counters.health.clone()
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
