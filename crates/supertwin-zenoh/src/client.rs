//! The other side of commands: a client with authority, retries and acknowledgements.

use crate::session::{LinkError, unique};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use supertwin_protocol::clock::Clock;
use supertwin_protocol::command_queue::{Answer, Request};
use supertwin_protocol::keys;
use supertwin_protocol::lease::{LeaseAction, LeaseReply, LeaseRequest};
use supertwin_protocol::payload::StreamedSetpoint;
use zenoh::bytes::Encoding;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{SampleKind, SourceInfo};
use zenoh::{Session, Wait};

/// How long one attempt waits for its acknowledgement.
const ATTEMPT: Duration = Duration::from_millis(500);
/// Attempts before a request counts as undelivered.
const ATTEMPTS: u32 = 6;

/// A request that was not obeyed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The service said no.
    #[error("refused: {0}")]
    Refused(String),
    /// Nobody answered within the time allowed.
    #[error("no answer from {key}: is the service up, and may you reach it?")]
    NoAnswer {
        /// Where the question went.
        key: String,
    },
    /// The answer is none.
    #[error("{key} answered with something else: {cause}")]
    Strange {
        /// Where the question went.
        key: String,
        /// Why the answer could not be read.
        cause: String,
    },
    /// The session failed.
    #[error(transparent)]
    Link(#[from] LinkError),
}

/// A client of one vehicle. Its session has no namespace.
pub struct Client {
    session: Session,
    vehicle: String,
    /// Name that this client gives with its requests.
    pub name: String,
    token: String,
    /// Number of the last request; services tell whose command they applied by name and number.
    pub seq: u64,
    clock: Arc<dyn Clock>,
}

impl Client {
    /// A client called `name`, unique among clients, of `vehicle`.
    #[must_use]
    pub fn new(session: Session, vehicle: &str, name: &str, clock: Arc<dyn Clock>) -> Self {
        Self { session, vehicle: vehicle.to_owned(), name: name.to_owned(), token: String::new(), seq: 0, clock }
    }

    /// The full key of one relative to the vehicle.
    #[must_use]
    pub fn key(&self, relative: &str) -> String {
        format!("{}/{relative}", keys::namespace(&self.vehicle))
    }

    /// Takes the authority for `for_s` seconds.
    ///
    /// # Errors
    /// When somebody else holds it, or nobody answers.
    pub fn acquire(&mut self, for_s: f64) -> Result<LeaseReply, ClientError> {
        if self.token.is_empty() {
            self.token = unique() + &unique();
        }
        let reply = self.lease(LeaseAction::Acquire, for_s)?;
        if let Some(token) = &reply.token {
            self.token.clone_from(token);
        }
        Ok(reply)
    }

    /// Keeps, gives back, or asks for the authority.
    ///
    /// # Errors
    /// When it is refused, or nobody answers.
    pub fn lease(&mut self, action: LeaseAction, for_s: f64) -> Result<LeaseReply, ClientError> {
        let request = LeaseRequest { client: self.name.clone(), action, for_s, token: self.token.clone() };
        let key = self.key(keys::LEASE);
        let value = self.ask(&key, Some(&request))?;
        serde_json::from_value(value).map_err(|error| ClientError::Strange { key, cause: error.to_string() })
    }

    /// Sends a command; returns the tick at which it applies. Repetitions carry the same number, so that a command
    /// is obeyed once however often it had to be sent.
    ///
    /// # Errors
    /// When it is refused, or nobody answers.
    pub fn command(
        &mut self,
        service: &str,
        name: &str,
        value: Value,
        at_tick: Option<u64>,
    ) -> Result<u64, ClientError> {
        self.request(&keys::command(service, name), value, at_tick)
    }

    /// Changes a parameter; returns the tick at which it applies.
    ///
    /// # Errors
    /// When it is refused, or nobody answers.
    pub fn set_parameter(
        &mut self,
        service: &str,
        path: &str,
        value: Value,
        at_tick: Option<u64>,
    ) -> Result<u64, ClientError> {
        self.request(&keys::param(service, path), value, at_tick)
    }

    fn request(&mut self, relative: &str, value: Value, at_tick: Option<u64>) -> Result<u64, ClientError> {
        self.seq += 1;
        let request = Request { client: self.name.clone(), seq: self.seq, token: self.token.clone(), value, at_tick };
        let key = self.key(relative);
        let answer = self.ask(&key, Some(&request))?;
        match serde_json::from_value(answer) {
            Ok(Answer::Scheduled { apply_tick, .. }) => Ok(apply_tick),
            Ok(Answer::Refused { reason, .. }) => Err(ClientError::Refused(reason)),
            Err(error) => Err(ClientError::Strange { key, cause: error.to_string() }),
        }
    }

