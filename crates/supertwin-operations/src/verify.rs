//! The same bits in one process, in separate processes, and over a bad link.

use crate::{OperationError, Progress};
use serde::Serialize;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use supertwin_core::Tick;
use supertwin_core::digest::{DigestProbe, RunDigest};
use supertwin_core::observe::Snapshot;
use supertwin_lab::mission::Mission;
use supertwin_lab::{ResolvedTrial, Twin};
use supertwin_protocol::{Clock as _, FaultRates, Shape, SystemClock, keys};
use supertwin_zenoh::witness::{Lap, RING};
use supertwin_zenoh::{Link, Mailbox, WitnessOptions, close, unique, witness};

/// Name of the witness that the plant waits for.
pub const WITNESS: &str = "verify";

/// One placement of one trial.
#[derive(Debug, Serialize)]
pub struct PlacementCheck {
    /// Name of the trial that was run.
    pub trial: String,
    /// Where it ran.
    pub placement: &'static str,
    /// State hash, if nothing differs.
    pub hash: Option<String>,
    /// Ticks that were compared.
    pub ticks: u64,
    /// Seconds that they took.
    pub wall_s: f64,
    /// Ticks per second.
    pub laps_per_s: f64,
    /// Where it parts from one process.
    pub first_difference: Option<FirstDifference>,
    /// What ended it early.
    pub error: Option<String>,
}

/// Where two placements part.
#[derive(Clone, Debug, Serialize)]
pub struct FirstDifference {
    /// Tick, from 0 at the start of the run.
    pub tick: u64,
    /// Who shows it.
    pub service: String,
    /// Path of the signal.
    pub signal: String,
    /// Its value in one process.
    pub here: String,
    /// Its value there.
    pub there: String,
}

/// A process that hosts a service of one trial, in lock step.
#[derive(Debug)]
pub struct ServiceProcess<'a> {
    /// Which of the four.
    pub service: &'static str,
    /// Router to connect to.
    pub endpoint: &'a str,
    /// Name on the network.
    pub vehicle: &'a str,
    /// Trial that the service is part of.
    pub trial: &'a ResolvedTrial,
    /// Length of the run in simulated seconds.
    pub duration_s: f64,
    /// Shares of messages that are lost and doubled on purpose.
    pub faults: Option<(f64, f64)>,
}

/// How trials are verified.
pub struct VerifyOptions<'a> {
    /// Simulated seconds of each.
    pub duration_s: f64,
    /// A router that is there already.
    pub router: Option<String>,
    /// The command that starts the process of a service, of which the plant must wait for [`WITNESS`]; or, for `None`, a
    /// router on a free port of this machine, that prints a line of JSON with its endpoints under `listening`.
    pub command: &'a dyn Fn(Option<&ServiceProcess<'_>>) -> Command,
}

/// Runs each trial in one process, in four, and in four over a bad link; three results for each, in this order. Ends
/// early when `stop` is set.
///
/// # Errors
/// A trial can't be built, or a process can't be started.
pub fn verify(
    trials: &[ResolvedTrial],
    options: &VerifyOptions<'_>,
    stop: &AtomicBool,
    progress: &dyn Progress,
) -> Result<Vec<PlacementCheck>, OperationError> {
    let mut checks = Vec::new();
    for trial in trials {
        let ticks = Tick::at_or_after(options.duration_s, trial.trial.tick_s.get());
        checks.push(in_one_process(trial, ticks)?);
        for (placement, faults) in [("four processes", None), ("four processes, bad link", Some((0.1, 0.1)))] {
            checks.push(Job { options, trial, ticks, placement, faults }.run(stop, progress)?);
            if stop.load(Ordering::Relaxed) {
                return Ok(checks);
            }
        }
    }
    Ok(checks)
}

/// Whether every placement of every trial has the bits of its first.
#[must_use]
pub fn is_equal(checks: &[PlacementCheck]) -> bool {
    checks.chunks(3).all(|checks| checks.iter().all(|one| one.hash.is_some() && one.hash == checks[0].hash))
}

