//! What a service says beside its wire: telemetry, events, health, states, answers. Sent by a thread of its own, so
//! that control never waits for the network.

use crate::session::LinkError;
use crate::transport::publisher;
use parking_lot::{Condvar, Mutex};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;
use supertwin_protocol::event_order::EVENTS_KEPT;
use supertwin_protocol::keys;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Query;
use zenoh::{Session, Wait};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

/// Telemetry that may wait; what is older goes, and is counted.
const TELEMETRY: usize = 64;
/// Everything else that may wait.
const OUTGOING: usize = 4096;
/// How often a service says which event was its last: who was away when it was sent finds out by this.
const HEARTBEAT: Duration = Duration::from_millis(500);

/// A message that is not telemetry and waits to be sent.
#[derive(Debug)]
pub(crate) enum Outgoing {
    /// An event, never dropped.
    Event(Vec<u8>),
    /// Counters of the service, as JSON.
    Health(Vec<u8>),
    /// A state for late joiners.
    State(String, Vec<u8>),
    /// An answer on a key, the question's own if none is given; `Err` is a refusal.
    Answer(Query, Option<String>, Result<Vec<u8>, Vec<u8>>),
    /// Somebody asks for states.
    StateQuery(Query),
}

#[derive(Debug, Default)]
struct Queues {
    telemetry: VecDeque<(usize, Vec<u8>)>,
    outgoing: VecDeque<Outgoing>,
    telemetry_dropped: u64,
    others_dropped: u64,
    closing: bool,
}

/// What callbacks and the sending thread have in common.
#[derive(Debug, Default)]
pub(crate) struct Shared {
    queues: Mutex<Queues>,
    filled: Condvar,
}

