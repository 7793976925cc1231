//! What was heard, tick by tick, into the recording of its run.

use super::super::lap_assembler::{Lap, ServiceTelemetry};
use super::super::link_monitor::LinkMonitor;
use super::super::run_recording::RunRecording;
use super::super::signal_registry::SignalRegistry;
use super::{ASK, DESCRIBED, Run, Shared, Vehicle};
use serde_json::json;
use std::collections::BTreeMap;
use std::time::Duration;
use supertwin_core::message::{Measurements, Message as _, Nav, Reference, SignalValues, Thrust};
use supertwin_core::run::{FORMAT, Properties, Property};
use supertwin_core::{EventKind, Observe as _, Probe as _, RunHeader, Severity, Signal, Tick};
use supertwin_lab::Tracking;
use supertwin_protocol::Shape;
use supertwin_zenoh::Inbox;
use supertwin_zenoh::witness::RING;

/// Ticks of a run that is not scored at its end: it would take gigabytes.
const LONG: u64 = 1_000_000;
const TOO_LONG: &str = "longer than a million ticks";

impl Lap {
    fn shown(&self, signal: &Signal) -> Option<&Shape> {
        self.parts.iter().flatten().find_map(|part| part.telemetry.signals.get(signal.path))
    }
}

impl SignalValues for Lap {
    fn numbers(&self, signal: &'static Signal) -> Option<&[f64]> {
        match self.shown(signal)? {
            Shape::Numbers(values) => Some(values),
            Shape::Label(_) => None,
        }
    }
    fn label(&self, signal: &'static Signal) -> Option<&str> {
        match self.shown(signal)? {
            Shape::Label(label) => Some(label),
            Shape::Numbers(_) => None,
        }
    }
}

impl Vehicle {
    /// Begins the recording as soon as the run is described.
    pub(super) fn describe(&mut self, now: Duration, inbox: &Inbox) {
        let Some(run) = &mut self.run else { return };
        if run.recording.is_some() {
            return;
        }
        let about = self.about.get("plant").cloned();
        if about.is_none() && now.saturating_sub(run.first_received_at) < DESCRIBED {
            if now.saturating_sub(self.asked_at) > ASK {
                self.inquire(inbox);
            }
            return;
        }
        let undescribed = about.is_none();
        let mut properties = about.unwrap_or_default();
        if let Some(Property::Number(tick_s)) = properties.get("tick_s") {
            run.dt_s = *tick_s;
        }
        run.lock_step = properties.get("placement") == Some(&Property::from("lockstep"));
        properties.insert("run".to_owned(), run.id.as_str().into());
        properties.insert("network_name".to_owned(), self.name.as_str().into());
        properties.entry("placement".to_owned()).or_insert_with(|| "network".into());
        properties.insert("format".to_owned(), FORMAT.into());
        properties.insert("recorder_version".to_owned(), env!("CARGO_PKG_VERSION").into());
        for service in RING {
            for name in ["config", "controller", "seed"] {
                let own = self.about.get(service).and_then(|about| about.get(name)).cloned();
                if let Some(own) = own.filter(|own| Some(own) != properties.get(name)) {
                    properties.insert(format!("{name}_of_{service}"), own);
                }
            }
        }
        let scene = super::super::scene(&properties).unwrap_or_default();
        let name = format!("{}-{}", self.name, run.id);
        let header = RunHeader { name, properties, scene };
        let Shared { live, options, .. } = &self.shared;
        run.recording = Some(RunRecording::begin(header, options.folder.clone(), live.as_ref(), options.rotation, now));
        if undescribed {
            self.tell(Severity::Warning, EventKind::ConfigurationUnknown);
        }
    }

