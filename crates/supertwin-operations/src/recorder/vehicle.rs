//! What one vehicle says, sorted into the recording of its run.

mod receive;
mod write;

use super::Options;
use super::lap_assembler::LapAssembler;
use super::link_monitor::LinkMonitor;
use super::run_recording::RunRecording;
use super::signal_registry::SignalRegistry;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;
use supertwin_core::digest::RunDigest;
use supertwin_core::message::{Measurements, Message as _, Nav, Reference, Thrust, WrenchRequest};
use supertwin_core::run::Properties;
use supertwin_core::{Event, EventKind, Severity, Tick};
use supertwin_protocol::{Clock, Health, keys};
use supertwin_rerun::{Clocks, Live};
use supertwin_zenoh::witness::RING;
use supertwin_zenoh::{Inbox, LinkError, Receipts, ServicePublisher, Session};

/// Wires whose exact bytes are kept: what a replay needs.
pub(crate) const WIRES: [&str; 7] = [
    Measurements::KEY,
    Nav::KEY,
    Reference::KEY,
    Thrust::KEY,
    WrenchRequest::KEY,
    supertwin_lab::shadow::MEASUREMENTS,
    supertwin_lab::shadow::TRUTH,
];
/// How long a run that nobody describes is waited for before it is recorded without its configuration.
const DESCRIBED: Duration = Duration::from_secs(3);
/// How often a question that nobody answers is asked again.
const ASK: Duration = Duration::from_millis(500);
/// Events and messages that wait for their run to be known.
const ROOM: usize = 20_000;

/// What all vehicles of one recorder have in common.
#[derive(Clone)]
pub(crate) struct Shared {
    pub(crate) session: Session,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) instance: String,
    pub(crate) live: Option<Live>,
    pub(crate) options: Options,
}

/// A message that has been read as far as its header.
struct UnwrittenMessage {
    key: String,
    run: String,
    tick: u64,
    clocks: Clocks,
    bytes: Vec<u8>,
}

/// A vehicle on the network, and the run of it that is being recorded.
pub(crate) struct Vehicle {
    name: String,
    root: String,
    shared: Shared,
    publisher: ServicePublisher,
    receipts: Receipts,
    registry: SignalRegistry,
    monitor: LinkMonitor,
    about: BTreeMap<String, Properties>,
    run: Option<Run>,
    /// Nothing may be lost while a run is not yet known.
    events: Vec<(String, Event, Clocks)>,
    wires: Vec<UnwrittenMessage>,
    states: Vec<(String, Clocks, String)>,
    asked_at: Duration,
    /// The end of a lock-step run that has been announced: tick, complete.
    stop: Option<(u64, bool)>,
    /// Signals that nobody has described, since when.
    undescribed: Option<Duration>,
    /// How many runs have come to their end here.
    pub(crate) finished: u64,
    /// Files of runs that are over and are being rewritten.
    pub(crate) compacting: Vec<JoinHandle<Result<(), String>>>,
    /// What happened to files, for whoever shows it.
    pub(crate) notices: Vec<Value>,
}

/// A run that is being recorded, or will be as soon as it is described.
#[derive(Default)]
struct Run {
    id: String,
    assembler: LapAssembler,
    recording: Option<RunRecording>,
    first_received_at: Duration,
    dt_s: f64,
    lock_step: bool,
    digest: RunDigest,
    /// The hash does not cover every tick from the first.
    digest_broken: bool,
    ticks: u64,
    /// Number of the tick that was written last.
    last: u64,
    wire_seen: BTreeMap<String, (String, u64)>,
    wire_missing: BTreeMap<String, u64>,
    widths: BTreeMap<&'static str, usize>,
    warnings: u64,
}

impl Run {
    /// The tick that was written last.
    fn last(&self) -> Tick {
        Tick { k: self.last, dt_s: self.dt_s }
    }
}

impl Vehicle {
    /// Begins to listen; `root` is what its keys begin with.
    pub(crate) fn new(name: &str, root: &str, shared: &Shared, inbox: &Inbox) -> Result<Self, LinkError> {
        let now = shared.clock.now();
        let publisher = ServicePublisher::open(
            &shared.session,
            root,
            "recorder",
            &shared.instance,
            Arc::clone(&shared.clock),
            true,
        )?;
        let receipts = Receipts::open(&shared.session, root, &shared.options.witness, &shared.instance, None, now)?;
        let mut vehicle = Self {
            name: name.to_owned(),
            root: root.to_owned(),
            shared: shared.clone(),
            publisher,
            receipts,
            registry: SignalRegistry::default(),
            monitor: LinkMonitor::default(),
            about: BTreeMap::new(),
            run: None,
            events: Vec::new(),
            wires: Vec::new(),
            states: Vec::new(),
            asked_at: now,
            stop: None,
            undescribed: None,
            finished: 0,
            compacting: Vec::new(),
            notices: Vec::new(),
        };
        vehicle.inquire(inbox);
        for service in RING {
            // Whoever was here before may have left a gap that the services can still fill.
            inbox.recall(&shared.session, &format!("{root}{}", keys::telemetry(service)), None);
        }
        Ok(vehicle)
    }

    fn inquire(&mut self, inbox: &Inbox) {
        self.asked_at = self.shared.clock.now();
        inbox.inquire(&self.shared.session, &format!("{}{}", self.root, keys::state("*", "**")));
    }

    /// Asks a service for its newest telemetry again.
    fn recall(&self, service: usize, newest: u64, inbox: &Inbox) {
        let key = format!("{}{}", self.root, keys::telemetry(RING[service]));
        inbox.recall(&self.shared.session, &key, Some(newest));
    }