/// The sending side of one service.
#[derive(Debug)]
pub(crate) struct Outbox {
    pub(crate) shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Shared {
    /// Hands a message over; never waits.
    pub(crate) fn send(&self, message: Outgoing) {
        let mut queues = self.queues.lock();
        // Events are numbered already: one that is dropped here could never be recovered.
        if queues.outgoing.len() >= OUTGOING && !matches!(message, Outgoing::Event(_)) {
            queues.others_dropped += 1;
            return;
        }
        queues.outgoing.push_back(message);
        drop(queues);
        self.filled.notify_one();
    }
}

struct Sender {
    session: Session,
    root: String,
    service: &'static str,
    telemetry: Vec<AdvancedPublisher<'static>>,
    events: AdvancedPublisher<'static>,
    health: Publisher<'static>,
    states: BTreeMap<String, Vec<u8>>,
}

impl Outbox {
    /// Declares the publishers of `service` below `root`; `telemetry` lists the keys that may be dropped, and of which
    /// the last `kept` messages can be asked for.
    pub(crate) fn open(
        session: &Session,
        root: &str,
        service: &'static str,
        telemetry: &[String],
        kept: usize,
    ) -> Result<Self, LinkError> {
        let failed = |key: &str| LinkError::session(format!("publisher {key}"));
        let droppable = |key: &String| {
            let publisher = publisher(session, format!("{root}{key}"), Priority::DataLow).advanced();
            // Numbers rather than time stamps tell the kept messages apart; nobody needs to be told of the last one.
            let publisher = if kept == 0 {
                publisher
            } else {
                let cache = CacheConfig::default().max_samples(kept);
                publisher.cache(cache).sample_miss_detection(MissDetectionConfig::default())
            };
            publisher.wait().map_err(failed(key))
        };
        let (health, events) = (keys::health(service), keys::event(service));
        let health = publisher(session, format!("{root}{health}"), Priority::Data).wait().map_err(failed(&health))?;
        let events = publisher(session, format!("{root}{events}"), Priority::Data)
            .cache(CacheConfig::default().max_samples(EVENTS_KEPT))
            .sample_miss_detection(MissDetectionConfig::default().heartbeat(HEARTBEAT))
            .publisher_detection()
            .wait()
            .map_err(failed(&keys::event(service)))?;
        let sender = Sender {
            session: session.clone(),
            service,
            root: root.to_owned(),
            telemetry: telemetry.iter().map(droppable).collect::<Result<_, _>>()?,
            events,
            health,
            states: BTreeMap::new(),
        };
        let shared = Arc::new(Shared::default());
        let inner = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name(format!("{service}-outbox"))
            .spawn(move || send_all(&inner, sender))
            .map_err(|cause| LinkError::failed("thread", &cause))?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Hands a message over; never waits.
    pub(crate) fn send(&self, message: Outgoing) {
        self.shared.send(message);
    }

    /// Hands over telemetry for the `i`-th key; never waits. When the queue is full the oldest goes.
    pub(crate) fn telemetry(&self, i: usize, payload: Vec<u8>) {
        let mut queues = self.shared.queues.lock();
        if queues.telemetry.len() >= TELEMETRY {
            queues.telemetry.pop_front();
            queues.telemetry_dropped += 1;
        }
        queues.telemetry.push_back((i, payload));
        drop(queues);
        self.shared.filled.notify_one();
    }

    /// What did not fit: telemetry, everything else.
    pub(crate) fn dropped(&self) -> (u64, u64) {
        let queues = self.shared.queues.lock();
        (queues.telemetry_dropped, queues.others_dropped)
    }
}

impl Drop for Outbox {
    fn drop(&mut self) {
        self.shared.queues.lock().closing = true;
        self.shared.filled.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic in the thread has been printed already; there is nothing left to send.
            let _ = thread.join();
        }
    }
}

fn send_all(shared: &Shared, mut sender: Sender) {
    loop {
        let mut queues = shared.queues.lock();
        let (outgoing, telemetry) = loop {
            if !queues.outgoing.is_empty() || !queues.telemetry.is_empty() {
                break (core::mem::take(&mut queues.outgoing), core::mem::take(&mut queues.telemetry));
            }
            if queues.closing {
                return;
            }
            shared.filled.wait(&mut queues);
        };
        drop(queues);
        for message in outgoing {
            sender.message(message);
        }
        for (i, payload) in telemetry {
            // A put that does not get through is visible to every receiver as a gap in the sequence numbers.
            let _ = sender.telemetry[i].put(payload).wait();
        }
    }
}

impl Sender {
    fn message(&mut self, message: Outgoing) {
        // What fails here fails because the session is closing; receivers see gaps, clients see no answer.
        let _ = match message {
            Outgoing::Event(payload) => self.events.put(payload).wait(),
            Outgoing::Health(payload) => self.health.put(payload).wait(),
            Outgoing::State(name, payload) => {
                let name = if name.contains('/') { name } else { keys::state(self.service, &name) };
                let key = format!("{}{name}", self.root);
                self.states.insert(key.clone(), payload.clone());
                self.session
                    .put(key, payload)
                    .encoding(Encoding::APPLICATION_JSON)
                    .congestion_control(CongestionControl::Drop)
                    .priority(Priority::RealTime)
                    .express(true)
                    .wait()
            }
            Outgoing::Answer(query, key, answer) => {
                let key = key.unwrap_or_else(|| query.key_expr().as_str().to_owned());
                match answer {
                    Ok(payload) => query.reply(key, payload).encoding(Encoding::APPLICATION_JSON).wait(),
                    Err(payload) => query.reply_err(payload).encoding(Encoding::APPLICATION_JSON).wait(),
                }
            }
            Outgoing::StateQuery(query) => {
                for (key, payload) in &self.states {
                    let Ok(key) = zenoh::key_expr::KeyExpr::try_from(key.clone()) else { continue };
                    if query.key_expr().intersects(&key) {
                        let _ = query.reply(key, payload.clone()).encoding(Encoding::APPLICATION_JSON).wait();
                    }
                }
                Ok(())
            }
        };
    }
}
