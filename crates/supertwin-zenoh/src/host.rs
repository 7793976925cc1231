//! Puts any block behind its keys: one step per tick, in lock step or in real time, with commands, events and accounts.

use crate::authority::{Authority, LeaseReply, LeaseRequest, LeaseState, LeaseView};
use crate::clock::Clock;
use crate::desk::{Desk, DeskCounts, Moment, Request};
use crate::envelope::{Envelope, MAX_PAYLOAD, Rejected, decode, encode};
use crate::fault::{Fault, FaultRates};
use crate::keys;
use crate::ledger::{Counts, Ledger, Verdict};
use crate::mailbox::{Mailbox, Overflow};
use crate::outbox::{Letter, Outbox};
use crate::session::LinkError;
use crate::telemetry::Shown;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;
use supertwin_core::digest::{DigestProbe, block_digest};
use supertwin_core::observe::Snapshot;
use supertwin_core::port::{MessageVisitor, Offered, PortVisitor};
use supertwin_core::run::Severity;
use supertwin_core::{Event, Message, OperatorLink, Port, PortRule, Tick, Watch, Wired};
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{Query, Queryable};
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

/// How ticks follow each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// By the wall clock, this many times as fast as real time.
    RealTime(f64),
    /// When all inputs of a tick are there.
    LockStep,
}

/// How a block is hosted.
#[derive(Clone, Debug)]
pub struct HostOptions<C> {
    /// Name of the run; the owner of time needs one, the others adopt it.
    pub run: String,
    /// Tells this instance from another of the same service.
    pub instance: String,
    /// How ticks follow each other.
    pub pace: Pace,
    /// Length of a tick.
    pub tick_s: f64,
    /// Number of ticks; without it, for ever.
    pub ticks: Option<u64>,
    /// Telemetry at every n-th tick; 0 for none.
    pub telemetry_every: u64,
    /// Timed commands.
    pub mission: Vec<(u64, C)>,
    /// Ticks from a request to when it applies.
    pub lead_ticks: u64,
    /// In lock step: how long to wait for the others before giving up.
    pub patience: Duration,
    /// How long a stream of set-points may pause before the operator counts as lost.
    pub deadman: Duration,
    /// Keeps the lease: one service per vehicle.
    pub keeps_authority: bool,
    /// Takes streaming set-points.
    pub takes_setpoints: bool,
    /// In lock step: witnesses that the ring waits for, kept by the owner of time.
    pub witnesses: Vec<String>,
    /// What the codec does to messages on purpose.
    pub faults: Option<FaultRates>,
    /// Asks those who are up which run and tick it is; of no use when all start together in one process.
    pub rejoins: bool,
    /// Keeps the hash of each step for whoever drives the host.
    pub keep_digests: bool,
}

/// How a host ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// All ticks done.
    Complete,
    /// Somebody ended it.
    Stopped(String),
    /// It could not go on.
    Failed(String),
}

/// What ends a lock-step run for everybody.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stop {
    /// Which run.
    pub run: String,
    /// Who says so.
    pub source: String,
    /// At which tick.
    pub tick: u64,
    /// All ticks were done.
    pub complete: bool,
    /// Why.
    pub reason: String,
}

/// A witness has seen a tick.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seen {
    /// Which run.
    pub run: String,
    /// Which witness.
    pub source: String,
    /// The newest tick of which it has everything.
    pub tick: u64,
    /// Sent again because nothing was heard.
    #[serde(default)]
    pub repeat: bool,
}

/// A streaming set-point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamedSetpoint {
    /// Who sends.
    pub client: String,
    /// Proof of authority.
    pub token: String,
    /// Counts the client's samples on this key.
    pub seq: u64,
    /// The value; absent when the stream ends and the last value stays.
    #[serde(default)]
    pub value: Option<f64>,
}

/// A host as the engine sees it, whatever its block.
pub trait Hosted: Send {
    /// The service's name.
    fn service(&self) -> &'static str;
    /// A message on wire `wire`.
    fn deliver(&mut self, wire: usize, payload: &ZBytes);
    /// A request.
    fn request(&mut self, query: Query);
    /// Does what can be done now; true when something was.
    fn poll(&mut self, overflow: Overflow) -> bool;
    /// When it wants to be polled again, if nothing arrives.
    fn deadline(&self) -> Option<Duration>;
    /// Whether it is over, and how.
    fn ending(&self) -> Option<&Ending>;
    /// Ends it from outside.
    fn interrupt(&mut self, reason: &str);
    /// Hashes of the steps since the last call, with their ticks.
    fn digests(&mut self) -> &mut VecDeque<(u64, u64)>;
}

/// Wires that are no ports of the block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Port(usize),
    Setpoint(usize),
    Lease,
    Stop,
    Witness,
    Operator,
}

#[derive(Debug)]
struct Wire {
    side: Side,
    ledger: Ledger,
    /// The newest payload, for those who start anew.
    held: Option<ZBytes>,
    age_max: u64,
    transport_ms_max: f64,
}

#[derive(Debug, Default)]
struct Beat {
    /// Real time: when the next step is due without a trigger.
    due: Option<Duration>,
    /// The newest trigger that has not been acted on.
    trigger: Option<u64>,
}

#[derive(Clone, Copy, Debug, Default, Serialize)]
struct StepCounts {
    steps: u64,
    skipped: u64,
    by_timer: u64,
    deadline_misses: u64,
    late_triggers: u64,
    repeats: u64,
    not_finite: u64,
}

#[derive(Debug)]
struct Witness {
    name: String,
    source: String,
    seen: Option<u64>,
}

#[derive(Debug, Default)]
struct Stream {
    seq: u64,
    client: String,
    heard_at: Duration,
    live: bool,
    accepted: u64,
    refused: u64,
}

/// Names of the set-points that may be streamed.
pub const STREAMS: [&str; 4] = ["depth_m", "heading_rad", "net_distance_m", "speed_m_per_s"];

/// A block behind its keys.
pub struct Host<B: Wired> {
    block: B,
    /// The block as it was built: another run starts from here.
    pristine: B,
    ports: B::Ports,
    wires: Vec<Wire>,
    watch: Watch,
    probe: DigestProbe,
    desk: Desk<B::Command>,
    options: HostOptions<B::Command>,
    clock: Arc<dyn Clock>,
    source: String,
    run: String,
    next: u64,
    beat: Beat,
    output: Option<(u64, B::Out, u64)>,
    telemetry: Option<Vec<u8>>,
    seq: u64,
    event_seq: u64,
    sent_at: Duration,
    heard_at: Duration,
    repeat_after: Duration,
    fault: Option<Fault>,
    witnesses: Vec<Witness>,
    authority: Option<Authority>,
    lease: LeaseView,
    operator_was: OperatorLink,
    streams: [Stream; STREAMS.len()],
    steps: StepCounts,
    refused_reported: (Duration, u64),
    overflow: Overflow,
    step_us: Vec<f64>,
    health_due: Duration,
    digests: VecDeque<(u64, u64)>,
    ending: Option<Ending>,
    buffer: Vec<u8>,
    thrown: u64,
    publisher: Publisher<'static>,
    stop_publisher: Publisher<'static>,
    outbox: Outbox,
    session: Session,
    asides: Vec<String>,
    // Kept for what dropping them would undo.
    _subscribers: Vec<Subscriber<()>>,
    _liveliness: Vec<Subscriber<()>>,
    _queryables: Vec<Queryable<()>>,
    _token: zenoh::liveliness::LivelinessToken,
}

