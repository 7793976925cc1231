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
use supertwin_protocol::{Clock, Received, keys};
use supertwin_rerun::Live;
use supertwin_zenoh::{Inbox, LinkError, Session, unique};
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
    vehicles: BTreeMap<String, Vehicle>,
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
        let panicked =
            |_| OperationError::Option("the recorder has panicked; what it had written is readable".to_owned());
        Ok(self.thread.join().map_err(panicked)??)
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

impl Options {
    /// What the keys of `vehicle` begin with.
    fn root(&self, vehicle: &str) -> String {
        if self.namespaced { String::new() } else { format!("{}/", keys::namespace(vehicle)) }
    }
}

impl Recorder {
    /// Listens on `session`, in `inbox`, by whose interrupter its wait is ended.
    ///
    /// # Errors
    /// A key can't be subscribed to.
    pub fn new(
        mut inbox: Inbox,
        session: &Session,
        clock: Arc<dyn Clock>,
        live: Option<Live>,
        options: Options,
    ) -> Result<Self, LinkError> {
        let root = options.root(options.vehicle.as_deref().unwrap_or("*"));
        let wires = vehicle::WIRES.iter().map(|key| (*key).to_owned());
        let others = [keys::telemetry("*"), keys::health("*"), keys::stop("*"), keys::state("*", "**")];
        for key in wires.chain(others) {
            inbox.listen(session, &format!("{root}{key}"))?;
        }
        inbox.listen_events(session, &format!("{root}{}", keys::event("*")))?;
        let shared = Shared { session: session.clone(), clock, instance: unique(), live, options };
        let mut recorder = Self { inbox, shared, vehicles: BTreeMap::new(), lost: 0 };
        if let Some(name) = recorder.shared.options.vehicle.clone() {
            recorder.meet(&name)?;
        }
        Ok(recorder)
    }

    /// Its name among recorders.
    #[must_use]
    pub fn instance(&self) -> &str {
        &self.shared.instance
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
        let vehicle = Vehicle::new(name, &self.shared.options.root(name), &self.shared, &self.inbox)?;
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
            if let Some(message) = self.inbox.next(Some(due.max(now))) {
                self.receive(&message)?;
                // All that is there already, before anything is written.
                let now = self.shared.clock.now();
                for _ in 0..256 {
                    let Some(message) = self.inbox.next(Some(now)) else { break };
                    self.receive(&message)?;
                }
            }
            due = self.shared.clock.now() + Duration::from_millis(250);
            for vehicle in self.vehicles.values_mut() {
                due = due.min(vehicle.poll(&self.inbox));
                vehicle.notices.drain(..).for_each(|notice| say(&notice));
            }
            self.count_lost();
            if self.shared.options.once
                && !self.vehicles.is_empty()
                && self.vehicles.values().all(|vehicle| vehicle.finished > 0)
            {
                break;
            }
        }
        // A slow disk leaves a queue: what has arrived is recorded before the end.
        for message in self.inbox.rest() {
            self.receive(&message)?;
        }
        let now = self.shared.clock.now();
        for vehicle in self.vehicles.values_mut() {
            vehicle.poll(&self.inbox);
            vehicle.end_run(false, now);
            vehicle.notices.drain(..).for_each(|notice| say(&notice));
            for compacting in vehicle.compacting.drain(..) {
                let warning = match compacting.join() {
                    Ok(Ok(())) => continue,
                    Ok(Err(cause)) => format!("not compacted, and whole: {cause}"),
                    Err(_) => "compacting has panicked; the recording is whole".to_owned(),
                };
                say(&json!({ "warning": warning }));
            }
        }
        Ok(())
    }

    /// Hands a message to the vehicle that its key names, which may be one that has not been met before.
    fn receive(&mut self, message: &Received) -> Result<(), LinkError> {
        let (name, key) = if self.shared.options.namespaced {
            (self.shared.options.vehicle.clone().unwrap_or_default(), message.key.as_str())
        } else {
            let mut parts = message.key.splitn(3, '/');
            match (parts.next(), parts.next(), parts.next()) {
                (Some("supertwin"), Some(name), Some(key)) => (name.to_owned(), key),
                _ => return Ok(()),
            }
        };
        if !self.vehicles.contains_key(&name) && self.vehicles.len() < VEHICLES {
            self.meet(&name)?;
        }
        if let Some(vehicle) = self.vehicles.get_mut(&name) {
            vehicle.receive(key, message, &self.inbox);
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