    /// Writes the next lap, if it is ready.
    pub(super) fn write_next(&mut self, now: Duration, inbox: &Inbox) -> bool {
        let Some(run) = &mut self.run else { return false };
        if run.recording.is_none() {
            return false;
        }
        let flush = self.stop.is_some_and(|(_, complete)| !complete);
        if run.lock_step && !flush && !wires_are_there(run) {
            return false;
        }
        let described = |path: &String| self.registry.get(path).is_some();
        if !flush && !run.assembler.first_paths().all(described) {
            // Whoever shows a signal has described it before: the description is on its way, or can be asked for.
            let since = *self.undescribed.get_or_insert(now);
            if now.saturating_sub(since) < DESCRIBED {
                if now.saturating_sub(self.asked_at) > ASK || since == now {
                    self.inquire(inbox);
                }
                return false;
            }
        }
        self.undescribed = None;
        let missing = run.assembler.missing;
        let Some(lap) = run.assembler.pop(now, run.lock_step, flush) else { return false };
        let before = run.last;
        self.tell_gaps(missing, Some(before), lap.tick, now);
        // What came too late is older than this one: labels keep their order.
        self.write_late(now, false);
        self.write(&lap, now);
        true
    }

    fn write(&mut self, lap: &Lap, now: Duration) {
        let Some(run) = &mut self.run else { return };
        let Some(recording) = &mut run.recording else { return };
        let tick = Tick { k: lap.tick, dt_s: run.dt_s };
        let clocks = lap.parts.iter().flatten().next().map(|part| part.clocks).unwrap_or_default();
        recording.tick(tick, clocks, now);
        for part in lap.parts.iter().flatten() {
            self.monitor.refused += write_signals(part, &mut self.registry, &mut run.widths, recording);
        }
        if let Some(tracking) = Tracking::from_signals(lap) {
            tracking.observe(recording);
        }
        self.monitor.show(&mut self.registry, run.assembler.missing, &run.wire_missing, clocks, recording);
        for (service, part) in RING.iter().zip(&lap.parts) {
            if let Some(part) = part {
                write_step_account(service, part, tick, recording);
            }
        }
        let digests: Vec<u64> = lap.parts.iter().flatten().filter_map(|part| part.digest).collect();
        match <[u64; RING.len()]>::try_from(digests) {
            Ok(digests) if !run.digest_broken && tick.k == run.ticks => {
                run.digest.fold(tick, digests);
            }
            _ => run.digest_broken = true,
        }
        run.ticks += 1;
        run.last = tick.k;
        if run.lock_step {
            self.receipts.give(&run.id, tick.k, now);
        }
    }

    /// Writes what came after its tick had been written, such as what a service said on the far side of a cut tether.
    pub(super) fn write_late(&mut self, now: Duration, flush: bool) {
        let Some(run) = &mut self.run else { return };
        let Some(recording) = &mut run.recording else { return };
        let missing = run.assembler.missing;
        let late_telemetry = run.assembler.take_late(now, flush);
        let until = late_telemetry.iter().map(|(_, tick, _)| *tick).max().unwrap_or_default();
        for (service, k, part) in late_telemetry {
            let tick = Tick { k, dt_s: run.dt_s };
            recording.late_tick(tick, part.clocks);
            self.monitor.refused += write_signals(&part, &mut self.registry, &mut run.widths, recording);
            write_step_account(RING[service], &part, tick, recording);
        }
        self.tell_gaps(missing, None, until, now);
    }

    /// Hands events, states and exact messages on, as soon as their run is known.
    pub(super) fn flush_notes(&mut self) {
        let Some(run) = &mut self.run else { return };
        let Some(recording) = &mut run.recording else { return };
        for (id, event, clocks) in self.events.drain(..) {
            if id.is_empty() || id == run.id {
                run.warnings += u64::from(event.severity > Severity::Info);
                recording.event(&event, clocks);
            }
        }
        for (path, clocks, words) in self.states.drain(..) {
            recording.text(&path, Tick { k: run.last, dt_s: run.dt_s }, clocks, &words);
        }
        for message in self.wires.drain(..) {
            if message.run.is_empty() || message.run == run.id {
                let tick = Tick { k: message.tick, dt_s: run.dt_s };
                recording.bytes(&format!("wire/{}", message.key), tick, message.clocks, message.bytes);
            }
        }
    }

