//! What a host says: events, states, refusals, the end.

use super::{Ending, Host};
use crate::outbox::Outgoing;
use serde::Serialize;
use std::borrow::Cow;
use std::time::Duration;
use supertwin_core::{Event, EventKind, Severity, Wired};
use supertwin_protocol::envelope::{Envelope, encode};
use supertwin_protocol::keys;
use supertwin_protocol::payload::Stop;
use zenoh::Wait;

impl<B: Wired + 'static> Host<B> {
    pub(super) fn note(&mut self, severity: Severity, what: EventKind) {
        let tick = self.next;
        self.tell(&Event { tick, service: Cow::Borrowed(B::NAME), severity, what });
    }

    pub(super) fn header(&self, k: u64, seq: u64) -> Envelope<'_, ()> {
        Envelope::new(&self.run, &self.source, self.tick(k), seq, self.clock.unix_ns())
    }

    pub(super) fn tell(&mut self, event: &Event) {
        self.sent.events += 1;
        let mut payload = Vec::with_capacity(256);
        if encode(&self.header(event.tick, self.sent.events).with(event), &mut payload).is_ok() {
            self.outbox.send(Outgoing::Event(payload));
        }
    }

    pub(super) fn tell_state(&self, name: String, state: &impl Serialize) {
        if let Ok(payload) = serde_json::to_vec(state) {
            self.outbox.send(Outgoing::State(name, payload));
        }
    }

    /// In the host that grants the lease: tells the others how it stands.
    pub(super) fn tell_lease(&self) {
        if let Some(authority) = &self.operator.authority {
            self.tell_state(keys::LEASE_STATE.to_owned(), &authority.state(&self.source, self.now));
        }
    }

    pub(super) fn tell_parameters(&self) {
        let parameters = self.block.parameters();
        if !parameters.is_null() {
            self.tell_state("parameters".to_owned(), &parameters);
        }
    }

    /// Something was refused; `what` is told why and how much was refused so far.
    pub(super) fn refused(&mut self, reason: &str, what: impl FnOnce(String, u64) -> EventKind) {
        // A flood makes one event a second, not one per message; every one is counted.
        let (at, count) = &mut self.counters.refused;
        *count += 1;
        let now = self.now;
        if *count == 1 || now.saturating_sub(*at) >= Duration::from_secs(1) {
            // What others wrote is quoted, but an event has its limits.
            let reason: String = reason.chars().filter(|c| !c.is_control()).take(300).collect();
            let what = what(reason, *count);
            *at = now;
            self.note(Severity::Error, what);
        }
    }

    pub(super) fn fail(&mut self, reason: String) {
        self.fail_by(EventKind::RunFailed { reason });
    }

    pub(super) fn fail_by(&mut self, what: EventKind) {
        if self.ending.is_none() {
            let reason = what.to_string();
            self.note(Severity::Error, what);
            self.say_stop(false, &reason);
            self.ending = Some(Ending::Failed(reason));
        }
    }

    pub(super) fn say_stop(&self, complete: bool, reason: &str) {
        let stop = Stop {
            run: self.run.clone(),
            source: self.source.clone(),
            tick: self.next,
            complete,
            reason: reason.to_owned(),
        };
        if self.lock_step()
            && let Ok(payload) = serde_json::to_vec(&stop)
        {
            // The others also end by their own patience.
            let _ = self.stop_publisher.put(payload).wait();
        }
    }
}