/// First wait before an output is repeated in lock step.
const REPEAT_FIRST: Duration = Duration::from_millis(4);
/// Longest wait between repetitions.
const REPEAT_MOST: Duration = Duration::from_millis(250);
/// Nothing is repeated more often than this.
const REPEAT_LEAST: Duration = Duration::from_millis(2);
/// Longest wait for those who are up, when a service starts.
const REJOIN: Duration = Duration::from_millis(300);
/// After its last tick a service answers the others for this long, when nobody says that the run is over.
const LINGER: Duration = Duration::from_secs(2);
/// Before the first message of a run the others may take this long to come up.
const START_PATIENCE: Duration = Duration::from_secs(60);
/// A message from this far in the future is a mistake or an attack.
const FUTURE_S: f64 = 60.0;
/// The owner of time makes up for at most this much after it was stopped.
const CATCH_UP_S: f64 = 30.0;

struct Keys(Vec<(&'static str, PortRule)>);
impl PortVisitor for Keys {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        self.0.push((M::KEY, port.rule()));
    }
}

struct AsideKeys(Vec<String>);
impl MessageVisitor for AsideKeys {
    fn message<M: Message>(&mut self, _: &M) {
        self.0.push(M::KEY.to_owned());
    }
}

/// Puts a payload into port number `wanted`.
struct Deliver<'a> {
    wanted: usize,
    at: usize,
    payload: &'a [u8],
    ledger: &'a mut Ledger,
    run: &'a mut String,
    lock_step: bool,
    now: Duration,
    newest_allowed: u64,
    outcome: Delivered,
}

#[derive(Debug, Default)]
enum Delivered {
    #[default]
    Nothing,
    Rejected(Rejected),
    /// Not for us: another run, a rival, a repetition.
    Left {
        repeat: bool,
    },
    /// Another instance writes now, or another run began.
    Changed {
        source: String,
        run: String,
        tick: u64,
    },
    Taken {
        tick: u64,
        clock_ns: u64,
        trigger: bool,
        gap: u64,
        takeover: bool,
    },
}

impl PortVisitor for Deliver<'_> {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        self.at += 1;
        if self.at != self.wanted + 1 {
            return;
        }
        let envelope: Envelope<'_, M> = match decode(self.payload) {
            Ok(envelope) => envelope,
            Err(rejected) => {
                self.ledger.counts.rejected += 1;
                self.outcome = Delivered::Rejected(rejected);
                return;
            }
        };
        if envelope.tick > self.newest_allowed {
            self.ledger.counts.rejected += 1;
            let text = format!("tick {} lies too far ahead", envelope.tick);
            self.outcome = Delivered::Rejected(Rejected::Malformed(text));
            return;
        }
        let changed = |envelope: &Envelope<'_, M>| Delivered::Changed {
            source: envelope.source.clone().into_owned(),
            run: envelope.run.clone().into_owned(),
            tick: envelope.tick,
        };
        let others_run = !envelope.run.is_empty() && !self.run.is_empty() && envelope.run != *self.run;
        if others_run && self.lock_step {
            self.outcome = changed(&envelope);
            return;
        }
        let verdict = self.ledger.enter(&envelope.source, envelope.seq, self.now);
        let (gap, takeover) = match verdict {
            Verdict::New { gap } => (gap, false),
            Verdict::Takeover if self.lock_step => {
                self.outcome = changed(&envelope);
                return;
            }
            Verdict::Takeover => (0, true),
            Verdict::Rival if self.lock_step => {
                self.outcome = changed(&envelope);
                return;
            }
            Verdict::Duplicate | Verdict::Rival => {
                self.outcome = Delivered::Left { repeat: envelope.repeat };
                return;
            }
        };
        if others_run && port.rule().trigger {
            self.outcome = changed(&envelope);
            return;
        }
        if self.run.is_empty() && !envelope.run.is_empty() {
            *self.run = envelope.run.clone().into_owned();
        }
        let (tick, clock_ns, repeat) = (envelope.tick, envelope.clock_ns, envelope.repeat);
        match port.offer(tick, envelope.data) {
            Offered::Old => {
                self.ledger.counts.old += 1;
                self.outcome = Delivered::Left { repeat };
                return;
            }
            Offered::Displaced => self.ledger.counts.displaced += 1,
            Offered::Taken => {}
        }
        self.outcome = Delivered::Taken { tick, clock_ns, trigger: port.rule().trigger, gap, takeover };
    }
}

/// Whether step k has all it needs, and the ticks of what it would use.
struct Readiness<'a> {
    k: u64,
    ready: bool,
    at: usize,
    used: &'a mut Vec<(&'static str, u64)>,
    ages: &'a mut [Wire],
}

impl PortVisitor for Readiness<'_> {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        self.ready &= port.ready(self.k);
        if let Some(made_at) = port.made_at() {
            self.used.push((M::KEY, made_at));
            let age = port.expected(self.k).map_or(0, |expected| expected.saturating_sub(made_at));
            if let Some(wire) = self.ages.get_mut(self.at) {
                wire.age_max = wire.age_max.max(age);
            }
        }
        self.at += 1;
    }
}

struct Ready(u64, bool);
impl PortVisitor for Ready {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        self.1 &= port.ready(self.0);
    }
}

struct Missing(u64, Vec<&'static str>);
impl PortVisitor for Missing {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        if !port.ready(self.0) {
            self.1.push(M::KEY);
        }
    }
}

struct Stepped;
impl PortVisitor for Stepped {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        port.stepped();
    }
}

struct Clear;
impl PortVisitor for Clear {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        port.clear();
    }
}

struct AsideWriter<'a> {
    envelope: Envelope<'a, ()>,
    outbox: &'a Outbox,
    at: usize,
}
impl MessageVisitor for AsideWriter<'_> {
    fn message<M: Message>(&mut self, message: &M) {
        self.at += 1;
        let envelope = with(&self.envelope, message);
        let mut payload = Vec::with_capacity(1024);
        if encode(&envelope, &mut payload).is_ok() {
            // Number 0 is telemetry.
            self.outbox.telemetry(self.at, payload);
        }
    }
}

fn with<'a, T>(envelope: &Envelope<'a, ()>, data: T) -> Envelope<'a, T> {
    Envelope {
        run: envelope.run.clone(),
        source: envelope.source.clone(),
        tick: envelope.tick,
        seq: envelope.seq,
        sim_time_s: envelope.sim_time_s,
        clock_ns: envelope.clock_ns,
        digest: envelope.digest.clone(),
        repeat: envelope.repeat,
        data,
    }
}

