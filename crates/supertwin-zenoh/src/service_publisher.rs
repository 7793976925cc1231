//! What a service that is no block has to say, such as a recorder: events, counters, states, and that it is up.

use crate::outbox::{Outbox, Outgoing};
use crate::session::LinkError;
use serde::Serialize;
use std::borrow::Cow;
use std::sync::Arc;
use supertwin_core::{Event, EventKind, Severity, Tick};
use supertwin_protocol::Health;
use supertwin_protocol::clock::Clock;
use supertwin_protocol::envelope::{Envelope, encode};
use supertwin_protocol::keys;
use zenoh::liveliness::LivelinessToken;
use zenoh::{Session, Wait};

/// The sending side of a service without a block. Nothing here waits for the network.
pub struct ServicePublisher {
    outbox: Outbox,
    service: &'static str,
    source: String,
    clock: Arc<dyn Clock>,
    events: u64,
    // Shows that it is up.
    _token: Option<LivelinessToken>,
}

impl ServicePublisher {
    /// Speaks as `service` of the vehicle whose keys begin with `root`.
    ///
    /// # Errors
    /// When the session fails.
    pub fn open(
        session: &Session,
        root: &str,
        service: &'static str,
        instance: &str,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, LinkError> {
        let token = session
            .liveliness()
            .declare_token(format!("{root}{}", keys::alive(service, instance)))
            .wait()
            .map_err(LinkError::session("liveliness token"))?;
        Ok(Self { _token: Some(token), ..Self::unseen(session, root, service, instance, clock)? })
    }

    /// The same without a sign of life: for what is no service of the vehicle, such as its router.
    ///
    /// # Errors
    /// When the session fails.
    pub fn unseen(
        session: &Session,
        root: &str,
        service: &'static str,
        instance: &str,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, LinkError> {
        let outbox = Outbox::open(session, root, service, &[], 0)?;
        Ok(Self { outbox, service, source: format!("{service}-{instance}"), clock, events: 0, _token: None })
    }

    /// Service and instance as which it publishes.
    #[must_use]
    pub fn source(&self) -> &str {
        &self.source
    }

    /// Something happened; returns the event as others hear it.
    pub fn event(&mut self, run: &str, tick: Tick, severity: Severity, what: EventKind) -> Event {
        self.events += 1;
        let event = Event { tick: tick.k, service: Cow::Borrowed(self.service), severity, what };
        let envelope = Envelope {
            run: Cow::Borrowed(run),
            source: Cow::Borrowed(&*self.source),
            tick: tick.k,
            seq: self.events,
            sim_time_s: tick.t_s(),
            clock_ns: self.clock.unix_ns(),
            digest: None,
            repeat: false,
            data: &event,
        };
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
