//! What a service that is no block has to say, such as a recorder: events, counters, states, and that it is up.

use crate::outbox::{Outbox, Outgoing};
use crate::session::LinkError;
use crate::watch::Presence;
use serde::Serialize;
use std::borrow::Cow;
use std::sync::Arc;
use supertwin_core::{Event, EventKind, Severity, Tick};
use supertwin_protocol::Health;
use supertwin_protocol::clock::Clock;
use supertwin_protocol::envelope::{Envelope, encode};
use supertwin_protocol::keys;
use zenoh::Session;

/// The sending side of a service without a block. Nothing here waits for the network.
pub struct ServicePublisher {
    outbox: Outbox,
    service: &'static str,
    source: String,
    clock: Arc<dyn Clock>,
    events: u64,
    // Shows that it is up.
    _token: Option<Presence>,
}

impl ServicePublisher {
    /// Speaks as `service` of the vehicle whose keys begin with `root`. What is no service of the vehicle, such as its
    /// router, does not show that it is `alive`.
    ///
    /// # Errors
    /// When the session fails.
    pub fn open(
        session: &Session,
        root: &str,
        service: &'static str,
        instance: &str,
        clock: Arc<dyn Clock>,
        alive: bool,
    ) -> Result<Self, LinkError> {
        let key = format!("{root}{}", keys::alive(service, instance));
        let _token = alive.then(|| Presence::show(session, &key)).transpose()?;
        let outbox = Outbox::open(session, root, service, &[], 0)?;
        Ok(Self { outbox, service, source: format!("{service}-{instance}"), clock, events: 0, _token })
    }

    /// Something happened; returns the event as others hear it.
    pub fn event(&mut self, run: &str, tick: Tick, severity: Severity, what: EventKind) -> Event {
        self.events += 1;
        let event = Event { tick: tick.k, service: Cow::Borrowed(self.service), severity, what };
        let envelope = Envelope::new(run, &self.source, tick, self.events, self.clock.unix_ns()).with(&event);
        let mut payload = Vec::with_capacity(256);
        if encode(&envelope, &mut payload).is_ok() {
            self.outbox.send(Outgoing::Event(payload));
        }
        event
    }

    /// Its counters; source, version, clock and number of events are filled in.
    pub fn health(&self, health: Health) {
        let health = Health {
            source: self.source.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            clock_ns: self.clock.unix_ns(),
            events: self.events,
            letters_dropped: self.outbox.dropped().1,
            ..health
        };
        if let Ok(payload) = serde_json::to_vec(&health) {
            self.outbox.send(Outgoing::Health(payload));
        }
    }

    /// A state for late joiners.
    pub fn state(&self, name: &str, state: &impl Serialize) {
        if let Ok(payload) = serde_json::to_vec(state) {
            self.outbox.send(Outgoing::State(name.to_owned(), payload));
        }
    }
}