impl<B: Wired + 'static> Host<B> {
    /// Declares everything on `session`; `index` is the host's number in `mailbox`.
    ///
    /// # Errors
    /// When something can't be declared.
    pub fn open(
        session: &Session,
        block: B,
        options: HostOptions<B::Command>,
        mailbox: &Arc<Mailbox>,
        index: usize,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, LinkError> {
        let mut ports = B::ports();
        let mut keys = Keys(Vec::new());
        B::visit(&mut ports, &mut keys);
        let mut asides = AsideKeys(Vec::new());
        block.asides(&mut asides);
        let mut droppable = vec![keys::telemetry(B::NAME)];
        droppable.extend(asides.0.iter().cloned());
        let outbox = Outbox::open(session, B::NAME, &droppable)?;
        let publisher = wire_publisher(session, B::Out::KEY)?;
        let stop_publisher = wire_publisher(session, &keys::stop(B::NAME))?;

        let silence = match options.pace {
            Pace::RealTime(factor) => Duration::from_secs_f64(3.0 * options.tick_s / factor),
            Pace::LockStep => Duration::MAX,
        };
        let mut sides: Vec<(String, Side)> =
            keys.0.iter().enumerate().map(|(i, (key, _))| ((*key).to_owned(), Side::Port(i))).collect();
        if options.takes_setpoints {
            sides.extend(STREAMS.iter().enumerate().map(|(i, name)| (keys::setpoint(name), Side::Setpoint(i))));
        }
        if !options.keeps_authority {
            sides.push((keys::LEASE_STATE.to_owned(), Side::Lease));
        }
        if options.pace == Pace::LockStep {
            sides.push((keys::stop("*"), Side::Stop));
            if !options.witnesses.is_empty() {
                sides.push((keys::witness("*"), Side::Witness));
            }
        }
        let mut subscribers = Vec::new();
        for (number, (key, _)) in sides.iter().enumerate() {
            let mailbox = Arc::clone(mailbox);
            let subscriber = session
                .declare_subscriber(key.clone())
                .callback(move |sample| {
                    if sample.kind() == SampleKind::Put {
                        mailbox.wire(index, number, sample.payload().clone());
                    }
                })
                .wait()
                .map_err(LinkError::session(format!("subscriber {key}")))?;
            subscribers.push(subscriber);
        }
        let mut liveliness = Vec::new();
        if options.keeps_authority {
            let number = sides.len();
            sides.push((keys::operator("*"), Side::Operator));
            let mailbox = Arc::clone(mailbox);
            let gone = session
                .liveliness()
                .declare_subscriber(keys::operator("*"))
                .callback(move |sample| {
                    if sample.kind() == SampleKind::Delete {
                        let client = sample.key_expr().as_str().rsplit('/').next().unwrap_or("").to_owned();
                        mailbox.wire(index, number, ZBytes::from(client));
                    }
                })
                .wait()
                .map_err(LinkError::session("liveliness of operators"))?;
            liveliness.push(gone);
        }
        let wires = sides
            .iter()
            .map(|(_, side)| Wire {
                side: *side,
                ledger: Ledger::new(silence),
                held: None,
                age_max: 0,
                transport_ms_max: 0.0,
            })
            .collect();

        let mut queryables = Vec::new();
        let mut served = vec![
            keys::command(B::NAME, "*"),
            format!("{}/**", keys::param(B::NAME, "")),
            keys::held(B::NAME, "**"),
            keys::state(B::NAME, "now"),
        ];
        if options.keeps_authority {
            served.push(keys::LEASE.to_owned());
            served.push(keys::PING.to_owned());
        }
        for key in served {
            let mailbox = Arc::clone(mailbox);
            let queryable = session
                .declare_queryable(key.clone())
                .complete(true)
                .callback(move |query| {
                    let urgent = query.key_expr().as_str().ends_with("/neutral");
                    mailbox.request(index, query, urgent);
                })
                .wait()
                .map_err(LinkError::session(format!("queryable {key}")))?;
            queryables.push(queryable);
        }
        let mut states = vec![keys::state(B::NAME, "*")];
        if options.keeps_authority {
            states.push(keys::LEASE_STATE.to_owned());
        }
        for key in states {
            let slot = outbox.slot();
            let queryable = session
                .declare_queryable(key.clone())
                .callback(move |query| slot.send(Letter::StateQuery(query)))
                .wait()
                .map_err(LinkError::session(format!("queryable {key}")))?;
            queryables.push(queryable);
        }
        let token = session
            .liveliness()
            .declare_token(keys::alive(B::NAME, &options.instance))
            .wait()
            .map_err(LinkError::session("liveliness token"))?;

        let now = clock.now();
        let owner = B::OWNS_TIME;
        let mut host = Self {
            watch: Watch::new(&block),
            pristine: block.clone(),
            block,
            ports,
            wires,
            probe: DigestProbe::default(),
            desk: Desk::new(&options.mission),
            source: format!("{}-{}", B::NAME, options.instance),
            run: if owner { options.run.clone() } else { String::new() },
            next: 0,
            beat: Beat::default(),
            output: None,
            telemetry: None,
            seq: 0,
            event_seq: 0,
            sent_at: now,
            heard_at: now,
            repeat_after: REPEAT_FIRST,
            fault: options.faults.map(|rates| Fault::new(rates, B::NAME)),
            witnesses: options
                .witnesses
                .iter()
                .map(|name| Witness { name: name.clone(), source: String::new(), seen: None })
                .collect(),
            authority: options.keeps_authority.then(Authority::default),
            lease: LeaseView::default(),
            operator_was: OperatorLink::Present,
            streams: Default::default(),
            steps: StepCounts::default(),
            refused_reported: (now, 0),
            overflow: Overflow::default(),
            step_us: Vec::with_capacity(128),
            health_due: now + Duration::from_secs(1),
            digests: VecDeque::new(),
            ending: None,
            buffer: Vec::with_capacity(4096),
            thrown: 0,
            publisher,
            stop_publisher,
            outbox,
            session: session.clone(),
            asides: asides.0,
            options,
            clock,
            _subscribers: subscribers,
            _liveliness: liveliness,
            _queryables: queryables,
            _token: token,
        };
        if host.options.rejoins && matches!(host.options.pace, Pace::RealTime(_)) {
            host.rejoin()?;
        }
        if let Some(authority) = &host.authority {
            let state = authority.state(now);
            host.tell_state(keys::LEASE_STATE.to_owned(), &state);
        }
        host.tell_parameters();
        Ok(host)
    }

    fn lock_step(&self) -> bool {
        self.options.pace == Pace::LockStep
    }

    /// Length of a tick on the wall.
    fn beat_length(&self) -> Duration {
        match self.options.pace {
            Pace::RealTime(factor) => Duration::from_secs_f64(self.options.tick_s / factor),
            Pace::LockStep => Duration::ZERO,
        }
    }

    fn tick(&self, k: u64) -> Tick {
        Tick { k, dt_s: self.options.tick_s }
    }

    /// Real time: learns from those who are up which run and tick it is, who has the lease, and what the last
    /// messages were.
    fn rejoin(&mut self) -> Result<(), LinkError> {
        let ask = |key: String| {
            self.session
                .get(key.clone())
                .target(zenoh::query::QueryTarget::All)
                .consolidation(zenoh::query::ConsolidationMode::None)
                .timeout(REJOIN)
                .wait()
                .map_err(LinkError::session(key))
        };
        // All questions at once: whoever is up answers within a tick, and the wait is one time-out at worst.
        let (nows, lease) = (ask(keys::state("*", "now"))?, ask(keys::LEASE_STATE.to_owned())?);
        let mut names = Keys(Vec::new());
        B::visit(&mut B::ports(), &mut names);
        let kept = names.0.iter().map(|(key, _)| ask(keys::held("*", key))).collect::<Result<Vec<_>, _>>()?;
        let payloads = |replies: zenoh::handlers::FifoChannelHandler<zenoh::query::Reply>| -> Vec<ZBytes> {
            let samples = replies.into_iter().filter_map(|reply| reply.into_result().ok());
            samples.map(|sample| sample.payload().clone()).collect()
        };
        let mut newest: Option<Now> = None;
        for payload in payloads(nows) {
            let Ok(now) = serde_json::from_slice::<Now>(&payload.to_bytes()) else { continue };
            let others = now.source != self.source && !now.run.is_empty() && now.next > 0;
            if others && newest.as_ref().is_none_or(|best| now.next > best.next) {
                newest = Some(now);
            }
        }
        let held: Vec<(usize, ZBytes)> = kept
            .into_iter()
            .enumerate()
            .flat_map(|(i, replies)| payloads(replies).into_iter().map(move |payload| (i, payload)))
            .collect();
        let lease = payloads(lease);
        let Some(newest) = newest else { return Ok(()) };
        if B::OWNS_TIME {
            self.run.clone_from(&newest.run);
            self.next = newest.next + 1;
            // Its mission up to here is history.
            self.desk.due(self.next.saturating_sub(1));
            self.note(Severity::Info, format!("rejoins run {} at tick {}", self.run, self.next));
        }
        for (i, payload) in held {
            self.offer_held(i, &payload, &newest.run);
        }
        for payload in lease {
            self.lease_state(&payload.to_bytes());
        }
        Ok(())
    }

    /// A message that somebody kept: known, but nothing new, and no sign that its writer is alive.
    fn offer_held(&mut self, i: usize, payload: &ZBytes, run: &str) {
        let mut scratch = Ledger::new(Duration::ZERO);
        let mut its_run = run.to_owned();
        let mut deliver = Deliver {
            wanted: i,
            at: 0,
            payload: &payload.to_bytes(),
            ledger: &mut scratch,
            run: &mut its_run,
            lock_step: false,
            now: self.clock.now(),
            newest_allowed: u64::MAX - 1,
            outcome: Delivered::Nothing,
        };
        B::visit(&mut self.ports, &mut deliver);
        if let Delivered::Taken { .. } = deliver.outcome {
            self.wires[i].held = Some(payload.clone());
        }
    }

    fn note(&mut self, severity: Severity, text: String) {
        let tick = self.next;
        self.tell(&Event { tick, service: Cow::Borrowed(B::NAME), severity, text: Cow::Owned(text) });
    }

    fn header(&self, k: u64, seq: u64) -> Envelope<'_, ()> {
        Envelope {
            run: Cow::Borrowed(&self.run),
            source: Cow::Borrowed(&self.source),
            tick: k,
            seq,
            sim_time_s: self.tick(k).t_s(),
            clock_ns: self.clock.unix_ns(),
            digest: None,
            repeat: false,
            data: (),
        }
    }

    fn tell(&mut self, event: &Event) {
        self.event_seq += 1;
        let mut payload = Vec::with_capacity(256);
        if encode(&with(&self.header(event.tick, self.event_seq), event), &mut payload).is_ok() {
            self.outbox.send(Letter::Event(payload));
        }
    }

    fn tell_state(&self, name: String, state: &impl Serialize) {
        if let Ok(payload) = serde_json::to_vec(state) {
            self.outbox.send(Letter::State(name, payload));
        }
    }

    fn tell_parameters(&self) {
        let parameters = self.block.parameters();
        if !parameters.is_null() {
            self.tell_state("parameters".to_owned(), &parameters);
        }
    }

    fn refused(&mut self, what: &str) {
        // A flood makes one event a second, not one per message; every one is counted.
        let (at, count) = &mut self.refused_reported;
        *count += 1;
        let now = self.clock.now();
        if *count == 1 || now.saturating_sub(*at) >= Duration::from_secs(1) {
            let text = format!("refused: {what} ({count} so far)");
            *at = now;
            self.note(Severity::Error, text);
        }
    }

    fn fail(&mut self, reason: String) {
        if self.ending.is_none() {
            self.note(Severity::Error, reason.clone());
            self.say_stop(false, &reason);
            self.ending = Some(Ending::Failed(reason));
        }
    }

    fn say_stop(&self, complete: bool, reason: &str) {
        let stop = Stop {
            run: self.run.clone(),
            source: self.source.clone(),
            tick: self.next,
            complete,
            reason: reason.to_owned(),
        };
        if self.lock_step()
            && let Ok(payload) = serde_json::to_vec(&stop)
        {
            // The others also end by their own patience.
            let _ = self.stop_publisher.put(payload).wait();
        }
    }

    // -------------------------------------------------------------------------------------------------- arriving

    fn wire(&mut self, number: usize, payload: &ZBytes) {
        match self.wires[number].side {
            Side::Port(i) => self.port(number, i, payload),
            Side::Setpoint(i) => self.streamed(i, &payload.to_bytes()),
            Side::Lease => self.lease_state(&payload.to_bytes()),
            Side::Stop => self.stop(&payload.to_bytes()),
            Side::Witness => self.witness(&payload.to_bytes()),
            Side::Operator => {
                let gone = payload.to_bytes();
                let client = String::from_utf8_lossy(&gone);
                let now = self.clock.now();
                if let Some(authority) = &mut self.authority
                    && authority.vanished(&client)
                {
                    let state = authority.state(now);
                    self.tell_state(keys::LEASE_STATE.to_owned(), &state);
                    self.note(Severity::Warning, format!("operator {client} has vanished; its lease is over"));
                }
            }
        }
    }

    fn port(&mut self, number: usize, i: usize, payload: &ZBytes) {
        let now = self.clock.now();
        let elapsed_s = now.saturating_sub(self.heard_at).as_secs_f64();
        let ahead = (elapsed_s + FUTURE_S) / self.options.tick_s;
        let known = !self.run.is_empty() || B::OWNS_TIME;
        let bytes = payload.to_bytes();
        let was_source = self.wires[number].ledger.source().to_owned();
        let mut deliver = Deliver {
            wanted: i,
            at: 0,
            payload: &bytes,
            ledger: &mut self.wires[number].ledger,
            run: &mut self.run,
            lock_step: self.options.pace == Pace::LockStep,
            now,
            newest_allowed: if known { self.next.saturating_add(ahead as u64) } else { u64::MAX / 2 },
            outcome: Delivered::Nothing,
        };
        B::visit(&mut self.ports, &mut deliver);
        match deliver.outcome {
            Delivered::Nothing => {}
            Delivered::Rejected(rejected) => self.refused(&format!("message on wire {number}: {rejected}")),
            Delivered::Left { repeat } => self.answer_repetition(repeat, now),
            Delivered::Changed { source, run, tick } => self.changed(&was_source, &source, &run, tick, payload),
            Delivered::Taken { tick, clock_ns, trigger, gap, takeover } => {
                self.heard_at = now;
                self.repeat_after = REPEAT_FIRST;
                let late_ns = self.clock.unix_ns().saturating_sub(clock_ns);
                let wire = &mut self.wires[number];
                wire.held = Some(payload.clone());
                if clock_ns > 0 {
                    wire.transport_ms_max = wire.transport_ms_max.max(late_ns as f64 / 1e6);
                }
                if !self.lock_step() {
                    if trigger {
                        self.beat.trigger = Some(tick);
                    } else if tick < self.next.saturating_sub(1) {
                        self.wires[number].ledger.counts.late += 1;
                    }
                    if gap > 0 {
                        self.note(Severity::Warning, format!("gap: {gap} messages missing from {was_source}"));
                    }
                    if takeover {
                        let source = self.wires[number].ledger.source().to_owned();
                        self.note(Severity::Info, format!("{source} takes over from {was_source}"));
                    }
                }
            }
        }
    }

    /// Another instance or another run: the end of a lock-step run, a fresh start in real time.
    fn changed(&mut self, was: &str, source: &str, run: &str, tick: u64, payload: &ZBytes) {
        if self.lock_step() {
            if self.output.is_none() && was.is_empty() && tick > 0 {
                self.fail(format!("{source} is at tick {tick} of run {run} already: a service can't join later"));
            } else if was.is_empty() || run != self.run {
                self.fail(format!("{source} belongs to run {run}, this is run {}", self.run));
            } else {
                self.fail(format!("{source} came in the place of {was}, without its state"));
            }
            return;
        }
        self.note(Severity::Warning, format!("run {run} begins at tick {tick}; starts afresh"));
        self.block = self.pristine.clone();
        self.watch = Watch::new(&self.block);
        self.desk = Desk::new(&self.options.mission);
        self.next = tick;
        run.clone_into(&mut self.run);
        self.output = None;
        self.beat = Beat { due: None, trigger: None };
        B::visit(&mut self.ports, &mut Clear);
        for i in 0..self.wires.len() {
            if let Side::Port(_) = self.wires[i].side {
                self.wires[i].held = None;
            }
        }
        self.desk.due(tick.saturating_sub(1));
        // The message that said so is the first of the run.
        for i in 0..self.wires.len() {
            if let Side::Port(_) = self.wires[i].side
                && self.wires[i].ledger.source() == source
            {
                self.offer_held(i, payload, run);
            }
        }
        self.beat.trigger = Some(tick);
    }

    fn answer_repetition(&mut self, repeat: bool, now: Duration) {
        // A doubled message is left; one that was sent again because somebody misses our answer gets it.
        if self.lock_step() && repeat && now.saturating_sub(self.sent_at) >= REPEAT_LEAST {
            self.send_again();
        }
    }

    fn stop(&mut self, payload: &[u8]) {
        let Ok(stop) = serde_json::from_slice::<Stop>(payload) else { return };
        if stop.source == self.source || (!self.run.is_empty() && stop.run != self.run) || self.ending.is_some() {
            return;
        }
        let done = self.options.ticks.is_some_and(|ticks| self.next >= ticks);
        self.ending = Some(if stop.complete && done { Ending::Complete } else { Ending::Stopped(stop.reason) });
    }

    fn witness(&mut self, payload: &[u8]) {
        let Ok(seen) = serde_json::from_slice::<Seen>(payload) else { return };
        if seen.run != self.run {
            return;
        }
        let now = self.clock.now();
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
            self.heard_at = now;
            self.repeat_after = REPEAT_FIRST;
        } else {
            self.answer_repetition(seen.repeat, now);
        }
    }

    fn lease_state(&mut self, payload: &[u8]) {
        if self.authority.is_none()
            && let Ok(state) = serde_json::from_slice::<LeaseState>(payload)
        {
            self.lease.update(state, self.clock.now());
        }
    }

    fn lease(&self) -> &LeaseView {
        self.authority.as_ref().map_or(&self.lease, Authority::view)
    }

    fn streamed(&mut self, i: usize, payload: &[u8]) {
        let now = self.clock.now();
        let taken = (|| {
            if payload.len() > MAX_PAYLOAD / 64 {
                return Err(format!("{} bytes", payload.len()));
            }
            let sample: StreamedSetpoint = serde_json::from_slice(payload).map_err(|error| error.to_string())?;
            self.lease().allows(&sample.client, &sample.token, now)?;
            let stream = &self.streams[i];
            if stream.client == sample.client && sample.seq <= stream.seq {
                return Err(format!("seq = {}: must be greater than {}", sample.seq, stream.seq));
            }
            if let Some(value) = sample.value {
                let command =
                    serde_json::from_value(json!({ STREAMS[i]: value })).map_err(|error| error.to_string())?;
                self.block.clone().command(self.tick(self.next), &command).map_err(|refusal| refusal.0)?;
                self.desk.stream(STREAMS[i], value, &sample.client, self.next)?;
            }
            Ok(sample)
        })();
        match taken {
            Ok(sample) => {
                let stream = &mut self.streams[i];
                stream.live = sample.value.is_some();
                stream.client = sample.client;
                stream.seq = sample.seq;
                stream.heard_at = now;
                stream.accepted += 1;
            }
            Err(why) => {
                self.streams[i].refused += 1;
                self.refused(&format!("setpoint/{}: {why}", STREAMS[i]));
            }
        }
    }

    // ------------------------------------------------------------------------------------------------- requests

    fn answer(&mut self, query: Query) {
        let key = query.key_expr().as_str().to_owned();
        let payload = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
        let mut parts = key.splitn(3, '/');
        let (kind, _, name) = (parts.next().unwrap_or(""), parts.next(), parts.next().unwrap_or(""));
        let answer = match kind {
            "command" => self.command(name, &payload),
            "param" if payload.is_empty() => self.parameter(&name.replace('/', ".")),
            "param" => self.set_parameter(&name.replace('/', "."), &payload),
            "authority" => self.authority(&payload),
            "clock" => Ok(json!({ "received_ns": self.clock.unix_ns() })),
            "state" if name == "now" => {
                let now = Now { run: self.run.clone(), source: self.source.clone(), next: self.next };
                serde_json::to_value(now).map_err(|error| json!(error.to_string()))
            }
            "state" => {
                let wire = name.strip_prefix("held/").unwrap_or(name);
                return self.answer_held(query, wire);
            }
            _ => Err(json!({ "status": "refused", "reason": format!("{key}: no such request") })),
        };
        let bytes = |value: Value| value.to_string().into_bytes();
        let own_key = (kind == "state").then(|| keys::state(B::NAME, name));
        self.outbox.send(Letter::Answer(query, own_key, answer.map(bytes).map_err(bytes)));
    }

    fn answer_held(&self, query: Query, wire: &str) {
        let mut names = Keys(Vec::new());
        B::visit(&mut B::ports(), &mut names);
        let i = names.0.iter().position(|(key, _)| *key == wire);
        match i.and_then(|i| self.wires[i].held.as_ref()) {
            Some(payload) => {
                // The key must be ours, not the question's pattern.
                let key = Some(keys::held(B::NAME, wire));
                self.outbox.send(Letter::Answer(query, key, Ok(payload.to_bytes().into_owned())));
            }
            None => drop(query),
        }
    }

    fn moment(&self) -> Moment {
        Moment { now: self.clock.now(), next: self.next, tick_s: self.options.tick_s, lead: self.options.lead_ticks }
    }

    fn command(&mut self, name: &str, payload: &[u8]) -> Result<Value, Value> {
        let moment = self.moment();
        let tick = self.tick(self.next);
        let (block, lease) = (&self.block, self.authority.as_ref().map_or(&self.lease, Authority::view));
        let before = self.desk.counts;
        let answer = self.desk.submit(name, payload, lease, moment, |command| block.clone().command(tick, command));
        let after = self.desk.counts;
        let value = serde_json::to_value(&answer).unwrap_or(Value::Null);
        match answer {
            crate::desk::Answer::Scheduled { apply_tick, .. } => {
                if after.scheduled > before.scheduled {
                    let who = said(payload);
                    self.note(Severity::Info, format!("command scheduled for tick {apply_tick}: {name} {who}"));
                }
                Ok(value)
            }
            crate::desk::Answer::Refused { reason, .. } => {
                self.refused(&format!("command {name} {}: {reason}", said(payload)));
                Err(value)
            }
        }
    }

    fn set_parameter(&mut self, path: &str, payload: &[u8]) -> Result<Value, Value> {
        let inner = serde_json::from_slice::<Request>(payload).map(|mut request| {
            request.value = json!({ "path": path, "value": request.value });
            serde_json::to_vec(&request).unwrap_or_default()
        });
        // What is no request is refused by the desk, in its own words.
        self.command("parameter", &inner.unwrap_or_else(|_| payload.to_vec()))
    }

    fn parameter(&self, path: &str) -> Result<Value, Value> {
        let parameters = self.block.parameters();
        let mut place = &parameters;
        for name in path.split('.').filter(|name| !name.is_empty()) {
            let next = match place {
                Value::Object(map) => map.get(name),
                Value::Array(list) => name.parse::<usize>().ok().and_then(|i| list.get(i)),
                _ => None,
            };
            let reason = || json!({ "status": "refused", "reason": format!("{} has no parameter {path}", B::NAME) });
            place = next.ok_or_else(reason)?;
        }
        Ok(place.clone())
    }

    fn authority(&mut self, payload: &[u8]) -> Result<Value, Value> {
        let now = self.clock.now();
        let Some(authority) = &mut self.authority else {
            return Err(json!({ "reason": "this service does not keep the authority" }));
        };
        let request: LeaseRequest = match serde_json::from_slice(payload) {
            Ok(request) if payload.len() <= crate::desk::MAX_REQUEST => request,
            Ok(_) => return Err(json!({ "reason": "too large" })),
            Err(error) => {
                let reason = format!("authority/lease: {error}");
                self.refused(&reason);
                return Err(json!({ "reason": reason }));
            }
        };
        let token = zenoh::session::ZenohId::default().to_string() + &zenoh::session::ZenohId::default().to_string();
        let (reply, changed) = authority.answer(&request, &token, now);
        let state = authority.state(now);
        if changed {
            // Before the answer and with a higher priority: who is granted may command at once.
            self.tell_state(keys::LEASE_STATE.to_owned(), &state);
        }
        self.lease_event(&request, &reply);
        let value = serde_json::to_value(&reply).unwrap_or(Value::Null);
        if reply.reason.is_some() { Err(value) } else { Ok(value) }
    }

    fn lease_event(&mut self, request: &LeaseRequest, reply: &LeaseReply) {
        use crate::authority::LeaseAction;
        match (request.action, &reply.reason) {
            (LeaseAction::Acquire, None) if reply.token.is_some() => {
                self.note(Severity::Info, format!("{} has the authority for {} s", request.client, request.for_s));
            }
            (LeaseAction::Release, None) => {
                self.note(Severity::Info, format!("{} gives the authority back", request.client));
            }
            (_, Some(reason)) => self.refused(&format!("authority for {:?}: {reason}", request.client)),
            _ => {}
        }
    }

    // ------------------------------------------------------------------------------------------------- stepping

    fn operator(&mut self) -> OperatorLink {
        if !self.options.takes_setpoints {
            return OperatorLink::Present;
        }
        let now = self.clock.now();
        let (deadman, lease) = (self.options.deadman, self.lease());
        let silent = self.streams.iter().any(|stream| {
            // A stream whose client has given the authority back is over.
            let theirs = lease.holder(now) == Some(stream.client.as_str());
            stream.live && theirs && now.saturating_sub(stream.heard_at) > deadman
        });
        let link = if lease.operator_lost(now) || silent { OperatorLink::Lost } else { OperatorLink::Present };
        if core::mem::replace(&mut self.operator_was, link) != link {
            match link {
                OperatorLink::Lost if silent => self.note(Severity::Warning, "deadman: set-points stopped".to_owned()),
                OperatorLink::Lost => self.note(Severity::Warning, "operator lost".to_owned()),
                OperatorLink::Present => self.note(Severity::Info, "operator present".to_owned()),
            }
        }
        link
    }

    fn apply(&mut self, k: u64) -> Vec<Value> {
        let mut applied = Vec::new();
        for waiting in self.desk.due(k) {
            let text = serde_json::to_value(&waiting.command).unwrap_or(Value::Null);
            let said = waiting.by.as_ref().map_or_else(|| text.to_string(), |by| format!("{text} by {by}"));
            // Missions speak with the voice they have in batch.
            let service = if waiting.by.is_some() { B::NAME } else { "mission" };
            let streaming = waiting.by.as_ref().is_some_and(|by| by.ends_with("streaming"));
            let (severity, text_of_event) = match self.block.command(self.tick(k), &waiting.command) {
                Ok(()) => {
                    self.desk.counts.applied += 1;
                    if waiting.name.starts_with("parameter") {
                        self.tell_parameters();
                    }
                    let value = text.get(&waiting.name).unwrap_or(&text).clone();
                    self.tell_state(waiting.name, &json!({ "value": value, "applied_tick": k, "by": waiting.by }));
                    applied.push(text);
                    (Severity::Info, format!("command applied: {said}"))
                }
                Err(refusal) => (Severity::Error, format!("command refused: {said}: {refusal}")),
            };
            if !streaming || severity > Severity::Info {
                let text = Cow::Owned(text_of_event);
                self.tell(&Event { tick: k, service: Cow::Borrowed(service), severity, text });
            }
        }
        applied
    }

    fn step(&mut self, k: u64, publish: bool) {
        let began = self.clock.now();
        let commands = self.apply(k);
        let operator = self.operator();
        let tick = self.tick(k);
        let mut used = Vec::with_capacity(4);
        let mut readiness = Readiness { k, ready: true, at: 0, used: &mut used, ages: &mut self.wires };
        B::visit(&mut self.ports, &mut readiness);
        let out = self.block.step(tick, B::input(&self.ports, tick, operator));
        B::visit(&mut self.ports, &mut Stepped);
        self.next = k + 1;
        self.steps.steps += 1;
        let digest = block_digest(&mut self.probe, &self.block, &out);
        if !self.probe.take_finite() {
            self.steps.not_finite += 1;
            let mut shown = Snapshot::of(&self.block);
            let of_output = Snapshot::of(&out);
            shown.vectors.extend(of_output.vectors);
            let path = shown.first_non_finite().map_or("a quantity", |signal| signal.path);
            let text = format!("tick {k}: {path} is NaN or infinite; not sent");
            if self.lock_step() {
                self.fail(text);
            } else {
                self.refused(&text);
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
            self.seq += 1;
            self.output = Some((k, out, digest));
            self.send_output(false);
            self.send_telemetry(k, digest, &used, &commands);
        }
        let took = self.clock.now().saturating_sub(began);
        if self.step_us.len() >= 256 {
            self.step_us.remove(0);
        }
        self.step_us.push(took.as_secs_f64() * 1e6);
    }

    fn send_output(&mut self, repeat: bool) {
        let Some((k, out, digest)) = &self.output else { return };
        let mut buffer = core::mem::take(&mut self.buffer);
        buffer.clear();
        let mut envelope = with(&self.header(*k, self.seq), out);
        envelope.digest = Some(Cow::Owned(format!("{digest:016x}")));
        envelope.repeat = repeat;
        let encoded = encode(&envelope, &mut buffer);
        let copies = self.fault.as_mut().map_or(1, Fault::copies);
        if encoded.is_ok() {
            let payload = ZBytes::from(buffer.as_slice());
            for _ in 0..copies {
                // What does not get through is a gap to its receivers, and repeated in lock step.
                let _ = self.publisher.put(payload.clone()).wait();
            }
        }
        self.buffer = buffer;
        self.sent_at = self.clock.now();
    }

    fn send_telemetry(&mut self, k: u64, digest: u64, used: &[(&'static str, u64)], commands: &[Value]) {
        let every = self.options.telemetry_every;
        if every == 0 || !k.is_multiple_of(every) {
            return;
        }
        let Some((_, out, _)) = &self.output else { return };
        let mut envelope = with(&self.header(k, self.seq), Shown::<B> { used, commands, signals: (&self.block, out) });
        envelope.digest = Some(Cow::Owned(format!("{digest:016x}")));
        let mut payload = Vec::with_capacity(4096);
        if encode(&envelope, &mut payload).is_err() {
            self.thrown += 1;
            return;
        }
        if !self.asides.is_empty() {
            let mut writer = AsideWriter { envelope: self.header(k, self.seq), outbox: &self.outbox, at: 0 };
            self.block.asides(&mut writer);
        }
        let copies = self.fault.as_mut().map_or(1, Fault::copies);
        for _ in 0..copies {
            self.outbox.telemetry(0, payload.clone());
        }
        self.telemetry = self.lock_step().then_some(payload);
    }

    fn send_again(&mut self) {
        if self.output.is_some() {
            self.steps.repeats += 1;
            self.send_output(true);
            if let Some(payload) = self.telemetry.clone() {
                self.outbox.telemetry(0, payload);
            }
        }
    }

    fn poll_lock_step(&mut self) -> bool {
        let now = self.clock.now();
        let done = self.options.ticks.is_some_and(|ticks| self.next >= ticks);
        let mut ready = Ready(self.next, true);
        B::visit(&mut self.ports, &mut ready);
        let seen = self.next.checked_sub(1);
        let witnessed = self.witnesses.iter().all(|witness| seen.is_none_or(|tick| witness.seen >= Some(tick)));
        if ready.1 && witnessed && !done {
            let joined_late = !B::OWNS_TIME && self.run.is_empty();
            if !joined_late {
                self.step(self.next, true);
                return true;
            }
        }
        if done && B::OWNS_TIME && ready.1 && witnessed {
            for _ in 0..3 {
                self.say_stop(true, "complete");
            }
            self.ending = Some(Ending::Complete);
            return true;
        }
        let silent = now.saturating_sub(self.heard_at);
        if done && !B::OWNS_TIME && silent > LINGER {
            self.ending = Some(Ending::Complete);
            return true;
        }
        let started = self.wires.iter().any(|wire| wire.held.is_some());
        let patience = if started { self.options.patience } else { START_PATIENCE.max(self.options.patience) };
        if silent > patience {
            let mut missing = Missing(self.next, Vec::new());
            B::visit(&mut self.ports, &mut missing);
            let mut waits: Vec<String> = missing.1.into_iter().map(str::to_owned).collect();
            let unseen = self.witnesses.iter().filter(|witness| witness.seen < seen);
            waits.extend(unseen.map(|witness| format!("witness {}", witness.name)));
            let (tick, waits) = (self.next, waits.join(", "));
            self.fail(format!("tick {tick}: waited {:.0} s for {waits}", silent.as_secs_f64()));
            return true;
        }
        if self.output.is_some() && now.saturating_sub(self.sent_at) >= self.repeat_after {
            self.send_again();
            self.repeat_after = (self.repeat_after * 2).min(REPEAT_MOST);
        }
        false
    }

    fn poll_real_time(&mut self) -> bool {
        let now = self.clock.now();
        let beat = self.beat_length();
        if self.options.ticks.is_some_and(|ticks| self.next >= ticks) {
            self.ending = Some(Ending::Complete);
            return true;
        }
        if B::OWNS_TIME {
            let due = *self.beat.due.get_or_insert(now);
            if now < due {
                return false;
            }
            // Behind by whole ticks: they are simulated, but only the newest is worth sending.
            let behind = (now - due).as_nanos() / beat.as_nanos().max(1);
            let most = (CATCH_UP_S / self.options.tick_s) as u128;
            if behind > most {
                let lost = u64::try_from(behind - most).unwrap_or(u64::MAX / 2);
                self.note(Severity::Error, format!("stopped for too long: {lost} ticks are left out"));
                self.next += lost;
                self.steps.skipped += lost;
                self.beat.due = Some(now);
                self.step(self.next, true);
                self.beat.due = Some(now + beat);
                return true;
            }
            let behind = u64::try_from(behind).unwrap_or(0);
            for _ in 0..behind {
                self.step(self.next, false);
            }
            if behind > 0 {
                self.steps.deadline_misses += behind;
                self.note(Severity::Warning, format!("{behind} ticks late: simulated, not sent"));
            }
            self.step(self.next, true);
            self.beat.due = Some(due + beat * u32::try_from(behind + 1).unwrap_or(u32::MAX));
            return true;
        }
        if let Some(tick) = self.beat.trigger.take() {
            if tick >= self.next {
                if self.output.is_some() {
                    self.steps.skipped += tick - self.next;
                }
                self.step(tick, true);
                self.beat.due = Some(now + 2 * beat);
                return true;
            }
            // Ahead of the owner of time: waits until it is level again.
            self.steps.late_triggers += 1;
            if self.next - tick < 50 {
                self.beat.due = Some(now + 2 * beat);
            }
            return false;
        }
        if let Some(due) = self.beat.due
            && now >= due
        {
            self.steps.by_timer += 1;
            self.step(self.next, true);
            self.beat.due = Some(if due + beat < now { now + beat } else { due + beat });
            return true;
        }
        false
    }

    fn housekeeping(&mut self, overflow: Overflow) {
        let now = self.clock.now();
        if overflow != self.overflow {
            let lost = overflow.wires + overflow.requests - self.overflow.wires - self.overflow.requests;
            self.overflow = overflow;
            self.refused(&format!("{lost} messages did not fit into the mailbox"));
        }
        if let Some(authority) = &mut self.authority
            && authority.expire(now)
        {
            let state = authority.state(now);
            self.tell_state(keys::LEASE_STATE.to_owned(), &state);
            self.note(Severity::Warning, "the lease has run out without being given back".to_owned());
        }
        if now >= self.health_due {
            self.health_due = now + Duration::from_secs(1);
            self.tell_health();
            if let Some(authority) = &self.authority {
                let state = authority.state(now);
                self.tell_state(keys::LEASE_STATE.to_owned(), &state);
            }
        }
    }

    fn tell_health(&mut self) {
        let mut names = Keys(Vec::new());
        B::visit(&mut B::ports(), &mut names);
        let (telemetry_dropped, letters_dropped) = self.outbox.dropped();
        let mut sorted = self.step_us.clone();
        sorted.sort_by(f64::total_cmp);
        let quantile = |q: f64| sorted.get((q * (sorted.len() as f64 - 1.0)) as usize).copied().unwrap_or(0.0);
        let inputs: BTreeMap<&str, InputHealth> = names
            .0
            .iter()
            .zip(&self.wires)
            .map(|((key, _), wire)| {
                let silent = self.clock.now().saturating_sub(wire.ledger.heard_at()).as_secs_f64();
                let health = InputHealth {
                    source: wire.ledger.source().to_owned(),
                    counts: wire.ledger.counts,
                    age_ticks_max: wire.age_max,
                    transport_ms_max: wire.transport_ms_max,
                    silent_s: silent,
                };
                (*key, health)
            })
            .collect();
        let health = Health {
            run: self.run.clone(),
            source: self.source.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            clock_ns: self.clock.unix_ns(),
            tick: self.next.saturating_sub(1),
            tick_s: self.options.tick_s,
            lock_step: self.lock_step(),
            sent: self.seq,
            steps: self.steps.steps,
            skipped: self.steps.skipped,
            by_timer: self.steps.by_timer,
            deadline_misses: self.steps.deadline_misses,
            late_triggers: self.steps.late_triggers,
            repeats: self.steps.repeats,
            not_finite: self.steps.not_finite,
            step_us: [quantile(0.5), quantile(0.99), quantile(1.0)],
            inputs: inputs.into_iter().map(|(key, health)| (key.to_owned(), health)).collect(),
            commands: self.desk.counts,
            setpoints: [
                self.streams.iter().map(|stream| stream.accepted).sum(),
                self.streams.iter().map(|stream| stream.refused).sum(),
            ],
            overflow: [self.overflow.wires, self.overflow.requests],
            telemetry_dropped: telemetry_dropped + self.thrown,
            letters_dropped,
            refused: self.refused_reported.1,
            events: self.event_seq,
        };
        for wire in &mut self.wires {
            wire.age_max = 0;
            wire.transport_ms_max = 0.0;
        }
        if let Ok(payload) = serde_json::to_vec(&health) {
            self.outbox.send(Letter::Health(payload));
        }
    }
}

fn said(payload: &[u8]) -> String {
    let text = String::from_utf8_lossy(&payload[..payload.len().min(200)]);
    // A token is a secret, also in a log.
    match serde_json::from_slice::<Request>(payload) {
        Ok(request) => format!("{} by {} seq {}", request.value, request.client, request.seq),
        Err(_) => text.chars().filter(|c| !c.is_control()).take(80).collect(),
    }
}

fn wire_publisher(session: &Session, key: &str) -> Result<Publisher<'static>, LinkError> {
    session
        .declare_publisher(key.to_owned())
        .encoding(Encoding::APPLICATION_JSON)
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::InteractiveHigh)
        .express(true)
        .wait()
        .map_err(LinkError::session(format!("publisher {key}")))
}

