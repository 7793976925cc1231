//! Puts any block behind its keys: one step per tick, in lock step or in real time, with commands, events and accounts.

mod declare;
mod health;
mod ports;
mod publish;
mod receive;
mod rejoin;
mod request;
pub(crate) mod schedule;
mod state;
mod step;

use crate::mailbox::{Mailbox, Overflow};
use crate::outbox::Outbox;
use crate::session::LinkError;
use crate::watch::Presence;
use declare::{queryables, subscribe, wire_kinds, wire_publisher};
use ports::AsideKeys;
use schedule::REPEAT_FIRST;
use state::{Counters, LapTimer, Operator, Sent, StepSchedule, WireKind, WireState, Witness};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use supertwin_core::digest::DigestProbe;
use supertwin_core::run::Properties;
use supertwin_core::{EventKind, Message, Ports, Severity, Tick, Watch, Wired};
use supertwin_protocol::clock::Clock;
use supertwin_protocol::command_queue::CommandQueue;
use supertwin_protocol::fault::{Fault, FaultRates};
use supertwin_protocol::keys;
use supertwin_protocol::lease::Authority;
use supertwin_protocol::telemetry::{AppliedBefore, SignalList};
use zenoh::Session;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::query::{Query, Queryable};

/// Telemetry that a recorder can ask for after it was cut off: ten seconds at 50 Hz.
const TELEMETRY_CACHE: usize = 500;

/// How ticks follow each other.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Pace {
    /// By the wall clock, this many times as fast as real time.
    RealTime(f64),
    /// When all inputs of a tick are there.
    #[default]
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
    /// Where its configuration comes from, for recordings: everything that is needed to repeat the run.
    pub about: Properties,
    /// Commands of the mission, by the tick at which they apply.
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

impl<C> HostOptions<C> {
    /// How long the writer of a wire is silent before another may take its place.
    fn silence(&self) -> Duration {
        match self.pace {
            // Three ticks, and on the wall no less than a process may be held up without being dead.
            Pace::RealTime(factor) => Duration::from_secs_f64((3.0 * self.tick_s / factor).max(0.1)),
            Pace::LockStep => Duration::MAX,
        }
    }
}

/// How a host ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// All ticks of the run were stepped.
    Complete,
    /// Ended before its last tick, for this reason.
    Stopped(String),
    /// It could not go on.
    Failed(String),
}

/// A host as the engine sees it, whatever its block.
pub trait Hosted: Send {
    /// The service's name.
    fn service(&self) -> &'static str;
    /// Takes a message that has arrived on wire `wire`.
    fn deliver(&mut self, wire: usize, payload: &ZBytes, now: Duration);
    /// Takes a request that has arrived.
    fn request(&mut self, query: Query, now: Duration);
    /// The thread was held up for so long: others who were not heard meanwhile were not silent.
    fn held_up(&mut self, stall: Duration, now: Duration);
    /// Does what can be done at `now`; true when something was.
    fn poll(&mut self, overflow: Overflow, now: Duration) -> bool;
    /// When it wants to be polled again, if nothing arrives.
    fn deadline(&self) -> Option<Duration>;
    /// Whether it is over, and how.
    fn ending(&self) -> Option<&Ending>;
    /// Ends it from outside.
    fn interrupt(&mut self, reason: &str);
    /// Steps done, and the time from the first to the last.
    fn progress(&self) -> (u64, Duration);
    /// Hashes of the steps since the last call, with their ticks.
    fn digests(&mut self) -> &mut VecDeque<(u64, u64)>;
}

/// A block behind its keys.
pub struct Host<B: Wired> {
    block: B,
    /// The block as it was built: another run starts from here.
    pristine: B,
    ports: Ports<B>,
    wires: Vec<WireState>,
    watch: Watch,
    probe: DigestProbe,
    commands: CommandQueue<B::Command>,
    options: HostOptions<B::Command>,
    /// Stamps what is sent, and times steps; deadlines go by `now`.
    clock: Arc<dyn Clock>,
    /// The moment at which whoever drives the host has called it.
    now: Duration,
    source: String,
    run: String,
    next: u64,
    schedule: StepSchedule,
    output: Option<(u64, B::Out, u64)>,
    telemetry: Option<Vec<u8>>,
    signals: SignalList,
    sent: Sent,
    received_at: Duration,
    lap: LapTimer,
    fault: Option<Fault>,
    witnesses: Vec<Witness>,
    operator: Operator,
    counters: Counters,
    /// Steps of the block since it was as built, in this run.
    steps_of_run: u64,
    /// Commands that applied and that no telemetry has told yet.
    untold: Vec<AppliedBefore>,
    began_at: Option<Duration>,
    digests: VecDeque<(u64, u64)>,
    ending: Option<Ending>,
    publisher: Publisher<'static>,
    stop_publisher: Publisher<'static>,
    outbox: Outbox,
    // Kept for what dropping them would undo.
    _subscribers: Vec<Subscriber<()>>,
    _queryables: Vec<Queryable<()>>,
    _token: Presence,
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
        let ports = Ports::default();
        let mut asides = AsideKeys(Vec::new());
        block.asides(&mut asides);
        let mut droppable = vec![keys::telemetry(B::NAME)];
        droppable.extend(asides.0);
        // In lock step nothing is lost that could be asked for again; a cache would only cost time.
        let cache = if options.pace == Pace::LockStep { 0 } else { TELEMETRY_CACHE };
        let outbox = Outbox::open(session, "", B::NAME, &droppable, cache)?;
        let publisher = wire_publisher(session, B::Out::KEY)?;
        let stop_publisher = wire_publisher(session, &keys::stop(B::NAME))?;

