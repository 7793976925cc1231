//! What a vehicle says, message by message: read, counted, and put where it waits for its tick.

use super::super::lap_assembler::{Entered, ServiceTelemetry};
use super::{ASK, ROOM, Run, UnwrittenMessage, Vehicle, WIRES};
use std::time::Duration;
use supertwin_core::run::Properties;
use supertwin_core::{Event, EventKind, Severity};
use supertwin_protocol::payload::Stop;
use supertwin_protocol::{Description, Health, Received, decode, head, telemetry};
use supertwin_zenoh::Inbox;
use supertwin_zenoh::witness::RING;

/// States that are remembered; whoever makes up more of them is not believed.
const STATES: usize = 4096;

impl Vehicle {
    /// Sorts a message in; `key` is relative to the vehicle.
    pub(crate) fn receive(&mut self, key: &str, message: &Received, inbox: &Inbox) {
        if message.gone {
            return;
        }
        let parts: Vec<&str> = key.split('/').collect();
        match parts.as_slice() {
            ["telemetry", service] => {
                if let Some(service) = RING.iter().position(|name| name == service) {
                    self.telemetry(service, message, inbox);
                }
            }
            ["event" | "health", "recorder"] => {}
            ["event", _] => self.event(message),
            ["health", service] => self.health(service, message),
            ["stop", _] => self.stop(message),
            ["state", _, "now"] | ["state", _, "held", ..] => {}
            ["state", service, name @ ..] => self.state(service, &name.join("/"), message),
            _ if WIRES.contains(&key) => self.wire(key, message),
            _ => {}
        }
    }

    fn refuse(&mut self, what: &str, why: &impl std::fmt::Display) {
        self.monitor.refused += 1;
        let event = EventKind::MessageRefused { message: what.to_owned(), reason: why.to_string(), so_far: None };
        if self.monitor.may_complain(&event.to_string(), self.shared.clock.now()) {
            self.tell(Severity::Warning, event);
        }
    }

    /// The run that `id` names: the present one, or a new one that displaces it.
    fn run_of(&mut self, id: &str, tick: u64, now: Duration) -> Option<&mut Run> {
        if id.is_empty() {
            return None;
        }
        if self.run.as_ref().is_some_and(|run| run.id != id) {
            // What a run that is over still has to say must not end the present one: only a younger run does.
            let silent = now.saturating_sub(self.monitor.received_at) > 2 * ASK;
            if !silent && self.run.as_ref().is_some_and(|run| tick >= run.last) {
                return None;
            }
            self.end_run(false, now);
        }
        Some(self.run.get_or_insert_with(|| Run { id: id.to_owned(), first_received_at: now, ..Run::default() }))
    }

    fn telemetry(&mut self, service: usize, message: &Received, inbox: &Inbox) {
        let now = self.shared.clock.now();
        let envelope = match telemetry::read(&message.payload) {
            Ok(envelope) => envelope,
            Err(rejected) => return self.refuse(&format!("telemetry of {}", RING[service]), &rejected),
        };
        let clocks = self.clocks(envelope.clock_ns, message.at);
        let digest = envelope.digest.as_deref().and_then(|digest| u64::from_str_radix(digest, 16).ok());
        let (tick, id) = (envelope.tick, envelope.run.clone().into_owned());
        let dt_s = if tick > 0 { envelope.sim_time_s / tick as f64 } else { 0.0 };
        let (source, seq, telemetry) = (envelope.source.into_owned(), envelope.seq, envelope.data);
        let part = ServiceTelemetry { source, seq, digest, clocks, telemetry, thinned: false };
        let Some(run) = self.run_of(&id, tick, now) else { return };
        if run.dt_s == 0.0 {
            run.dt_s = dt_s;
        }
        let newest = run.assembler.is_newest(tick);
        let entered = run.assembler.enter(service, tick, part, now);
        if service == 0 && newest && entered == Entered::Waiting {
            self.monitor.sender(clocks);
        }
        self.monitor.received_at = now;
        if let Entered::Gap(wanted) = entered {
            self.recall(service, wanted, inbox);
        }
    }

