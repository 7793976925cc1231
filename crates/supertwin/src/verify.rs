//! `supertwin verify`: the same bits in one process, in separate processes, and over a bad link.

use crate::cli::{Cli, TrialsArguments, positive};
use crate::clock::Stopwatch;
use crate::failure::{Failure, INTERRUPTED};
use crate::output;
use crate::placement::{stop_flag, unique};
use clap::Args;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use comfy_table::{CellAlignment, ContentArrangement, Table};
use serde::Serialize;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use supertwin_core::digest::{DigestProbe, RunDigest};
use supertwin_core::observe::Snapshot;
use supertwin_core::{Observe, Tick};
use supertwin_lab::mission::Mission;
use supertwin_lab::{ResolvedTrial, Twin};
use supertwin_protocol::{FaultRates, Shape, SystemClock, keys};
use supertwin_zenoh::witness::{Lap, RING};
use supertwin_zenoh::{Link, Mailbox, WitnessOptions, close, witness};

/// Arguments of `verify`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin verify                               the paper's three trials, 60 s each
  supertwin verify paper-agsta --duration 10
  supertwin verify --router tcp/127.0.0.1:7447   over a router that runs already, such as a stock zenohd

Each trial runs in one process; as four processes in lock step, connected only through a router; and again with a
tenth of all messages lost and a tenth sent twice.
Exit status: 0 the same bits everywhere, 1 not, 2 the call or its input is wrong, 130 interrupted.")]
pub(crate) struct VerifyArguments {
    #[command(flatten)]
    trials: TrialsArguments,

    /// Simulated seconds
    #[arg(long, value_name = "S", default_value = "60", value_parser = positive)]
    duration: f64,

    /// Use this router instead of starting one
    #[arg(long, value_name = "ENDPOINT")]
    router: Option<String>,

    /// Print one JSON object instead of a table
    #[arg(long)]
    json: bool,
}

/// Name of the witness.
const WITNESS: &str = "verify";

/// One placement of one trial.
#[derive(Debug, Serialize)]
struct Row {
    trial: String,
    placement: &'static str,
    hash: Option<String>,
    ticks: u64,
    wall_s: f64,
    laps_per_s: f64,
    first_difference: Option<Difference>,
    error: Option<String>,
}

/// Where two placements part.
#[derive(Clone, Debug, Serialize)]
struct Difference {
    tick: u64,
    service: String,
    signal: String,
    here: String,
    there: String,
}

/// The JSON object of `--json`.
#[derive(Debug, Serialize)]
struct Report<'a> {
    equal: bool,
    rows: &'a [Row],
}

