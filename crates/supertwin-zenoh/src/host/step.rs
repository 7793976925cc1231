//! One step of the block with all that belongs to it: commands before, events, output and telemetry after.

use super::Host;
use super::ports::AsideWriter;
use serde_json::Value;
use std::borrow::Cow;
use supertwin_core::digest::block_digest;
use supertwin_core::event::EventCommand;
use supertwin_core::observe::Snapshot;
use supertwin_core::{Event, EventKind, Observe, OperatorLink, Severity, Wired};
use supertwin_protocol::envelope::encode;
use supertwin_protocol::fault::Fault;
use supertwin_protocol::payload::Applied;
use supertwin_protocol::telemetry::{AppliedBefore, Shown, Used};
use zenoh::Wait;
use zenoh::bytes::ZBytes;

/// Commands that wait for telemetry; more of them belong to no recording that could be repeated.
const MAX_UNTOLD: usize = 4096;

impl<B: Wired + 'static> Host<B> {
    pub(super) fn operator(&mut self) -> OperatorLink {
        if !self.options.takes_setpoints {
            return OperatorLink::Present;
        }
        let now = self.now;
        let (deadman, lease) = (self.options.deadman, self.lease());
        let silent = self.operator.streams.iter().any(|stream| {
            // A stream whose client has given the authority back is over.
            let theirs = lease.holder(now) == Some(stream.client.as_str());
            stream.live && theirs && now.saturating_sub(stream.received_at) > deadman
        });
        let link = if lease.operator_lost(now) || silent { OperatorLink::Lost } else { OperatorLink::Present };
        if core::mem::replace(&mut self.operator.link, link) != link {
            match link {
                OperatorLink::Lost => {
                    self.note(Severity::Warning, EventKind::OperatorLost { setpoints_stopped: silent });
                }
                OperatorLink::Present => self.note(Severity::Info, EventKind::OperatorPresent),
            }
        }
        link
    }

    pub(super) fn apply(&mut self, k: u64) -> Vec<Value> {
        let mut applied = Vec::new();
        for waiting in self.commands.due(k) {
            let json = serde_json::to_value(&waiting.command).unwrap_or(Value::Null);
            let command = EventCommand::new(B::NAME, json.clone(), waiting.by.clone());
            // Missions speak with the voice they have in batch.
            let service = if waiting.by.is_some() { B::NAME } else { "mission" };
            let streaming = waiting.by.as_ref().is_some_and(|by| by.seq.is_none());
            let (severity, what) = match self.block.command(self.tick(k), &waiting.command) {
                Ok(()) => {
                    self.commands.counts.applied += 1;
                    if waiting.name.starts_with("parameter") {
                        self.tell_parameters();
                    }
                    let value = json.get(&waiting.name).unwrap_or(&json).clone();
                    let by = waiting.by.map(|by| by.to_string());
                    self.tell_state(waiting.name, &Applied { value, applied_tick: k, by });
                    applied.push(json);
                    (Severity::Info, EventKind::CommandApplied { command })
                }
                Err(refusal) => {
                    let reason = refusal.to_string();
                    (Severity::Error, EventKind::CommandRefused { command, session: None, reason, so_far: None })
                }
            };
            if !streaming || severity > Severity::Info {
                self.tell(&Event { tick: k, service: Cow::Borrowed(service), severity, what });
            }
        }
        applied
    }

    pub(super) fn step(&mut self, k: u64, publish: bool) {
        let began = self.clock.now();
        self.began_at.get_or_insert(began);
        let commands = self.apply(k);
        let operator = self.operator();
        let tick = self.tick(k);
        let mut used = Used::new();
        for (port, wire) in self.ports.states().zip(&mut self.wires) {
            let Some(made_at) = port.made_at() else { continue };
            used.push((port.key, port.used().to_vec()));
            let age = port.expected(k).map_or(0, |expected| expected.saturating_sub(made_at));
            wire.age_max = wire.age_max.max(age);
        }
        let out = self.block.step(tick, self.ports.input(tick, operator));
        self.ports.stepped();
        self.next = k + 1;
        self.counters.health.steps += 1;
        self.steps_of_run += 1;
        if self.options.telemetry_every > 0 {
            self.untold.extend(commands.into_iter().map(|command| AppliedBefore { tick: k, command }));
            let over = self.untold.len().saturating_sub(MAX_UNTOLD);
            self.untold.drain(..over);
        }
        let digest = block_digest(&mut self.probe, &self.block, &out);
        if !self.probe.finish_tick()
            && let Some(path) = not_finite(&self.block, &out)
        {
            self.counters.health.not_finite += 1;
            let what = |so_far| EventKind::NotFinite { at_tick: k, signal: Cow::Borrowed(path), so_far };
            if self.lock_step() {
                self.fail_by(what(None));
            } else {
                self.refused("", |_, so_far| what(Some(so_far)));
            }
            return;
        }
        let mut events = Vec::new();
        self.watch.after(tick, &self.block, &out, |event| events.push(event));
        for event in &events {
            self.tell(event);
        }
        if self.options.keep_digests {
            self.digests.push_back((k, digest));
        }
        if publish {
            self.sent.outputs += 1;
            self.output = Some((k, out, digest));
            self.send_output(false);
            self.send_telemetry(k, digest, used, operator);
        }
        self.counters.step_us.add(self.clock.now().saturating_sub(began));
    }

    pub(super) fn send_output(&mut self, repeat: bool) {
        let Some((k, out, digest)) = &self.output else { return };
        let mut envelope = self.header(*k, self.sent.outputs).with(out);
        envelope.digest = Some(Cow::Owned(format!("{digest:016x}")));
        envelope.repeat = repeat;
        let mut payload = Vec::with_capacity(4096);
        let encoded = encode(&envelope, &mut payload);
        let copies = self.fault.as_mut().map_or(1, Fault::copies);
        if encoded.is_ok() {
            let payload = ZBytes::from(payload);
            for _ in 0..copies {
                // What does not get through is a gap to its receivers, and repeated in lock step.
                let _ = self.publisher.put(payload.clone()).wait();
            }
        }
        self.lap.sent_at = self.clock.now();
    }

    fn send_telemetry(&mut self, k: u64, digest: u64, used: Used, operator: OperatorLink) {
        let every = self.options.telemetry_every;
        if every == 0 || !k.is_multiple_of(every) {
            return;
        }
        let Some((_, out, _)) = &self.output else { return };
        if self.signals.update(&self.block, out) {
            self.tell_state("signals".to_owned(), &self.signals.known);
        }
        self.sent.telemetry += 1;
        let operator_lost = operator == OperatorLink::Lost;
        let untold = core::mem::take(&mut self.untold);
        // They are in the order of their ticks.
        let (earlier, now) = untold.split_at(untold.partition_point(|applied| applied.tick < k));
        let commands: Vec<Value> = now.iter().map(|applied| applied.command.clone()).collect();
        let steps = self.steps_of_run;
        let shown =
            Shown::<B> { used, steps, operator_lost, commands: &commands, earlier, signals: (&self.block, out) };
        let mut envelope = self.header(k, self.sent.telemetry).with(shown);
        envelope.digest = Some(Cow::Owned(format!("{digest:016x}")));
        let mut payload = Vec::with_capacity(4096);
        if encode(&envelope, &mut payload).is_err() {
            self.counters.unwritten += 1;
            return;
        }
        let mut writer = AsideWriter { envelope: self.header(k, self.sent.telemetry), outbox: &self.outbox, at: 0 };
        self.block.asides(&mut writer);
        let copies = self.fault.as_mut().map_or(1, Fault::copies);
        for _ in 0..copies {
            self.outbox.telemetry(0, payload.clone());
        }
        self.telemetry = self.lock_step().then_some(payload);
    }

    pub(super) fn send_again(&mut self) {
        if self.output.is_some() {
            self.counters.health.repeats += 1;
            self.send_output(true);
            if let Some(payload) = self.telemetry.clone() {
                self.outbox.telemetry(0, payload);
            }
        }
    }
}

/// The first quantity of a step that is no number.
fn not_finite(block: &impl Observe, out: &impl Observe) -> Option<&'static str> {
    let first = |shown: Snapshot| shown.first_non_finite().map(|signal| signal.path);
    first(Snapshot::of(block)).or_else(|| first(Snapshot::of(out)))
}
