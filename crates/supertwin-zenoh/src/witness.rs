//! A participant of a lock-step ring that only looks: it holds the ring back rather than miss a tick.

use crate::host::schedule::shortest;
use crate::mailbox::{Arrival, Mailbox};
use crate::session::LinkError;
use crate::transport::publisher;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use supertwin_protocol::clock::Clock;
use supertwin_protocol::envelope::{Envelope, decode, head};
use supertwin_protocol::fault::{Fault, FaultRates};
use supertwin_protocol::keys;
use supertwin_protocol::payload::{Seen, Stop};
use supertwin_protocol::telemetry::Telemetry;
use zenoh::pubsub::Publisher;
use zenoh::qos::Priority;
use zenoh::{Session, Wait};

/// The services whose telemetry a witness wants, in the order of the ring.
pub use supertwin_core::block::SERVICES as RING;

/// How a witness looks.
#[derive(Clone, Debug)]
pub struct WitnessOptions {
    /// The name that the plant was told.
    pub name: String,
    /// Tells this instance from another.
    pub instance: String,
    /// Ticks of the run.
    pub ticks: u64,
    /// How long to wait for the ring before giving up.
    pub patience: Duration,
    /// What the codec does to acknowledgements on purpose.
    pub faults: Option<FaultRates>,
}

/// Why a witness stopped looking.
#[derive(Debug, thiserror::Error)]
pub enum WitnessError {
    /// The session failed, or something could not be declared on it.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The ring stands still, somebody ended the run, or a message could not be read.
    #[error("tick {tick}: {cause}")]
    Failed {
        /// Tick that the witness waited for.
        tick: u64,
        /// Which of these it was, and by whose fault.
        cause: String,
    },
    /// Stopped from outside.
    #[error("interrupted")]
    Interrupted,
}

/// Everything that the four services showed at a tick, in the order of the ring.
pub type Lap<'a> = [Envelope<'a, Telemetry>; 4];

