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
    /// Takes a message; `key` is relative to the vehicle.
    pub(crate) fn take(&mut self, key: &str, heard: &Received, inbox: &Inbox) {
        if heard.gone {
            return;
        }
        let parts: Vec<&str> = key.split('/').collect();
        match parts.as_slice() {
            ["telemetry", service] => {
                if let Some(service) = RING.iter().position(|name| name == service) {
                    self.telemetry(service, heard, inbox);
                }
            }
            ["event", "recorder"] => {}
            ["event", _] => self.event(heard),
            ["health", service] => self.health(service, heard),
            ["stop", _] => self.stop(heard),
            ["state", _, "now"] | ["state", _, "held", ..] => {}
            ["state", service, name @ ..] => self.state(service, &name.join("/"), heard),
            _ if WIRES.contains(&key) => self.wire(key, heard),
            _ => {}
        }
    }

    fn refuse(&mut self, message: &str, why: &impl std::fmt::Display, now: Duration) {
        self.monitor.refused += 1;
        let what = EventKind::MessageRefused { message: message.to_owned(), reason: why.to_string(), so_far: None };
        if self.monitor.may_complain(&what.to_string(), now) {
            self.tell(Severity::Warning, what);
        }
    }

    /// The run that `id` names: the present one, or a new one that displaces it.
    fn run_of(&mut self, id: &str, tick: u64, now: Duration) -> Option<&mut Run> {
        if id.is_empty() {
            return None;
        }
        if self.run.as_ref().is_some_and(|run| run.id != id) {
            // What a run that is over still has to say must not end the present one: only a younger run does.
            let silent = now.saturating_sub(self.monitor.heard_at) > 2 * ASK;
            if !silent && self.run.as_ref().is_some_and(|run| tick >= run.last.k) {
                return None;
            }
            self.end_run(false, now);
        }
        Some(self.run.get_or_insert_with(|| Run::new(id, now)))
    }

    fn telemetry(&mut self, service: usize, heard: &Received, inbox: &Inbox) {
        let now = self.shared.clock.now();
        let envelope = match telemetry::read(&heard.payload) {
            Ok(envelope) => envelope,
            Err(rejected) => return self.refuse(&format!("telemetry of {}", RING[service]), &rejected, now),
        };
        let clocks = self.clocks(envelope.clock_ns, heard.at);
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
        if service == 0 && newest && entered == Entered::Taken {
            self.monitor.sender(clocks);
        }
        self.monitor.heard_at = now;
        if let Entered::Gap(wanted) = entered {
            self.recall(service, wanted, inbox);
        }
    }

    fn event(&mut self, heard: &Received) {
        let now = self.shared.clock.now();
        match decode::<Event>(&heard.payload) {
            Ok(envelope) => {
                let clocks = self.clocks(envelope.clock_ns, heard.at);
                if self.events.len() < ROOM {
                    self.events.push((envelope.run.into_owned(), envelope.data, clocks));
                } else {
                    self.monitor.refused += 1;
                }
            }
            Err(rejected) => self.refuse("event", &rejected, now),
        }
    }

    fn health(&mut self, service: &str, heard: &Received) {
        let now = self.shared.clock.now();
        if service == "recorder" {
            return;
        }
        match serde_json::from_slice::<Health>(&heard.payload) {
            Ok(health) => self.monitor.health(service, health),
            Err(error) => self.refuse(&format!("health of {service}"), &error, now),
        }
    }

    fn stop(&mut self, heard: &Received) {
        if let Ok(stop) = serde_json::from_slice::<Stop>(&heard.payload)
            && self.run.as_ref().is_some_and(|run| run.id == stop.run)
            && self.stop.is_none_or(|(_, complete)| !complete)
        {
            self.stop = Some((stop.tick, stop.complete));
        }
    }

    fn state(&mut self, service: &str, name: &str, heard: &Received) {
        let now = self.shared.clock.now();
        match name {
            "signals" => match serde_json::from_slice::<Vec<Description<'_>>>(&heard.payload) {
                Ok(descriptions) => self.registry.learn(&descriptions),
                Err(error) => self.refuse(&format!("signals of {service}"), &error, now),
            },
            "run" => match serde_json::from_slice::<Properties>(&heard.payload) {
                Ok(properties) if RING.contains(&service) => {
                    let before = self.about.insert(service.to_owned(), properties.clone());
                    // A service that is started anew may have other files; those at the beginning are in the properties.
                    let recording = self.run.as_ref().is_some_and(|run| run.recording.is_some());
                    let words = serde_json::to_string(&properties).unwrap_or_default();
                    if recording && before.is_some_and(|before| before != properties) && self.states.len() < ROOM {
                        let clocks = self.clocks(self.shared.clock.unix_ns(), heard.at);
                        self.states.push((format!("state/{service}/run"), clocks, words));
                    }
                }
                Ok(_) => {}
                Err(error) => self.refuse(&format!("properties of {service}"), &error, now),
            },
            _ => {
                if let Ok(words) = String::from_utf8(heard.payload.clone()) {
                    let path = format!("state/{service}/{name}");
                    let known = self.monitor.states.get(&path) == Some(&words);
                    if !known && self.states.len() < ROOM && self.monitor.states.len() < STATES {
                        self.monitor.states.insert(path.clone(), words.clone());
                        self.states.push((path, self.clocks(self.shared.clock.unix_ns(), heard.at), words));
                    }
                }
            }
        }
    }

    fn wire(&mut self, key: &str, heard: &Received) {
        let now = self.shared.clock.now();
        let (run, source, seq, tick, clocks) = match head(&heard.payload) {
            Ok(head) => {
                let clocks = self.clocks(head.clock_ns, heard.at);
                (head.run.into_owned(), head.source.into_owned(), head.seq, head.tick, clocks)
            }
            Err(rejected) => return self.refuse(key, &rejected, now),
        };
        let Some(active) = &mut self.run else {
            if self.wires.len() < ROOM {
                self.wires.push(UnwrittenMessage {
                    key: key.to_owned(),
                    run,
                    tick,
                    clocks,
                    bytes: heard.payload.clone(),
                });
            }
            return;
        };
        if !run.is_empty() && run != active.id {
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
                    if self.monitor.may_complain(&format!("gap in {key}"), now) {
                        let key = key.to_owned();
                        let gap = EventKind::NotRecorded { key, messages: gap, after_tick: None, before_tick: tick };
                        self.tell(Severity::Warning, gap);
                    }
                }
            }
            _ => {
                active.wire_seen.insert(key.to_owned(), (source, seq));
            }
        }
        self.wires.push(UnwrittenMessage { key: key.to_owned(), run, tick, clocks, bytes: heard.payload.clone() });
    }
}
