//! Listening from outside the ring: samples, past events, who comes and goes. Bounded, and never in the network's way.

use crate::session::LinkError;
use crate::transport::question;
use parking_lot::{Condvar, Mutex};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use supertwin_protocol::event_order::{EVENTS_KEPT, EventOrder};
use supertwin_protocol::{Clock, Received, keys};
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::ReplyKeyExpr;
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};
use zenoh_ext::{AdvancedSubscriber, AdvancedSubscriberBuilderExt, HistoryConfig, RecoveryConfig};

/// Samples that may wait for a slow reader; what is older goes, and is counted.
const ROOM: usize = 20_000;
/// How long past events are waited for before new ones are shown.
const HISTORY: Duration = Duration::from_millis(500);

/// Events wait by themselves, to be put in order.
#[derive(Clone, Copy, Debug)]
enum Kind {
    Sample,
    Event,
}

#[derive(Debug, Default)]
struct Queue {
    samples: VecDeque<Received>,
    events: VecDeque<Received>,
    lost: u64,
    interrupted: bool,
}

#[derive(Debug, Default)]
struct Shared {
    queue: Mutex<Queue>,
    filled: Condvar,
}

impl Shared {
    fn push(&self, kind: Kind, received: Received) {
        let mut queue = self.queue.lock();
        let Queue { samples, events, lost, .. } = &mut *queue;
        let line = match kind {
            Kind::Sample => samples,
            Kind::Event => events,
        };
        if line.len() >= ROOM {
            line.pop_front();
            *lost += 1;
        }
        line.push_back(received);
        drop(queue);
        self.filled.notify_one();
    }
}

/// Ends the wait of an inbox, for ever; may be called from any thread.
#[derive(Clone, Debug)]
pub struct Interrupter(Arc<Shared>);

impl Interrupter {
    /// Nobody waits any more.
    pub fn interrupt(&self) {
        self.0.queue.lock().interrupted = true;
        self.0.filled.notify_all();
    }

    /// Whether that has happened.
    #[must_use]
    pub fn interrupted(&self) -> bool {
        self.0.queue.lock().interrupted
    }
}

/// Where everything that one listens to arrives, in order.
pub struct Inbox {
    shared: Arc<Shared>,
    clock: Arc<dyn Clock>,
    subscribers: Vec<Subscriber<()>>,
    advanced: Vec<AdvancedSubscriber<()>>,
    /// Whom to ask for events that are missing.
    session: Option<Session>,
    order: Mutex<EventOrder>,
}

impl Inbox {
    /// Listens to nothing yet.
    #[must_use]
    pub fn new(clock: Arc<dyn Clock>) -> Self {
        Self {
            shared: Arc::default(),
            clock,
            subscribers: Vec::new(),
            advanced: Vec::new(),
            session: None,
            order: Mutex::default(),
        }
    }

    /// What ends its waits.
    #[must_use]
    pub fn interrupter(&self) -> Interrupter {
        Interrupter(Arc::clone(&self.shared))
    }