/// The ring of one process, tick by tick.
struct Reference<'a> {
    trial: &'a ResolvedTrial,
    twin: Twin,
    mission: Mission,
    probe: DigestProbe,
}

impl<'a> Reference<'a> {
    fn new(trial: &'a ResolvedTrial) -> Result<Self, OperationError> {
        let dt_s = trial.trial.tick_s.get();
        Ok(Self {
            trial,
            twin: Twin::new(trial, trial.trial.seed)?,
            mission: Mission::new(&trial.trial.mission, dt_s),
            probe: DigestProbe::default(),
        })
    }

    /// One tick; false when a quantity is no number.
    fn step(&mut self, k: u64) -> bool {
        let tick = Tick { k, dt_s: self.trial.trial.tick_s.get() };
        while let Some(command) = self.mission.due(tick) {
            // A refusal is the same everywhere: nothing happens.
            let _ = self.twin.command(tick, command);
        }
        self.twin.step(tick);
        self.twin.digest(tick, &mut self.probe).is_ok()
    }
}

fn in_one_process(trial: &ResolvedTrial, ticks: u64) -> Result<PlacementCheck, OperationError> {
    let clock = SystemClock::start();
    let mut reference = Reference::new(trial)?;
    let done = (0..ticks).take_while(|k| reference.step(*k)).count() as u64;
    let wall_s = clock.now().as_secs_f64();
    Ok(PlacementCheck {
        trial: trial.name.clone(),
        placement: "one process",
        hash: Some(reference.twin.run_digest.to_string()),
        ticks: done,
        wall_s,
        laps_per_s: done as f64 / wall_s,
        first_difference: None,
        error: None,
    })
}

/// One trial in separate processes.
struct Job<'a> {
    options: &'a VerifyOptions<'a>,
    trial: &'a ResolvedTrial,
    ticks: u64,
    placement: &'static str,
    faults: Option<(f64, f64)>,
}

impl Job<'_> {
    fn run(&self, stop: &AtomicBool, progress: &dyn Progress) -> Result<PlacementCheck, OperationError> {
        let mut processes = Processes::default();
        let endpoint = match &self.options.router {
            Some(endpoint) => endpoint.clone(),
            None => processes.router((self.options.command)(None))?,
        };
        // Every run has a namespace of its own: a stranger on the same router can't disturb it.
        let vehicle = format!("verify-{}", unique());
        let session = Link {
            mode: Some("client"),
            connect: vec![endpoint.clone()],
            namespace: Some(keys::namespace(&vehicle)),
            patience_ms: 5000,
            ..Link::default()
        }
        .open()?;
        for service in RING {
            let (endpoint, vehicle) = (endpoint.as_str(), vehicle.as_str());
            let (trial, duration_s, faults) = (self.trial, self.options.duration_s, self.faults);
            let process = ServiceProcess { service, endpoint, vehicle, trial, duration_s, faults };
            processes.start(service, (self.options.command)(Some(&process)))?;
        }
        let mut reference = Reference::new(self.trial)?;
        let mut digest = RunDigest::default();
        let mut difference = None;
        progress.begin(&format!("{}, {}", self.trial.name, self.placement), self.ticks);
        let options = WitnessOptions {
            name: WITNESS.to_owned(),
            instance: unique(),
            ticks: self.ticks,
            patience: Duration::from_secs(10),
            faults: self.faults.map(|(drop, double)| FaultRates { drop, double, seed: 1 }),
        };
        let mailbox = Arc::new(Mailbox::default());
        let clock = SystemClock::start();
        let (mut done, mut began) = (0, None);
        let looked = witness(&session, &options, &clock, &mailbox, stop, |k, lap| {
            began.get_or_insert_with(SystemClock::start);
            let there = digests(lap);
            digest.fold(Tick { k, dt_s: self.trial.trial.tick_s.get() }, there);
            done = k + 1;
            progress.advance(1);
            let finite = reference.step(k);
            if finite && reference.twin.digests == there {
                return true;
            }
            difference = Some(first_difference(k, &reference.twin, lap));
            false
        });
        progress.end();
        let wall_s = began.map_or(0.0, |began| began.now().as_secs_f64());
        let error = looked.err().map(|error| match processes.last_words() {
            said if said.is_empty() => error.to_string(),
            said => format!("{error}\n{said}"),
        });
        close(&session);
        Ok(PlacementCheck {
            trial: self.trial.name.clone(),
            placement: self.placement,
            hash: (difference.is_none() && error.is_none()).then(|| digest.to_string()),
            ticks: done,
            wall_s,
            laps_per_s: if wall_s > 0.0 { done as f64 / wall_s } else { 0.0 },
            first_difference: difference,
            error,
        })
    }
}