    /// Closes the recording of the present run.
    pub(crate) fn end_run(&mut self, complete: bool, now: Duration) {
        // What waits is written as it is: there will be no more of it.
        while let Some(lap) = self.run.as_mut().and_then(|run| run.assembler.pop(now, false, true)) {
            self.write_late(now, true);
            self.write(&lap, now);
        }
        self.write_late(now, true);
        self.flush_notes();
        self.stop = None;
        if let Some(run) = &mut self.run {
            let mut results = Properties::from([
                ("ticks".to_owned(), run.ticks.into()),
                ("complete".to_owned(), u64::from(complete).into()),
                ("warnings".to_owned(), run.warnings.into()),
            ]);
            for (i, service) in RING.iter().enumerate() {
                results.insert(format!("missing.{service}"), run.assembler.missing[i].into());
                results.insert(format!("thinned.{service}"), run.assembler.thinned[i].into());
            }
            if !run.digest_broken && run.ticks > 0 {
                results.insert("hash".to_owned(), run.digest.to_string().into());
            }
            if let Some(recording) = &mut run.recording {
                let rescored = if run.ticks > LONG { Some(Err(TOO_LONG.to_owned())) } else { recording.rescore() };
                match rescored {
                    Some(Ok(rescored)) => results.extend(rescored.scores.properties()),
                    // A run without a plant or without its configuration has no scores.
                    Some(Err(why)) => {
                        results.insert("not_scored".to_owned(), why.into());
                    }
                    None => {}
                }
                recording.finish(&results, now);
                self.compacting.append(&mut recording.compacting);
            }
        }
        self.report();
        if self.run.take().is_some() {
            self.finished += 1;
        }
        self.about.remove("plant");
        self.monitor = LinkMonitor::default();
    }
}

/// Shows the signals of a service at a tick; how many could not be shown.
fn write_signals(
    part: &ServiceTelemetry,
    registry: &mut SignalRegistry,
    widths: &mut BTreeMap<&'static str, usize>,
    recording: &mut RunRecording,
) -> u64 {
    let mut refused = 0;
    for (path, shape) in &part.telemetry.signals {
        let Some(signal) = registry.register(path, &[], &[], "") else {
            refused += 1;
            continue;
        };
        match shape {
            Shape::Numbers(values) => {
                let width = *widths.entry(signal.path).or_insert(values.len());
                if width == values.len() {
                    recording.vector(signal, values);
                } else {
                    refused += 1;
                }
            }
            Shape::Label(value) => match registry.label(value) {
                Some(value) => recording.label(signal, value),
                None => refused += 1,
            },
        }
    }
    refused
}

/// Keeps who stepped on what, and the commands that applied: what a replay needs beside the messages.
fn write_step_account(service: &str, part: &ServiceTelemetry, tick: Tick, recording: &mut RunRecording) {
    let telemetry = &part.telemetry;
    let mut account = json!({ "source": part.source, "seq": part.seq, "used": telemetry.used });
    if telemetry.steps > 0 {
        account["steps"] = telemetry.steps.into();
    }
    if let Some(digest) = part.digest {
        account["digest"] = format!("{digest:016x}").into();
    }
    if telemetry.operator_lost {
        account["operator_lost"] = true.into();
    }
    let path = format!("command/{service}");
    for applied in &telemetry.earlier {
        recording.text(&path, Tick { k: applied.tick, ..tick }, part.clocks, &applied.command.to_string());
    }
    for command in &telemetry.commands {
        recording.text(&path, tick, part.clocks, &command.to_string());
    }
    recording.text(&format!("step/{service}"), tick, part.clocks, &account.to_string());
}

/// In lock step a tick is only seen when its exact messages are there as well.
fn wires_are_there(run: &Run) -> bool {
    let next = run.assembler.next.unwrap_or(0);
    [Measurements::KEY, Nav::KEY, Reference::KEY, Thrust::KEY]
        .iter()
        .all(|key| run.wire_seen.get(*key).is_some_and(|(_, seq)| *seq > next))
}