    fn callback(&self, kind: Kind) -> impl Fn(Sample) + Send + Sync + 'static {
        let (shared, clock) = (Arc::clone(&self.shared), Arc::clone(&self.clock));
        move |sample| shared.push(kind, received(&sample, clock.now()))
    }

    /// Listens to `key`, which may have wildcards.
    ///
    /// # Errors
    /// When the session fails.
    pub fn listen(&mut self, session: &Session, key: &str) -> Result<(), LinkError> {
        let subscriber = session.declare_subscriber(key.to_owned()).callback(self.callback(Kind::Sample)).wait();
        self.subscribers.push(subscriber.map_err(LinkError::session(key))?);
        Ok(())
    }

    /// Listens to events: what happened before comes first, what the network loses is fetched, and the events of each
    /// service come once and in order.
    ///
    /// # Errors
    /// When the session fails.
    pub fn listen_events(&mut self, session: &Session, key: &str) -> Result<(), LinkError> {
        self.session = Some(session.clone());
        let subscriber = session
            .declare_subscriber(key.to_owned())
            .callback(self.callback(Kind::Event))
            // Also of publishers that come later; with room for the whole cache, so that the recovery of a gap is never
            // mistaken for a shorter history.
            .history(HistoryConfig::default().detect_late_publishers().max_samples(EVENTS_KEPT))
            .recovery(RecoveryConfig::default().heartbeat())
            .query_timeout(HISTORY)
            .wait();
        self.advanced.push(subscriber.map_err(LinkError::session(key))?);
        Ok(())
    }

    /// Listens to who comes and goes; who is there already comes first.
    ///
    /// # Errors
    /// When the session fails.
    pub fn listen_alive(&mut self, session: &Session, key: &str) -> Result<(), LinkError> {
        let subscriber = session
            .liveliness()
            .declare_subscriber(key.to_owned())
            .history(true)
            .callback(self.callback(Kind::Sample))
            .wait();
        self.subscribers.push(subscriber.map_err(LinkError::session(key))?);
        Ok(())
    }

    /// The next sample; `None` when there was none until `deadline` by the inbox's clock, or the wait was interrupted.
    #[must_use]
    pub fn next(&self, deadline: Option<Duration>) -> Option<Received> {
        loop {
            let mut order = self.order.lock();
            let now = self.clock.now();
            let mut queue = self.shared.queue.lock();
            if queue.interrupted {
                return None;
            }
            for event in queue.events.drain(..) {
                order.push(event, now);
            }
            if let Some(received) = queue.samples.pop_front() {
                return Some(received);
            }
            drop(queue);
            let questions = order.questions(now);
            if let Some(event) = order.pop() {
                return Some(event);
            }
            let due = order.due();
            drop(order);
            if let Some(session) = &self.session {
                // The service behind a key keeps its events.
                questions.iter().for_each(|key| self.ask(session, &keys::advanced(key), Kind::Event));
            }
            if deadline.is_some_and(|deadline| now >= deadline) {
                return None;
            }
            let until = [deadline, due].into_iter().flatten().min();
            let mut queue = self.shared.queue.lock();
            while queue.samples.is_empty() && queue.events.is_empty() && !queue.interrupted {
                match until.map(|until| until.saturating_sub(self.clock.now())) {
                    None => self.shared.filled.wait(&mut queue),
                    Some(left) if left.is_zero() => break,
                    Some(left) => {
                        self.shared.filled.wait_for(&mut queue, left);
                    }
                }
            }
        }
    }

    /// What has arrived and was not read, also after an interruption; waits for nothing.
    #[must_use]
    pub fn rest(&self) -> Vec<Received> {
        let mut order = self.order.lock();
        let mut queue = self.shared.queue.lock();
        let now = self.clock.now();
        for event in queue.events.drain(..) {
            order.push(event, now);
        }
        queue.samples.drain(..).chain(std::iter::from_fn(|| order.pop())).collect()
    }

    /// Asks whoever publishes on `key` for the `newest` messages that it keeps, or for all of them; they arrive like
    /// others, perhaps again.
    pub fn recall(&self, session: &Session, key: &str, newest: Option<u64>) {
        let only = newest.map_or_else(String::new, |count| format!("?_max={count}"));
        self.ask(session, &format!("{}{only}", keys::advanced(key)), Kind::Sample);
    }

    /// Asks whoever answers on `key`, which may have wildcards; the answers arrive like samples.
    pub fn inquire(&self, session: &Session, key: &str) {
        self.ask(session, key, Kind::Sample);
    }

    fn ask(&self, session: &Session, key: &str, kind: Kind) {
        let taken = self.callback(kind);
        // A question that fails is asked again, and in the end the gap stays visible in the numbers.
        let _ = question(session, key, HISTORY)
            .accept_replies(ReplyKeyExpr::Any)
            .callback(move |reply| {
                if let Ok(sample) = reply.result() {
                    taken(sample.clone());
                }
            })
            .wait();
    }

    /// Samples that went because the reader was too slow.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.shared.queue.lock().lost
    }
}

fn received(sample: &Sample, at: Duration) -> Received {
    Received {
        key: sample.key_expr().as_str().to_owned(),
        payload: sample.payload().to_bytes().into_owned(),
        gone: sample.kind() == SampleKind::Delete,
        at,
    }
}

/// Shows that a client is there, until dropped: its lease ends with it.
pub struct Presence(#[allow(dead_code, reason = "dropping it is its use")] LivelinessToken);

impl Presence {
    /// Shows it under `key`.
    ///
    /// # Errors
    /// When the session fails.
    pub fn show(session: &Session, key: &str) -> Result<Self, LinkError> {
        session.liveliness().declare_token(key.to_owned()).wait().map(Self).map_err(LinkError::session(key))
    }
}

/// Whether `text` may be listened to.
///
/// # Errors
/// Says what is wrong with it.
pub fn check_key(text: &str) -> Result<(), String> {
    KeyExpr::new(text).map(drop).map_err(|error| crate::session::brief(&error.to_string()))
}

/// Whether two keys have a key in common.
#[must_use]
pub fn overlap(a: &str, b: &str) -> bool {
    matches!((KeyExpr::new(a), KeyExpr::new(b)), (Ok(a), Ok(b)) if a.intersects(&b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use supertwin_protocol::SystemClock;

    fn received(i: usize) -> Received {
        Received { key: i.to_string(), ..Received::default() }
    }

    #[test]
    fn a_slow_reader_loses_the_oldest_and_knows_how_many() {
        let inbox = Inbox::new(Arc::new(SystemClock::start()));
        for i in 0..ROOM + 3 {
            inbox.shared.push(Kind::Sample, received(i));
        }
        assert_eq!(inbox.lost(), 3);
        assert_eq!(inbox.next(None), Some(received(3)));
    }

    #[test]
    fn waits_end_by_their_deadline_and_by_an_interruption() {
        let inbox = Inbox::new(Arc::new(SystemClock::start()));
        assert_eq!(inbox.next(Some(Duration::ZERO)), None);
        inbox.shared.push(Kind::Sample, received(0));
        inbox.interrupter().interrupt();
        assert_eq!(inbox.next(None), None, "who was interrupted reads no more");
        assert_eq!(inbox.rest(), [received(0)], "but what is left");
    }

    #[test]
    fn keys_are_checked_and_compared() {
        assert!(check_key("a/*/b/**").is_ok());
        for wrong in ["", "/a", "a//b", "a/", "a#b", "a/b*c"] {
            assert!(check_key(wrong).is_err(), "{wrong}");
        }
        assert!(overlap("event/**", "event/plant") && !overlap("health/*", "event/plant"));
    }
}
