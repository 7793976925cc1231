//! What is alive and what flows on the network: vehicles, keys, rates, and how services are.

use crate::network::NetworkClient;
use crate::{OperationError, Progress};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;
use supertwin_protocol::Received;
use supertwin_protocol::ledger::{Counts, Ledger};
use supertwin_zenoh::client;

/// What of a payload says who sent it, and as which; the rest is not read.
#[derive(Debug, Deserialize)]
struct Stamp {
    source: String,
    #[serde(default)]
    seq: Option<u64>,
}

/// What was received of one key.
#[derive(Default)]
struct Flow {
    first: Duration,
    last: Duration,
    messages: u64,
    bytes: u64,
    squares_s2: f64,
    longest: Duration,
    writers: BTreeSet<String>,
    /// Of messages with numbers.
    ledger: Option<Ledger>,
}

impl Flow {
    fn enter(&mut self, message: &Received) {
        if self.messages == 0 {
            self.first = message.at;
        } else {
            let interval = message.at.saturating_sub(self.last);
            self.longest = self.longest.max(interval);
            self.squares_s2 += interval.as_secs_f64() * interval.as_secs_f64();
        }
        self.last = message.at;
        self.messages += 1;
        self.bytes += message.payload.len() as u64;
        if let Ok(stamp) = serde_json::from_slice::<Stamp>(&message.payload) {
            if let Some(seq) = stamp.seq {
                // A second writer that is heard within a second of the first is another, not its successor.
                let ledger = self.ledger.get_or_insert_with(|| Ledger::new(Duration::from_secs(1)));
                ledger.enter(&stamp.source, seq, message.at);
            }
            self.writers.insert(stamp.source);
        }
    }

    fn intervals(&self) -> f64 {
        self.messages.saturating_sub(1) as f64
    }

    fn rate_hz(&self) -> Option<f64> {
        let span_s = (self.last - self.first).as_secs_f64();
        (span_s > 0.0).then(|| self.intervals() / span_s)
    }

    /// Standard deviation of the intervals.
    fn jitter_ms(&self) -> Option<f64> {
        let mean_s = 1.0 / self.rate_hz()?;
        Some((self.squares_s2 / self.intervals() - mean_s * mean_s).max(0.0).sqrt() * 1e3)
    }

    fn counts(&self) -> Option<Counts> {
        self.ledger.as_ref().map(|ledger| ledger.counts)
    }
}

/// Listens until `for_s` seconds have passed or it is interrupted: what was heard, by key.
fn listen(network: &NetworkClient, for_s: f64, stage: &str, progress: &dyn Progress) -> BTreeMap<String, Flow> {
    let mut flows: BTreeMap<String, Flow> = BTreeMap::new();
    progress.begin(stage, (for_s * 10.0).ceil() as u64);
    let began = network.clock.now();
    let end = network.after(for_s);
    while network.clock.now() < end && !network.stop.interrupted() {
        let slice = (network.clock.now() + Duration::from_millis(100)).min(end);
        while let Some(message) = network.inbox.next(Some(slice)) {
            flows.entry(message.key.clone()).or_default().enter(&message);
            if network.clock.now() >= slice {
                break;
            }
        }
        progress.reach((network.clock.now().saturating_sub(began).as_secs_f64() * 10.0) as u64);
    }
    progress.end();
    flows
}

/// A service that is up.
#[derive(Clone, Debug, Serialize)]
pub struct ListedService {
    /// Name of the service in the ring.
    pub service: String,
    /// Tells it from another of the same name.
    pub instance: String,
}

/// A key that flows.
#[derive(Clone, Debug, Serialize)]
pub struct ListedKey {
    /// Below the vehicle's.
    pub key: String,
    /// Whoever wrote it.
    pub writers: BTreeSet<String>,
    /// Messages that were heard.
    pub messages: u64,
    /// Of their payloads.
    pub bytes: u64,
}

/// A vehicle that is up, or whose keys flow.
#[derive(Clone, Debug, Serialize)]
pub struct ListedVehicle {
    /// Name of the vehicle on the network.
    pub vehicle: String,
    /// Services that are up.
    pub services: Vec<ListedService>,
    /// Clients that hold the authority, or want it.
    pub operators: Vec<String>,
    /// Keys that were heard.
    pub keys: Vec<ListedKey>,
}

/// Vehicles, services and keys, after listening for `for_s` seconds; of one vehicle, or of all.
///
/// # Errors
/// The network can't be asked.
pub fn list(
    network: &mut NetworkClient,
    only: Option<&str>,
    for_s: f64,
    progress: &dyn Progress,
) -> Result<Vec<ListedVehicle>, OperationError> {
    network.inbox.listen(&network.session, &format!("supertwin/{}/**", only.unwrap_or("*")))?;
    let flows = listen(network, for_s, "listening for keys", progress);
    let mut alive = client::alive(&network.session)?;
    alive.retain(|(vehicle, ..)| only.is_none_or(|only| only == vehicle));
    let vehicle_of = |key: &str| key.split('/').nth(1).unwrap_or("").to_owned();
    let mut vehicles: BTreeSet<String> = alive.iter().map(|(vehicle, ..)| vehicle.clone()).collect();
    vehicles.extend(flows.keys().map(|key| vehicle_of(key)));
    let listed = vehicles.into_iter().map(|vehicle| {
        let (operators, services): (Vec<_>, Vec<_>) =
            alive.iter().filter(|(other, ..)| *other == vehicle).partition(|(_, service, _)| service == "operator");
        let service = |(_, service, instance): &(_, String, String)| ListedService {
            service: service.clone(),
            instance: instance.clone(),
        };
        let keys = flows.iter().filter(|(key, _)| vehicle_of(key) == vehicle).map(|(key, flow)| ListedKey {
            key: key.splitn(3, '/').nth(2).unwrap_or(key).to_owned(),
            writers: flow.writers.clone(),
            messages: flow.messages,
            bytes: flow.bytes,
        });
        ListedVehicle {
            services: services.into_iter().map(service).collect(),
            operators: operators.into_iter().map(|(_, _, client)| client.clone()).collect(),
            keys: keys.collect(),
            vehicle,
        }
    });
    Ok(listed.collect())
}

