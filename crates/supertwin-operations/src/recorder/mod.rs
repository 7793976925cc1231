//! What flows on the network, into recordings and a live view.
//!
//! ```text
//! Inbox ─▶ Vehicle: LapAssembler, LinkMonitor, SignalRegistry ─▶ RunRecording ─▶ file (the record of truth)
//!                                                                              └▶ live view (drops and counts)
//! ```

mod lap_assembler;
mod link_monitor;
mod run_recording;
mod signal_registry;
mod vehicle;

use crate::OperationError;
pub use run_recording::Rotation;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use supertwin_core::run::{Properties, Property, Scene};
use supertwin_lab::ResolvedTrial;
use supertwin_protocol::{Clock, Received, SystemClock, keys};
use supertwin_rerun::Live;
use supertwin_zenoh::{Inbox, LinkError, Mailbox, Session, unique};
use vehicle::{Shared, Vehicle};

/// Name of the recorder as a witness in lock step.
pub const WITNESS: &str = "recorder";

/// Vehicles of one recorder: a larger fleet has several, and names that are made up fill no memory.
const VEHICLES: usize = 256;

/// What can be drawn of a run with these properties.
fn scene(properties: &Properties) -> Option<Scene> {
    let seed = match properties.get("seed") {
        Some(Property::Integer(seed)) => *seed,
        _ => 0,
    };
    let trial = ResolvedTrial::from_properties(properties, "a recording").ok()?;
    supertwin_lab::run::scene(&trial, seed).ok()
}

/// Listens to vehicles and keeps what they say.
pub struct Recorder {
    inbox: Inbox,
    shared: Shared,
    /// The one vehicle of a session with a namespace of its own, or whoever turns up.
    only: Option<String>,
    namespaced: bool,
    vehicles: BTreeMap<String, Vehicle>,
    once: bool,
    lost: u64,
}

/// A recorder in the background.
pub struct Background {
    stop: Arc<AtomicBool>,
    interrupter: supertwin_zenoh::Interrupter,
    thread: std::thread::JoinHandle<Result<(), LinkError>>,
}

impl Background {
    /// Closes its recordings.
    ///
    /// # Errors
    /// The link failed, or the recorder has panicked.
    pub fn end(self) -> Result<(), OperationError> {
        self.stop.store(true, Ordering::Relaxed);
        self.interrupter.interrupt();
        match self.thread.join() {
            Ok(done) => Ok(done?),
            Err(_) => {
                Err(OperationError::Option("the recorder has panicked; what it had written is readable".to_owned()))
            }
        }
    }
}

/// How a recorder records.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder for recordings; without it only the live view.
    pub folder: Option<PathBuf>,
    /// When a part is closed and the next one begun.
    pub rotation: Rotation,
    /// Name as a witness in lock step.
    pub witness: String,
    /// The only vehicle; without it all.
    pub vehicle: Option<String>,
    /// The session's keys begin below the vehicle's namespace.
    pub namespaced: bool,
    /// Ends with the first run.
    pub once: bool,
}

impl Recorder {
    /// Listens on `session`.
    ///
    /// # Errors
    /// A key can't be subscribed to.
    pub fn new(
        session: &Session,
        clock: Arc<dyn Clock>,
        live: Option<Live>,
        options: Options,
    ) -> Result<Self, LinkError> {
        let mut inbox = Inbox::new(Arc::clone(&clock));
        let root = match (&options.vehicle, options.namespaced) {
            (_, true) => String::new(),
            (Some(vehicle), false) => format!("{}/", keys::namespace(vehicle)),
            (None, false) => format!("{}/", keys::namespace("*")),
        };
        let wires = vehicle::WIRES.iter().map(|key| (*key).to_owned());
        let others = [keys::telemetry("*"), keys::health("*"), keys::stop("*"), keys::state("*", "**")];
        for key in wires.chain(others) {
            inbox.listen(session, &format!("{root}{key}"))?;
        }
        inbox.listen_events(session, &format!("{root}{}", keys::event("*")))?;
        let mut recorder = Self {
            shared: Shared {
                session: session.clone(),
                clock,
                instance: unique(),
                witness: options.witness,
                folder: options.folder,
                live,
                rotation: options.rotation,
            },
            inbox,
            only: options.vehicle,
            namespaced: options.namespaced,
            vehicles: BTreeMap::new(),
            once: options.once,
            lost: 0,
        };
        if let Some(name) = recorder.only.clone() {
            recorder.meet(&name)?;
        }
        Ok(recorder)
    }

