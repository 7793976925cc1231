//! Events as they happened: each once, in the order of their numbers, from the first. What is missing is asked for.
//!
//! An advanced subscriber recovers what the network lost; but an event that arrives while it still waits for the
//! history makes it leave the beginning out. The service keeps its last events, so they can be asked for.

use crate::envelope::{Received, head};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// First wait for a missing event before its service is asked; doubled from one question to the next.
const PATIENCE: Duration = Duration::from_millis(100);
/// Events that a service keeps, and that a listener can recover after it was cut off.
pub const EVENTS_KEPT: usize = 10_000;
/// Writers that are kept apart.
const LINES: usize = 1024;
/// Questions before a gap is accepted: the service is gone, or has forgotten.
const QUESTIONS: u32 = 5;

#[derive(Debug, Default)]
struct Line {
    next: u64,
    held: BTreeMap<u64, Received>,
    due: Duration,
    asked: u32,
}

/// Puts events in order.
#[derive(Debug, Default)]
pub struct EventOrder {
    lines: BTreeMap<(String, String), Line>,
    ready: VecDeque<Received>,
}

impl EventOrder {
    /// Takes an event that has arrived at `now`, in whatever order.
    pub fn push(&mut self, received: Received, now: Duration) {
        let header = head(&received.payload).ok().map(|event| (event.source.into_owned(), event.seq));
        let Some((source, seq)) = header else {
            // No event of ours; whoever listens may know what it is.
            self.ready.push_back(received);
            return;
        };
        let key = (received.key.clone(), source);
        let next = self.lines.get(&key).map(|line| line.next);
        if (next.is_none() && self.lines.len() >= LINES)
            || next.is_some_and(|next| seq > next.saturating_add(EVENTS_KEPT as u64))
        {
            // Too many writers, or a number from far away: shown, but nothing is concluded from it.
            self.ready.push_back(received);
            return;
        }
        let line = self.lines.entry(key).or_insert_with(|| Line { next: 1, ..Line::default() });
        if seq < line.next {
            return;
        }
        if line.held.is_empty() {
            (line.due, line.asked) = (now + PATIENCE, 0);
        }
        line.held.insert(seq, received);
        Self::release(line, &mut self.ready);
    }

    fn release(line: &mut Line, ready: &mut VecDeque<Received>) {
        while let Some(received) = line.held.remove(&line.next) {
            ready.push_back(received);
            line.next = line.next.saturating_add(1);
        }
    }

    /// The next event in its service's order, if it is ready.
    pub fn pop(&mut self) -> Option<Received> {
        self.ready.pop_front()
    }

    /// Keys whose service should be asked now for what it keeps.
    pub fn questions(&mut self, now: Duration) -> Vec<String> {
        let mut keys = Vec::new();
        for ((key, _), line) in &mut self.lines {
            if line.held.is_empty() || now < line.due {
                continue;
            }
            if line.asked < QUESTIONS {
                line.asked += 1;
                line.due = now + PATIENCE * 2_u32.pow(line.asked);
                keys.push(key.clone());
            } else if let Some(first) = line.held.keys().next() {
                line.next = *first;
                Self::release(line, &mut self.ready);
                (line.due, line.asked) = (now + PATIENCE, 0);
            }
        }
        keys
    }

    /// When to look again, if nothing arrives.
    pub fn due(&self) -> Option<Duration> {
        self.lines.values().filter(|line| !line.held.is_empty()).map(|line| line.due).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(seq: u64) -> Received {
        let payload = format!(r#"{{"source":"a","tick":0,"seq":{seq},"data":{{}}}}"#).into_bytes();
        Received { key: "event/plant".to_owned(), payload, at: Duration::from_secs(seq), ..Received::default() }
    }

    fn numbers(order: &mut EventOrder) -> Vec<u64> {
        std::iter::from_fn(|| order.pop()).map(|received| received.at.as_secs()).collect()
    }

    #[test]
    fn each_comes_once_and_in_order_whatever_the_network_does() {
        let mut order = EventOrder::default();
        for seq in [2, 2, 1, 5, 3, 4, 4, 1] {
            order.push(event(seq), Duration::ZERO);
        }
        assert_eq!(numbers(&mut order), [1, 2, 3, 4, 5]);
        assert_eq!(order.due(), None);
    }

    #[test]
    fn a_gap_is_asked_for_and_accepted_in_the_end() {
        let mut order = EventOrder::default();
        order.push(event(3), Duration::ZERO);
        assert!(numbers(&mut order).is_empty());
        let mut questions = 0;
        while let Some(due) = order.due() {
            questions += order.questions(due).len();
        }
        assert_eq!(questions, QUESTIONS as usize);
        assert_eq!(numbers(&mut order), [3], "better late and with a gap than never");
    }
}