/// One key in the answer of `hz`.
#[derive(Clone, Debug, Serialize)]
pub struct KeyRate {
    /// The full key.
    pub key: String,
    /// Whoever wrote it.
    pub writers: BTreeSet<String>,
    /// Messages that were heard.
    pub messages: u64,
    /// From the first to the last.
    pub rate_hz: Option<f64>,
    /// Standard deviation of the intervals.
    pub jitter_ms: Option<f64>,
    /// Longest time between two messages.
    pub longest_gap_ms: f64,
    /// Bytes of payloads, without headers of the transport.
    pub bytes_per_s: f64,
    /// By the numbers of the messages; `None`: they have none.
    pub missing: Option<u64>,
    /// Messages that came twice.
    pub duplicates: Option<u64>,
    /// Messages of a second writer.
    pub rivals: Option<u64>,
}

/// What `rates` has found.
#[derive(Clone, Debug)]
pub struct Rates {
    /// Seconds that it listened.
    pub for_s: f64,
    /// A line for each key.
    pub keys: Vec<KeyRate>,
    /// Samples that came faster than they could be counted.
    pub lost: u64,
}

/// Listens to `key` for `for_s` seconds: rate, jitter, bytes and gaps of each key that it means.
///
/// # Errors
/// The key can't be subscribed to, or nothing was heard.
pub fn rates(
    network: &mut NetworkClient,
    key: &str,
    for_s: f64,
    progress: &dyn Progress,
) -> Result<Rates, OperationError> {
    network.inbox.listen(&network.session, key)?;
    let began = network.clock.now();
    let flows = listen(network, for_s, &format!("listening to {key}"), progress);
    let listened_s = network.clock.now().saturating_sub(began).as_secs_f64();
    if flows.is_empty() && !network.stop.interrupted() {
        return Err(nothing_received(key, for_s));
    }
    let rate = |(key, flow): (String, Flow)| KeyRate {
        key,
        messages: flow.messages,
        rate_hz: flow.rate_hz(),
        jitter_ms: flow.jitter_ms(),
        longest_gap_ms: flow.longest.as_secs_f64() * 1e3,
        bytes_per_s: flow.bytes as f64 / listened_s,
        missing: flow.counts().map(|counts| counts.missing),
        duplicates: flow.counts().map(|counts| counts.duplicates),
        rivals: flow.counts().map(|counts| counts.rivals),
        writers: flow.writers,
    };
    Ok(Rates { for_s: listened_s, keys: flows.into_iter().map(rate).collect(), lost: network.inbox.lost() })
}

/// Begins to listen to `key` in the network's inbox. Of events, those that have happened are returned; they are waited
/// for until `end` at most.
///
/// # Errors
/// The key can't be subscribed to.
pub fn listen_with_history(
    network: &mut NetworkClient,
    key: &str,
    end: Option<Duration>,
) -> Result<VecDeque<Received>, OperationError> {
    // Only listeners of events and nothing else ask for the past: a pattern such as ** would fetch it in the middle
    // of everything else.
    if key.split('/').nth(2) == Some("event") {
        network.inbox.listen_events(&network.session, key)?;
        return Ok(history(network, end));
    }
    network.inbox.listen(&network.session, key)?;
    Ok(VecDeque::new())
}

/// Past events arrive service by service: waits for all of them and puts them in the order in which they happened.
fn history(network: &NetworkClient, end: Option<Duration>) -> VecDeque<Received> {
    let last = network.after(1.0).min(end.unwrap_or(Duration::MAX));
    let mut past = Vec::new();
    while let Some(message) =
        network.inbox.next(Some(network.after(if past.is_empty() { 1.0 } else { 0.15 }).min(last)))
    {
        past.push(message);
    }
    past.sort_by_key(|message| {
        serde_json::from_slice::<Value>(&message.payload).ok().and_then(|value| value["clock_ns"].as_u64())
    });
    past.into()
}

/// Nobody has published on `key` for `for_s` seconds.
#[must_use]
pub fn nothing_received(key: &str, for_s: f64) -> OperationError {
    OperationError::Unmet(format!("{key}: nothing was heard in {for_s} s; `supertwin list` shows the keys that flow"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(at_ms: u64, payload: &str) -> Received {
        Received { payload: payload.into(), at: Duration::from_millis(at_ms), ..Received::default() }
    }

    #[test]
    fn a_flow_counts_rate_jitter_and_gaps() {
        let mut flow = Flow::default();
        for (at_ms, seq) in [(0, 1), (20, 2), (40, 3), (60, 3), (100, 6)] {
            flow.enter(&message(at_ms, &format!(r#"{{"source":"estimator-1","seq":{seq},"tick":0,"data":{{}}}}"#)));
        }
        assert_eq!(flow.rate_hz(), Some(40.0));
        let jitter_ms = flow.jitter_ms().expect("several");
        assert!((jitter_ms - 75.0_f64.sqrt()).abs() < 1e-9, "{jitter_ms}");
        assert_eq!(flow.longest, Duration::from_millis(40));
        let counts = flow.counts().expect("numbered");
        assert_eq!((counts.missing, counts.duplicates), (2, 1));
        let mut single = Flow::default();
        single.enter(&message(5, "not JSON"));
        assert_eq!((single.rate_hz(), single.jitter_ms(), single.counts()), (None, None, None));
    }
}
