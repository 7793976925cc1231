//! Where callbacks put what arrives: bounded queues that one thread drains. A callback never waits.

use parking_lot::{Condvar, Mutex};
use std::collections::VecDeque;
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
    urgent: VecDeque<Arrival>,
    wires: VecDeque<Arrival>,
    requests: VecDeque<Arrival>,
    overflow: Overflow,
    woken: bool,
}

/// The queues of one thread. A thread that panics while it holds them leaves them whole: every change is one push or pop.
#[derive(Debug, Default)]
pub struct Mailbox {
    queues: Mutex<Queues>,
    arrived: Condvar,
}

impl Mailbox {
    /// A message of wire `wire` for host `host`. When the queue is full, the oldest goes.
    pub fn wire(&self, host: usize, wire: usize, payload: ZBytes) {
        let mut queues = self.queues.lock();
        if queues.wires.len() >= WIRES {
            queues.wires.pop_front();
            queues.overflow.wires += 1;
        }
        queues.wires.push_back(Arrival::Wire(host, wire, payload));
        drop(queues);
        self.arrived.notify_one();
    }

    /// A request for host `host`. When the queue is full, this one goes, and its client hears of it at once.
    pub fn request(&self, host: usize, query: Query, urgent: bool) {
        let mut guard = self.queues.lock();
        let queues = &mut *guard;
        let (line, room) = if urgent { (&mut queues.urgent, URGENT) } else { (&mut queues.requests, REQUESTS) };
        if line.len() >= room {
            queues.overflow.requests += 1;
            return;
        }
        line.push_back(Arrival::Request(host, query));
        drop(guard);
        self.arrived.notify_one();
    }

    /// Ends a wait of the engine, although nothing has arrived.
    pub fn wake(&self) {
        self.queues.lock().woken = true;
        self.arrived.notify_one();
    }

    /// The next arrival: urgent requests first, then wires, then other requests; wires only, if not `requests`.
    pub fn pop(&self, requests: bool) -> Option<Arrival> {
        let mut queues = self.queues.lock();
        if !requests {
            return queues.wires.pop_front();
        }
        let first = queues.urgent.pop_front().or_else(|| queues.wires.pop_front());
        first.or_else(|| queues.requests.pop_front())
    }

    /// Waits until something is there, or until `deadline` of the clock.
    pub fn wait(&self, clock: &dyn Clock, deadline: Option<Duration>) {
        let mut queues = self.queues.lock();
        while queues.urgent.is_empty() && queues.wires.is_empty() && queues.requests.is_empty() {
            if core::mem::take(&mut queues.woken) {
                return;
            }
            let left = deadline.map_or(Duration::from_secs(3600), |deadline| deadline.saturating_sub(clock.now()));
            if left.is_zero() {
                return;
            }
            self.arrived.wait_for(&mut queues, left);
        }
    }

    /// What did not fit so far.
    #[must_use]
    pub fn overflow(&self) -> Overflow {
        self.queues.lock().overflow
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
        assert!(matches!(mailbox.pop(true), Some(Arrival::Wire(0, 5, _))));
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
        assert!(matches!(mailbox.pop(true), Some(Arrival::Wire(1, 2, _))));
    }
}
