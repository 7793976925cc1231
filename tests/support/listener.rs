//! Who listens to a vehicle in the test's own process, and what it makes of events.

use super::LIMIT;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use supertwin_protocol::{Clock, Received, SystemClock};
use supertwin_zenoh::{Client, Inbox, Link, Session};

/// Listens to one vehicle from beside it.
pub struct Listener {
    pub session: Session,
    pub inbox: Inbox,
    pub clock: Arc<dyn Clock>,
    vehicle: String,
    prefix: String,
}

impl Listener {
    /// A client of the router at `endpoint`.
    pub fn open(endpoint: &str, vehicle: &str) -> Self {
        Self::open_as(None, endpoint, vehicle)
    }

    /// The same, with the credentials in a folder.
    pub fn open_as(credentials: Option<PathBuf>, endpoint: &str, vehicle: &str) -> Self {
        let link = Link {
            credentials,
            mode: Some("client"),
            connect: vec![endpoint.to_owned()],
            patience_ms: 20_000,
            overrides: vec!["connect/retry={period_init_ms:100,period_max_ms:300,period_increase_factor:2}".to_owned()],
            ..Link::default()
        };
        let session = link.open().expect("the router is there");
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
        let inbox = Inbox::new(Arc::clone(&clock));
        Self { session, inbox, clock, vehicle: vehicle.to_owned(), prefix: format!("supertwin/{vehicle}/") }
    }

    /// A client of the vehicle on the same session.
    pub fn client(&self, name: &str) -> Client {
        Client::new(self.session.clone(), &self.vehicle, name, Arc::clone(&self.clock))
    }

    /// Listens to a key of the vehicle.
    pub fn listen(mut self, key: &str) -> Self {
        self.inbox.listen(&self.session, &format!("{}{key}", self.prefix)).expect("may be listened to");
        self
    }

    /// Listens to events, with recovery.
    pub fn events(mut self) -> Self {
        self.inbox.listen_events(&self.session, &format!("{}event/*", self.prefix)).expect("may be listened to");
        self
    }

    /// The next sample: key without the vehicle, and JSON.
    pub fn next(&self) -> (String, Value, Duration) {
        let Received { key, payload, at, .. } =
            self.inbox.next(Some(self.clock.now() + LIMIT)).expect("something is heard");
        let value = serde_json::from_slice(&payload).unwrap_or(Value::Null);
        (key.strip_prefix(&self.prefix).unwrap_or(&key).to_owned(), value, at)
    }

    /// Reads until something has come from now on.
    pub fn fresh(&self) {
        let now = self.clock.now();
        while self.next().2 < now {}
    }

    /// Reads until `wanted` says that this is it.
    pub fn until(&self, what: &str, mut wanted: impl FnMut(&str, &Value) -> bool) -> (Value, Duration) {
        let give_up = self.clock.now() + LIMIT;
        loop {
            let (key, value, at) = self.next();
            if wanted(&key, &value) {
                return (value, at);
            }
            assert!(self.clock.now() < give_up, "waited in vain for {what}");
        }
    }

    /// The same of the samples on one key.
    pub fn until_on(&self, key: &str, what: &str, mut wanted: impl FnMut(&Value) -> bool) -> (Value, Duration) {
        self.until(what, |heard, value| heard == key && wanted(value))
    }

    /// Reads until the controller says this status in its telemetry.
    pub fn until_status(&self, wanted: &str) {
        let is_it = |value: &Value| value["data"]["signals"]["controller/status"] == wanted;
        self.until_on("telemetry/controller", &format!("the controller's status {wanted}"), is_it);
    }

    /// Enters events until there are as many of each of these services as it says of itself from now on. Health must be
    /// listened to as well.
    pub fn complete(&self, events: &mut Events, services: &[&str]) {
        let (began, give_up) = (self.clock.now(), self.clock.now() + LIMIT);
        let mut told: BTreeMap<String, usize> = BTreeMap::new();
        let all = |events: &Events, told: &BTreeMap<String, usize>, service: &str| {
            told.iter().any(|(source, sent)| {
                let heard = events.numbers.get(source).map_or(0, Vec::len);
                source.starts_with(&format!("{service}-")) && heard >= *sent
            })
        };
        while !services.iter().all(|service| all(events, &told, service)) {
            assert!(self.clock.now() < give_up, "{told:?} were sent, and these were heard: {:?}", events.numbers);
            let (key, value, at) = self.next();
            events.enter(&key, &value);
            if key.starts_with("health/") && at >= began {
                let source = value["source"].as_str().expect("a source").to_owned();
                told.insert(source, value["events"].as_u64().expect("a count") as usize);
            }
        }
        events.are_complete(services);
    }
}

/// Events that were heard, here or by a process.
#[derive(Clone, Debug, Default)]
pub struct Events {
    /// Their numbers, by source.
    pub numbers: BTreeMap<String, Vec<u64>>,
    /// What they say, as `service: text`.
    pub texts: Vec<String>,
    /// The controller's states, one after the other.
    states: Vec<String>,
}

impl Events {
    /// Enters what was heard on `key`, full or without the vehicle, if it is an event; what it says.
    pub fn enter(&mut self, key: &str, value: &Value) -> Option<&str> {
        let (_, service) = key.rsplit_once("event/")?;
        let source = value["source"].as_str().expect("a source");
        self.numbers.entry(source.to_owned()).or_default().push(value["seq"].as_u64().expect("a number"));
        self.texts.push(format!("{service}: {}", value["data"]["text"].as_str().expect("a text")));
        let what = &value["data"]["what"];
        if service == "controller" && what["kind"] == "state_changed" {
            self.states.extend(what["to"].as_str().map(str::to_owned));
        }
        self.texts.last().map(String::as_str)
    }

    /// How often the controller was no longer tracking, and then was again. With guidance alone silent it falls back; with
    /// the estimator silent as well its navigation is stale, at once or after a tick of falling back.
    pub fn outages(&self) -> usize {
        let known = self.states.iter().filter(|state| ["tracking", "fallback", "nav_stale"].contains(&state.as_str()));
        let tracking: Vec<bool> = known.map(|state| state == "tracking").skip_while(|tracking| !tracking).collect();
        tracking.windows(2).filter(|pair| !pair[0] && pair[1]).count()
    }

    /// Every event of each of these services, each once and in order, from the first.
    pub fn are_complete(&self, services: &[&str]) {
        for (source, numbers) in &self.numbers {
            assert!(numbers.iter().copied().eq(1..=numbers.len() as u64), "events of {source}: {numbers:?}");
        }
        for service in services {
            assert!(self.numbers.keys().any(|source| source.starts_with(&format!("{service}-"))), "none of {service}");
        }
    }
}