/// Which run and tick it is, for a service that starts anew.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Now {
    /// The run.
    pub run: String,
    /// Who says so.
    pub source: String,
    /// The next tick.
    pub next: u64,
}

/// One input of a service, in its health message.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InputHealth {
    /// Who writes it.
    pub source: String,
    /// The account.
    #[serde(flatten)]
    pub counts: Counts,
    /// Greatest age at a step in the last second.
    pub age_ticks_max: u64,
    /// Longest way here in the last second, if the clocks agree.
    pub transport_ms_max: f64,
    /// Time since it was last heard.
    pub silent_s: f64,
}

/// A service's counters, once a second.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Health {
    /// The run.
    pub run: String,
    /// Service and instance.
    pub source: String,
    /// Version of the program.
    pub version: String,
    /// The sender's clock, nanoseconds since 1970.
    pub clock_ns: u64,
    /// The last tick.
    pub tick: u64,
    /// Length of a tick.
    pub tick_s: f64,
    /// Lock step rather than real time.
    pub lock_step: bool,
    /// Messages sent on its wire.
    pub sent: u64,
    /// Steps done.
    pub steps: u64,
    /// Ticks without a step.
    pub skipped: u64,
    /// Steps by its own timer, without a trigger.
    pub by_timer: u64,
    /// Ticks that began too late to be sent.
    pub deadline_misses: u64,
    /// Triggers that came after their tick had been stepped.
    pub late_triggers: u64,
    /// Outputs sent again.
    pub repeats: u64,
    /// Outputs that were no numbers and were not sent.
    pub not_finite: u64,
    /// Time of a step with all that belongs to it: median, 99th percentile, maximum of the last 256, microseconds.
    pub step_us: [f64; 3],
    /// Inputs by key.
    pub inputs: BTreeMap<String, InputHealth>,
    /// Requests.
    pub commands: DeskCounts,
    /// Streaming set-points taken and refused.
    pub setpoints: [u64; 2],
    /// Messages and requests that did not fit into the mailbox.
    pub overflow: [u64; 2],
    /// Telemetry that did not fit into the outbox.
    pub telemetry_dropped: u64,
    /// Other letters that did not fit.
    pub letters_dropped: u64,
    /// Everything that was refused, of whatever kind.
    pub refused: u64,
    /// Events so far.
    pub events: u64,
}

