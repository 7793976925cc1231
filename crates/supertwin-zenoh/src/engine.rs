//! The thread that drives hosts: takes what has arrived, lets each host do what it can, waits.

use crate::host::{Ending, Hosted};
use crate::mailbox::{Arrival, Mailbox};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use supertwin_core::Tick;
use supertwin_core::digest::RunDigest;
use supertwin_protocol::clock::Clock;

/// Requests that are answered between two steps; the rest waits its turn.
const REQUESTS_AT_ONCE: usize = 8;

/// A round that takes longer than meant by this much is a stall.
const STALL: Duration = Duration::from_millis(20);
/// Arrivals of any kind between two steps: a flood must not keep the hosts from stepping.
const ARRIVALS_AT_ONCE: usize = 256;

/// Hosts of one process on one thread.
pub struct Engine {
    hosts: Vec<Box<dyn Hosted>>,
    mailbox: Arc<Mailbox>,
    clock: Arc<dyn Clock>,
    stop: Arc<AtomicBool>,
    digest: RunDigest,
    digested: u64,
    tick_s: f64,
}

/// How a process ended.
#[derive(Clone, Debug)]
pub struct Finished {
    /// Each service with its ending.
    pub endings: Vec<(&'static str, Ending)>,
    /// Each service with its steps, and the seconds from the first to the last.
    pub progress: Vec<(&'static str, u64, f64)>,
    /// Hash of the run, when all four services ran here with their hashes kept.
    pub digest: RunDigest,
    /// Ticks of which all four hashes were there.
    pub ticks: u64,
}

impl Engine {
    /// An engine without hosts; it ends when `stop` is set and its mailbox woken.
    #[must_use]
    pub fn new(mailbox: Arc<Mailbox>, clock: Arc<dyn Clock>, stop: Arc<AtomicBool>, tick_s: f64) -> Self {
        Self { hosts: Vec::new(), mailbox, clock, stop, digest: RunDigest::default(), digested: 0, tick_s }
    }

    /// Adds a host; its number in the mailbox must be its place here.
    pub fn add(&mut self, host: Box<dyn Hosted>) {
        self.hosts.push(host);
    }

    /// Number that the next host gets.
    #[must_use]
    pub fn next_index(&self) -> usize {
        self.hosts.len()
    }

    /// Drives the hosts until all have ended. `look` is called after each round with the ticks that are complete.
    pub fn run(mut self, mut look: impl FnMut(u64)) -> Finished {
        let mut expected = self.clock.now();
        while self.hosts.iter().any(|host| host.ending().is_none()) {
            if self.stop.load(Ordering::Relaxed) {
                self.hosts.iter_mut().for_each(|host| host.interrupt("interrupted"));
                break;
            }
            let round = self.clock.now();
            // What a round and its wait took beyond what was meant is a stall of this process, and nobody's silence.
            let stall = round.saturating_sub(expected);
            if stall > STALL {
                self.hosts.iter_mut().for_each(|host| host.held_up(stall, round));
            }
            let busy = self.round(round);
            look(self.digested);
            expected = round;
            if !busy && self.hosts.iter().any(|host| host.ending().is_none()) {
                let deadline = self.deadline();
                self.mailbox.wait(&*self.clock, deadline);
                // Whoever was woken earlier was woken by an arrival, in time.
                expected = deadline.unwrap_or(round).max(round).min(self.clock.now());
            }
        }
        self.fold();
        let ending = |host: &dyn Hosted| host.ending().cloned().unwrap_or(Ending::Stopped("interrupted".to_owned()));
        let endings = self.hosts.iter().map(|host| (host.service(), ending(&**host))).collect();
        let progress = self.hosts.iter().map(|host| {
            let (steps, time) = host.progress();
            (host.service(), steps, time.as_secs_f64())
        });
        Finished { progress: progress.collect(), endings, digest: self.digest, ticks: self.digested }
    }

    /// Hands what has arrived to the hosts and lets each do what it can at `now`; true when something was done.
    pub fn round(&mut self, now: Duration) -> bool {
        let (mut requests, mut arrivals) = (0, 0);
        while arrivals < ARRIVALS_AT_ONCE {
            arrivals += 1;
            match self.mailbox.pop(requests < REQUESTS_AT_ONCE) {
                None => break,
                Some(Arrival::Wire(host, wire, payload)) => self.hosts[host].deliver(wire, &payload, now),
                Some(Arrival::Request(host, query)) => {
                    requests += 1;
                    self.hosts[host].request(query, now);
                }
            }
        }
        let overflow = self.mailbox.overflow();
        let mut busy = false;
        for host in &mut self.hosts {
            busy |= host.poll(overflow, now);
        }
        self.fold();
        busy
    }

    /// When the next round is due, if nothing arrives.
    #[must_use]
    pub fn deadline(&self) -> Option<Duration> {
        self.hosts.iter().filter_map(|host| host.deadline()).min()
    }

    /// Folds the hashes of ticks that all four services have done.
    fn fold(&mut self) {
        let Ok(hosts) = <&mut [Box<dyn Hosted>; 4]>::try_from(self.hosts.as_mut_slice()) else { return };
        loop {
            let fronts = hosts.each_mut().map(|host| host.digests().front().copied());
            let [Some(p), Some(e), Some(g), Some(c)] = fronts else { return };
            self.digest.fold(Tick { k: p.0, dt_s: self.tick_s }, [p.1, e.1, g.1, c.1]);
            self.digested = p.0 + 1;
            for host in hosts.iter_mut() {
                host.digests().pop_front();
            }
        }
    }
}
