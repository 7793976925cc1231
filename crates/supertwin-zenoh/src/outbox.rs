//! What a service says beside its wire: telemetry, events, health, states, answers. Sent by a thread of its own, so
//! that control never waits for the network.

use crate::session::LinkError;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
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

#[derive(Debug, Default)]
struct Shared {
    queues: Mutex<Queues>,
    filled: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queues> {
        self.queues.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The sending side of one service.
#[derive(Debug)]
pub(crate) struct Outbox {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

/// A way into the outbox for callbacks.
#[derive(Clone, Debug)]
pub(crate) struct Slot(Arc<Shared>);

impl Slot {
    /// Hands a message over; never waits.
    pub(crate) fn send(&self, message: Outgoing) {
        let mut queues = self.0.lock();
        // Events are numbered already: one that is dropped here could never be recovered.
        if queues.outgoing.len() >= OUTGOING && !matches!(message, Outgoing::Event(_)) {
            queues.others_dropped += 1;
            return;
        }
        queues.outgoing.push_back(message);
        drop(queues);
        self.0.filled.notify_one();
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
        let droppable = |key: &String| {
            let publisher = session
                .declare_publisher(format!("{root}{key}"))
                .encoding(Encoding::APPLICATION_JSON)
                .congestion_control(CongestionControl::Drop)
                .priority(Priority::DataLow);
            let failed = LinkError::session(format!("publisher {key}"));
            let publisher = publisher.advanced();
            // Numbers rather than time stamps tell the kept messages apart; nobody needs to be told of the last one.
            let publisher = if kept == 0 {
                publisher
            } else {
                let cache = CacheConfig::default().max_samples(kept);
                publisher.cache(cache).sample_miss_detection(MissDetectionConfig::default())
            };
            publisher.wait().map_err(failed)
        };
        let health = session
            .declare_publisher(format!("{root}{}", keys::health(service)))
            .encoding(Encoding::APPLICATION_JSON)
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::Data)
            .wait()
            .map_err(LinkError::session(format!("publisher {}", keys::health(service))))?;
        let events = session
            .declare_publisher(format!("{root}{}", keys::event(service)))
            .encoding(Encoding::APPLICATION_JSON)
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::Data)
            .cache(CacheConfig::default().max_samples(EVENTS_KEPT))
            .sample_miss_detection(MissDetectionConfig::default().heartbeat(HEARTBEAT))
            .publisher_detection()
            .wait()
            .map_err(LinkError::session(format!("publisher {}", keys::event(service))))?;
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
            .map_err(|cause| LinkError::Session { what: "thread".to_owned(), cause: cause.to_string() })?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// A way in for callbacks.
    pub(crate) fn slot(&self) -> Slot {
        Slot(Arc::clone(&self.shared))
    }

    /// Hands a message over; never waits.
    pub(crate) fn send(&self, message: Outgoing) {
        self.slot().send(message);
    }

    /// Hands over telemetry for the `i`-th key; never waits. When the queue is full the oldest goes.
    pub(crate) fn telemetry(&self, i: usize, payload: Vec<u8>) {
        let mut queues = self.shared.lock();
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
        let queues = self.shared.lock();
        (queues.telemetry_dropped, queues.others_dropped)
    }
}

impl Drop for Outbox {
    fn drop(&mut self) {
        self.shared.lock().closing = true;
        self.shared.filled.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic in the thread has been printed already; there is nothing left to send.
            let _ = thread.join();
        }
    }
}

fn send_all(shared: &Shared, mut sender: Sender) {
    loop {
        let mut queues = shared.lock();
        let (outgoing, telemetry) = loop {
            if !queues.outgoing.is_empty() || !queues.telemetry.is_empty() {
                break (core::mem::take(&mut queues.outgoing), core::mem::take(&mut queues.telemetry));
            }
            if queues.closing {
                return;
            }
            queues = shared.filled.wait(queues).unwrap_or_else(PoisonError::into_inner);
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
        match message {
            Outgoing::Event(payload) => {
                let _ = self.events.put(payload).wait();
            }
            Outgoing::Health(payload) => {
                let _ = self.health.put(payload).wait();
            }
            Outgoing::State(name, payload) => {
                let name = if name.contains('/') { name } else { keys::state(self.service, &name) };
                let key = format!("{}{name}", self.root);
                let _ = self
                    .session
                    .put(key.clone(), payload.clone())
                    .encoding(Encoding::APPLICATION_JSON)
                    .congestion_control(CongestionControl::Drop)
                    .priority(Priority::RealTime)
                    .express(true)
                    .wait();
                self.states.insert(key, payload);
            }
            Outgoing::Answer(query, key, answer) => {
                let key = key.unwrap_or_else(|| query.key_expr().as_str().to_owned());
                let _ = match answer {
                    Ok(payload) => query.reply(key, payload).encoding(Encoding::APPLICATION_JSON).wait(),
                    Err(payload) => query.reply_err(payload).encoding(Encoding::APPLICATION_JSON).wait(),
                };
            }
            Outgoing::StateQuery(query) => {
                for (key, payload) in &self.states {
                    let Ok(key) = zenoh::key_expr::KeyExpr::try_from(key.clone()) else { continue };
                    if query.key_expr().intersects(&key) {
                        let _ = query.reply(key, payload.clone()).encoding(Encoding::APPLICATION_JSON).wait();
                    }
                }
            }
        }
    }
}