/// Looks at every tick of a run; `seen` is called once per tick, in order, and says whether to go on.
///
/// # Errors
/// When the ring stands still, is stopped, or says something that can't be read.
pub fn witness(
    session: &Session,
    options: &WitnessOptions,
    clock: &dyn Clock,
    mailbox: &Arc<Mailbox>,
    stop: &AtomicBool,
    mut seen: impl FnMut(u64, &Lap<'_>) -> bool,
) -> Result<(), WitnessError> {
    let mut subscribers = Vec::new();
    let keys = RING.iter().map(|service| keys::telemetry(service)).chain([keys::stop("*")]);
    for (number, key) in keys.enumerate() {
        let mailbox = Arc::clone(mailbox);
        let subscriber = session
            .declare_subscriber(key.clone())
            .callback(move |sample| mailbox.wire(0, number, sample.payload().clone()))
            .wait()
            .map_err(LinkError::session(format!("subscriber {key}")))?;
        subscribers.push(subscriber);
    }
    let mut receipts = Receipts::open(session, "", &options.name, &options.instance, options.faults, clock.now())?;
    let mut slots: [Option<Vec<u8>>; 4] = [None, None, None, None];
    let mut next = 0;
    let mut received_at = clock.now();
    loop {
        if stop.load(Ordering::Relaxed) {
            return Err(WitnessError::Interrupted);
        }
        while let Some(arrival) = mailbox.pop(true) {
            let Arrival::Wire(_, number, payload) = arrival else { continue };
            let bytes = payload.to_bytes();
            if number == RING.len() {
                let Ok(stop) = serde_json::from_slice::<Stop>(&bytes) else { continue };
                if stop.complete && next >= options.ticks {
                    return Ok(());
                }
                let (source, reason, missing) = (stop.source, stop.reason, missing(&slots));
                let cause = format!("{source} ended the run: {reason}; the witness still missed {missing}");
                return Err(WitnessError::Failed { tick: next, cause });
            }
            // Only the tick is needed to know whether it is the one that is waited for.
            let message = head(&bytes).map_err(|cause| malformed(next, number, &cause))?;
            if message.tick == next && slots[number].is_none() {
                received_at = clock.now();
                slots[number] = Some(bytes.into_owned());
            }
        }
        if let [Some(plant), Some(estimator), Some(guidance), Some(controller)] = &slots {
            let read = |number: usize, bytes| decode(bytes).map_err(|cause| malformed(next, number, &cause));
            let lap: Lap<'_> = [read(0, plant)?, read(1, estimator)?, read(2, guidance)?, read(3, controller)?];
            let run = lap[0].run.clone().into_owned();
            let go_on = seen(next, &lap);
            slots = [None, None, None, None];
            if !go_on {
                return Ok(());
            }
            receipts.give(&run, next, clock.now());
            next += 1;
            continue;
        }
        let now = clock.now();
        let patience = if next == 0 { options.patience.max(START) } else { options.patience };
        let silent = now.saturating_sub(received_at);
        if silent > patience {
            if next >= options.ticks {
                return Ok(());
            }
            let cause = format!("nothing from {} for {:.0} s", missing(&slots), silent.as_secs_f64());
            return Err(WitnessError::Failed { tick: next, cause });
        }
        let due = receipts.repeat(now);
        mailbox.wait(clock, Some(due));
    }
}

/// Receipts for ticks: the ring does not go on without them. Each is repeated until the next one is due.
pub struct Receipts {
    publisher: Publisher<'static>,
    fault: Option<Fault>,
    source: String,
    last: Option<Seen>,
    said_at: Duration,
    repeat_after: Duration,
    /// Length of the shortest lap lately.
    lap: Duration,
    lap_began: Duration,
}

impl Receipts {
    /// As `name`, which the plant was told, below `root`.
    ///
    /// # Errors
    /// When the session fails.
    pub fn open(
        session: &Session,
        root: &str,
        name: &str,
        instance: &str,
        faults: Option<FaultRates>,
        now: Duration,
    ) -> Result<Self, LinkError> {
        let publisher = publisher(session, format!("{root}{}", keys::witness(name)), Priority::InteractiveHigh)
            .express(true)
            .wait()
            .map_err(LinkError::session("publisher of the witness"))?;
        Ok(Self {
            publisher,
            fault: faults.map(|rates| Fault::new(rates, "witness")),
            source: format!("{name}-{instance}"),
            last: None,
            said_at: now,
            repeat_after: FIRST,
            lap: FIRST,
            lap_began: now,
        })
    }

    /// Everything of `tick` has been seen.
    pub fn give(&mut self, run: &str, tick: u64, now: Duration) {
        let seen = Seen { run: run.to_owned(), source: self.source.clone(), tick, repeat: false };
        self.say(&seen);
        self.lap = shortest(self.lap, now.saturating_sub(self.lap_began));
        (self.lap_began, self.said_at) = (now, now);
        self.repeat_after = (self.lap * 4).clamp(LEAST, MOST);
        self.last = Some(Seen { repeat: true, ..seen });
    }

    /// Gives the last one again if it is time; when to look next.
    pub fn repeat(&mut self, now: Duration) -> Duration {
        if now.saturating_sub(self.said_at) >= self.repeat_after
            && let Some(last) = self.last.take()
        {
            self.say(&last);
            self.last = Some(last);
            self.said_at = now;
            self.repeat_after = (self.repeat_after * 2).min(MOST);
        }
        self.said_at.max(now) + self.repeat_after
    }

    fn say(&mut self, seen: &Seen) {
        let copies = self.fault.as_mut().map_or(1, Fault::copies);
        if let Ok(payload) = serde_json::to_vec(seen) {
            for _ in 0..copies {
                // What does not get through is repeated.
                let _ = self.publisher.put(payload.clone()).wait();
            }
        }
    }
}

/// A lap, while none has been timed.
const FIRST: Duration = Duration::from_millis(5);
/// Least wait before an acknowledgement is repeated; four laps, if that is more.
const LEAST: Duration = Duration::from_millis(2);
/// Longest wait between repetitions.
const MOST: Duration = Duration::from_millis(250);
/// Before the first tick the services may take this long to come up.
const START: Duration = Duration::from_secs(60);

/// The services whose slot is empty.
fn missing(slots: &[Option<Vec<u8>>; 4]) -> String {
    let missing = RING.iter().zip(slots).filter(|(_, slot)| slot.is_none()).map(|(service, _)| *service);
    missing.collect::<Vec<_>>().join(", ")
}

fn malformed(tick: u64, number: usize, cause: &supertwin_protocol::envelope::Rejected) -> WitnessError {
    WitnessError::Failed { tick, cause: format!("{}: {cause}", RING[number]) }
}