        let kinds = wire_kinds(&ports, &options);
        let subscribers = subscribe(session, &kinds, mailbox, index)?;
        let silence = options.silence();
        let wires = kinds.iter().map(|(_, kind)| WireState::new(*kind, silence)).collect();
        let token = Presence::show(session, &keys::alive(B::NAME, &options.instance))?;

        let now = clock.now();
        let mut host = Self {
            watch: Watch::new(&block),
            pristine: block.clone(),
            block,
            ports,
            wires,
            probe: DigestProbe::default(),
            commands: CommandQueue::new(&options.mission),
            source: format!("{}-{}", B::NAME, options.instance),
            run: if B::OWNS_TIME { options.run.clone() } else { String::new() },
            next: 0,
            schedule: StepSchedule::default(),
            output: None,
            telemetry: None,
            signals: SignalList::default(),
            sent: Sent::default(),
            received_at: now,
            lap: LapTimer { began: now, shortest: Duration::ZERO, sent_at: now, repeat_after: REPEAT_FIRST },
            fault: options.faults.map(|rates| Fault::new(rates, B::NAME)),
            witnesses: options
                .witnesses
                .iter()
                .map(|name| Witness { name: name.clone(), ..Witness::default() })
                .collect(),
            operator: Operator { authority: options.keeps_authority.then(Authority::default), ..Operator::default() },
            counters: Counters { refused: (now, 0), due: now + Duration::from_secs(1), ..Counters::default() },
            steps_of_run: 0,
            untold: Vec::new(),
            began_at: None,
            digests: VecDeque::new(),
            ending: None,
            publisher,
            stop_publisher,
            outbox,
            options,
            clock,
            now,
            _subscribers: subscribers,
            _queryables: Vec::new(),
            _token: token,
        };
        if host.options.rejoins && matches!(host.options.pace, Pace::RealTime(_)) {
            host.rejoin(session)?;
        }
        // Only now, when it knows the run: who asks before would wait for an answer that nobody gives yet.
        host._queryables = queryables::<B>(session, host.options.keeps_authority, mailbox, index, &host.outbox)?;
        host.tell_lease();
        host.tell_parameters();
        host.tell_state("run".to_owned(), &host.options.about);
        Ok(host)
    }

    fn lock_step(&self) -> bool {
        self.options.pace == Pace::LockStep
    }

    /// Length of a tick on the wall.
    fn step_interval(&self) -> Duration {
        match self.options.pace {
            Pace::RealTime(factor) => Duration::from_secs_f64(self.options.tick_s / factor),
            Pace::LockStep => Duration::ZERO,
        }
    }

    fn tick(&self, k: u64) -> Tick {
        Tick { k, dt_s: self.options.tick_s }
    }
}

/// Everything that can be asked of a service.
impl<B: Wired + 'static> Hosted for Host<B> {
    fn service(&self) -> &'static str {
        B::NAME
    }

    fn deliver(&mut self, wire: usize, payload: &ZBytes, now: Duration) {
        self.now = now;
        self.wire(wire, payload);
    }

    fn request(&mut self, query: Query, now: Duration) {
        self.now = now;
        self.answer(query);
    }

    fn held_up(&mut self, stall: Duration, now: Duration) {
        for wire in &mut self.wires {
            wire.ledger.forgive(stall, now);
        }
    }

    fn poll(&mut self, overflow: Overflow, now: Duration) -> bool {
        self.now = now;
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
            // Without an output there is nothing to repeat; patience is looked at now and then.
            let look = self.now + Duration::from_millis(500);
            Some(if self.output.is_some() { look.min(self.lap.sent_at + self.lap.repeat_after) } else { look })
        } else {
            self.schedule.due
        };
        Some(next.map_or(self.counters.due, |next| next.min(self.counters.due)))
    }

    fn ending(&self) -> Option<&Ending> {
        self.ending.as_ref()
    }

    fn interrupt(&mut self, reason: &str) {
        if self.ending.is_none() {
            self.say_stop(false, reason);
            self.note(Severity::Info, EventKind::RunStopped { reason: reason.to_owned() });
            self.ending = Some(Ending::Stopped(reason.to_owned()));
        }
    }

    fn progress(&self) -> (u64, Duration) {
        let since = self.began_at.map_or(Duration::ZERO, |began| self.lap.sent_at.saturating_sub(began));
        (self.counters.health.steps, since)
    }

    fn digests(&mut self) -> &mut VecDeque<(u64, u64)> {
        &mut self.digests
    }
}