/// Does it.
pub(crate) fn verify(cli: &Cli, arguments: &VerifyArguments) -> Result<ExitCode, Failure> {
    let library = cli.library();
    let mailbox = Arc::new(Mailbox::default());
    let stop = stop_flag(&mailbox)?;
    let trials = arguments.trials.load(&library)?;
    let mut rows = Vec::new();
    for trial in &trials {
        let ticks = Tick::at_or_after(arguments.duration, trial.trial.tick_s.get());
        rows.push(in_one_process(trial, ticks)?);
        for (placement, faults) in [("four processes", None), ("four processes, bad link", Some((0.1, 0.1)))] {
            let job = Job { cli, arguments, trial, ticks, placement, faults };
            rows.push(job.run(&stop)?);
            if stop.load(std::sync::atomic::Ordering::Relaxed) {
                return Ok(ExitCode::from(INTERRUPTED));
            }
        }
    }
    let equal = rows.chunks(3).all(|rows| rows.iter().all(|row| row.hash.is_some() && row.hash == rows[0].hash));
    report(&rows, equal, arguments.json)?;
    Ok(if equal { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// The ring of one process, tick by tick.
struct Reference<'a> {
    trial: &'a ResolvedTrial,
    twin: Twin,
    mission: Mission,
    probe: DigestProbe,
}

impl<'a> Reference<'a> {
    fn new(trial: &'a ResolvedTrial) -> Result<Self, Failure> {
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

fn in_one_process(trial: &ResolvedTrial, ticks: u64) -> Result<Row, Failure> {
    let stopwatch = Stopwatch::start();
    let mut reference = Reference::new(trial)?;
    let done = (0..ticks).take_while(|k| reference.step(*k)).count() as u64;
    let wall_s = stopwatch.elapsed_s();
    Ok(Row {
        trial: trial.name.clone(),
        placement: "one process",
        hash: Some(reference.twin.run_digest().to_string()),
        ticks: done,
        wall_s,
        laps_per_s: done as f64 / wall_s,
        first_difference: None,
        error: None,
    })
}

/// One trial in separate processes.
struct Job<'a> {
    cli: &'a Cli,
    arguments: &'a VerifyArguments,
    trial: &'a ResolvedTrial,
    ticks: u64,
    placement: &'static str,
    faults: Option<(f64, f64)>,
}

impl Job<'_> {
    fn run(&self, stop: &AtomicBool) -> Result<Row, Failure> {
        let mut processes = Processes::default();
        let endpoint = match &self.arguments.router {
            Some(endpoint) => endpoint.clone(),
            None => processes.router(self.cli)?,
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
            processes.spawn(service, self.service(service, &endpoint, &vehicle))?;
        }
        let mut reference = Reference::new(self.trial)?;
        let mut digest = RunDigest::default();
        let mut difference = None;
        let progress =
            output::progress(&format!("{}, {}", self.trial.name, self.placement), self.ticks, self.arguments.json);
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
            began.get_or_insert_with(Stopwatch::start);
            let there = digests(lap);
            digest.fold(Tick { k, dt_s: self.trial.trial.tick_s.get() }, there);
            done = k + 1;
            progress.inc(1);
            let finite = reference.step(k);
            if finite && reference.twin.digests() == there {
                return true;
            }
            difference = Some(first_difference(k, &reference.twin, lap));
            false
        });
        progress.finish_and_clear();
        let wall_s = began.map_or(0.0, Stopwatch::elapsed_s);
        let mut error = looked.err().map(|error| error.to_string());
        if error.is_some() {
            let said = processes.last_words();
            error = error.map(|error| if said.is_empty() { error } else { format!("{error}\n{said}") });
        }
        close(&session);
        Ok(Row {
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

    fn service(&self, service: &str, endpoint: &str, vehicle: &str) -> Vec<String> {
        let mut words: Vec<String> = common(self.cli);
        words.extend(["serve", service, "--pace", "lockstep", "--connect", endpoint].map(str::to_owned));
        words.extend(["--vehicle".to_owned(), vehicle.to_owned()]);
        words.extend(["--trial".to_owned(), self.trial.path.display().to_string()]);
        words.extend(["--controller".to_owned(), self.trial.controller_name.clone()]);
        words.extend(["--duration".to_owned(), self.arguments.duration.to_string()]);
        if service == "plant" {
            words.extend(["--witness".to_owned(), WITNESS.to_owned()]);
        }
        if let Some((drop, double)) = self.faults {
            words.push(format!("--fault-drop={drop}"));
            words.push(format!("--fault-double={double}"));
        }
        words
    }
}

/// Options that every child shares with its parent.
fn common(cli: &Cli) -> Vec<String> {
    let mut words = vec!["--config".to_owned(), cli.library().root().display().to_string()];
    for set in &cli.set {
        words.extend(["--set".to_owned(), set.text.clone()]);
    }
    words
}

/// Children that end with their parent.
#[derive(Default)]
struct Processes(Vec<(&'static str, Child)>);

impl Processes {
    fn start(&mut self, name: &'static str, words: Vec<String>) -> Result<&mut Child, Failure> {
        let wrong = |cause: std::io::Error| Failure::Call(format!("{name} can't be started: {cause}"));
        let program = std::env::current_exe().map_err(wrong)?;
        let child = Command::new(program)
            .args(words)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(wrong)?;
        self.0.push((name, child));
        self.0.last_mut().map(|(_, child)| child).ok_or_else(|| Failure::Call("no process".to_owned()))
    }

    fn spawn(&mut self, name: &'static str, words: Vec<String>) -> Result<(), Failure> {
        self.start(name, words).map(drop)
    }

    /// Starts a router and returns where it listens.
    fn router(&mut self, cli: &Cli) -> Result<String, Failure> {
        let mut words = common(cli);
        words.extend(["serve", "router", "--listen", "tcp/127.0.0.1:0", "--json"].map(str::to_owned));
        let child = self.start("router", words)?;
        let mut line = String::new();
        if let Some(stdout) = child.stdout.as_mut() {
            // A router that dies says nothing, and that is found below.
            let _ = BufReader::new(stdout).read_line(&mut line);
        }
        let value: serde_json::Value = serde_json::from_str(&line).unwrap_or_default();
        let found = value["listening"].as_array().into_iter().flatten().filter_map(|place| place.as_str());
        let tcp = found.filter(|place| place.starts_with("tcp/")).map(str::to_owned).next();
        tcp.ok_or_else(|| Failure::Call(format!("the router did not come up: {}", self.last_words())))
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
fn first_difference(k: u64, twin: &Twin, lap: &Lap<'_>) -> Difference {
    let here = Snapshot::of(&Shown(twin));
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
                return Difference {
                    tick: k,
                    service: (*service).to_owned(),
                    signal: path.clone(),
                    here: here.named(path).map_or_else(|| "another label, or none".to_owned(), |v| format!("{v:?}")),
                    there: format!("{there:?}"),
                };
            }
        }
    }
    let services = digests(lap).into_iter().zip(twin.digests()).zip(RING).filter(|((a, b), _)| a != b);
    let service = services.map(|(_, name)| name).collect::<Vec<_>>().join(", ");
    let signal = "a signal that is shown here and not there".to_owned();
    Difference { tick: k, service, signal, here: String::new(), there: String::new() }
}

struct Shown<'a>(&'a Twin);
impl Observe for Shown<'_> {
    fn observe<P: supertwin_core::Probe>(&self, probe: &mut P) {
        self.0.observe(probe);
    }
}

fn report(rows: &[Row], equal: bool, json: bool) -> Result<(), Failure> {
    if json {
        let text = serde_json::to_string_pretty(&Report { equal, rows })
            .map_err(|cause| Failure::Call(format!("the report can't be written as JSON: {cause}")))?;
        output::print(&text);
        return Ok(());
    }
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED).set_content_arrangement(ContentArrangement::Disabled).set_header([
        "trial",
        "placement",
        "state hash",
        "ticks",
        "laps/s",
    ]);
    for row in rows {
        let hash = row.hash.clone().unwrap_or_else(|| "differs".to_owned());
        let laps = format!("{:.0}", row.laps_per_s);
        table.add_row([row.trial.clone(), row.placement.to_owned(), hash, row.ticks.to_string(), laps]);
    }
    for column in table.column_iter_mut().skip(3) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    output::print(&table.to_string());
    for row in rows {
        if let Some(d) = &row.first_difference {
            output::print(&format!(
                "{}, {}: differs first at tick {} in {} ({}): {} here, {} there",
                row.trial, row.placement, d.tick, d.signal, d.service, d.here, d.there
            ));
        }
        if let Some(error) = &row.error {
            output::print(&format!("{}, {}: {error}", row.trial, row.placement));
        }
    }
    output::print(if equal { "Equal: the same bits at every tick." } else { "Not equal." });
    Ok(())
}
