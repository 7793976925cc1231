//! Where callbacks put what arrives: bounded queues that one thread drains. A callback never waits.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use supertwin_protocol::clock::Clock;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

/// Room for messages of the wires; at 50 Hz more than the burst after a stall of five seconds.
const WIRES: usize = 1024;
/// Room for requests; a flood beyond it is dropped and counted.
const REQUESTS: usize = 64;
/// Room for requests that may not be crowded out.
const URGENT: usize = 16;

/// A message or a request that has arrived and waits for the engine.
#[derive(Debug)]
pub enum Arrival {
    /// A message on a wire: number of the host, number of its wire.
    Wire(usize, usize, ZBytes),
    /// A request: number of the host.
    Request(usize, Query),
}

/// What did not fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Overflow {
    /// Messages of wires that did not fit.
    pub wires: u64,
    /// Requests that did not fit.
    pub requests: u64,
}

#[derive(Debug, Default)]
struct Queues {
    urgent: VecDeque<(usize, Query)>,
    wires: VecDeque<(usize, usize, ZBytes)>,
    requests: VecDeque<(usize, Query)>,
    overflow: Overflow,
    woken: bool,
}

/// The queues of one thread.
#[derive(Debug, Default)]
pub struct Mailbox {
    queues: Mutex<Queues>,
    arrived: Condvar,
}

impl Mailbox {
    fn lock(&self) -> MutexGuard<'_, Queues> {
        // A thread that panicked while it held the queues has left them whole: every change is one push or pop.
        self.queues.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A message of wire `wire` for host `host`. When the queue is full, the oldest goes.
    pub fn wire(&self, host: usize, wire: usize, payload: ZBytes) {
        let mut queues = self.lock();
        if queues.wires.len() >= WIRES {
            queues.wires.pop_front();
            queues.overflow.wires += 1;
        }
        queues.wires.push_back((host, wire, payload));
        drop(queues);
        self.arrived.notify_one();
    }

    /// A request for host `host`. When the queue is full, this one goes, and its client hears of it at once.
    pub fn request(&self, host: usize, query: Query, urgent: bool) {
        let mut queues = self.lock();
        let room = if urgent { queues.urgent.len() < URGENT } else { queues.requests.len() < REQUESTS };
        if !room {
            queues.overflow.requests += 1;
            drop(queues);
            drop(query);
            return;
        }
        if urgent {
            queues.urgent.push_back((host, query));
        } else {
            queues.requests.push_back((host, query));
        }
        drop(queues);
        self.arrived.notify_one();
    }

    /// Ends a wait of the engine, although nothing has arrived.
    pub fn wake(&self) {
        self.lock().woken = true;
        self.arrived.notify_one();
    }

    /// The next arrival: urgent requests first, then wires, then other requests; wires only, if not `requests`.
    pub fn take(&self, requests: bool) -> Option<Arrival> {
        let mut queues = self.lock();
        if requests && let Some((host, query)) = queues.urgent.pop_front() {
            return Some(Arrival::Request(host, query));
        }
        if let Some((host, wire, payload)) = queues.wires.pop_front() {
            return Some(Arrival::Wire(host, wire, payload));
        }
        let request = if requests { queues.requests.pop_front() } else { None };
        request.map(|(host, query)| Arrival::Request(host, query))
    }

    /// Waits until something is there, or until `deadline` of the clock.
    pub fn wait(&self, clock: &dyn Clock, deadline: Option<Duration>) {
        let mut queues = self.lock();
        while queues.urgent.is_empty() && queues.wires.is_empty() && queues.requests.is_empty() {
            if core::mem::take(&mut queues.woken) {
                return;
            }
            let left = match deadline {
                Some(deadline) => deadline.saturating_sub(clock.now()),
                None => Duration::from_secs(3600),
            };
            if left.is_zero() {
                return;
            }
            queues = self.arrived.wait_timeout(queues, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// What did not fit so far.
    #[must_use]
    pub fn overflow(&self) -> Overflow {
        self.lock().overflow
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use supertwin_protocol::clock::SystemClock;

    #[test]
    fn a_full_queue_keeps_the_newest_and_counts_the_rest() {
        let mailbox = Mailbox::default();
        for i in 0..WIRES + 5 {
            mailbox.wire(0, i, ZBytes::default());
        }
        assert_eq!(mailbox.overflow(), Overflow { wires: 5, requests: 0 });
        assert!(matches!(mailbox.take(true), Some(Arrival::Wire(0, 5, _))));
    }

    #[test]
    fn a_wait_ends_at_its_deadline_when_woken_and_when_something_is_there() {
        let (mailbox, clock) = (Mailbox::default(), SystemClock::start());
        let deadline = clock.now() + Duration::from_millis(5);
        mailbox.wait(&clock, Some(deadline));
        assert!(clock.now() >= deadline);
        mailbox.wake();
        mailbox.wait(&clock, None);
        mailbox.wire(1, 2, ZBytes::default());
        mailbox.wait(&clock, None);
        assert!(matches!(mailbox.take(true), Some(Arrival::Wire(1, 2, _))));
    }
}