    /// The sender's clock, and the recorder's when the message arrived.
    fn clocks(&self, sender_ns: u64, arrived: Duration) -> Clocks {
        let narrow = |ns: u64| i64::try_from(ns).unwrap_or(i64::MAX);
        let waited = self.shared.clock.now().saturating_sub(arrived).as_nanos();
        let recorder_ns = narrow(self.shared.clock.unix_ns()) - i64::try_from(waited).unwrap_or(0);
        Clocks { sender_ns: narrow(sender_ns), recorder_ns }
    }

    /// The recorder was too slow for so many messages.
    pub(crate) fn overrun(&mut self, lost: u64) {
        self.monitor.refused += lost;
        self.tell(Severity::Error, EventKind::RecorderOverrun { messages: lost });
    }

    /// Says something about the recording, in the recording as well.
    fn tell(&mut self, severity: Severity, what: EventKind) {
        let (id, tick) =
            self.run.as_ref().map_or((String::new(), Tick { k: 0, dt_s: 0.0 }), |run| (run.id.clone(), run.last()));
        let event = self.publisher.event(&id, tick, severity, what);
        let clocks = self.clocks(self.shared.clock.unix_ns(), self.shared.clock.now());
        self.events.push((id, event, clocks));
    }

    /// Says that messages of a key are missing; of one that is too slow, and loses something at every tick, once a second.
    fn tell_gap(&mut self, key: String, messages: u64, after_tick: Option<u64>, before_tick: u64, now: Duration) {
        if self.monitor.may_complain(&format!("gap in {key}"), now) {
            self.tell(Severity::Warning, EventKind::NotRecorded { key, messages, after_tick, before_tick });
        }
    }

    /// Says what is missing of the telemetry of every service since `before`.
    fn tell_gaps(&mut self, before: [u64; RING.len()], after_tick: Option<u64>, before_tick: u64, now: Duration) {
        let Some(missing) = self.run.as_ref().map(|run| run.assembler.missing) else { return };
        for (i, service) in RING.into_iter().enumerate().filter(|(i, _)| missing[*i] > before[*i]) {
            self.tell_gap(keys::telemetry(service), missing[i] - before[i], after_tick, before_tick, now);
        }
    }

    /// Writes what is ready; when to look again.
    pub(crate) fn poll(&mut self, inbox: &Inbox) -> Duration {
        let now = self.shared.clock.now();
        if let Some(step_s) = self.monitor.clock_step(&*self.shared.clock) {
            self.tell(Severity::Warning, EventKind::ClockStepped { service: "recorder".into(), step_s });
        }
        if let Some(step_s) = self.monitor.sender_step_s.take() {
            self.tell(Severity::Warning, EventKind::ClockStepped { service: "plant".into(), step_s });
        }
        self.describe(now, inbox);
        self.write_late(now, false);
        while self.write_next(now, inbox) {}
        while let Some((service, wanted)) = self.run.as_mut().and_then(|run| run.assembler.ask_again(now)) {
            self.recall(service, wanted, inbox);
        }
        self.flush_notes();
        let mut due = now + Duration::from_millis(250);
        if let Some(run) = &mut self.run {
            if let Some(recording) = &mut run.recording {
                recording.poll(now);
            }
            if let Some(lap) = run.assembler.due() {
                due = due.min(lap.max(now + Duration::from_millis(1)));
            }
            if run.lock_step {
                due = due.min(self.receipts.repeat(now));
            }
        }
        self.report();
        if self.monitor.health_is_due(now) {
            self.tell_health(now);
        }
        if let Some((tick, complete)) = self.stop
            && self.run.as_ref().is_some_and(|run| run.assembler.next.is_some_and(|next| next >= tick))
        {
            self.end_run(complete, now);
        }
        due
    }

    /// Tells everybody what happened to the files.
    fn report(&mut self) {
        let Some(Run { recording: Some(recording), .. }) = &mut self.run else { return };
        for event in std::mem::take(&mut recording.events) {
            let (severity, name, what) = match &event {
                EventKind::RecordingOpened { path } => (Severity::Info, "recording", path),
                EventKind::RecordingClosed { path } => (Severity::Info, "closed", path),
                EventKind::RecordingFailed { reason } => (Severity::Error, "failed", reason),
                _ => continue,
            };
            self.notices.push(json!({ "vehicle": self.name, name: what }));
            self.tell(severity, event);
        }
    }

    /// Says once a second up to which tick the run is in the file.
    fn tell_health(&mut self, now: Duration) {
        if let Some(Run { recording: Some(recording), .. }) = &mut self.run {
            recording.save(now);
        }
        let dropped = self.shared.live.as_ref().map_or(0, Live::dropped);
        let mut health = Health { refused: self.monitor.refused, telemetry_dropped: dropped, ..Health::default() };
        if let Some(run) = &self.run {
            health.run.clone_from(&run.id);
            health.tick = run.last;
            health.tick_s = run.dt_s;
            health.lock_step = run.lock_step;
            health.steps = run.ticks;
            health.skipped = run.recording.as_ref().map_or(0, |recording| recording.lost_ticks);
            health.late_triggers = run.assembler.late;
            for (service, missing) in RING.iter().zip(run.assembler.missing) {
                let input = health.inputs.entry(keys::telemetry(service)).or_default();
                input.counts.missing = missing;
            }
            for (key, missing) in &run.wire_missing {
                health.inputs.entry(key.clone()).or_default().counts.missing = *missing;
            }
        }
        self.publisher.health(health);
    }
}