    /// One sample of a stream of set-points. Who stops sending has let go of the joystick; `None` ends the stream and
    /// keeps the last value.
    ///
    /// # Errors
    /// When the session fails; whether the sample arrives, only its effect tells.
    pub fn stream(&mut self, name: &str, value: Option<f64>) -> Result<(), ClientError> {
        self.seq += 1;
        let sample = StreamedSetpoint { client: self.name.clone(), token: self.token.clone(), seq: self.seq, value };
        let key = self.key(&keys::setpoint(name));
        let payload = serde_json::to_vec(&sample)
            .map_err(|error| ClientError::Strange { key: key.clone(), cause: error.to_string() })?;
        let put = self.session.put(key.clone(), payload).encoding(Encoding::APPLICATION_JSON);
        put.congestion_control(CongestionControl::Drop)
            .priority(Priority::InteractiveHigh)
            .express(true)
            .wait()
            .map_err(|error| LinkError::session(key)(error).into())
    }

    /// A parameter, or a branch of the tree.
    ///
    /// # Errors
    /// When there is none, or nobody answers.
    pub fn parameter(&self, service: &str, path: &str) -> Result<Value, ClientError> {
        self.ask(&self.key(&keys::param(service, path)), None::<&()>)
    }

    /// Asks and waits for one answer, several times if need be.
    ///
    /// # Errors
    /// When it is refused, or nobody answers.
    pub fn ask(&self, key: &str, body: Option<&impl Serialize>) -> Result<Value, ClientError> {
        let strange = |cause: String| ClientError::Strange { key: key.to_owned(), cause };
        let body = body.map(serde_json::to_vec).transpose().map_err(|error| strange(error.to_string()))?;
        for attempt in 0..ATTEMPTS {
            let began = self.clock.now();
            let mut query = self
                .session
                .get(key)
                .target(QueryTarget::BestMatching)
                .consolidation(ConsolidationMode::None)
                .congestion_control(CongestionControl::Block)
                .priority(Priority::InteractiveHigh)
                .express(true)
                // Whom to look for in the router's log.
                .source_info(SourceInfo::new(self.session.id(), attempt))
                .timeout(ATTEMPT);
            if let Some(body) = &body {
                query = query.payload(body.clone()).encoding(Encoding::APPLICATION_JSON);
            }
            let replies = query.wait().map_err(LinkError::session(key))?;
            while let Ok(reply) = replies.recv() {
                match reply.into_result() {
                    Ok(sample) => {
                        return serde_json::from_slice(&sample.payload().to_bytes())
                            .map_err(|error| strange(error.to_string()));
                    }
                    Err(error) => {
                        let text = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
                        if text != "Timeout" {
                            let value: Value = serde_json::from_str(&text).unwrap_or(Value::String(text));
                            let reason = value["reason"].as_str().map_or_else(|| value.to_string(), str::to_owned);
                            return Err(ClientError::Refused(reason));
                        }
                    }
                }
            }
            // Zero replies come at once: nobody is there yet. Wait until somebody is, or for a while.
            if attempt + 1 < ATTEMPTS {
                self.wait_for_somebody(key, began + ATTEMPT)?;
            }
        }
        Err(ClientError::NoAnswer { key: key.to_owned() })
    }

    /// Until a queryable for `key` is known, or `deadline`.
    fn wait_for_somebody(&self, key: &str, deadline: Duration) -> Result<(), ClientError> {
        let querier = self.session.declare_querier(key.to_owned()).wait().map_err(LinkError::session(key))?;
        let listener = querier.matching_listener().wait().map_err(LinkError::session(key))?;
        let already = querier.matching_status().wait().is_ok_and(|status| status.matching());
        loop {
            let left = deadline.saturating_sub(self.clock.now());
            // Somebody matched and still did not answer: the whole wait, to be gentle.
            match listener.recv_timeout(left) {
                Ok(Some(status)) if status.matching() && !already => return Ok(()),
                Ok(Some(_)) => {}
                Ok(None) | Err(_) => return Ok(()),
            }
        }
    }
}

/// Vehicles and services that are up, as `(vehicle, service, instance)`, sorted.
///
/// # Errors
/// When the session fails.
pub fn alive(session: &Session) -> Result<Vec<(String, String, String)>, LinkError> {
    let key = "supertwin/*/alive/**";
    let replies = session.liveliness().get(key).timeout(ATTEMPT).wait().map_err(LinkError::session("liveliness"))?;
    let found: BTreeSet<(String, String, String)> = replies
        .into_iter()
        .filter_map(|reply| reply.into_result().ok())
        .filter(|sample| sample.kind() == SampleKind::Put)
        .filter_map(|sample| {
            let mut parts = sample.key_expr().as_str().split('/').skip(1);
            let vehicle = parts.next()?.to_owned();
            let service = parts.nth(1)?.to_owned();
            Some((vehicle, service, parts.next().unwrap_or("").to_owned()))
        })
        .collect();
    Ok(found.into_iter().collect())
}
