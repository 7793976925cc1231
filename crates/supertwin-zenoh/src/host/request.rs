//! What is asked: commands, parameters, authority, time, and what a newcomer needs to know.

use super::Host;
use crate::outbox::Outgoing;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use supertwin_core::event::{CommandSource, EventCommand};
use supertwin_core::{EventKind, Severity, Wired};
use supertwin_protocol::command_queue::{Answer, MAX_REQUEST, Request, RequestTime};
use supertwin_protocol::keys;
use supertwin_protocol::lease::{LeaseAction, LeaseReply, LeaseRequest};
use supertwin_protocol::payload::{Now, Pong};
use zenoh::query::Query;

impl<B: Wired + 'static> Host<B> {
    pub(super) fn answer(&mut self, query: Query) {
        let key = query.key_expr().as_str().to_owned();
        let payload = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
        let mut parts = key.splitn(3, '/');
        let (kind, _, name) = (parts.next().unwrap_or(""), parts.next(), parts.next().unwrap_or(""));
        let session = sender(&query);
        let answer = match kind {
            "command" => self.command(name, &payload, session),
            "param" if payload.is_empty() => self.parameter(&name.replace('/', ".")),
            "param" => self.set_parameter(&name.replace('/', "."), &payload, session),
            "authority" => self.authority(&payload, session),
            "clock" => Ok(json!(Pong { received_ns: self.clock.unix_ns() })),
            "state" if name == "now" => {
                Ok(json!(Now { run: self.run.clone(), source: self.source.clone(), next: self.next }))
            }
            "state" => {
                let wire = name.strip_prefix("held/").unwrap_or(name);
                return self.answer_held(query, wire);
            }
            _ => Err(json!({ "status": "refused", "reason": format!("{key}: no such request") })),
        };
        let bytes = |value: Value| value.to_string().into_bytes();
        let own_key = (kind == "state").then(|| keys::state(B::NAME, name));
        self.outbox.send(Outgoing::Answer(query, own_key, answer.map(bytes).map_err(bytes)));
    }

    pub(super) fn answer_held(&self, query: Query, wire: &str) {
        let i = self.ports.states().position(|port| port.key == wire);
        match i.and_then(|i| self.wires[i].held.as_ref()) {
            Some(payload) => {
                // The key must be ours, not the question's pattern.
                let key = Some(keys::held(B::NAME, wire));
                self.outbox.send(Outgoing::Answer(query, key, Ok(payload.to_bytes().into_owned())));
            }
            None => drop(query),
        }
    }

    pub(super) fn request_time(&self) -> RequestTime {
        RequestTime { now: self.now, next: self.next, tick_s: self.options.tick_s, lead: self.options.lead_ticks }
    }

    pub(super) fn command(&mut self, name: &str, payload: &[u8], session: Option<String>) -> Result<Value, Value> {
        let time = self.request_time();
        let tick = self.tick(self.next);
        let (block, lease) =
            (&self.block, self.operator.authority.as_ref().map_or(&self.operator.lease, |authority| &authority.view));
        let before = self.commands.counts;
        let answer = self.commands.submit(name, payload, lease, time, |command| block.clone().command(tick, command));
        let after = self.commands.counts;
        let value = serde_json::to_value(&answer).unwrap_or(Value::Null);
        match answer {
            Answer::Scheduled { apply_tick, .. } => {
                if after.scheduled > before.scheduled {
                    let command = told::<B>(name, payload);
                    self.note(Severity::Info, EventKind::CommandScheduled { command, apply_tick, session });
                }
                Ok(value)
            }
            Answer::Refused { reason, .. } => {
                let command = told::<B>(name, payload);
                self.refused(&reason, |reason, so_far| EventKind::CommandRefused {
                    command,
                    session,
                    reason,
                    so_far: Some(so_far),
                });
                Err(value)
            }
        }
    }

    pub(super) fn set_parameter(
        &mut self,
        path: &str,
        payload: &[u8],
        session: Option<String>,
    ) -> Result<Value, Value> {
        let inner = read::<Request>(payload).map(|mut request| {
            request.value = json!({ "path": path, "value": request.value });
            serde_json::to_vec(&request).unwrap_or_default()
        });
        // What is no request is refused by the command queue, in its own words.
        self.command("parameter", &inner.unwrap_or_else(|| payload.to_vec()), session)
    }

    pub(super) fn parameter(&self, path: &str) -> Result<Value, Value> {
        let names = path.split('.').filter(|name| !name.is_empty());
        let pointer: String = names.map(|name| format!("/{name}")).collect();
        let reason = || json!({ "status": "refused", "reason": format!("{} has no parameter {path}", B::NAME) });
        self.block.parameters().pointer(&pointer).cloned().ok_or_else(reason)
    }

    pub(super) fn authority(&mut self, payload: &[u8], session: Option<String>) -> Result<Value, Value> {
        let now = self.now;
        let Some(authority) = &mut self.operator.authority else {
            return Err(json!({ "reason": "this service does not keep the authority" }));
        };
        let read = if payload.len() > MAX_REQUEST {
            Err(format!("{} bytes: must be at most {MAX_REQUEST}", payload.len()))
        } else {
            serde_json::from_slice(payload).map_err(|error| error.to_string())
        };
        let request: LeaseRequest = match read {
            Ok(request) => request,
            Err(error) => {
                self.refused(&error, |reason, so_far| EventKind::LeaseRefused {
                    client: None,
                    session,
                    reason,
                    so_far,
                });
                return Err(json!({ "reason": format!("authority/lease: {error}") }));
            }
        };
        let token = zenoh::session::ZenohId::default().to_string() + &zenoh::session::ZenohId::default().to_string();
        let (reply, changed) = authority.answer(&request, &token, now);
        if changed {
            // Before the answer and with a higher priority: who is granted may command at once.
            self.tell_lease();
        }
        self.lease_event(request, &reply, session);
        let value = serde_json::to_value(&reply).unwrap_or(Value::Null);
        if reply.reason.is_some() { Err(value) } else { Ok(value) }
    }

    pub(super) fn lease_event(&mut self, request: LeaseRequest, reply: &LeaseReply, session: Option<String>) {
        match (request.action, &reply.reason) {
            (LeaseAction::Acquire, None) if reply.token.is_some() => {
                let LeaseRequest { client, for_s, .. } = request;
                self.note(Severity::Info, EventKind::LeaseTaken { client, for_s, session });
            }
            (LeaseAction::Release, None) => {
                self.note(Severity::Info, EventKind::LeaseReturned { client: request.client, session });
            }
            (_, Some(reason)) => self.refused(reason, |reason, so_far| EventKind::LeaseRefused {
                client: Some(request.client),
                session,
                reason,
                so_far,
            }),
            _ => {}
        }
    }
}

/// Which session a request names as its own, if it does. Only a router knows whose it really is: its log ties sessions to
/// certificates.
fn sender(query: &Query) -> Option<String> {
    query.source_info().map(|info| info.source_id().zid().to_string())
}

/// What a client has sent, if it is not too long and can be read.
pub(super) fn read<T: DeserializeOwned>(payload: &[u8]) -> Option<T> {
    (payload.len() <= MAX_REQUEST).then(|| serde_json::from_slice(payload).ok()).flatten()
}

/// A request for the command `name`, as events tell of it.
fn told<B: Wired>(name: &str, payload: &[u8]) -> EventCommand {
    // A token is a secret, also in a log, and also in a request that is wrong: nothing of that one is quoted.
    let (value, by) = read::<Request>(payload).map_or((Value::Null, None), |request| {
        (request.value, Some(CommandSource { client: request.client, seq: Some(request.seq) }))
    });
    EventCommand { service: B::NAME.into(), name: name.to_owned(), value, by }
}
