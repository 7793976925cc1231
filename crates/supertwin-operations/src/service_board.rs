//! How the services of a vehicle are, from what they say once a second.

use crate::OperationError;
use crate::network::NetworkClient;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Duration;
use supertwin_protocol::{Health, Received, keys};

/// Health comes once a second; a rate needs two.
const FIRST_WAIT_S: f64 = 3.0;
/// Without health for this long a service that is alive counts as silent.
const SILENT: Duration = Duration::from_millis(2500);

/// What is known of one instance of a service.
#[derive(Debug, Default)]
struct ServiceState {
    alive: bool,
    gone_at: Option<Duration>,
    received_at: Option<Duration>,
    health: Option<Health>,
    rate_hz: Option<f64>,
}

/// How one instance of a service is.
#[derive(Debug, Serialize)]
pub struct ServiceLine<'a> {
    /// Name of the service in the ring.
    pub service: &'a str,
    /// Tells it from another of the same name.
    pub instance: &'a str,
    /// `up`, `silent` or `gone`.
    pub status: &'static str,
    /// Seconds since it was heard; of one that is gone, since it went.
    pub silent_s: Option<f64>,
    /// Ticks per second.
    pub rate_hz: Option<f64>,
    /// What it said last.
    pub health: Option<&'a Health>,
}

impl ServiceState {
    fn enter(&mut self, health: Health, at: Duration) {
        if let Some(before) = &self.health
            && before.run == health.run
            && health.clock_ns > before.clock_ns
        {
            // By the sender's own clock: the way here may vary.
            let passed_s = (health.clock_ns - before.clock_ns) as f64 / 1e9;
            self.rate_hz = Some(health.tick.saturating_sub(before.tick) as f64 / passed_s);
        }
        (self.health, self.received_at) = (Some(health), Some(at));
    }

    fn status(&self, now: Duration) -> &'static str {
        let silent = self.received_at.is_none_or(|at| now.saturating_sub(at) > SILENT);
        match (self.alive, silent) {
            (false, _) => "gone",
            (true, true) => "silent",
            (true, false) => "up",
        }
    }

    fn line<'a>(&'a self, service: &'a str, instance: &'a str, now: Duration) -> ServiceLine<'a> {
        let since = if self.alive { self.received_at } else { self.gone_at };
        ServiceLine {
            service,
            instance,
            status: self.status(now),
            silent_s: since.map(|at| now.saturating_sub(at).as_secs_f64()),
            rate_hz: self.rate_hz,
            health: self.health.as_ref(),
        }
    }
}

/// The services of one vehicle by name and instance.
#[derive(Debug, Default)]
pub struct ServiceBoard(BTreeMap<(String, String), ServiceState>);

impl ServiceBoard {
    /// Listens to the services of `vehicle` until everybody who is up has said enough for a rate, or for three seconds.
    ///
    /// # Errors
    /// The keys can't be subscribed to, or no service is up.
    pub fn open(network: &mut NetworkClient, vehicle: &str) -> Result<Self, OperationError> {
        let prefix = keys::namespace(vehicle);
        network.inbox.listen(&network.session, &format!("{prefix}/{}", keys::health("*")))?;
        network.inbox.listen_alive(&network.session, &format!("{prefix}/{}", keys::alive("*", "*")))?;
        let mut board = Self::default();
        let first = network.after(FIRST_WAIT_S);
        while !board.is_complete()
            && let Some(message) = network.inbox.next(Some(first))
        {
            board.enter(&message);
        }
        if board.0.is_empty() && !network.stop.interrupted() {
            let text = format!("{vehicle}: no service is up; start them with `supertwin up`");
            return Err(OperationError::Unmet(text));
        }
        Ok(board)
    }

    /// Takes in what is heard for `s` seconds, or until it is interrupted.
    pub fn listen(&mut self, network: &NetworkClient, s: f64) {
        let end = network.after(s);
        while let Some(message) = network.inbox.next(Some(end)) {
            self.enter(&message);
        }
    }

    /// How everybody is at `now`, by name and instance.
    #[must_use]
    pub fn lines(&self, now: Duration) -> Vec<ServiceLine<'_>> {
        self.0.iter().map(|((service, instance), state)| state.line(service, instance, now)).collect()
    }

    fn row(&mut self, service: &str, instance: &str) -> &mut ServiceState {
        self.0.entry((service.to_owned(), instance.to_owned())).or_default()
    }

    fn enter(&mut self, message: &Received) {
        let mut parts = message.key.split('/').skip(2);
        match (parts.next(), parts.next(), parts.next()) {
            (Some("alive"), Some(service), Some(instance)) if service != "operator" => {
                let row = self.row(service, instance);
                row.alive = !message.gone;
                row.gone_at = message.gone.then_some(message.at);
            }
            (Some("health"), Some(service), _) => {
                if let Ok(health) = serde_json::from_slice::<Health>(&message.payload)
                    && let Some(instance) = health.source.strip_prefix(service).and_then(|rest| rest.strip_prefix('-'))
                {
                    let instance = instance.to_owned();
                    self.row(service, &instance).enter(health, message.at);
                }
            }
            _ => {}
        }
    }

    /// Everybody who is alive has said enough for a rate.
    fn is_complete(&self) -> bool {
        !self.0.is_empty() && self.0.values().all(|row| !row.alive || row.rate_hz.is_some())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(key: &str, payload: Vec<u8>, gone: bool) -> Received {
        Received { key: key.to_owned(), payload, gone, at: Duration::from_secs(1) }
    }

    #[test]
    fn a_service_comes_speaks_and_goes() {
        let mut board = ServiceBoard::default();
        let alive = "supertwin/a/alive/plant/1";
        board.enter(&message(alive, Vec::new(), false));
        board.enter(&message("supertwin/a/alive/operator/anna", Vec::new(), false));
        assert!(!board.is_complete());
        for (tick, clock_ns) in [(100, 1_000_000_000), (150, 2_000_000_000)] {
            let health =
                Health { run: "r".to_owned(), source: "plant-1".to_owned(), tick, clock_ns, ..Health::default() };
            let payload = serde_json::to_vec(&health).expect("JSON");
            board.enter(&message("supertwin/a/health/plant", payload, false));
        }
        assert!(board.is_complete() && board.0.len() == 1);
        let line = |board: &ServiceBoard| {
            let lines = board.lines(Duration::from_secs(2));
            let tick = lines[0].health.map(|health| health.tick);
            (lines[0].status, lines[0].silent_s, lines[0].rate_hz, tick)
        };
        assert_eq!(line(&board), ("up", Some(1.0), Some(50.0), Some(150)));
        board.enter(&message(alive, Vec::new(), true));
        assert_eq!(line(&board), ("gone", Some(1.0), Some(50.0), Some(150)));
    }
}