impl<B: Wired + 'static> Hosted for Host<B>
where
    B::Ports: Send,
{
    fn service(&self) -> &'static str {
        B::NAME
    }

    fn deliver(&mut self, wire: usize, payload: &ZBytes) {
        self.wire(wire, payload);
    }

    fn request(&mut self, query: Query) {
        self.answer(query);
    }

    fn poll(&mut self, overflow: Overflow) -> bool {
        if self.ending.is_some() {
            return false;
        }
        self.housekeeping(overflow);
        if self.lock_step() { self.poll_lock_step() } else { self.poll_real_time() }
    }

    fn deadline(&self) -> Option<Duration> {
        if self.ending.is_some() {
            return None;
        }
        let next = if self.lock_step() {
            let repeat = self.output.is_some().then_some(self.sent_at + self.repeat_after);
            let give_up = self.heard_at + Duration::from_millis(500);
            Some(repeat.map_or(give_up, |repeat| repeat.min(give_up.max(self.sent_at + REPEAT_FIRST))))
        } else {
            self.beat.due
        };
        Some(next.map_or(self.health_due, |next| next.min(self.health_due)))
    }

    fn ending(&self) -> Option<&Ending> {
        self.ending.as_ref()
    }

    fn interrupt(&mut self, reason: &str) {
        if self.ending.is_none() {
            self.say_stop(false, reason);
            self.note(Severity::Info, reason.to_owned());
            self.ending = Some(Ending::Stopped(reason.to_owned()));
        }
    }

    fn digests(&mut self) -> &mut VecDeque<(u64, u64)> {
        &mut self.digests
    }
}