/// Children that end with their parent.
#[derive(Default)]
struct Processes(Vec<(&'static str, Child)>);

impl Processes {
    fn start(&mut self, name: &'static str, mut command: Command) -> Result<(), OperationError> {
        let wrong = |cause: std::io::Error| OperationError::Option(format!("{name} can't be started: {cause}"));
        let child =
            command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().map_err(wrong)?;
        self.0.push((name, child));
        Ok(())
    }

    /// Starts a router and returns where it listens.
    fn router(&mut self, command: Command) -> Result<String, OperationError> {
        self.start("router", command)?;
        let mut line = String::new();
        if let Some(stdout) = self.0.last_mut().and_then(|(_, child)| child.stdout.as_mut()) {
            // A router that dies says nothing, and that is found below.
            let _ = BufReader::new(stdout).read_line(&mut line);
        }
        let value: serde_json::Value = serde_json::from_str(&line).unwrap_or_default();
        let found = value["listening"].as_array().into_iter().flatten().filter_map(|place| place.as_str());
        let tcp = found.filter(|place| place.starts_with("tcp/")).map(str::to_owned).next();
        tcp.ok_or_else(|| OperationError::Option(format!("the router did not come up: {}", self.last_words())))
    }

    /// What they wrote to standard error, after they have been ended.
    fn last_words(&mut self) -> String {
        let mut said = Vec::new();
        for (name, child) in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
            let mut text = String::new();
            if let Some(stderr) = child.stderr.as_mut() {
                let _ = stderr.read_to_string(&mut text);
            }
            said.extend(text.lines().map(|line| format!("  {name}: {line}")));
        }
        said.join("\n")
    }
}

impl Drop for Processes {
    fn drop(&mut self) {
        for (_, child) in &mut self.0 {
            // Those that have ended by themselves are gone already.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn digests(lap: &Lap<'_>) -> [u64; 4] {
    lap.each_ref()
        .map(|sample| sample.digest.as_ref().and_then(|text| u64::from_str_radix(text, 16).ok()).unwrap_or_default())
}

/// The first signal, in the order of the ring, that is not the same bit for bit.
fn first_difference(k: u64, twin: &Twin, lap: &Lap<'_>) -> FirstDifference {
    let here = Snapshot::of(twin);
    for (service, sample) in RING.iter().zip(lap) {
        for (path, there) in &sample.data.signals {
            let differs = match there {
                Shape::Numbers(numbers) => here.named(path).is_none_or(|values| {
                    values.len() != numbers.len()
                        || values.iter().zip(numbers).any(|(a, b)| (a + 0.0).to_bits() != (b + 0.0).to_bits())
                }),
                Shape::Label(label) => !here.labels.iter().any(|(signal, value)| signal.path == path && value == label),
            };
            if differs {
                let (service, signal, there) = ((*service).to_owned(), path.clone(), format!("{there:?}"));
                let here = here.named(path).map_or_else(|| "another label, or none".to_owned(), |v| format!("{v:?}"));
                return FirstDifference { tick: k, service, signal, here, there };
            }
        }
    }
    let services = digests(lap).into_iter().zip(twin.digests).zip(RING).filter(|((a, b), _)| a != b);
    let service = services.map(|(_, name)| name).collect::<Vec<_>>().join(", ");
    let signal = "a signal that is shown here and not there".to_owned();
    FirstDifference { tick: k, service, signal, here: String::new(), there: String::new() }
}