    /// Its name among recorders.
    #[must_use]
    pub fn instance(&self) -> &str {
        &self.shared.instance
    }

    /// Its wait ends when `stop` is set and `mailbox` is woken.
    pub fn ends_with(&self, stop: &Arc<AtomicBool>, mailbox: Arc<Mailbox>) {
        let (stop, interrupter) = (Arc::clone(stop), self.inbox.interrupter());
        std::thread::spawn(move || {
            let clock = SystemClock::start();
            while !stop.load(Ordering::Relaxed) {
                mailbox.wait(&clock, None);
            }
            interrupter.interrupt();
        });
    }

    /// Records in a thread of its own until the handle is ended.
    pub fn in_background(mut self, say: impl FnMut(&Value) + Send + 'static) -> Background {
        let stop = Arc::new(AtomicBool::new(false));
        let interrupter = self.inbox.interrupter();
        let flag = Arc::clone(&stop);
        let thread = std::thread::spawn(move || self.run(&flag, say));
        Background { stop, interrupter, thread }
    }

    fn meet(&mut self, name: &str) -> Result<(), LinkError> {
        let root = if self.namespaced { String::new() } else { format!("{}/", keys::namespace(name)) };
        let vehicle = Vehicle::new(name, &root, &self.shared, &self.inbox)?;
        self.vehicles.insert(name.to_owned(), vehicle);
        Ok(())
    }

    /// Records until `stop` is set (and its wait interrupted); `say` hears what happens to files.
    ///
    /// # Errors
    /// A vehicle that turns up can't be listened to.
    pub fn run(&mut self, stop: &AtomicBool, mut say: impl FnMut(&Value)) -> Result<(), LinkError> {
        let mut due = self.shared.clock.now();
        while !stop.load(Ordering::Relaxed) {
            let now = self.shared.clock.now();
            if let Some(heard) = self.inbox.next(Some(due.max(now))) {
                self.take(&heard)?;
                // All that is there already, before anything is written.
                let now = self.shared.clock.now();
                for _ in 0..256 {
                    let Some(heard) = self.inbox.next(Some(now)) else { break };
                    self.take(&heard)?;
                }
            }
            due = self.shared.clock.now() + Duration::from_millis(250);
            for vehicle in self.vehicles.values_mut() {
                due = due.min(vehicle.poll(&self.inbox));
                vehicle.news.drain(..).for_each(|news| say(&news));
            }
            self.count_lost();
            if self.once && !self.vehicles.is_empty() && self.vehicles.values().all(|vehicle| vehicle.finished > 0) {
                break;
            }
        }
        // A slow disk leaves a queue: what has arrived is recorded before the end.
        for heard in self.inbox.rest() {
            self.take(&heard)?;
        }
        let now = self.shared.clock.now();
        for vehicle in self.vehicles.values_mut() {
            vehicle.poll(&self.inbox);
            vehicle.end_run(false, now);
            vehicle.news.drain(..).for_each(|news| say(&news));
            for compacting in vehicle.compacting.drain(..) {
                match compacting.join() {
                    Ok(Ok(())) => {}
                    Ok(Err(cause)) => say(&json!({ "warning": format!("not compacted, and whole: {cause}") })),
                    Err(_) => say(&json!({ "warning": "compacting has panicked; the recording is whole" })),
                }
            }
        }
        Ok(())
    }

    fn take(&mut self, heard: &Received) -> Result<(), LinkError> {
        if self.namespaced {
            let name = self.only.clone().unwrap_or_default();
            if let Some(vehicle) = self.vehicles.get_mut(&name) {
                vehicle.take(&heard.key, heard, &self.inbox);
            }
            return Ok(());
        }
        let mut parts = heard.key.splitn(3, '/');
        let (Some("supertwin"), Some(name), Some(key)) = (parts.next(), parts.next(), parts.next()) else {
            return Ok(());
        };
        if !self.vehicles.contains_key(name) {
            if self.vehicles.len() >= VEHICLES {
                return Ok(());
            }
            let name = name.to_owned();
            self.meet(&name)?;
        }
        if let Some(vehicle) = self.vehicles.get_mut(name) {
            vehicle.take(key, heard, &self.inbox);
        }
        Ok(())
    }

    /// Messages that did not fit into the inbox are gaps of the recording; all vehicles hear of it.
    fn count_lost(&mut self) {
        let lost = self.inbox.lost();
        if lost > self.lost {
            let more = lost - std::mem::replace(&mut self.lost, lost);
            for vehicle in self.vehicles.values_mut() {
                vehicle.overrun(more);
            }
        }
    }
}