    fn event(&mut self, message: &Received) {
        match decode::<Event>(&message.payload) {
            Ok(envelope) => {
                let clocks = self.clocks(envelope.clock_ns, message.at);
                if self.events.len() < ROOM {
                    self.events.push((envelope.run.into_owned(), envelope.data, clocks));
                } else {
                    self.monitor.refused += 1;
                }
            }
            Err(rejected) => self.refuse("event", &rejected),
        }
    }

    fn health(&mut self, service: &str, message: &Received) {
        match serde_json::from_slice::<Health>(&message.payload) {
            Ok(health) => self.monitor.health(service, health),
            Err(error) => self.refuse(&format!("health of {service}"), &error),
        }
    }

    fn stop(&mut self, message: &Received) {
        if let Ok(stop) = serde_json::from_slice::<Stop>(&message.payload)
            && self.run.as_ref().is_some_and(|run| run.id == stop.run)
            && self.stop.is_none_or(|(_, complete)| !complete)
        {
            self.stop = Some((stop.tick, stop.complete));
        }
    }

    fn state(&mut self, service: &str, name: &str, message: &Received) {
        match name {
            "signals" => match serde_json::from_slice::<Vec<Description<'_>>>(&message.payload) {
                Ok(descriptions) => self.registry.learn(&descriptions),
                Err(error) => self.refuse(&format!("signals of {service}"), &error),
            },
            "run" => match serde_json::from_slice::<Properties>(&message.payload) {
                Ok(properties) if RING.contains(&service) => {
                    let before = self.about.insert(service.to_owned(), properties.clone());
                    // A service that is started anew may have other files; those at the beginning are in the properties.
                    let recording = self.run.as_ref().is_some_and(|run| run.recording.is_some());
                    let words = serde_json::to_string(&properties).unwrap_or_default();
                    if recording && before.is_some_and(|before| before != properties) && self.states.len() < ROOM {
                        let clocks = self.clocks(self.shared.clock.unix_ns(), message.at);
                        self.states.push((format!("state/{service}/run"), clocks, words));
                    }
                }
                Ok(_) => {}
                Err(error) => self.refuse(&format!("properties of {service}"), &error),
            },
            _ => {
                if let Ok(words) = String::from_utf8(message.payload.clone()) {
                    let path = format!("state/{service}/{name}");
                    let known = self.monitor.states.get(&path) == Some(&words);
                    if !known && self.states.len() < ROOM && self.monitor.states.len() < STATES {
                        self.monitor.states.insert(path.clone(), words.clone());
                        self.states.push((path, self.clocks(self.shared.clock.unix_ns(), message.at), words));
                    }
                }
            }
        }
    }

    fn wire(&mut self, key: &str, message: &Received) {
        let now = self.shared.clock.now();
        let head = match head(&message.payload) {
            Ok(head) => head,
            Err(rejected) => return self.refuse(key, &rejected),
        };
        let (source, seq, tick) = (head.source.into_owned(), head.seq, head.tick);
        let unwritten = UnwrittenMessage {
            key: key.to_owned(),
            run: head.run.into_owned(),
            tick,
            clocks: self.clocks(head.clock_ns, message.at),
            bytes: message.payload.clone(),
        };
        let Some(active) = &mut self.run else {
            if self.wires.len() < ROOM {
                self.wires.push(unwritten);
            }
            return;
        };
        if !unwritten.run.is_empty() && unwritten.run != active.id {
            return;
        }
        match active.wire_seen.get_mut(key) {
            Some((known, last)) if *known == source => {
                if seq <= *last {
                    return;
                }
                let gap = seq - *last - 1;
                *last = seq;
                if gap > 0 {
                    *active.wire_missing.entry(key.to_owned()).or_default() += gap;
                    self.tell_gap(key.to_owned(), gap, None, tick, now);
                }
            }
            _ => {
                active.wire_seen.insert(key.to_owned(), (source, seq));
            }
        }
        self.wires.push(unwritten);
    }
}
