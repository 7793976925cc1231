//! What arrives: messages on ports, set-points, the lease, witnesses, the end of a run.

use super::ports::{Deliver, Delivered};
use super::request::read;
use super::state::Stream;
use super::{Ending, Host, Pace, StepSchedule, WireKind};
use serde_json::json;
use std::time::Duration;
use supertwin_core::{EventKind, Ports, Severity, Watch, Wired};
use supertwin_protocol::command_queue::{CommandQueue, MAX_REQUEST};
use supertwin_protocol::lease::{LeaseState, LeaseView};
use supertwin_protocol::payload::{STREAMS, Seen, Stop, StreamedSetpoint};
use zenoh::bytes::ZBytes;

/// A message from this far in the future, counted from when something was last heard, is a mistake or an attack.
const FUTURE_S: f64 = 1.0;

impl<B: Wired + 'static> Host<B> {
    pub(super) fn wire(&mut self, number: usize, payload: &ZBytes) {
        match self.wires[number].kind {
            WireKind::Port => self.port(number, payload),
            WireKind::Setpoint(i) => self.streamed(i, &payload.to_bytes()),
            WireKind::Lease => self.lease_state(&payload.to_bytes()),
            WireKind::Stop => self.stop(&payload.to_bytes()),
            WireKind::Witness => self.witness(&payload.to_bytes()),
            WireKind::Operator => {
                let client = String::from_utf8_lossy(&payload.to_bytes()).into_owned();
                if self.operator.authority.as_mut().is_some_and(|authority| authority.vanished(&client)) {
                    self.tell_lease();
                    self.note(Severity::Warning, EventKind::OperatorVanished { client });
                }
            }
        }
    }

    pub(super) fn port(&mut self, number: usize, payload: &ZBytes) {
        let now = self.now;
        let elapsed_s = now.saturating_sub(self.received_at).as_secs_f64();
        let factor = if let Pace::RealTime(factor) = self.options.pace { factor } else { 1.0 };
        let ahead = (elapsed_s * factor + FUTURE_S) / self.options.tick_s;
        // Before its first step a service has no idea of the tick, even when a message has told it the run.
        let known = self.output.is_some() || B::OWNS_TIME;
        let bytes = payload.to_bytes();
        let was_source = self.wires[number].ledger.source.clone();
        let mut deliver = Deliver {
            wanted: number,
            payload: &bytes,
            ledger: &mut self.wires[number].ledger,
            run: &mut self.run,
            lock_step: self.options.pace == Pace::LockStep,
            now,
            newest_allowed: if known { self.next.saturating_add(ahead as u64) } else { u64::MAX / 2 },
            outcome: Delivered::Nothing,
        };
        self.ports.visit(&mut deliver);
        match deliver.outcome {
            Delivered::Nothing => {}
            Delivered::Rejected(rejected) => self.refused(&rejected.to_string(), |reason, so_far| {
                let message = format!("message on wire {number}");
                EventKind::MessageRefused { message, reason, so_far: Some(so_far) }
            }),
            Delivered::Left { repeat } => self.answer_repetition(repeat, now),
            Delivered::Changed { source, run, tick } => self.changed(&was_source, &source, &run, tick, payload),
            Delivered::Taken { tick, clock_ns, trigger, gap, takeover } => {
                self.received_at = now;
                let late_ns = self.clock.unix_ns().saturating_sub(clock_ns);
                let wire = &mut self.wires[number];
                wire.held = Some(payload.clone());
                if clock_ns > 0 {
                    wire.transport_ms_max = wire.transport_ms_max.max(late_ns as f64 / 1e6);
                }
                if B::OWNS_TIME && tick + 1 == self.next {
                    self.counters.loop_us.add(now.saturating_sub(self.lap.sent_at));
                }
                if self.lock_step() {
                    if tick > self.next {
                        let source = self.wires[number].ledger.source.clone();
                        let (run, next) = (self.run.clone(), self.next);
                        self.fail(format!(
                            "{source} is at tick {tick} of run {run} already and this service at {next}: nobody can \
                             join a lock-step run later"
                        ));
                    }
                } else {
                    if trigger {
                        self.schedule.trigger = Some(tick);
                    } else if tick < self.next.saturating_sub(1) {
                        self.wires[number].ledger.counts.late += 1;
                    }
                    if gap > 0 {
                        let source = was_source.clone();
                        self.note(Severity::Warning, EventKind::MessagesMissing { source, messages: gap });
                    }
                    if takeover {
                        let to = self.wires[number].ledger.source.clone();
                        self.note(Severity::Info, EventKind::SourceChanged { from: was_source, to });
                    }
                }
            }
        }
    }

    /// Another instance or another run: the end of a lock-step run, a fresh start in real time.
    pub(super) fn changed(&mut self, was: &str, source: &str, run: &str, tick: u64, payload: &ZBytes) {
        if self.lock_step() {
            if was.is_empty() || run != self.run {
                self.fail(format!("{source} belongs to run {run}, this is run {}", self.run));
            } else {
                self.fail(format!("{source} came in the place of {was}, without its state"));
            }
            return;
        }
        self.note(Severity::Warning, EventKind::RunStarted { run: run.to_owned(), at_tick: tick });
        let old = core::mem::replace(&mut self.block, self.pristine.clone());
        self.block.succeed(&old);
        let discarded = self.commands.waiting();
        if discarded > 0 {
            let commands = discarded as u64;
            self.note(Severity::Warning, EventKind::CommandsDiscarded { commands });
        }
        self.watch = Watch::new(&self.block);
        self.steps_of_run = 0;
        self.untold.clear();
        self.commands = CommandQueue::new(&self.options.mission);
        self.next = tick;
        run.clone_into(&mut self.run);
        self.output = None;
        self.schedule = StepSchedule { due: None, trigger: None };
        self.ports = Ports::default();
        self.wires.iter_mut().for_each(|wire| wire.held = None);
        self.commands.due(tick.saturating_sub(1));
        // The message that said so is the first of the run.
        for i in 0..self.wires.len() {
            if self.wires[i].kind == WireKind::Port && self.wires[i].ledger.source == source {
                self.offer_held(i, payload, run);
            }
        }
        self.schedule.trigger = Some(tick);
    }

    pub(super) fn answer_repetition(&mut self, repeat: bool, now: Duration) {
        // A doubled message is left; one that was sent again because somebody misses our answer gets it.
        if self.lock_step() && repeat && now.saturating_sub(self.lap.sent_at) >= self.repeat_first() {
            self.send_again();
        }
    }

    pub(super) fn stop(&mut self, payload: &[u8]) {
        let Ok(stop) = serde_json::from_slice::<Stop>(payload) else { return };
        if stop.source == self.source || (!self.run.is_empty() && stop.run != self.run) || self.ending.is_some() {
            return;
        }
        let done = self.options.ticks.is_some_and(|ticks| self.next >= ticks);
        self.ending = Some(if stop.complete && done { Ending::Complete } else { Ending::Stopped(stop.reason) });
    }

    pub(super) fn witness(&mut self, payload: &[u8]) {
        let Ok(seen) = serde_json::from_slice::<Seen>(payload) else { return };
        if seen.run != self.run {
            return;
        }
        let now = self.now;
        let name = |source: &str| source.rsplit_once('-').map_or(source.to_owned(), |(name, _)| name.to_owned());
        let Some(witness) = self.witnesses.iter_mut().find(|witness| witness.name == name(&seen.source)) else {
            return;
        };
        if witness.source.is_empty() {
            witness.source.clone_from(&seen.source);
        } else if witness.source != seen.source {
            let (was, is) = (witness.source.clone(), seen.source);
            return self.fail(format!("{is} came in the place of {was}, without its state"));
        }
        if witness.seen.is_none_or(|tick| seen.tick > tick) {
            witness.seen = Some(seen.tick);
            self.received_at = now;
        } else {
            self.answer_repetition(seen.repeat, now);
        }
    }

    pub(super) fn lease_state(&mut self, payload: &[u8]) {
        if self.operator.authority.is_none()
            && let Ok(state) = serde_json::from_slice::<LeaseState>(payload)
        {
            self.operator.lease.update(state, self.now);
        }
    }

    pub(super) fn lease(&self) -> &LeaseView {
        self.operator.authority.as_ref().map_or(&self.operator.lease, |authority| &authority.view)
    }

    pub(super) fn streamed(&mut self, i: usize, payload: &[u8]) {
        let now = self.now;
        let taken = (|| {
            if payload.len() > MAX_REQUEST {
                return Err(format!("{} bytes", payload.len()));
            }
            let sample: StreamedSetpoint = serde_json::from_slice(payload).map_err(|error| error.to_string())?;
            self.lease().allows(&sample.client, &sample.token, now)?;
            let stream = &self.operator.streams[i];
            if stream.client == sample.client && stream.token == sample.token && sample.seq <= stream.seq {
                return Err(format!("seq = {}: must be greater than {}", sample.seq, stream.seq));
            }
            if let Some(value) = sample.value {
                let command =
                    serde_json::from_value(json!({ STREAMS[i]: value })).map_err(|error| error.to_string())?;
                self.block.clone().command(self.tick(self.next), &command).map_err(|refusal| refusal.0)?;
                self.commands.stream(STREAMS[i], value, &sample.client, self.next)?;
            }
            Ok(sample)
        })();
        match taken {
            Ok(sample) => {
                let stream = &mut self.operator.streams[i];
                let (accepted, refused, live) = (stream.accepted + 1, stream.refused, sample.value.is_some());
                let StreamedSetpoint { client, token, seq, .. } = sample;
                *stream = Stream { seq, token, client, received_at: now, live, accepted, refused };
            }
            Err(why) => {
                self.operator.streams[i].refused += 1;
                let client = read::<StreamedSetpoint>(payload).map(|sample| sample.client);
                self.refused(&why, |reason, so_far| EventKind::SetpointRefused {
                    name: STREAMS[i].into(),
                    client,
                    reason,
                    so_far,
                });
            }
        }
    }
}
