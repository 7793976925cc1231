//! `supertwin record`: what flows on the network, into recordings and a live view.
//!
//! ```text
//! Inbox ─▶ Vehicle: Laps, Account, Catalogue ─▶ Keep ─▶ file (the record of truth)
//!                                                    └▶ live view (drops and counts)
//! ```

mod account;
mod catalogue;
mod keep;
mod laps;
mod vehicle;

use crate::cli::{LinkArguments, LiveArguments, RecordingArguments};
use crate::failure::{Failure, INTERRUPTED};
use crate::output;
use crate::placement::unique;
use crate::serve::open_patiently;
use clap::Args;
pub(crate) use keep::Rotation;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use supertwin_core::run::{Properties, Property, Scene};
use supertwin_lab::{Library, ResolvedTrial};
use supertwin_protocol::{Clock, Heard, SystemClock, keys};
use supertwin_rerun::Live;
use supertwin_zenoh::{Inbox, LinkError, Mailbox, Session, close};
use vehicle::{Shared, Vehicle};

/// Arguments of `record`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin record                               every vehicle of this router, into runs/recorded
  supertwin record --live                        the same, and shows it as it comes
  supertwin record --vehicle argus-mini --out /data --part-min 10
  supertwin serve plant --pace lockstep --witness recorder &  supertwin record --once
                                                 the ring waits for the recorder: no tick is missing

Ctrl-C and SIGTERM close the files. After a crash or a power cut everything but the last second is there; `supertwin
repair` makes such a file whole.
Exit status: 0 stopped, 2 the call is wrong, 130 interrupted before a router was there.")]
pub(crate) struct RecordArguments {
    #[command(flatten)]
    pub(crate) recording: RecordingArguments,
    #[command(flatten)]
    pub(crate) link: LinkArguments,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// Name of the recorder as a witness in lock step.
pub(crate) const WITNESS: &str = "recorder";

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
pub(crate) struct Recorder {
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
pub(crate) struct Background {
    stop: Arc<AtomicBool>,
    interrupter: supertwin_zenoh::Interrupter,
    thread: std::thread::JoinHandle<Result<(), LinkError>>,
}

impl Background {
    /// Closes its recordings.
    pub(crate) fn end(self) -> Result<(), Failure> {
        self.stop.store(true, Ordering::Relaxed);
        self.interrupter.interrupt();
        match self.thread.join() {
            Ok(done) => Ok(done?),
            Err(_) => Err(Failure::Call("the recorder has panicked; what it had written is readable".to_owned())),
        }
    }
}

/// How a recorder records.
#[derive(Clone, Debug)]
pub(crate) struct Options {
    /// Folder for recordings; without it only the live view.
    pub(crate) folder: Option<PathBuf>,
    /// When a part is closed and the next one begun.
    pub(crate) rotation: Rotation,
    /// Name as a witness in lock step.
    pub(crate) witness: String,
    /// The only vehicle; without it all.
    pub(crate) vehicle: Option<String>,
    /// The session's keys begin below the vehicle's namespace.
    pub(crate) namespaced: bool,
    /// Ends with the first run.
    pub(crate) once: bool,
}

impl Recorder {
    /// Listens on `session`.
    pub(crate) fn new(
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

    /// Its wait ends when `stop` is set and `mailbox` is woken.
    fn ends_with(&self, stop: &Arc<AtomicBool>, mailbox: Arc<Mailbox>) {
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
    pub(crate) fn in_background(mut self, json: bool) -> Background {
        let stop = Arc::new(AtomicBool::new(false));
        let interrupter = self.inbox.interrupter();
        let flag = Arc::clone(&stop);
        let thread = std::thread::spawn(move || self.run(&flag, say(json)));
        Background { stop, interrupter, thread }
    }

    fn meet(&mut self, name: &str) -> Result<(), LinkError> {
        let root = if self.namespaced { String::new() } else { format!("{}/", keys::namespace(name)) };
        let vehicle = Vehicle::new(name, &root, &self.shared, &self.inbox)?;
        self.vehicles.insert(name.to_owned(), vehicle);
        Ok(())
    }

    /// Records until `stop` is set (and its wait interrupted); `say` hears what happens to files.
    pub(crate) fn run(&mut self, stop: &AtomicBool, mut say: impl FnMut(&Value)) -> Result<(), LinkError> {
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
                    Ok(Err(cause)) => output::warn(&format!("warning: not compacted, and whole: {cause}")),
                    Err(_) => output::warn("warning: compacting has panicked; the recording is whole"),
                }
            }
        }
        Ok(())
    }

    fn take(&mut self, heard: &Heard) -> Result<(), LinkError> {
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

/// Serves a live view, if one is asked for, and says how to open it.
pub(crate) fn live(arguments: &LiveArguments, json: bool) -> Result<Option<Live>, Failure> {
    let Some(port) = arguments.live.or(arguments.live_web.map(|_| crate::cli::LIVE_PORT)) else { return Ok(None) };
    let live = Live::serve(port, arguments.live_web).map_err(|error| Failure::Call(format!("--live: {error}")))?;
    let (url, port) = (live.url(), live.port());
    let tunnel = format!("ssh -N -L {port}:127.0.0.1:{port} USER@THIS-MACHINE");
    if json {
        output::print(&json!({ "live": url, "page": live.page(), "tunnel": tunnel }).to_string());
        return Ok(Some(live));
    }
    output::print(&format!("Live view: rerun {url}     (pip install rerun-sdk==0.36.3)"));
    if let Some(page) = live.page() {
        output::print(&format!("In a browser: {page}"));
    }
    output::print(&format!("From another machine first: {tunnel}"));
    Ok(Some(live))
}

/// What happened to a file, for people or programs.
pub(crate) fn say(json: bool) -> impl FnMut(&Value) {
    move |news| {
        if json {
            output::print(&news.to_string());
        } else if let Some(path) = news["recording"].as_str() {
            output::print(&format!("{}: recording to {path}", news["vehicle"].as_str().unwrap_or_default()));
        } else if let Some(path) = news["closed"].as_str() {
            output::print(&format!("closed {path}"));
        } else if let Some(cause) = news["failed"].as_str() {
            output::warn(&format!("error: NOT RECORDING: {cause}"));
        }
    }
}

/// `supertwin record`, and `supertwin serve recorder`.
pub(crate) fn record(
    arguments: &RecordingArguments,
    link: &LinkArguments,
    json: bool,
    library: &Library,
) -> Result<ExitCode, Failure> {
    let mailbox = Arc::new(Mailbox::default());
    let stop = crate::placement::stop_flag(&mailbox)?;
    let Some(session) = open_patiently(link.link(library, "local", None, None), &stop)? else {
        return Ok(ExitCode::from(INTERRUPTED));
    };
    let live = live(&arguments.live, json)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
    let options = Options {
        folder: (!arguments.no_file).then(|| arguments.out.clone()),
        rotation: arguments.rotation(),
        witness: arguments.as_witness.clone(),
        vehicle: link.vehicle.clone(),
        namespaced: false,
        once: arguments.once,
    };
    let mut recorder = Recorder::new(&session, clock, live, options)?;
    // Ctrl-C wakes the mailbox; here somebody else waits.
    recorder.ends_with(&stop, mailbox);
    if json {
        output::print(&json!({ "recorder": recorder.shared.instance }).to_string());
    } else {
        output::print("waiting for a vehicle; Ctrl-C closes the recordings");
    }
    recorder.run(&stop, say(json))?;
    close(&session);
    Ok(ExitCode::SUCCESS)
}
